//! A run's folder: checkpoints and the state that training goes on from.
//!
//! | file | what |
//! | --- | --- |
//! | `run.json` | configuration, data and what the run is |
//! | `best.safetensors` | checkpoint with the lowest validation error |
//! | `last-G.safetensors`, `last-G.state.safetensors` | newest checkpoint and optimiser state of generation (step) G |
//! | `history.json` | losses and validation errors over the run |
//! | `stability.json` | what the probes that need no training found on it |
//!
//! A checkpoint holds textures as queries read them; the state holds the variables themselves (unsmoothed) with Adam's
//! moments. Every file is written to a sibling and renamed, the state after its checkpoint; the previous pair goes only when
//! the new one is complete, so the newest matching pair is always whole.

use crate::config::Config;
use crate::error::{Error, Result};
use neumip_export::checkpoint::Checkpoint;
use neumip_export::tensors::{Tensor, read_tensors, write_tensors};
use neumip_export::whole_file::write_json;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const STATE_KEY: &str = "neumip-state";
const STATE_SUFFIX: &str = ".state.safetensors";
const CHECKPOINT_SUFFIX: &str = ".safetensors";
const RECORD: &str = "run.json";
const BEST: &str = "best.safetensors";
const HISTORY: &str = "history.json";
const STABILITY: &str = "stability.json";
/// Version of `run.json` and of the state file.
const FORMAT: u32 = 1;

/// What `run.json` says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunRecord {
    /// Version of the folder's format.
    pub format: u32,
    /// What is trained and how.
    pub config: Config,
    /// Identity of the training data: see [`crate::dataset::Dataset::identity`].
    pub data: String,
    /// Bytes of training data kept in memory, which decide the order of reading.
    pub memory: usize,
}

impl RunRecord {
    /// The record of a run.
    pub fn new(config: Config, data: String, memory: usize) -> Self {
        Self { format: FORMAT, config, data, memory }
    }
}

/// A run's folder.
#[derive(Clone, Debug)]
pub struct RunFolder {
    path: PathBuf,
}

/// The state file's content.
pub struct State {
    /// Optimiser steps done.
    pub generation: u64,
    /// The trainer's progress as JSON.
    pub progress: serde_json::Value,
    /// Variables and moments, prefixed `value.`, `first.`, `second.`.
    pub tensors: BTreeMap<String, Tensor>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StateHeader {
    format: u32,
    generation: u64,
    progress: serde_json::Value,
}

impl RunFolder {
    /// Makes the folder. An existing one is refused; with `force` a run's files are removed from it and no others.
    ///
    /// # Errors
    /// `File` if it exists or cannot be made.
    pub fn create(path: &Path, record: &RunRecord, force: bool) -> Result<Self> {
        let this = Self { path: path.to_path_buf() };
        if path.exists() {
            if !force {
                return Err(Error::file(
                    path,
                    "exists; choose another --out, --resume it, or replace it with --force",
                ));
            }
            let foreign = this.names()?.into_iter().find(|name| !is_ours(name));
            if let Some(name) = foreign.filter(|_| !this.holds_a_record()) {
                let problem = format!("is not a run's folder, it holds {name}; --force replaces only runs");
                return Err(Error::file(path, problem));
            }
            // The record goes last: until then the folder is a run's and can be replaced again.
            this.remove(|name| is_ours(name) && name != RECORD)?;
        }
        std::fs::create_dir_all(path).map_err(|e| Error::file(path, format!("cannot be made: {e}")))?;
        this.write_json(RECORD, record)?;
        Ok(this)
    }

    /// True if `run.json` is a run's; other programs have files of that name.
    fn holds_a_record(&self) -> bool {
        let text = std::fs::read_to_string(self.path.join(RECORD)).unwrap_or_default();
        let record: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
        ["format", "config", "data", "memory"].iter().all(|field| record.get(field).is_some())
    }

    /// An existing run.
    ///
    /// # Errors
    /// `File` if it is not a run's folder or of an unknown version.
    pub fn open(path: &Path) -> Result<(Self, RunRecord)> {
        let file = path.join(RECORD);
        let text = std::fs::read_to_string(&file)
            .map_err(|e| Error::file(&file, format!("cannot be read: {e}; is this a run's folder?")))?;
        let record: RunRecord = serde_json::from_str(&text)
            .map_err(|e| Error::file(&file, format!("not a run's record: {e}")))?;
        if record.format != FORMAT {
            return Err(Error::file(file, format!("format {}; this program reads {FORMAT}", record.format)));
        }
        record.config.train.validate().map_err(|e| Error::file(&file, e))?;
        Ok((Self { path: path.to_path_buf() }, record))
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes a JSON file of the folder.
    ///
    /// # Errors
    /// `File` if it cannot be written.
    pub fn write_json(&self, name: &str, value: &impl Serialize) -> Result<()> {
        Ok(write_json(&self.path.join(name), value)?)
    }

    /// Writes the best checkpoint.
    ///
    /// # Errors
    /// `File` if it cannot be written.
    pub fn save_best(&self, checkpoint: &Checkpoint) -> Result<()> {
        Ok(checkpoint.write(&self.path.join(BEST))?)
    }

    /// Writes a checkpoint and state of one generation, then removes older ones.
    ///
    /// # Errors
    /// `File` if a file cannot be written; the previous pair is then still there.
    pub fn save_last(&self, checkpoint: &Checkpoint, state: &State) -> Result<()> {
        let header =
            StateHeader { format: FORMAT, generation: state.generation, progress: state.progress.clone() };
        let json = serde_json::to_string(&header).map_err(|e| Error::file(&self.path, e))?;
        checkpoint.write(&self.checkpoint_path(state.generation))?;
        write_tensors(&self.state_path(state.generation), STATE_KEY, &json, &state.tensors)?;
        // What a killed run left half done goes too.
        let kept = format!("{}.", generation_stem(state.generation));
        self.remove(|name| is_part(name) || (generation_of(name).is_some() && !name.starts_with(&kept)))
    }

    /// The newest matching pair's state.
    ///
    /// # Errors
    /// `File` if there is none that can be read.
    pub fn load_last(&self) -> Result<State> {
        let mut generations = self.generations()?;
        generations.sort_unstable();
        let mut problem = Error::file(&self.path, "has no saved state to resume from");
        while let Some(generation) = generations.pop() {
            match self.load_state(generation) {
                Ok(state) => return Ok(state),
                Err(error) => problem = error,
            }
        }
        Err(problem)
    }

    fn load_state(&self, generation: u64) -> Result<State> {
        let path = self.state_path(generation);
        Checkpoint::read(&self.checkpoint_path(generation))?;
        let (json, tensors) = read_tensors(&path, STATE_KEY)?;
        let header: StateHeader = serde_json::from_str(&json).map_err(|e| Error::file(&path, e))?;
        if header.format != FORMAT || header.generation != generation {
            return Err(Error::file(path, "is of another version or generation than its name says"));
        }
        Ok(State { generation, progress: header.progress, tensors })
    }

    /// The checkpoint that answers for a run: the best if there is one, else the newest.
    ///
    /// # Errors
    /// `File` if there is none.
    pub fn answering_checkpoint(&self) -> Result<PathBuf> {
        let best = self.path.join(BEST);
        if best.is_file() {
            return Ok(best);
        }
        match self.generations()?.into_iter().max() {
            Some(generation) => Ok(self.checkpoint_path(generation)),
            None => Err(Error::file(&self.path, "has no checkpoint yet")),
        }
    }

    /// Generations with both files.
    fn generations(&self) -> Result<Vec<u64>> {
        let names = self.names()?;
        let states = names.iter().filter(|name| name.ends_with(STATE_SUFFIX));
        Ok(states
            .filter_map(|name| generation_of(name))
            .filter(|g| self.checkpoint_path(*g).is_file())
            .collect())
    }

    /// Names of what is in the folder.
    fn names(&self) -> Result<Vec<String>> {
        let entries = std::fs::read_dir(&self.path)
            .map_err(|e| Error::file(&self.path, format!("cannot be read: {e}")))?;
        Ok(entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect())
    }

    /// Removes the files whose names are chosen.
    fn remove(&self, chosen: impl Fn(&str) -> bool) -> Result<()> {
        for name in self.names()?.iter().filter(|name| chosen(name)) {
            let path = self.path.join(name);
            std::fs::remove_file(&path).map_err(|e| Error::file(&path, format!("cannot be removed: {e}")))?;
        }
        Ok(())
    }

    fn checkpoint_path(&self, generation: u64) -> PathBuf {
        self.path.join(format!("{}{CHECKPOINT_SUFFIX}", generation_stem(generation)))
    }

    fn state_path(&self, generation: u64) -> PathBuf {
        self.path.join(format!("{}{STATE_SUFFIX}", generation_stem(generation)))
    }
}

fn generation_stem(generation: u64) -> String {
    format!("last-{generation:09}")
}

/// The generation of a checkpoint's or state's name.
fn generation_of(name: &str) -> Option<u64> {
    let rest = name.strip_prefix("last-")?;
    rest.strip_suffix(STATE_SUFFIX).or(rest.strip_suffix(CHECKPOINT_SUFFIX))?.parse().ok()
}

/// True for a temporary sibling that a killed run left.
fn is_part(name: &str) -> bool {
    name.starts_with(neumip_export::whole_file::PART)
}

/// True for the names that a run's files have.
fn is_ours(name: &str) -> bool {
    [RECORD, BEST, HISTORY, STABILITY].contains(&name) || generation_of(name).is_some() || is_part(name)
}

/// The checkpoint of a fit's folder, which has no record of a run.
pub fn of_fit(path: &Path) -> Option<PathBuf> {
    let best = path.join(BEST);
    (!path.join(RECORD).exists() && best.is_file()).then_some(best)
}

/// Reads the checkpoint that a path means: a checkpoint file, or the folder of a run or a fit.
///
/// # Errors
/// `File` if there is none or it is damaged.
pub fn load(path: &Path) -> Result<Checkpoint> {
    if path.is_dir() {
        if let Some(best) = of_fit(path) {
            return Ok(Checkpoint::read(&best)?);
        }
        let (folder, _) = RunFolder::open(path)?;
        return Ok(Checkpoint::read(&folder.answering_checkpoint()?)?);
    }
    Ok(Checkpoint::read(path)?)
}
