//! `neumip export`.

use super::console::Console;
use crate::error::{Error, Result};
use crate::onnx_material::{OnnxMaterial, largest_difference};
use crate::query::QueryBuffer;
use crate::{checkpoint, golden};
use clap::Args;
use neumip_export::bundle::MATERIAL;
use neumip_export::{BundleFile, Checkpoint, Golden, Precision, TexturePrecision, onnx, write_bundle_as};
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
    /// Round the textures to half floats before anything is written, store them so in material.onnx, and say what that
    /// changes of the answers.
    #[arg(long)]
    half_textures: bool,
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
        let textures = if self.half_textures { Precision::Half } else { Precision::Single };
        let bundle = bundle_as(&checkpoint::load(&self.run)?, textures, &self.out, self.force)?;
        for file in &bundle.files {
            console.say(format!("{:>10}  {}", file.bytes, self.out.join(&file.name).display()));
        }
        console.say(format!(
            "material.onnx answers within {:.1e} (1 + |value|) of the model",
            bundle.difference
        ));
        if let Some(cost) = &bundle.texture_precision {
            console.say(format!(
                "half textures move the answers by at most {:.1e} (1 + |value|), {:.1e} in the mean",
                cost.largest_difference, cost.mean_difference
            ));
        }
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
    /// What rounding the textures cost, where they were.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub texture_precision: Option<TexturePrecision>,
}

/// Writes the bundle of a checkpoint with its golden answers, once an engine that is not ours gives the same from its graph.
pub fn bundle(checkpoint: &Checkpoint, out: &Path, force: bool) -> Result<Written> {
    bundle_as(checkpoint, Precision::Single, out, force)
}

/// As [`bundle`], with textures rounded to a precision before anything is written.
pub fn bundle_as(checkpoint: &Checkpoint, textures: Precision, out: &Path, force: bool) -> Result<Written> {
    match textures {
        Precision::Single => {
            let golden = golden::answers(checkpoint, golden::QUERIES)?;
            checked(checkpoint, &golden, None, out, force)
        }
        Precision::Half => {
            let rounded = golden::rounded(checkpoint, textures, golden::QUERIES)?;
            checked(&rounded.checkpoint, &rounded.golden, Some(rounded.cost), out, force)
        }
    }
}

fn checked(
    checkpoint: &Checkpoint,
    golden: &Golden,
    texture_precision: Option<TexturePrecision>,
    out: &Path,
    force: bool,
) -> Result<Written> {
    let textures = texture_precision.map_or(Precision::Single, |p| p.storage);
    let difference = difference(checkpoint, textures, golden, &out.join(MATERIAL))?;
    let files = write_bundle_as(checkpoint, golden, texture_precision, out, force)?;
    Ok(Written { files, difference, texture_precision })
}

/// Runs the graph that is about to be written as `path`.
fn difference(checkpoint: &Checkpoint, textures: Precision, golden: &Golden, path: &Path) -> Result<f64> {
    let graph = OnnxMaterial::from_bytes(path, onnx::material_graph_as(checkpoint, textures)?)?;
    let Golden { u, wi, wo, level, rgb, tolerance, images } = golden.clone();
    let queries = QueryBuffer::new(1, level.len(), u, wi, wo, level)?;
    let difference = largest_difference(&graph.answers(&queries, images)?, &rgb);
    if difference.is_nan() || difference > tolerance {
        let problem = format!("would answer {difference:.1e} (1 + |value|) off, more than {tolerance:.0e}");
        return Err(Error::file(path, problem));
    }
    Ok(difference)
}
