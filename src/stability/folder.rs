//! A suite's folder: what is finished is a file, so that a stopped suite goes on.
//!
//! | path | what |
//! | --- | --- |
//! | `scale.json` | how much the suite does |
//! | `data/NAME/`, `runs/NAME/` | datasets and trainings |
//! | `probes/NAME.json` | the outcome of a finished probe |
//! | `prices.json` | what the cures cost |
//! | `pictures/NAME.png`, `NAME.svg` | its picture and its curve |
//! | `stability.json`, `STABILITY.md` | the report over all of them |

use super::probe::{Outcome, Probe};
use super::suite::Finished;
use super::workshop::{Scale, made};
use crate::error::{Error, Result};
use crate::report::figures;
use neumip_export::whole_file::{write_json, write_whole};
use serde::Deserialize;
use std::path::{Path, PathBuf};

const SCALE: &str = "scale.json";

/// The folder of a suite.
#[derive(Clone, Debug)]
pub struct Folder {
    root: PathBuf,
}

impl Folder {
    /// The folder of a suite of this scale, new or as it was left.
    ///
    /// # Errors
    /// `File` if it cannot be made, or holds something else.
    pub fn open(root: &Path, scale: &Scale) -> Result<Self> {
        let this = Self { root: root.to_path_buf() };
        let path = root.join(SCALE);
        if path.is_file() {
            let there: Scale = read(&path)?;
            if there != *scale {
                let problem = format!("holds the {} suite of other sizes; choose another --out", there.name);
                return Err(Error::file(root, problem));
            }
            return Ok(this);
        }
        if std::fs::read_dir(root).ok().and_then(|mut entries| entries.next()).is_some() {
            return Err(Error::file(root, "exists and is no suite's folder; choose another --out"));
        }
        made(Some(root))?;
        write_json(&path, scale)?;
        Ok(this)
    }

    /// The folder itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Where a dataset is.
    pub fn data(&self, name: &str) -> PathBuf {
        self.root.join("data").join(name)
    }

    /// Where a training is.
    pub fn run(&self, name: &str) -> PathBuf {
        self.root.join("runs").join(name)
    }

    /// What a probe found, if it is finished.
    ///
    /// # Errors
    /// `File` if it cannot be read.
    pub fn finished(&self, probe: &Probe) -> Result<Option<Finished>> {
        self.optional(&format!("probes/{}.json", probe.name))
    }

    /// What a file of the folder holds, if it is there.
    ///
    /// # Errors
    /// `File` if it cannot be read.
    pub fn optional<T: for<'a> Deserialize<'a>>(&self, name: &str) -> Result<Option<T>> {
        let path = self.root.join(name);
        if path.is_file() { read(&path).map(Some) } else { Ok(None) }
    }

    /// Keeps what a probe found, pictures first.
    ///
    /// # Errors
    /// `File` if something cannot be written.
    pub fn save(&self, probe: &Probe, outcome: &Outcome, finished: &Finished) -> Result<()> {
        let pictures = self.root.join("pictures");
        made(Some(&pictures))?;
        if let Some((_, png)) = &outcome.picture {
            write_whole(&pictures.join(format!("{}.png", probe.name)), png)?;
        }
        if let Some(plot) = &outcome.plot
            && let Some(svg) = figures::curves(&plot.series, &plot.x, &plot.y)?
        {
            write_whole(&pictures.join(format!("{}.svg", probe.name)), figures::as_file(&svg).as_bytes())?;
        }
        let path = self.root.join("probes").join(format!("{}.json", probe.name));
        made(path.parent())?;
        Ok(write_json(&path, finished)?)
    }

    /// True where a file of the report is there.
    pub fn has(&self, name: &str) -> bool {
        self.root.join(name).is_file()
    }
}

fn read<T: for<'a> Deserialize<'a>>(path: &Path) -> Result<T> {
    let bytes = std::fs::read(path).map_err(|e| Error::file(path, format!("cannot be read: {e}")))?;
    serde_json::from_slice(&bytes).map_err(|e| Error::file(path, format!("is not what its name says: {e}")))
}
