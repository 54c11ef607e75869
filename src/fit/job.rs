//! One material fitted to one scene, from what is asked to the report's figures.

use super::candidates::{Candidate, candidates};
use super::goal::{Goal, Metric};
use super::model::{checkpoint, material};
use super::need::Need;
use super::outcome::{Elsewhere, FITTED, FULL, Outcome, ROUNDED, Row, TRUNCATED};
use super::pictures::{Pictures, Times, Wanted};
use super::prior::Prior;
use super::samples::{Amount, samples};
use super::search::{CANDIDATES, Found, SHARES, Tensors, Tried, search};
use super::shape::Shape;
use super::transfer::transfer;
use super::trial;
use super::truth::Truth;
use crate::config::Config;
use crate::dataset::{Dataset, SplitName};
use crate::error::{Error, Result};
use crate::evaluate::{Apart, apart_table, costs_on};
use crate::query::{QueryBuffer, Reflectance};
use crate::render::compare::Comparison;
use crate::render::{Sample, Scene};
use neumip_export::Storage;
use neumip_export::checkpoint::Checkpoint;
use serde_json::json;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Queries that a demand keeps: enough that each trains on a patch of its own.
const ASKED: usize = 200_000;
/// Frames between two of a path's from which queries are drawn.
const DENSER: usize = 4;
/// Queries by which layers are narrowed: a hundred for each weight into a unit.
const CALIBRATION: usize = 8192;
/// Queries that are timed.
const TIMED: usize = 1 << 17;
/// Rounds of a timing.
const ROUNDS: usize = 7;
/// How much a rounded model may lose of what it reaches, where no bound says it.
const ROUNDING: f64 = 1.01;
/// Numbers of the report's pictures are not those that choices were made on.
const REPORTED: u64 = 0x7e57;

/// How much work a fit is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effort {
    /// Training samples that are measured.
    pub unique: usize,
    /// Validation samples.
    pub validation: usize,
    /// Rays of a training sample.
    pub spp: usize,
    /// Share of the training samples that is spread over everything else.
    pub floor: f64,
    /// Pictures on which choices are made, and as many for the report.
    pub frames: usize,
    /// Samples a pixel; 0: the scene's.
    pub samples: usize,
    /// Rays a query of a picture's truth.
    pub picture_spp: usize,
    /// Samples presented that count as one full training.
    pub training: u64,
    /// Candidates of the first rung.
    pub candidates: usize,
    /// Highest learning rate.
    pub rate: f64,
    /// Seed of everything.
    pub seed: u64,
}

impl Default for Effort {
    /// Half a million samples, four pictures of four samples a pixel, a learning rate half of the presets'.
    fn default() -> Self {
        Self {
            unique: 1 << 19,
            validation: 1 << 15,
            spp: 16,
            floor: 0.1,
            frames: 4,
            samples: 4,
            picture_spp: 32,
            training: 0,
            candidates: CANDIDATES,
            rate: 3e-3,
            seed: 1,
        }
    }
}

/// Who is told what is being done and how far it is, and may stop it.
pub type Watch<'a> = dyn Fn(&str, f64) -> ControlFlow<()> + 'a;

/// A fit.
pub struct Job<'a> {
    /// The scene's name.
    pub name: &'a str,
    /// Which material of the scene is fitted; the scene has the full model in its place.
    pub material: usize,
    /// The full model.
    pub full: &'a Checkpoint,
    /// How it was trained.
    pub config: &'a Config,
    /// Samples presented to it and seconds of that, where it says so.
    pub trained: Option<(u64, f64)>,
    /// Who knows the answers.
    pub truth: &'a Truth,
    /// Held-out data of the whole material.
    pub data: Option<&'a Dataset>,
    /// What is wanted.
    pub goal: Goal,
    /// How much work.
    pub effort: Effort,
    /// Folder of everything that is kept.
    pub folder: &'a Path,
}

/// A fitted model with what came of it.
pub struct Fitted {
    /// The model, its numbers those of its storage.
    pub checkpoint: Checkpoint,
    /// How it is to be stored.
    pub storage: Storage,
    /// The report's figures.
    pub outcome: Outcome,
    /// The report's pictures.
    pub pictures: Pictures,
    /// The truncated model.
    pub truncated: Checkpoint,
}

/// What trials are made from.
pub struct Prepared {
    /// What the scene needs.
    pub need: Need,
    /// The pictures that choices are made on.
    pub pictures: Pictures,
    data: Dataset,
    /// The full model's errors on the pictures.
    pub full: Comparison,
    /// Queries that layers are narrowed on.
    some: QueryBuffer,
    seconds: f64,
}

impl Job<'_> {
    /// Asks the scene and measures the answers that trials need.
    ///
    /// # Errors
    /// `Config` for a scene that never shows the material, what measuring meets, `Interrupted`.
    pub fn prepare(&self, scene: &mut Scene, watch: &Watch) -> Result<Prepared> {
        let begun = Instant::now();
        let architecture = &self.full.header.architecture;
        let path = scene.frames();
        let sample = Sample {
            frames: (path - 1) * DENSER + 1,
            samples: self.effort.samples,
            most: ASKED,
            seed: self.effort.seed,
        };
        let demands = scene.demand(&sample, &mut |done| watch("ask the scene", done))?;
        let demand = demands.into_iter().nth(self.material);
        let demand = demand.ok_or_else(|| Error::config("material", "the scene has none of that number"))?;
        let need = Need::new(&demand, architecture.coarsest())?;
        // Budgets that nothing holds are refused before anything is measured.
        self.of(&need, &self.goal)?;
        let pictures = self.pictures(scene, Times::Between, watch)?;
        let of = (self.full.header.material.as_str(), self.full.header.height_range);
        let amount = Amount {
            train: self.effort.unique,
            validation: self.effort.validation,
            spp: self.effort.spp,
            floor: self.effort.floor,
            seed: self.effort.seed,
        };
        let folder = self.folder.join("data");
        let mut told = |done| watch("measure training data", done);
        let data = samples(&folder, &demand, &need, self.truth, of, &amount, &mut told)?;
        let full = mean(&pictures, &material(self.full, Storage::SINGLE)?)?;
        let some = demand.queries.range(0, demand.queries.len().min(CALIBRATION));
        Ok(Prepared { need, pictures, data, full, some, seconds: begun.elapsed().as_secs_f64() })
    }

    fn pictures(&self, scene: &mut Scene, times: Times, watch: &Watch) -> Result<Pictures> {
        let folder = self.folder.join("truth");
        std::fs::create_dir_all(&folder).map_err(|e| Error::file(&folder, format!("cannot be made: {e}")))?;
        let (name, seed) = match times {
            Times::Between => ("choice", self.effort.seed),
            Times::Whole => ("report", self.effort.seed ^ REPORTED),
        };
        let wanted = Wanted {
            material: self.material,
            frames: self.effort.frames,
            times,
            samples: self.effort.samples,
            spp: self.effort.picture_spp,
            folder: &folder,
            name,
        };
        let kept = std::mem::replace(&mut scene.seed, seed);
        let taken = Pictures::take(scene, self.truth, &wanted, &mut |done| watch("render the truth", done));
        scene.seed = kept;
        taken
    }

    /// The candidates of a goal.
    ///
    /// # Errors
    /// As [`candidates`].
    pub fn candidates(&self, prepared: &Prepared, goal: &Goal) -> Result<Vec<Candidate>> {
        self.of(&prepared.need, goal)
    }

    fn of(&self, need: &Need, goal: &Goal) -> Result<Vec<Candidate>> {
        let model = &self.full.header.architecture.model;
        candidates(model, need, &Prior::new()?, goal, self.effort.candidates)
    }

    /// Trains a candidate for `presented` samples and compares its pictures.
    ///
    /// # Errors
    /// What training meets.
    pub fn attempt(
        &self,
        prepared: &Prepared,
        candidate: &Candidate,
        (rung, presented): (usize, u64),
        start: Option<&Tensors>,
        watch: &Watch,
    ) -> Result<Tried> {
        let model = &self.full.header.architecture.model;
        let architecture = candidate.shape.model(model, &prepared.need)?;
        let begun = match start {
            Some(tensors) => tensors.clone(),
            None => transfer(self.full, &architecture, &prepared.need, &prepared.some)?,
        };
        let name = format!("{}-{rung}", candidate.shape.to_string().replace([' ', ':'], "_"));
        let out = self.folder.join("trials").join(name);
        if let Some(parent) = out.parent() {
            std::fs::create_dir_all(parent)
                .map_err(|e| Error::file(parent, format!("cannot be made: {e}")))?;
        }
        let label = format!("try {} for {presented} samples", candidate.shape);
        let flow = |done| watch(&label, done);
        let amount = (presented, self.effort.rate);
        let (trained, progress) =
            trial::train(self.config, &architecture, &begun, &prepared.data, &out, amount, &flow)?;
        let tensors = trained.tensors;
        let checkpoint = self.checkpoint(&candidate.shape, tensors.clone(), &prepared.need)?;
        // Compared as it is going to be stored.
        let rounded = Storage::HALF.round(checkpoint).map_err(|e| Error::Diverged(e.to_string()))?;
        let errors = mean(&prepared.pictures, &material(&rounded, Storage::HALF)?)?;
        Ok(Tried { tensors, errors, seconds: progress.seconds })
    }

    fn checkpoint(&self, shape: &Shape, tensors: Tensors, need: &Need) -> Result<Checkpoint> {
        let architecture = shape.model(&self.full.header.architecture.model, need)?;
        checkpoint(self.full, &architecture, tensors, need, (self.name, self.effort.floor))
    }

    /// The whole search.
    ///
    /// # Errors
    /// What trials meet; `Usage` for budgets that no model holds; `Interrupted`.
    pub fn search(&self, prepared: &Prepared, watch: &Watch) -> Result<Found> {
        let all = self.candidates(prepared, &self.goal)?;
        let full = self.goal.metric().of(&prepared.full)?;
        search(all, &self.goal, full, self.effort.training, &mut |candidate, rung, samples, start| {
            self.attempt(prepared, candidate, (rung, samples), start, watch)
        })
    }

    /// Searches and measures what was found beside the full and the truncated model.
    ///
    /// # Errors
    /// As [`Job::prepare`] and [`Job::search`].
    pub fn run(&self, scene: &mut Scene, watch: &Watch) -> Result<Fitted> {
        let prepared = self.prepare(scene, watch)?;
        let found = self.search(&prepared, watch)?;
        self.finish(scene, prepared, found, watch)
    }

    /// Measures what was found.
    ///
    /// # Errors
    /// What measuring meets.
    pub fn finish(
        &self,
        scene: &mut Scene,
        prepared: Prepared,
        found: Found,
        watch: &Watch,
    ) -> Result<Fitted> {
        let begun = Instant::now();
        let need = &prepared.need;
        let shape = &found.candidate.shape;
        let metric = self.goal.metric();
        let bound = self.goal.bound(metric.of(&prepared.full)?);
        let most = bound.unwrap_or(ROUNDING * metric.of(&found.errors)?);
        let trained = self.checkpoint(shape, found.tensors.clone(), need)?;
        let (mut fitted, storage) = stored(trained, &prepared.pictures, metric, most)?;
        fitted.header.provenance = json!({
            "fit": {
                "scene": self.name, "shape": shape.to_string(), "goal": self.goal, "seed": self.effort.seed,
                "unique_samples": self.effort.unique, "samples": SHARES.map(|share| self.presented(share)),
            },
            "full": self.full.header.provenance,
        });
        fitted.header.errors = json!({ "pictures": mean(&prepared.pictures, &material(&fitted, storage)?)? });

        let architecture = shape.model(&self.full.header.architecture.model, need)?;
        let cut = transfer(self.full, &architecture, need, &prepared.some)?;
        let truncated = storage.round(self.checkpoint(shape, cut, need)?)?;
        let rounded = Storage::HALF.round(self.full.clone())?;
        let pictures = self.pictures(scene, Times::Whole, watch)?;

        let search_seconds: f64 = found.trials.iter().map(|trial| trial.seconds).sum();
        let full_seconds = self.trained.map_or(0.0, |(_, seconds)| seconds);
        let whole =
            Shape::of(&self.full.header.architecture.model).map(|s| s.to_string()).unwrap_or_default();
        let models = [
            (FULL, self.full, Storage::SINGLE, whole.clone(), full_seconds),
            (ROUNDED, &rounded, Storage::HALF, whole, full_seconds),
            (FITTED, &fitted, storage, shape.to_string(), search_seconds),
            (TRUNCATED, &truncated, storage, shape.to_string(), 0.0),
        ];
        let rows = rows(&models, &pictures)?;
        let queries: usize = pictures.queries().map(QueryBuffer::len).sum();
        let holds = match (bound, rows.iter().find(|row| row.name == FITTED)) {
            (Some(bound), Some(row)) => metric.of(&row.errors)? <= bound,
            _ => true,
        };
        let outcome = Outcome {
            scene: self.name.into(),
            material: scene.materials.get(self.material).map(|m| m.name.clone()).unwrap_or_default(),
            trained_on: self.full.header.material.clone(),
            need: need.clone(),
            goal: self.goal,
            bound,
            holds,
            truth: if self.truth.is_surface() { "surface" } else { "full model" }.into(),
            unique_samples: self.effort.unique,
            floor: self.effort.floor,
            pictures: pictures.len(),
            queries_per_picture: queries as f64 / pictures.len().max(1) as f64,
            rows,
            full_training: self.trained,
            measuring_seconds: prepared.seconds + begun.elapsed().as_secs_f64(),
            search_samples: found.trials.iter().map(|trial| trial.samples).sum(),
            search_seconds,
            trainings: self.trained.map(|(_, seconds)| search_seconds / seconds.max(1e-9)),
            trials: found.trials,
            elsewhere: self.elsewhere(&fitted, storage)?,
        };
        Ok(Fitted { checkpoint: fitted, storage, outcome, pictures, truncated })
    }

    /// Errors on the data's own held-out splits, inside and outside of the domain.
    fn elsewhere(&self, fitted: &Checkpoint, storage: Storage) -> Result<Vec<Elsewhere>> {
        let Some(data) = self.data else { return Ok(Vec::new()) };
        let architecture = &fitted.header.architecture;
        let splits: Vec<SplitName> = [SplitName::Test, SplitName::Offgrid]
            .into_iter()
            .filter(|name| data.split_names().contains(name))
            .collect();
        let apart = |checkpoint: &Checkpoint, storage: Storage| {
            apart_table(&material(checkpoint, storage)?, architecture, data, &splits)
        };
        let mse = |row: &Apart| {
            [&row.errors_inside, &row.errors_outside].map(|errors| errors.as_ref().map(|errors| errors.mse))
        };
        let rows = apart(self.full, Storage::SINGLE)?.into_iter().zip(apart(fitted, storage)?);
        let both = rows.map(|(full, small)| Elsewhere {
            queries: [full.count.queries - full.count.outside, full.count.outside],
            full: mse(&full),
            fitted: mse(&small),
            split: full.split,
        });
        Ok(both.collect())
    }

    /// Samples that are presented in a trial of this share.
    pub fn presented(&self, share: f64) -> u64 {
        (self.effort.training as f64 * share) as u64
    }

    /// Folder of everything that a fit keeps but its result.
    pub fn workings(folder: &Path) -> [PathBuf; 3] {
        ["data", "trials", "truth"].map(|name| folder.join(name))
    }
}

/// The model in bytes if its pictures' error is at most `most` then, else in the half precision that trials were compared in; as
/// it was trained only where half floats cannot hold it.
fn stored(
    trained: Checkpoint,
    pictures: &Pictures,
    metric: Metric,
    most: f64,
) -> Result<(Checkpoint, Storage)> {
    if let Ok(rounded) = Storage::BYTE.round(trained.clone())
        && metric.of(&mean(pictures, &material(&rounded, Storage::BYTE)?)?)? <= most
    {
        return Ok((rounded, Storage::BYTE));
    }
    match Storage::HALF.round(trained.clone()) {
        Ok(rounded) => Ok((rounded, Storage::HALF)),
        Err(_) => Ok((trained, Storage::SINGLE)),
    }
}

fn rows(models: &[(&str, &Checkpoint, Storage, String, f64)], pictures: &Pictures) -> Result<Vec<Row>> {
    let materials = models
        .iter()
        .map(|(_, checkpoint, storage, ..)| material(checkpoint, *storage))
        .collect::<Result<Vec<_>>>()?;
    let asked = pictures.queries().find(|queries| !queries.is_empty());
    let asked = asked.ok_or_else(|| Error::config("scene", "its pictures ask the material nothing"))?;
    let timed = asked.range(0, asked.len().min(TIMED));
    let answerers: Vec<&dyn Reflectance> = materials.iter().map(|m| m as &dyn Reflectance).collect();
    let costs = costs_on(&answerers, &timed, ROUNDS)?;
    let queries: usize = pictures.queries().map(QueryBuffer::len).sum();
    let each = queries as f64 / pictures.len().max(1) as f64;
    let mut out = Vec::new();
    for (((name, checkpoint, storage, shape, seconds), material), cost) in
        models.iter().zip(&materials).zip(costs)
    {
        let architecture = &checkpoint.header.architecture;
        let errors = pictures.compare(material)?;
        out.push(Row {
            name: (*name).into(),
            shape: shape.clone(),
            storage: *storage,
            bytes: architecture.bytes_as(*storage),
            flops: architecture.flops_per_query(),
            frame_ms: cost.ns_per_query * each * 1e-6,
            cost,
            training_seconds: *seconds,
            errors: Comparison::mean(&errors)
                .ok_or_else(|| Error::config("scene", "has no pictures to compare"))?,
            pictures: errors,
        });
    }
    Ok(out)
}

/// The mean over all pictures.
fn mean(pictures: &Pictures, material: &dyn Reflectance) -> Result<Comparison> {
    let all = pictures.compare(material)?;
    Comparison::mean(&all).ok_or_else(|| Error::config("scene", "has no pictures to compare"))
}
