//! Datasets and trainings that probes share: each is made once and kept in the suite's folder.

use super::folder::Folder;
use crate::checkpoint::{self, RunFolder};
use crate::config::{Budget, Config};
use crate::dataset::{Dataset, Existing, GenerateConfig, Source, SplitName, generate};
use crate::engine::FusedMaterial;
use crate::error::{Error, Result};
use crate::evaluate::split_table;
use crate::metrics::Errors;
use crate::query::{QueryBuffer, Reflectance, RgbImage};
use crate::random::hash;
use crate::reference::{Reference, ReferenceOptions, Sampling};
use crate::trainer::{Progress, Trainer};
use candle_core::Device;
use neumip_export::checkpoint::Checkpoint;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

/// Memory for the training data.
const MEMORY: usize = 2 << 30;
/// Validations of a training: each costs about one thousandth of it.
const VALIDATIONS: usize = 10;
/// Random numbers of references that probes ask are not those of any dataset.
const PROBE_SEED: u64 = 0x5eed;

/// How much a suite does; everything that its outcomes depend on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scale {
    /// `quick` or `full`.
    pub name: String,
    /// Texels along a side of a tile.
    pub resolution: usize,
    /// Unique training samples a texel.
    pub unique: u64,
    /// Samples presented a texel in a training.
    pub budget: u64,
    /// Samples a step.
    pub batch: usize,
    /// Sub-samples of a training sample.
    pub spp: usize,
    /// Sub-samples of every other one.
    pub held_out_spp: usize,
    /// Indirect bounces.
    pub bounces: usize,
    /// Materials: the glossy one first, then the matte one, then whatever else takes part in motion.
    pub materials: Vec<String>,
    /// Queries in which no answer may be without number.
    pub queries: u64,
    /// Short trainings with random configurations.
    pub trainings: u64,
    /// Seeds of the spread.
    pub seeds: u64,
    /// Frames of a sequence.
    pub frames: usize,
}

impl Scale {
    /// What CI runs: a few minutes.
    pub fn quick() -> Self {
        Self {
            name: "quick".into(),
            resolution: 64,
            unique: 120,
            budget: 600,
            batch: 2048,
            spp: 16,
            held_out_spp: 64,
            bounces: 0,
            materials: ["metal-rings", "rocks"].map(String::from).to_vec(),
            queries: 10_000_000,
            trainings: 10,
            seeds: 3,
            frames: 5,
        }
    }

    /// Everything, at the size of the study.
    pub fn full() -> Self {
        Self {
            name: "full".into(),
            resolution: 128,
            budget: 1200,
            batch: 8192,
            bounces: 1,
            materials: ["metal-rings", "rocks", "leather", "basket-cloth"].map(String::from).to_vec(),
            queries: 100_000_000,
            trainings: 100,
            seeds: 5,
            ..Self::quick()
        }
    }

    /// True for the quick suite.
    pub fn is_quick(&self) -> bool {
        self.name == "quick"
    }

    /// Texels of a tile.
    pub fn texels(&self) -> u64 {
        (self.resolution * self.resolution) as u64
    }

    /// The glossy material.
    pub fn glossy(&self) -> &str {
        self.materials.iter().find(|m| *m == "metal-rings").map_or("metal-rings", String::as_str)
    }

    /// The matte material.
    pub fn matte(&self) -> &str {
        self.materials.iter().find(|m| *m == "rocks").map_or("rocks", String::as_str)
    }
}

/// Who is told what happens and may stop it.
pub trait Watch {
    /// A line of information.
    fn say(&self, line: &str);
    /// `Break` to stop.
    fn flow(&self) -> ControlFlow<()>;
}

/// What became of a training.
#[derive(Clone, Debug)]
pub enum Trained {
    /// A model.
    Model(Box<Model>),
    /// It left the finite numbers; why.
    Diverged(String),
}

/// A trained model.
#[derive(Clone, Debug)]
pub struct Model {
    /// Its best state.
    pub checkpoint: Checkpoint,
    /// What was done.
    pub progress: Progress,
    /// What answers.
    pub material: FusedMaterial,
}

impl Trained {
    /// The model, if there is one.
    pub fn model(&self) -> Option<&Model> {
        match self {
            Self::Model(model) => Some(model),
            Self::Diverged(_) => None,
        }
    }

    /// The model.
    ///
    /// # Errors
    /// `Diverged` where there is none.
    pub fn sound(&self) -> Result<&Model> {
        match self {
            Self::Model(model) => Ok(model),
            Self::Diverged(problem) => Err(Error::Diverged(problem.clone())),
        }
    }
}

/// Where probes work.
pub struct Workshop<'a> {
    scale: Scale,
    folder: Folder,
    watch: &'a dyn Watch,
    references: BTreeMap<String, Arc<Reference>>,
    trained: BTreeMap<String, Trained>,
}

impl<'a> Workshop<'a> {
    /// A workshop in a suite's folder.
    pub fn new(scale: Scale, folder: Folder, watch: &'a dyn Watch) -> Self {
        Self { scale, folder, watch, references: BTreeMap::new(), trained: BTreeMap::new() }
    }

    /// How much is done.
    pub fn scale(&self) -> &Scale {
        &self.scale
    }

    /// The suite's folder.
    pub fn folder(&self) -> &Folder {
        &self.folder
    }

    /// Tells what happens.
    pub fn say(&self, line: &str) {
        self.watch.say(line);
    }

    /// An error once the work is to stop; what is finished is kept.
    ///
    /// # Errors
    /// `Interrupted`.
    pub fn check(&self) -> Result<()> {
        match self.watch.flow() {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(self.interrupted()),
        }
    }

    fn interrupted(&self) -> Error {
        let root = self.folder.root().display();
        Error::Interrupted(format!("{root} keeps what is finished; the same command goes on"))
    }

    /// A built-in material's surface.
    ///
    /// # Errors
    /// What building it meets.
    pub fn reference(&mut self, material: &str) -> Result<Arc<Reference>> {
        if let Some(reference) = self.references.get(material) {
            return Ok(reference.clone());
        }
        let options = ReferenceOptions {
            resolution: Some([self.scale.resolution; 2]),
            bounces: self.scale.bounces,
            sampling: Sampling { spp: self.scale.held_out_spp, seed: PROBE_SEED, first: 0 },
            ..ReferenceOptions::default()
        };
        let reference = Arc::new(Reference::open(material, &options)?);
        self.references.insert(material.into(), reference.clone());
        Ok(reference)
    }

    /// The surface's answers from `spp` sub-samples a query; `first` tells apart what must not share random numbers.
    ///
    /// # Errors
    /// What the surface reports.
    pub fn truth(
        &mut self,
        material: &str,
        queries: &QueryBuffer,
        spp: usize,
        first: u64,
    ) -> Result<RgbImage> {
        let sampling = Sampling { spp, seed: PROBE_SEED, first };
        Ok(self.reference(material)?.measure(queries, &sampling)?.rgb)
    }

    /// What datasets of this scale are: scattered, without views.
    pub fn generation(&self) -> GenerateConfig {
        let scale = &self.scale;
        let mut config = GenerateConfig::new(scale.resolution);
        config.samples = scale.texels() * scale.unique;
        config.spp = scale.spp;
        config.held_out_spp = scale.held_out_spp;
        config.test_pairs = 8;
        config.view_size = 0;
        config.heights = false;
        config.seed = 1;
        config
    }

    /// The scattered dataset of a material.
    ///
    /// # Errors
    /// What rendering it meets.
    pub fn data(&mut self, material: &str) -> Result<Dataset> {
        let reference = self.reference(material)?;
        self.data_of(material, &*reference, &self.generation())
    }

    /// The dataset of a source under a name of its own, rendered where it is not there yet.
    ///
    /// # Errors
    /// What rendering it meets.
    pub fn data_of(&mut self, name: &str, source: &dyn Source, config: &GenerateConfig) -> Result<Dataset> {
        let path = self.folder.data(name);
        if let Some(data) = Dataset::open(&path).ok().filter(|data| data.manifest().complete) {
            return Ok(data);
        }
        self.say(&format!("data {name}"));
        made(path.parent())?;
        let existing = if path.exists() { Existing::Resume } else { Existing::Refuse };
        let watch = self.watch;
        match generate(source, config, &path, existing, &mut |_| watch.flow()) {
            Ok(_) => Dataset::open(&path),
            Err(Error::Interrupted(_)) => Err(self.interrupted()),
            Err(other) => Err(other),
        }
    }

    /// A preset at the budget of this scale, with fields set as on the command line.
    ///
    /// # Errors
    /// As [`Config::preset`] and [`Config::set`].
    pub fn config(&self, preset: &str, set: &[&str]) -> Result<Config> {
        let scale = &self.scale;
        let mut config = Config::preset(preset)?;
        let train = &mut config.train;
        train.piece = train.piece.min(scale.resolution);
        train.batch = scale.batch.max(train.piece * train.piece);
        train.budget = Budget::Steps((scale.texels() * scale.budget / train.batch as u64).max(1));
        train.validations = VALIDATIONS;
        for assignment in set {
            config.set(assignment)?;
        }
        config.train.validate()?;
        Ok(config)
    }

    /// A preset trained on a material's dataset.
    ///
    /// # Errors
    /// As [`Workshop::train_on`].
    pub fn train(&mut self, material: &str, preset: &str, set: &[&str]) -> Result<Trained> {
        let data = self.data(material)?;
        let config = self.config(preset, set)?;
        self.train_on(&format!("{material}.{preset}"), config, &data)
    }

    /// A configuration trained on a dataset; the same call later finds the run. A run that diverges is no error.
    ///
    /// # Errors
    /// What training meets.
    pub fn train_on(&mut self, label: &str, config: Config, data: &Dataset) -> Result<Trained> {
        let text = serde_json::to_string(&config).map_err(|e| Error::config("train", e))?;
        let key = text.bytes().chain(data.identity()?.bytes()).fold(0, |k, b| hash(k ^ u64::from(b)));
        let name = format!("{label}.{key:016x}");
        if let Some(trained) = self.trained.get(&name) {
            return Ok(trained.clone());
        }
        let trained = match self.trained_in(&name, config, data) {
            Ok(progress) => {
                let checkpoint = checkpoint::load(&self.folder.run(&name))?;
                let material = FusedMaterial::from_checkpoint(&checkpoint)?;
                Trained::Model(Box::new(Model { checkpoint, progress, material }))
            }
            Err(Error::Diverged(problem)) => Trained::Diverged(problem),
            Err(other) => return Err(other),
        };
        self.trained.insert(name, trained.clone());
        Ok(trained)
    }

    fn trained_in(&self, name: &str, config: Config, data: &Dataset) -> Result<Progress> {
        let path = self.folder.run(name);
        made(path.parent())?;
        let begun = path.is_dir().then(|| RunFolder::open(&path).ok()).flatten();
        let mut trainer = match begun {
            Some((_, record)) if record.config == config => Trainer::resume(&path, data, &Device::Cpu)?,
            _ => Trainer::new(config, data, &path, path.exists(), MEMORY, &Device::Cpu)?,
        };
        if trainer.progress().fraction < 1.0 {
            self.say(&format!("train {name}"));
        }
        let watch = self.watch;
        match trainer.run(&mut |_| watch.flow()) {
            Ok(()) => Ok(trainer.progress().clone()),
            Err(Error::Interrupted(_)) => Err(self.interrupted()),
            Err(other) => Err(other),
        }
    }
}

/// Errors of an answerer on a split of a dataset.
///
/// # Errors
/// What reading and answering meet.
pub fn split_errors(material: &dyn Reflectance, data: &Dataset, split: SplitName) -> Result<Errors> {
    let rows = split_table(material, data, split, u64::MAX, None)?;
    let all = rows.into_iter().find(|row| row.level.is_none());
    all.map(|row| row.errors).ok_or_else(|| Error::config(split.as_str(), "has no rows"))
}

/// `mse` of answering every query of a split with the mean of all: what a model that has learnt nothing reaches.
///
/// # Errors
/// What reading meets.
pub fn error_of_the_mean(data: &Dataset, split: SplitName) -> Result<f64> {
    let split = data.split(split)?;
    let (mut sums, mut squares, mut pixels) = ([0.0; 3], 0.0, 0.0);
    for file in 0..split.files() {
        for block in split.read_file(file)? {
            for rgb in block.target() {
                for (sum, value) in sums.iter_mut().zip(rgb) {
                    let value = f64::from(value.clamp(0.0, 1.0));
                    *sum += value;
                    squares += value * value;
                }
                pixels += 1.0;
            }
        }
    }
    Ok((squares - sums.iter().map(|s| s * s / pixels).sum::<f64>()) / (3.0 * pixels))
}

/// Makes a folder.
///
/// # Errors
/// `File` if it cannot be made.
pub(super) fn made(folder: Option<&Path>) -> Result<()> {
    let Some(folder) = folder else { return Ok(()) };
    std::fs::create_dir_all(folder).map_err(|e| Error::file(folder, format!("cannot be made: {e}")))
}
