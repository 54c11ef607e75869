//! Training: steps, validations, checkpoints. It emits events and never prints.

mod candle_engine;
mod diagnosis;
mod engine;
mod fused_engine;
mod learner;
mod optimiser;
mod progress;

pub use engine::Step;
pub use learner::Learner;
pub use progress::{Point, Progress};

use crate::checkpoint::{RunFolder, RunRecord, State};
use crate::config::{Budget, Config, Stage};
use crate::dataset::{Block, Dataset, SplitName, Stream};
use crate::error::{Error, Result};
use crate::inference::{Answerer, answerer};
use crate::metrics::ErrorSum;
use crate::model::texture::{Sigmas, smoothed};
use crate::model::{Networks, Tables, Variables};
use crate::random::{Random, Stream as RandomStream};
use candle_core::Device;
use neumip_export::checkpoint::{Checkpoint, Header};
use neumip_export::config::Architecture;
use neumip_export::{Precision, Tensor as StoredTensor};
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

/// Points of the loss curve over a run.
const CURVE_POINTS: u64 = 200;
/// Rounding of shares of a run.
const SLACK: f64 = 1e-9;

/// What happens while training.
#[derive(Clone, Debug)]
pub enum Event {
    /// A step is done.
    Step {
        /// Steps done.
        step: u64,
        /// Samples presented.
        samples: u64,
        /// Share of the run done.
        fraction: f64,
        /// The step's loss.
        loss: f64,
    },
    /// A validation is done.
    Validation {
        /// The point of the curve.
        point: Point,
        /// True if this is the best so far.
        best: bool,
    },
    /// Another stage of the losses begins.
    Stage {
        /// Its index.
        index: usize,
    },
}

/// Called with every event; `Break` saves and stops.
pub type Listener<'a> = dyn FnMut(&Event) -> ControlFlow<()> + 'a;

/// A training run.
pub struct Trainer {
    config: Config,
    stages: Vec<Stage>,
    learner: Learner,
    stream: Stream,
    validation: Vec<Block>,
    header: Header,
    progress: Progress,
    folder: RunFolder,
    data: String,
    device: Device,
    /// Share of the run done when the textures were last updated.
    updated: f64,
}

impl Trainer {
    /// A new run in a new folder. `memory` bounds the training data kept at a time, in bytes.
    ///
    /// # Errors
    /// `Config` for a value that cannot work, `File` for data that cannot be read or a folder that cannot be made.
    pub fn new(
        config: Config,
        data: &Dataset,
        out: &Path,
        force: bool,
        memory: usize,
        device: &Device,
    ) -> Result<Self> {
        let architecture = Architecture::new(config.model.clone(), data.resolution())?;
        let variables = Variables::initial(&architecture, config.train.seed, device)?;
        Self::begun(config, variables, data, (out, force), memory, device)
    }

    /// A new run that begins with the tensors of another model of the same architecture.
    ///
    /// # Errors
    /// As [`Trainer::new`]; `Config` for a tensor that is missing or does not fit.
    pub fn starting_from(
        start: &BTreeMap<String, StoredTensor>,
        config: Config,
        data: &Dataset,
        (out, force): (&Path, bool),
        memory: usize,
        device: &Device,
    ) -> Result<Self> {
        let architecture = Architecture::new(config.model.clone(), data.resolution())?;
        let variables = Variables::from_stored(&architecture, start, device)?;
        Self::begun(config, variables, data, (out, force), memory, device)
    }

    fn begun(
        config: Config,
        variables: Variables,
        data: &Dataset,
        (out, force): (&Path, bool),
        memory: usize,
        device: &Device,
    ) -> Result<Self> {
        config.train.validate()?;
        let architecture = Architecture::new(config.model.clone(), data.resolution())?;
        let train = &config.train;
        let learner = Learner::new(&architecture, variables, train.adam, train.engine, device)?;
        let learner = learner.with_clip(train.clip);
        let sources = Sources::open(&config, data, memory, 0)?;
        let folder =
            RunFolder::create(out, &RunRecord::new(config.clone(), data.identity()?, memory), force)?;
        let this = Self::assemble(config, learner, sources, data, folder, device)?;
        // From the first moment on there is something to resume.
        this.save_last()?;
        Ok(this)
    }

    /// Goes on with the newest saved state of a run, on the data it began with.
    ///
    /// # Errors
    /// `File` for a folder without a state, or data that is not the run's.
    pub fn resume(out: &Path, data: &Dataset, device: &Device) -> Result<Self> {
        let (folder, record) = RunFolder::open(out)?;
        if record.data != data.identity()? {
            return Err(Error::file(
                data.root(),
                format!("is not the data that {} was begun with", out.display()),
            ));
        }
        let config = record.config;
        let architecture = Architecture::new(config.model.clone(), data.resolution())?;
        let state = folder.load_last()?;
        let part = |prefix: &str| {
            state
                .tensors
                .iter()
                .filter_map(|(n, t)| Some((n.strip_prefix(prefix)?.to_string(), t.clone())))
                .collect()
        };
        let restore = |prefix: &str| Variables::from_stored(&architecture, &part(prefix), device);
        let variables = restore("value.")?;
        let moments = [restore("first.")?, restore("second.")?];
        let train = &config.train;
        let learner = Learner::restored(&architecture, variables, moments, train.adam, train.engine, device)?;
        let learner = learner.with_clip(train.clip);
        let progress: Progress = serde_json::from_value(state.progress).map_err(|e| Error::file(out, e))?;
        let sources = Sources::open(&config, data, record.memory, progress.step)?;
        let mut this = Self::assemble(config, learner, sources, data, folder, device)?;
        this.updated = progress.fraction;
        this.progress = progress;
        if this.progress.stage >= this.stages.len() || !this.progress.fraction.is_finite() {
            return Err(Error::file(out, "its saved progress does not fit its configuration"));
        }
        Ok(this)
    }

    fn assemble(
        config: Config,
        learner: Learner,
        sources: Sources,
        data: &Dataset,
        folder: RunFolder,
        device: &Device,
    ) -> Result<Self> {
        let header = Header {
            format: neumip_export::checkpoint::FORMAT,
            architecture: learner.architecture().clone(),
            height_range: data.manifest().height_range,
            measure: data.manifest().measure,
            material: data.manifest().material.clone(),
            provenance: serde_json::Value::Null,
            errors: serde_json::Value::Null,
        };
        Ok(Self {
            stages: config.train.stages.resolve()?,
            learner,
            stream: sources.stream,
            validation: sources.validation,
            header,
            progress: Progress::default(),
            folder,
            data: data.identity()?,
            device: device.clone(),
            updated: 0.0,
            config,
        })
    }

    /// What has been done.
    pub fn progress(&self) -> &Progress {
        &self.progress
    }

    /// The run's folder.
    pub fn folder(&self) -> &RunFolder {
        &self.folder
    }

    /// Trains to the end of the budget.
    ///
    /// # Errors
    /// `Diverged` for a loss that is not finite, `Interrupted` when the listener breaks; both leave a state on disk.
    pub fn run(&mut self, listener: &mut Listener) -> Result<()> {
        let mut clock = Instant::now();
        let mut next_validation = self.next_validation();
        let mut stop = false;
        while self.progress.fraction < 1.0 {
            // Inside the pool, the step's many parallel parts begin without waking it each time.
            let loss = match rayon::scope(|_| self.step()) {
                Ok(loss) => loss,
                Err(error) => {
                    if matches!(error, Error::Diverged(_)) {
                        self.save_last()?;
                    }
                    return Err(error);
                }
            };
            self.progress.seconds += clock.elapsed().as_secs_f64();
            clock = Instant::now();
            self.progress.fraction = self.fraction();
            let mut events = vec![Event::Step {
                step: self.progress.step,
                samples: self.progress.samples,
                fraction: self.progress.fraction,
                loss,
            }];
            // Between two updates of the textures a state would not hold all that the run knows.
            let whole = self.progress.fraction >= 1.0 || self.between_updates() == 0;
            let validated = whole && self.progress.fraction >= next_validation - SLACK;
            if validated {
                next_validation = self.next_validation();
                events.push(self.validate()?);
                self.progress.seconds += clock.elapsed().as_secs_f64();
                clock = Instant::now();
            }
            if self.progress.advance_stage(&self.stages) {
                events.push(Event::Stage { index: self.progress.stage });
            }
            if validated {
                self.save_last()?;
            }
            for event in &events {
                stop |= listener(event).is_break();
            }
            if stop && whole && self.progress.fraction < 1.0 {
                if !validated {
                    self.save_last()?;
                }
                return Err(Error::Interrupted(format!(
                    "saved at step {}; go on with --resume --out {}",
                    self.progress.step,
                    self.folder.path().display()
                )));
            }
        }
        Ok(())
    }

    /// The share of the run at which the next validation is due.
    fn next_validation(&self) -> f64 {
        let validations = self.config.train.validations as f64;
        ((self.progress.fraction * validations + SLACK).floor() + 1.0) / validations
    }

    fn fraction(&self) -> f64 {
        let p = &self.progress;
        let share = match self.config.train.budget {
            Budget::Steps(steps) => p.step as f64 / steps as f64,
            Budget::Samples(samples) => p.samples as f64 / samples as f64,
            Budget::Minutes(minutes) => p.seconds / (60.0 * minutes),
        };
        share.min(1.0)
    }

    fn sigmas(&self) -> Sigmas {
        Sigmas::at(self.learner.architecture(), self.config.train.smoothing.as_ref(), self.progress.fraction)
    }

    /// One optimiser step; returns its loss.
    fn step(&mut self) -> Result<f64> {
        let (step, fraction) = (self.progress.step, self.progress.fraction);
        let train = &self.config.train;
        let batch = self.stream.next_batch()?;
        let offset_texture = !train.offset_freeze.is_some_and(|share| fraction >= share);
        let task = Step {
            pieces: &batch.pieces,
            terms: &self.stages[self.progress.stage].terms,
            target_range: train.target_range,
            highest_level: self.highest_level(step),
            offset_texture,
        };
        let sigmas = self.sigmas();
        let loss = self.learner.step(&task, &sigmas)?;
        if !loss.is_finite() {
            return Err(Error::Diverged(self.explain(&task, &sigmas)?));
        }
        let rate = train.learning_rate.at(fraction);
        self.learner.update_networks(rate, step + 1)?;
        self.progress.step += 1;
        self.progress.samples += train.batch as u64;
        self.progress.add_loss(loss, self.curve_interval());
        if self.between_updates() == 0 || self.fraction() >= 1.0 {
            let updates = self.progress.step.div_ceil(self.texture_every());
            self.learner.update_textures(rate, updates, offset_texture)?;
            self.blend()?;
        }
        Ok(loss)
    }

    /// Steps since the last update of the textures.
    fn between_updates(&self) -> u64 {
        self.progress.step % self.texture_every()
    }

    fn texture_every(&self) -> u64 {
        self.config.train.texture_every(self.learner.architecture().resolution)
    }

    fn explain(&self, step: &Step, sigmas: &Sigmas) -> Result<String> {
        let (architecture, variables) = (self.learner.architecture(), self.learner.variables());
        let job = candle_engine::Job {
            networks: &Networks::new(architecture, variables)?,
            variables,
            tables: &Tables::new(architecture, variables, sigmas)?,
            step,
            device: &self.device,
        };
        Ok(diagnosis::explain(&job, self.progress.step, self.folder.path()))
    }

    /// Steps between two points of the loss curve; with a budget in minutes the count of steps is not known beforehand.
    fn curve_interval(&self) -> u64 {
        let steps = match self.config.train.budget {
            Budget::Steps(steps) => steps,
            Budget::Samples(samples) => samples / self.config.train.batch as u64,
            Budget::Minutes(_) => return 50,
        };
        (steps / CURVE_POINTS).max(1)
    }

    fn highest_level(&self, step: u64) -> Option<u32> {
        let choices = &self.config.train.level_dropout;
        if choices.is_empty() {
            return None;
        }
        let mut random = Random::new(self.config.train.seed, RandomStream::LevelDropout, step);
        choices[random.below(choices.len())]
    }

    /// NeuMIP's early blending of the stored levels towards their blur.
    fn blend(&mut self) -> Result<()> {
        let Some(blend) = self.config.train.blend else {
            return Ok(());
        };
        let after = self.fraction();
        let before = std::mem::replace(&mut self.updated, after);
        if before >= blend.until || (before / blend.every).floor() == (after / blend.every).floor() {
            return Ok(());
        }
        for (name, var) in self.learner.variables().iter() {
            if name.starts_with("texture.") {
                let stored = var.as_detached_tensor();
                let blurred = smoothed(&stored, blend.sigma)?;
                var.set(&((stored * (1.0 - blend.amount))? + (blurred * blend.amount)?)?)?;
            }
        }
        Ok(())
    }

    fn validate(&mut self) -> Result<Event> {
        let checkpoint = self.checkpoint()?;
        let engine = self.config.train.engine;
        let Answerer { material, .. } = answerer(&checkpoint, engine, Precision::Single, &self.device)?;
        let mut sum = ErrorSum::default();
        for block in &self.validation {
            let queries = block.queries(self.header.architecture.resolution);
            let answer = material.evaluate(&queries).map_err(|error| match error {
                Error::Config { problem, .. } => Error::Diverged(format!(
                    "validation at step {}: {problem}; lower the learning rate; the last good state is kept in {}",
                    self.progress.step,
                    self.folder.path().display()
                )),
                other => other,
            })?;
            sum.add(&answer.pixels, &block.target());
        }
        let (point, best) = self.progress.add_validation(sum.errors(), &self.stages);
        if best {
            let mut checkpoint = checkpoint;
            checkpoint.header.errors = self.progress.latest_errors();
            self.folder.save_best(&checkpoint)?;
        }
        Ok(Event::Validation { point, best })
    }

    /// The material as queries read it now.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn checkpoint(&self) -> Result<Checkpoint> {
        let sigmas = self.sigmas();
        let mut tensors = self.learner.variables().to_stored()?;
        for (name, var) in self.learner.variables().iter() {
            let sigma = sigmas.of(name);
            if sigma > 0.0 {
                let texture = smoothed(&var.as_detached_tensor(), sigma)?;
                tensors.insert(name.to_string(), crate::model::variables::to_stored(&texture)?);
            }
        }
        let mut header = self.header.clone();
        header.provenance = self.progress.provenance(&self.config, &self.data);
        header.errors = self.progress.latest_errors();
        Ok(Checkpoint { header, tensors })
    }

    fn save_last(&self) -> Result<()> {
        let mut tensors = BTreeMap::new();
        let (first, second) = self.learner.moments();
        for (prefix, variables) in [("value", self.learner.variables()), ("first", first), ("second", second)]
        {
            for (name, tensor) in variables.to_stored()? {
                tensors.insert(format!("{prefix}.{name}"), tensor);
            }
        }
        let progress =
            serde_json::to_value(&self.progress).map_err(|e| Error::file(self.folder.path(), e))?;
        let state = State { generation: self.progress.step, progress, tensors };
        self.folder.save_last(&self.checkpoint()?, &state)?;
        self.folder.write_json("history.json", &self.progress)
    }
}

/// Checks that the data has images for a decoder that reads them.
fn check_images(config: &Config, data: &Dataset) -> Result<()> {
    let resolution = data.resolution();
    let architecture = Architecture::new(config.model.clone(), resolution)?;
    let Some(radius) = architecture.neighbourhood() else { return Ok(()) };
    for name in [SplitName::Train, SplitName::Validation] {
        let split = data.split(name)?;
        // Validation answers whole blocks.
        let piece = if name == SplitName::Train { config.train.piece } else { split.info().side };
        (0..split.files()).try_for_each(|file| {
            split.layouts(file)?.iter().try_for_each(|layout| layout.check_images(radius, piece, resolution))
        })?;
    }
    Ok(())
}

/// The data of a run: the training stream and the validation split.
struct Sources {
    stream: Stream,
    validation: Vec<Block>,
}

impl Sources {
    /// The sources of a run that is about to take step `step`.
    fn open(config: &Config, data: &Dataset, memory: usize, step: u64) -> Result<Self> {
        let train = &config.train;
        let pieces = train.batch / (train.piece * train.piece);
        let mut stream = Stream::new(data, SplitName::Train, train.piece, pieces, memory, train.seed)?;
        // Damaged data is better found before a run's folder is made; what is read here is the first step's.
        stream.seek(step);
        stream.next_batch()?;
        stream.seek(step);
        check_images(config, data)?;
        let split = data.split(SplitName::Validation)?;
        let mut validation = Vec::new();
        for file in 0..split.files() {
            validation.extend(split.read_file(file)?);
        }
        Ok(Self { stream, validation })
    }
}
