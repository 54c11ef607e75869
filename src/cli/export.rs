//! `neumip export`.

use super::console::Console;
use crate::error::{Error, Result};
use crate::onnx_material::{OnnxMaterial, largest_difference};
use crate::query::{QueryBuffer, Reflectance};
use crate::{checkpoint, golden};
use clap::Args;
use neumip_export::bundle::MATERIAL;
use neumip_export::{BundleFile, Checkpoint, write_bundle};
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
        let bundle = bundle(&checkpoint::load(&self.run)?, &self.out, self.force)?;
        for file in &bundle.files {
            console.say(format!("{:>10}  {}", file.bytes, self.out.join(&file.name).display()));
        }
        console.say(format!("material.onnx answers within {:.1e} (1 + |value|) of the model", bundle.difference));
        match &self.json {
            Some(path) => super::write_json(path, &bundle),
            None => Ok(()),
        }
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

/// Writes the bundle of a checkpoint with its golden answers, and checks its graph with an engine that is not ours.
pub fn bundle(checkpoint: &Checkpoint, out: &Path, force: bool) -> Result<Written> {
    let golden = golden::answers(checkpoint, golden::QUERIES)?;
    let files = write_bundle(checkpoint, &golden, out, force)?;
    let graph = out.join(MATERIAL);
    let n = golden.level.len();
    let queries = QueryBuffer::new(1, n, golden.u, golden.wi, golden.wo, golden.level)?;
    let answers = OnnxMaterial::open(&graph)?.evaluate(&queries)?.pixels;
    let difference = largest_difference(&answers, &golden.rgb);
    if difference.is_nan() || difference > golden.tolerance {
        let problem = format!("answers differ by {difference:.1e} (1 + |value|), more than {:.0e}", golden.tolerance);
        return Err(Error::file(graph, problem));
    }
    Ok(Written { files, difference })
}
