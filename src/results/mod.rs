//! Results as they are kept: `results.json`, one object for each material, variant, seed, regime, split and level.
//!
//! Files of several machines and days are merged: a cell is known by what was trained and what was asked, and the file
//! that is merged in last says what came of it.

mod cell;

pub use cell::{Cell, Metrics, RunKey, Trial};

use crate::error::{Error, Result};
use neumip_export::whole_file::write_whole;
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

    /// Writes the file, whole or not at all: a line a cell, numbers of six digits, so that versions can be compared.
    ///
    /// # Errors
    /// `File` if it cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let failed = |e: serde_json::Error| Error::file(path, e);
        let text = |value: &str| serde_json::to_string(value).map_err(failed);
        let mut out =
            format!("{{\n\"format\": {},\n\"generator\": {},\n", self.format, text(&self.generator)?);
        out += &format!("\"machines\": {},\n", serde_json::to_string(&self.machines).map_err(failed)?);
        out += &format!("\"trials\": [{}],\n", lines(&self.trials).map_err(failed)?);
        out += &format!("\"cells\": [{}]\n}}\n", lines(&self.cells).map_err(failed)?);
        Ok(write_whole(path, out.as_bytes())?)
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
        self.trials.sort_by_key(Trial::key);
        let cells = std::mem::take(&mut self.cells).into_iter().chain(other.cells);
        let all: BTreeMap<_, Cell> = cells.map(|cell| (cell.key(), cell)).collect();
        self.cells = all.into_values().collect();
    }
}

/// A line an item, its numbers rounded.
fn lines(items: &[impl Serialize]) -> serde_json::Result<String> {
    let line = |item| Ok(rounded(serde_json::to_value(item)?).to_string());
    let all: Vec<String> = items.iter().map(line).collect::<serde_json::Result<_>>()?;
    Ok(if all.is_empty() { String::new() } else { format!("\n{}\n", all.join(",\n")) })
}

/// Digits that are kept: no figure here is known to more.
const DIGITS: usize = 6;

/// The value with its floating-point numbers rounded.
fn rounded(value: serde_json::Value) -> serde_json::Value {
    use serde_json::Value;
    match value {
        Value::Number(number) if number.is_f64() => {
            let digits = DIGITS - 1;
            let short = number.as_f64().and_then(|v| format!("{v:.digits$e}").parse::<f64>().ok());
            short.map_or(Value::Number(number), Value::from)
        }
        Value::Array(items) => items.into_iter().map(rounded).collect(),
        Value::Object(fields) => fields.into_iter().map(|(name, value)| (name, rounded(value))).collect(),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(preset: &str, seed: u64, mse: f64) -> Cell {
        Cell {
            material: "rocks".into(),
            preset: preset.into(),
            seed,
            resolution: [16, 16],
            samples_per_texel: 1200.0,
            unique_samples_per_texel: 120.0,
            regime: "scattered".into(),
            split: "test".into(),
            level: Some(0),
            metrics: Metrics { mse: Some(mse), ..Metrics::default() },
            noise: None,
            ns_per_query: None,
            bytes: 100,
            flops: 10,
            engine: "fused".into(),
        }
    }

    #[test]
    fn what_is_written_is_read_and_merging_replaces_and_adds() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        let mut first = Results { cells: vec![cell("a", 1, 0.25), cell("b", 1, 0.5)], ..Results::default() };
        first.write(&path).unwrap();
        assert_eq!(Results::read(&path).unwrap(), first);
        let second = Results { cells: vec![cell("b", 2, 1.0), cell("a", 1, 0.125)], ..Results::default() };
        first.merge(second.clone());
        let values: Vec<_> = first.cells.iter().map(|c| (c.preset.as_str(), c.seed, c.metrics.mse)).collect();
        assert_eq!(values, [("a", 1, Some(0.125)), ("b", 1, Some(0.5)), ("b", 2, Some(1.0))]);
        let before = first.clone();
        first.merge(second);
        assert_eq!(first, before);
    }

    #[test]
    fn numbers_are_rounded_and_files_of_others_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        let exact = Results { cells: vec![cell("a", 1, 1.0 / 3.0)], ..Results::default() };
        exact.write(&path).unwrap();
        assert_eq!(Results::read(&path).unwrap().cells[0].metrics.mse, Some(0.333333));
        for (text, problem) in
            [("{}", "no field format"), ("{\"format\": 9}", "format 9"), ("x", "no results file")]
        {
            std::fs::write(&path, text).unwrap();
            let error = Results::read(&path).unwrap_err().to_string();
            assert!(error.contains(problem) && error.contains(FILE), "{error}");
        }
    }
}
