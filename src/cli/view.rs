//! `neumip view`.

use super::console::Console;
use crate::dataset::read_query_frame;
use crate::error::{Error, Result};
use crate::view::{Reference, html};
use clap::Args;
use neumip_export::read_bundle;
use neumip_export::whole_file::write_whole;
use std::path::PathBuf;

/// Make a page that shows a bundle's material on a plane, a sphere, a torus and a cloth, in any browser with WebGL 2.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  neumip view bundles/metal --out metal.html\n  \
    neumip view bundles/metal --reference data/metal/views-s4.exr --out metal.html")]
pub struct View {
    /// A bundle's folder.
    bundle: PathBuf,
    /// The page: one file that needs no other and no network.
    #[arg(long)]
    out: PathBuf,
    /// A query-buffer EXR with true answers (a view of a dataset): the page shows the material's answers beside them, and
    /// the differences in false colours.
    #[arg(long)]
    reference: Option<PathBuf>,
    /// Replace an existing file.
    #[arg(long)]
    force: bool,
}

impl View {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        super::check_json(Some(&self.out))?;
        if self.out.exists() && !self.force {
            return Err(Error::file(&self.out, "exists: name another file or add --force"));
        }
        let bundle = read_bundle(&self.bundle)?;
        let reference = match &self.reference {
            None => None,
            Some(path) => {
                let (queries, rgb) = read_query_frame(path)?;
                let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
                Some(Reference { name, queries, rgb })
            }
        };
        let page = html(&bundle, reference.as_ref())?;
        write_whole(&self.out, page.as_bytes())?;
        console.say(format!("{:>10}  {}", page.len(), self.out.display()));
        console.say("open it in a browser; ? lists its keys");
        Ok(())
    }
}
