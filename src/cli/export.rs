//! `neumip export`.

use super::console::Console;
use crate::error::{Error, Result};
use crate::onnx_material::{OnnxMaterial, largest_difference};
use crate::query::{QueryBuffer, Reflectance};
use crate::{checkpoint, golden};
use clap::Args;
use neumip_export::bundle::MATERIAL;
use neumip_export::{BundleFile, Checkpoint, Golden, onnx, write_bundle};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Write what another renderer needs: ONNX graphs, textures, conventions, golden answers.
#[derive(Debug, Args)]
#[command(after_help = "Example: neumip export runs/metal --out bundles/metal")]
pub struct Export {
    /// A run's folder or a checkpoint.
    run: PathBuf,
    /// The bundle's folder.
    #[arg(long)]
    out: PathBuf,
    /// Replace an existing bundle.
    #[arg(long)]
    force: bool,
    /// Write the list of files here.
    #[arg(long)]
    json: Option<PathBuf>,
}

impl Export {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        super::check_json(self.json.as_deref())?;
        let bundle = bundle(&checkpoint::load(&self.run)?, &self.out, self.force)?;
        for file in &bundle.files {
            console.say(format!("{:>10}  {}", file.bytes, self.out.join(&file.name).display()));
        }
        console.say(format!(
            "material.onnx answers within {:.1e} (1 + |value|) of the model",
            bundle.difference
        ));
        super::save_json(self.json.as_deref(), &bundle)
    }
}

/// A bundle that was written and checked.
#[derive(Clone, Debug, Serialize)]
pub struct Written {
    /// Its files.
    pub files: Vec<BundleFile>,
    /// Largest |difference| / (1 + |value|) of its graph's golden answers.
    pub difference: f64,
}

/// Writes the bundle of a checkpoint with its golden answers, once an engine that is not ours gives the same from its graph.
pub fn bundle(checkpoint: &Checkpoint, out: &Path, force: bool) -> Result<Written> {
    let golden = golden::answers(checkpoint, golden::QUERIES)?;
    let difference = difference(checkpoint, &golden, &out.join(MATERIAL))?;
    Ok(Written { files: write_bundle(checkpoint, &golden, out, force)?, difference })
}

/// Runs the graph that is about to be written as `path`.
fn difference(checkpoint: &Checkpoint, golden: &Golden, path: &Path) -> Result<f64> {
    let graph = OnnxMaterial::from_bytes(path, onnx::material_graph(checkpoint)?)?;
    let Golden { u, wi, wo, level, rgb, tolerance } = golden.clone();
    let queries = QueryBuffer::new(1, level.len(), u, wi, wo, level)?;
    let difference = largest_difference(&graph.evaluate(&queries)?.pixels, &rgb);
    if difference.is_nan() || difference > tolerance {
        let problem = format!("would answer {difference:.1e} (1 + |value|) off, more than {tolerance:.0e}");
        return Err(Error::file(path, problem));
    }
    Ok(difference)
}
