//! Results as they are kept: `results.json`, one object for each material, variant, seed, regime, split and level.
//!
//! Files of several machines and days are merged: a cell is known by what was trained and what was asked, and the file
//! that is merged in last says what came of it.

mod cell;

pub use cell::{Cell, Metrics, Trial};

use crate::error::{Error, Result};
use neumip_export::whole_file::write_json;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Version of the format that is written and read.
pub const FORMAT: u32 = 1;
/// Name of the file inside a folder of results.
pub const FILE: &str = "results.json";

/// What was measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Results {
    /// Version of the format.
    pub format: u32,
    /// Program and version.
    pub generator: String,
    /// Machines that took part: processor, cores, and the program's commit where it is known.
    #[serde(default)]
    pub machines: Vec<String>,
    /// Tuning trials, in the order in which they were run.
    #[serde(default)]
    pub trials: Vec<Trial>,
    /// What was measured.
    pub cells: Vec<Cell>,
}

impl Default for Results {
    fn default() -> Self {
        Self {
            format: FORMAT,
            generator: format!("neumip {}", env!("CARGO_PKG_VERSION")),
            machines: Vec::new(),
            trials: Vec::new(),
            cells: Vec::new(),
        }
    }
}

impl Results {
    /// Reads a file.
    ///
    /// # Errors
    /// `File` if it cannot be read, is no such file or has another format.
    pub fn read(path: &Path) -> Result<Self> {
        let failed = |problem: String| Error::file(path, problem);
        let bytes = std::fs::read(path).map_err(|e| failed(format!("cannot be read: {e}")))?;
        let value: serde_json::Value =
            serde_json::from_slice(&bytes).map_err(|e| failed(format!("is no results file: {e}")))?;
        // The version comes first: another one may have other fields.
        match value.get("format").and_then(serde_json::Value::as_u64) {
            Some(version) if version == u64::from(FORMAT) => {}
            Some(version) => {
                return Err(failed(format!("has format {version}; this program reads {FORMAT}")));
            }
            None => return Err(failed("has no field format: it is no results file".into())),
        }
        serde_json::from_value(value).map_err(|e| failed(format!("is no results file: {e}")))
    }

    /// Writes the file, whole or not at all.
    ///
    /// # Errors
    /// `File` if it cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        Ok(write_json(path, self)?)
    }

    /// Takes in other results: what both have is replaced, what is new is added, and all is put in order.
    pub fn merge(&mut self, other: Self) {
        self.machines.extend(other.machines);
        self.machines.sort();
        self.machines.dedup();
        for trial in other.trials {
            match self.trials.iter_mut().find(|mine| mine.key() == trial.key()) {
                Some(mine) => *mine = trial,
                None => self.trials.push(trial),
            }
        }
        self.trials.sort_by(|a, b| a.key().cmp(&b.key()));
        let cells = std::mem::take(&mut self.cells).into_iter().chain(other.cells);
        let all: BTreeMap<_, Cell> = cells.map(|cell| (cell.key(), cell)).collect();
        self.cells = all.into_values().collect();
    }
}
