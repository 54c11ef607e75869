//! A study's folder: what is finished is a file, so that a stopped study goes on and folders of several machines are one.
//!
//! | path | what |
//! | --- | --- |
//! | `study.json` | what every cell shares |
//! | `data/MATERIAL-REGIME/` | datasets |
//! | `trials/NAME.json` | one tuning trial |
//! | `runs/NAME/` | training that is under way, and the checkpoint of what is finished |
//! | `cells/NAME.json` | the cells of one finished training |
//! | `times.json` | nanoseconds a query of each variant |
//! | `pictures/NAME.png` | views |

use super::job::{Job, plain};
use super::study::{Directions, Study};
use super::tuning;
use crate::error::{Error, Result};
use crate::results::{Cell, Results, Trial};
use neumip_export::whole_file::{write_json, write_whole};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const STUDY: &str = "study.json";
const TIMES: &str = "times.json";
/// Folders whose files are results: what a merge takes over.
const KEPT: [&str; 3] = ["trials", "cells", "pictures"];

/// The folder of a study.
#[derive(Clone, Debug)]
pub struct Folder {
    root: PathBuf,
}

/// What one finished training left.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Finished {
    /// Where it was trained.
    pub machine: String,
    /// Seconds of the training; 0 where nothing is trained.
    pub seconds: f64,
    /// Its cells.
    pub cells: Vec<Cell>,
    /// Why there are none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failure: Option<String>,
}

impl Folder {
    /// The folder of a study, new or as it was left.
    ///
    /// # Errors
    /// `File` if it cannot be made, or holds another study.
    pub fn open(root: &Path, study: &Study) -> Result<Self> {
        let this = Self { root: root.to_path_buf() };
        let path = root.join(STUDY);
        if path.is_file() {
            let there: Study = read(&path)?;
            if there != *study {
                return Err(Error::file(
                    &path,
                    format!(
                        "this folder holds a study with {}; use those values or another --out",
                        differences(&there, study)
                    ),
                ));
            }
            return Ok(this);
        }
        let foreign = std::fs::read_dir(root).ok().and_then(|mut entries| entries.next());
        if foreign.is_some() {
            return Err(Error::file(root, "exists and is no study's folder; choose another --out"));
        }
        std::fs::create_dir_all(root).map_err(|e| Error::file(root, format!("cannot be made: {e}")))?;
        write_json(&path, study)?;
        Ok(this)
    }

    /// The folder itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Where a dataset is.
    pub fn data(&self, material: &str, directions: Directions) -> PathBuf {
        self.root.join("data").join(plain(&format!("{material}-{directions}")))
    }

    /// Where a training is.
    pub fn run(&self, name: &str) -> PathBuf {
        self.root.join("runs").join(plain(name))
    }

    /// Where a picture is.
    pub fn picture(&self, name: &str) -> PathBuf {
        self.root.join("pictures").join(format!("{}.png", plain(name)))
    }

    /// What a job left, if it is finished.
    ///
    /// # Errors
    /// `File` if it cannot be read.
    pub fn finished(&self, job: &Job) -> Result<Option<Finished>> {
        self.optional(&self.root.join("cells").join(format!("{}.json", job.name())))
    }

    /// Keeps what a job left.
    ///
    /// # Errors
    /// `File` if it cannot be written.
    pub fn save(&self, job: &Job, finished: &Finished) -> Result<()> {
        self.write("cells", &job.name(), finished)
    }

    /// A trial that was run.
    ///
    /// # Errors
    /// `File` if it cannot be read.
    pub fn trial(&self, name: &str) -> Result<Option<Trial>> {
        self.optional(&self.root.join("trials").join(format!("{}.json", plain(name))))
    }

    /// Keeps a trial.
    ///
    /// # Errors
    /// `File` if it cannot be written.
    pub fn save_trial(&self, name: &str, trial: &Trial) -> Result<()> {
        self.write("trials", name, trial)
    }

    /// Keeps a picture.
    ///
    /// # Errors
    /// `File` if it cannot be written.
    pub fn save_picture(&self, name: &str, png: &[u8]) -> Result<()> {
        let path = self.picture(name);
        made(path.parent())?;
        Ok(write_whole(&path, png)?)
    }

    /// Nanoseconds a query by variant.
    ///
    /// # Errors
    /// `File` if the file is no such table.
    pub fn times(&self) -> Result<BTreeMap<String, f64>> {
        Ok(self.optional(&self.root.join(TIMES))?.unwrap_or_default())
    }

    /// Keeps the times.
    ///
    /// # Errors
    /// `File` if they cannot be written.
    pub fn save_times(&self, times: &BTreeMap<String, f64>) -> Result<()> {
        Ok(write_json(&self.root.join(TIMES), times)?)
    }

    /// Takes over the finished trials and cells of another folder of the same study; returns how many files.
    ///
    /// # Errors
    /// `File` if the other folder holds another study, or something cannot be read or written.
    pub fn merge(&self, other: &Path) -> Result<usize> {
        let (mine, theirs): (Study, Study) = (read(&self.root.join(STUDY))?, read(&other.join(STUDY))?);
        if mine != theirs {
            return Err(Error::file(
                other,
                format!("holds a study with {}: it cannot be merged", differences(&theirs, &mine)),
            ));
        }
        let mut taken = 0;
        for part in KEPT {
            for path in files(&other.join(part))? {
                let Some(name) = path.file_name() else { continue };
                let to = self.root.join(part).join(name);
                if !to.exists() {
                    let bytes = std::fs::read(&path).map_err(|e| Error::file(&path, e))?;
                    made(to.parent())?;
                    write_whole(&to, &bytes)?;
                    taken += 1;
                }
            }
        }
        Ok(taken)
    }

    /// Everything that is finished, whoever asked for it, with the trials that were chosen marked and the times filled in.
    ///
    /// # Errors
    /// `File` if a file cannot be read.
    pub fn results(&self, study: &Study) -> Result<Results> {
        let mut results = Results::default();
        let times = self.times()?;
        for path in files(&self.root.join("cells"))? {
            let finished: Finished = read(&path)?;
            let mut part = Results { machines: vec![finished.machine], ..Results::default() };
            part.cells = finished.cells;
            for cell in &mut part.cells {
                cell.ns_per_query = times.get(&cell.preset).copied().or(cell.ns_per_query);
            }
            results.merge(part);
        }
        let trials =
            files(&self.root.join("trials"))?.iter().map(|path| read(path)).collect::<Result<_>>()?;
        results.merge(Results { trials, ..Results::default() });
        let all = results.trials.clone();
        for trial in &mut results.trials {
            let rivals = all.iter().filter(|t| t.preset == trial.preset && t.regime == trial.regime);
            trial.chosen = tuning::best(rivals, &study.tuned_on) == Some(trial.index);
        }
        Ok(results)
    }

    fn write(&self, part: &str, name: &str, value: &impl Serialize) -> Result<()> {
        let path = self.root.join(part).join(format!("{}.json", plain(name)));
        made(path.parent())?;
        Ok(write_json(&path, value)?)
    }

    fn optional<T: for<'a> Deserialize<'a>>(&self, path: &Path) -> Result<Option<T>> {
        if path.is_file() { read(path).map(Some) } else { Ok(None) }
    }
}

fn made(folder: Option<&Path>) -> Result<()> {
    let Some(folder) = folder else { return Ok(()) };
    std::fs::create_dir_all(folder).map_err(|e| Error::file(folder, format!("cannot be made: {e}")))
}

/// The files of a folder in the order of their names; none where there is no folder.
fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let entries =
        std::fs::read_dir(folder).map_err(|e| Error::file(folder, format!("cannot be read: {e}")))?;
    let mut all: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    // Temporary siblings of a killed run are no results.
    all.retain(|path| {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        path.is_file() && !name.starts_with(neumip_export::whole_file::PART)
    });
    all.sort();
    Ok(all)
}

fn read<T: for<'a> Deserialize<'a>>(path: &Path) -> Result<T> {
    let bytes = std::fs::read(path).map_err(|e| Error::file(path, format!("cannot be read: {e}")))?;
    serde_json::from_slice(&bytes).map_err(|e| Error::file(path, format!("is not what its name says: {e}")))
}

/// The fields in which two studies differ, with the first one's values.
fn differences(there: &Study, asked: &Study) -> String {
    let tree = |study: &Study| serde_json::to_value(study).unwrap_or_default();
    let (there, asked) = (tree(there), tree(asked));
    let Some(fields) = there.as_object() else { return String::new() };
    let differing = fields.iter().filter(|(name, value)| asked.get(name) != Some(value));
    differing.map(|(name, value)| format!("{name} {value}")).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::super::study::tests::{scope, study};
    use super::*;
    use crate::reproduce::jobs;

    fn finished(job: &Job) -> Finished {
        let cell = Cell {
            material: job.material.clone(),
            preset: job.variant.label.clone(),
            seed: job.seed,
            resolution: [16, 16],
            samples_per_texel: 20.0,
            unique_samples_per_texel: 20.0,
            regime: job.directions.to_string(),
            split: "test".into(),
            level: None,
            metrics: Default::default(),
            noise: None,
            ns_per_query: None,
            bytes: 1,
            flops: 1,
            engine: String::new(),
        };
        Finished { machine: "one".into(), seconds: 1.0, cells: vec![cell], failure: None }
    }

    #[test]
    fn what_is_finished_is_found_again_and_folders_merge() {
        let there = tempfile::tempdir().unwrap();
        let (a, b) = (there.path().join("a"), there.path().join("b"));
        let (study, jobs) = (study(), jobs(&study(), &scope()));
        let (first, second) = (Folder::open(&a, &study).unwrap(), Folder::open(&b, &study).unwrap());
        first.save(&jobs[0], &finished(&jobs[0])).unwrap();
        second.save(&jobs[1], &finished(&jobs[1])).unwrap();
        assert_eq!(first.finished(&jobs[0]).unwrap(), Some(finished(&jobs[0])));
        assert_eq!(first.finished(&jobs[1]).unwrap(), None);
        let again = Folder::open(&a, &study).unwrap();
        assert_eq!((again.merge(&b).unwrap(), again.merge(&b).unwrap()), (1, 0));
        again.save_times(&BTreeMap::from([(jobs[1].variant.label.clone(), 7.0)])).unwrap();
        let results = again.results(&study).unwrap();
        assert_eq!((results.cells.len(), results.machines.len()), (2, 1));
        let timed = results.cells.iter().filter(|c| c.ns_per_query == Some(7.0));
        assert_eq!(timed.count(), results.cells.iter().filter(|c| c.preset == jobs[1].variant.label).count());
    }

    #[test]
    fn another_study_is_refused_by_name() {
        let there = tempfile::tempdir().unwrap();
        let root = there.path().join("a");
        Folder::open(&root, &study()).unwrap();
        let other = Study { budget: 77, ..study() };
        let error = Folder::open(&root, &other).unwrap_err().to_string();
        assert!(error.contains("budget 20") && !error.contains("unique"), "{error}");
        let second = there.path().join("b");
        let folder = Folder::open(&second, &other).unwrap();
        assert!(folder.merge(&root).unwrap_err().to_string().contains("budget"));
        std::fs::write(there.path().join("foreign"), "x").unwrap();
        assert!(Folder::open(there.path(), &study()).is_err());
    }
}
