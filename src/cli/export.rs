//! `neumip export`.

use super::console::Console;
use crate::error::Result;
use crate::{checkpoint, golden};
use clap::Args;
use neumip_export::{BundleFile, Checkpoint, write_bundle};
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
        let files = bundle(&checkpoint::load(&self.run)?, &self.out, self.force)?;
        for file in &files {
            console.say(format!("{:>10}  {}", file.bytes, self.out.join(&file.name).display()));
        }
        match &self.json {
            Some(path) => super::write_json(path, &files),
            None => Ok(()),
        }
    }
}

/// Writes the bundle of a checkpoint with its golden answers.
pub fn bundle(checkpoint: &Checkpoint, out: &Path, force: bool) -> Result<Vec<BundleFile>> {
    Ok(write_bundle(checkpoint, &golden::answers(checkpoint, golden::QUERIES)?, out, force)?)
}
