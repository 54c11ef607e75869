//! Equal work side by side: who takes part, their rounds, and the rows that follow.

use super::subject::Subject;
use super::work::{Task, Trainee};
use super::{Options, Row, peak};
use crate::config::{EngineKind, Smoothing};
use crate::engine::FusedMaterial;
use crate::error::{Error, Result};
use crate::kernels::simd::Isa;
use crate::model::texture::Sigmas;
use crate::model::{self, NeuralMaterial, Variables};
use crate::trainer::Learner;
use neumip_export::Precision;
use neumip_export::checkpoint::Checkpoint;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// Lights that prepared queries are answered under.
const LIGHTS: [usize; 3] = [1, 4, 16];
/// From this batch on a step of plain candle takes seconds, ...
const LARGE: usize = 1 << 17;
/// ... and it takes part in so many rounds only.
const ROUNDS_OF_LARGE: usize = 3;
/// Sigma in texels under which training reads a texture as it is, and the least of the offset texture.
const SKIP_BELOW: f64 = 0.2;
const OFFSET_MINIMUM: f64 = 1.0;

/// What all groups share.
pub(super) struct Group<'a> {
    options: &'a Options,
    checkpoint: Checkpoint,
    pools: Vec<ThreadPool>,
    sets: Vec<Isa>,
    chosen: Isa,
}

/// One that takes part.
struct Entry<'a> {
    work: String,
    /// None for the peak.
    engine: Option<EngineKind>,
    isa: Option<Isa>,
    smoothing: String,
    /// Samples of a pass.
    samples: usize,
    /// Useful operations of a sample; for the peak, of a pass on one thread.
    operations: f64,
    rounds: usize,
    task: Task<'a>,
    /// On each pool.
    timings: Vec<Timing>,
}

#[derive(Clone, Default)]
struct Timing {
    passes: usize,
    /// A pass in each round.
    seconds: Vec<f64>,
}

/// Hears the share of the group's timings that are done and what is timed; its error ends the bench.
type Tell<'a> = dyn FnMut(f64, &str) -> Result<()> + 'a;

impl<'a> Group<'a> {
    pub fn new(options: &'a Options) -> Result<Self> {
        let pool = |&n: &usize| {
            let built = ThreadPoolBuilder::new().num_threads(n).build();
            built.map_err(|e| Error::usage(format!("{n} timing threads cannot be started: {e}")))
        };
        Ok(Self {
            options,
            checkpoint: options.subject.checkpoint()?,
            pools: options.threads.iter().map(pool).collect::<Result<_>>()?,
            sets: Isa::all(),
            chosen: Isa::chosen()?,
        })
    }

    /// Times optimiser steps.
    pub fn train(&self, batch: usize, tell: &mut Tell) -> Result<Vec<Row>> {
        let options = self.options;
        let batches = options.subject.batches(batch)?;
        let sigma = format!("sigma {}", options.sigma);
        let smoothed = self.sigmas(options.sigma);
        let rarely = format!("{sigma}, textures every {}", options.texture_every);
        let mut ways = vec![("none".to_string(), Sigmas::none(self.architecture()), 1)];
        if !options.bare {
            ways.push((sigma, smoothed.clone(), 1));
            if options.texture_every > 1 {
                ways.push((rarely, smoothed, options.texture_every));
            }
        }
        let operations = 3.0 * options.subject.operations().0;
        let mut entries = Vec::new();
        for (smoothing, sigmas, every) in ways {
            let mut add = |isa: Option<Isa>| -> Result<()> {
                let trainee = Trainee {
                    learner: self.learner(isa)?,
                    subject: &options.subject,
                    batches: &batches,
                    sigmas: sigmas.clone(),
                    every,
                    // A whole cycle of candle's takes half a minute.
                    most: if isa.is_some() { u64::MAX } else { 1 },
                    steps: 0,
                    updates: 0,
                };
                let task = Task::Train(Box::new(trainee));
                entries.push(self.entry("train", isa, &smoothing, batch, operations, task));
                Ok(())
            };
            add(Some(self.chosen))?;
            if every == 1 {
                self.others(batch).try_for_each(|isa| add(Some(isa)))?;
            }
            if !options.bare {
                add(None)?;
            }
        }
        self.rounds(entries, batch, tell)
    }

    /// Times answers.
    pub fn infer(&self, batch: usize, tell: &mut Tell) -> Result<Vec<Row>> {
        let options = self.options;
        let subject: &Subject = &options.subject;
        let queries = subject.queries(batch)?;
        let (whole, without_light) = subject.operations();
        let material = |isa, precision| {
            FusedMaterial::new(self.architecture(), &self.checkpoint.tensors, precision, isa)
        };
        let mut fused = vec![("infer", material(self.chosen, Precision::Single)?)];
        let mut plain = None;
        if !options.bare {
            fused.push(("infer-half", material(self.chosen, Precision::Half)?));
            for isa in self.others(batch) {
                fused.push(("infer", material(isa, Precision::Single)?));
                fused.push(("infer-half", material(isa, Precision::Half)?));
            }
            plain = Some(NeuralMaterial::from_checkpoint(&self.checkpoint, &model::device("cpu")?)?);
        }
        let with_lights = !options.bare && batch == options.batch_of_all_sets();
        let most = if with_lights { LIGHTS.into_iter().max().unwrap_or(0) } else { 0 };
        let lights = subject.lights(batch, most);

        let mut entries = Vec::new();
        for (work, material) in &fused {
            let task = Task::Answer(material, &queries);
            entries.push(self.entry(work, Some(material.isa()), "none", batch, whole, task));
        }
        for count in LIGHTS.into_iter().filter(|n| *n <= most) {
            let task = Task::Lights(&fused[0].1, &queries, &lights[..count]);
            // What does not depend on the light is done once for all of them.
            let operations = whole - without_light + without_light / count as f64;
            let samples = count * batch;
            entries.push(self.entry(
                &format!("lights-{count}"),
                Some(self.chosen),
                "none",
                samples,
                operations,
                task,
            ));
        }
        if let Some(material) = &plain {
            entries.push(self.entry("infer", None, "none", batch, whole, Task::Answer(material, &queries)));
        }
        self.rounds(entries, batch, tell)
    }

    /// One that takes part; without an instruction set it is candle.
    fn entry<'b>(
        &self,
        work: &str,
        isa: Option<Isa>,
        smoothing: &str,
        samples: usize,
        operations: f64,
        task: Task<'b>,
    ) -> Entry<'b> {
        let rounds = self.options.rounds;
        Entry {
            work: work.into(),
            engine: Some(if isa.is_some() { EngineKind::Fused } else { EngineKind::Candle }),
            isa,
            smoothing: smoothing.into(),
            samples,
            operations,
            rounds: if isa.is_none() && samples >= LARGE { rounds.min(ROUNDS_OF_LARGE) } else { rounds },
            task,
            timings: vec![Timing::default(); self.pools.len()],
        }
    }

    fn architecture(&self) -> &neumip_export::config::Architecture {
        &self.checkpoint.header.architecture
    }

    /// Instruction sets besides the chosen one, where a batch is timed on all.
    fn others(&self, batch: usize) -> impl Iterator<Item = Isa> {
        let all = !self.options.bare && batch == self.options.batch_of_all_sets();
        self.sets.iter().copied().filter(move |isa| all && *isa != self.chosen)
    }

    /// A fresh model; without an instruction set it is candle's.
    fn learner(&self, isa: Option<Isa>) -> Result<Learner> {
        let device = model::device("cpu")?;
        let variables = Variables::from_stored(self.architecture(), &self.checkpoint.tensors, &device)?;
        let adam = self.options.subject.adam;
        match isa {
            Some(isa) => Learner::with_isa(self.architecture(), variables, adam, isa),
            None => Learner::new(self.architecture(), variables, adam, Some(EngineKind::Candle), &device),
        }
    }

    /// Sigma of every texture where that of level 0 is `sigma`, by the rules of training.
    fn sigmas(&self, sigma: f64) -> Sigmas {
        let smoothing = Smoothing {
            start: sigma,
            rate: 0.0,
            minimum: 0.0,
            skip_below: SKIP_BELOW,
            offset_minimum: OFFSET_MINIMUM,
        };
        Sigmas::at(self.architecture(), Some(&smoothing), 0.0)
    }

    /// Times all entries and the machine's peak in turn.
    fn rounds(&self, mut entries: Vec<Entry>, batch: usize, tell: &mut Tell) -> Result<Vec<Row>> {
        for &isa in &self.sets {
            let entry = self.entry("peak", Some(isa), "none", 1, peak::operations(isa), Task::Peak(isa));
            entries.push(Entry { engine: None, ..entry });
        }
        let timings = entries.iter().map(|e| (e.rounds + 1) * self.pools.len()).sum::<usize>() as f64;
        let mut done = 0.0;
        // The first round warms caches and allocators, and says how long a pass takes.
        for round in 0..=self.options.rounds {
            for entry in entries.iter_mut().filter(|e| round <= e.rounds) {
                for (pool, timing) in self.pools.iter().zip(&mut entry.timings) {
                    tell(done / timings, &format!("{} {batch}", entry.work))?;
                    done += 1.0;
                    let seconds = entry.task.time(pool, timing.passes)?;
                    if round > 0 {
                        timing.seconds.push(seconds);
                    } else {
                        let pass = seconds * entry.task.steps() as f64;
                        timing.passes = (self.options.seconds / pass.max(1e-9)).ceil() as usize;
                    }
                }
            }
        }
        Ok(self.rows(&entries, batch))
    }

    fn rows(&self, entries: &[Entry], batch: usize) -> Vec<Row> {
        let mut rows = Vec::new();
        for (k, &threads) in self.options.threads.iter().enumerate() {
            let peak = |isa: Option<Isa>| {
                let entry = entries.iter().find(|e| e.engine.is_none() && e.isa == isa);
                entry.map_or(f64::NAN, |e| e.operations * threads as f64 / e.timings[k].median() * 1e-9)
            };
            let widest = peak(self.sets.first().copied());
            for entry in entries {
                let Some(engine) = entry.engine else { continue };
                let kind = if entry.work == "train" { "train" } else { "infer" };
                let rate = |e: &Entry| e.samples as f64 / e.timings[k].median();
                let over =
                    |of: &dyn Fn(&&Entry) -> bool| entries.iter().find(of).map(|e| rate(entry) / rate(e));
                let timing = &entry.timings[k];
                let useful = rate(entry) * entry.operations * 1e-9;
                let of_candle = |e: &&Entry| {
                    e.engine == Some(EngineKind::Candle) && e.work == kind && e.smoothing == entry.smoothing
                };
                let of_whole = |e: &&Entry| e.engine == Some(engine) && e.work == kind && e.isa == entry.isa;
                rows.push(Row {
                    work: entry.work.clone(),
                    engine,
                    isa: entry.isa.map_or("auto", Isa::name).into(),
                    batch,
                    threads,
                    smoothing: entry.smoothing.clone(),
                    samples_per_s: rate(entry),
                    low: entry.samples as f64 / timing.at(1.0),
                    high: entry.samples as f64 / timing.at(0.0),
                    rounds: timing.seconds.len(),
                    ratio_to_candle: over(&of_candle),
                    ratio_to_whole: if entry.work.starts_with("lights") { over(&of_whole) } else { None },
                    useful_gflops: useful,
                    peak_gflops: widest,
                    isa_peak_gflops: entry.isa.map_or(widest, |isa| peak(Some(isa))),
                    peak_share: useful / widest,
                    resolution: self.architecture().resolution,
                    model: self.options.subject.name.clone(),
                });
            }
        }
        rows
    }
}

impl Timing {
    fn median(&self) -> f64 {
        self.at(0.5)
    }

    /// The time below which a share of the rounds lies.
    fn at(&self, share: f64) -> f64 {
        let mut sorted = self.seconds.clone();
        sorted.sort_by(f64::total_cmp);
        let index = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
        sorted.get(index).copied().unwrap_or(f64::NAN)
    }
}
