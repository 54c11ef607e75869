//! `neumip info`.

use super::console::Console;
use crate::checkpoint::{RunFolder, of_fit};
use crate::dataset::{Dataset, MANIFEST};
use crate::error::{Error, Result};
use clap::Args;
use neumip_export::{Checkpoint, Sampler, read_bundle};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Say what a checkpoint, run, dataset or bundle is.
#[derive(Debug, Args)]
#[command(after_help = "Example: neumip info runs/metal/best.safetensors")]
pub struct Info {
    /// A checkpoint or sampler file, or the folder of a run, dataset or bundle.
    path: PathBuf,
    /// Write it here as JSON too.
    #[arg(long)]
    json: Option<PathBuf>,
}

impl Info {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        let value = describe(&self.path)?;
        let text = serde_json::to_string_pretty(&value).map_err(|e| Error::file(&self.path, e))?;
        super::save_json(self.json.as_deref(), &value)?;
        console.answer(text)
    }
}

fn describe(path: &Path) -> Result<Value> {
    if !path.exists() {
        return Err(Error::file(path, "no such file or folder"));
    }
    if path.is_file() {
        return match Sampler::read(path) {
            Ok(sampler) => Ok(json!({ "kind": "sampler", "sampler": sampler.header })),
            // A damaged file is more likely to be what most files are.
            Err(_) => Ok(checkpoint(&Checkpoint::read(path)?)),
        };
    }
    if path.join(MANIFEST).is_file() {
        let data = Dataset::open(path)?;
        return Ok(json!({ "kind": "dataset", "dataset": data.manifest() }));
    }
    if path.join("run.json").is_file() {
        let (folder, record) = RunFolder::open(path)?;
        let answering = folder.answering_checkpoint()?;
        return Ok(json!({
            "kind": "run",
            "data": record.data,
            "config": record.config,
            "checkpoint": answering.file_name().map(|n| n.to_string_lossy()),
            "answers": checkpoint(&Checkpoint::read(&answering)?),
        }));
    }
    if path.join("material.json").is_file() && path.join("golden.json").is_file() {
        let bundle = read_bundle(path)?;
        return Ok(json!({ "kind": "bundle", "material": bundle.sidecar }));
    }
    if let Some(best) = of_fit(path) {
        let fit = std::fs::read(path.join("fit.json")).ok();
        let figures: Value = fit.and_then(|bytes| serde_json::from_slice(&bytes).ok()).unwrap_or(Value::Null);
        return Ok(
            json!({ "kind": "fit", "figures": figures, "answers": checkpoint(&Checkpoint::read(&best)?) }),
        );
    }
    Err(Error::file(path, "is no run, dataset or bundle: it has none of run.json, dataset.json, golden.json"))
}

fn checkpoint(checkpoint: &Checkpoint) -> Value {
    let header = &checkpoint.header;
    let architecture = &header.architecture;
    let mut value = json!({
        "kind": "checkpoint",
        "format": header.format,
        "material": header.material,
        "measure": header.measure,
        "height_range": header.height_range,
        "resolution": architecture.resolution,
        "levels": architecture.levels(),
        "finest_stored_level": architecture.model.texture.finest,
        "weights": architecture.network_weights(),
        "texture_values": architecture.texture_values(),
        "bytes": architecture.bytes(),
        "flops_per_query": architecture.flops_per_query(),
        "model": architecture.model,
        "provenance": header.provenance,
        "errors": header.errors,
        "tensors": checkpoint.tensors.iter().map(|(n, t)| (n.clone(), json!(t.shape))).collect::<serde_json::Map<_, _>>(),
    });
    if let Some(domain) = &architecture.domain {
        value["domain"] = json!({
            "meaning": domain.explained(architecture.resolution, architecture.coarsest()),
            "bounds": domain,
        });
    }
    value
}
