//! What training steps and answers cost, on every instruction set, beside plain candle and beside the machine's own peak.
//!
//! All that does equal work is timed in turn, round by round: a machine that slows down for a while slows all of it down.

mod group;
mod peak;
mod subject;
#[cfg(test)]
mod tests;
mod work;

pub use subject::{DEFAULT, PIECE, Subject};

use crate::config::EngineKind;
use crate::error::{Error, Result};
use group::Group;
use serde::Serialize;
use std::ops::ControlFlow;

/// The batch at which every instruction set is timed; the largest, where it is not among them.
pub const BATCH_OF_ALL_SETS: usize = 65_536;
/// Largest batch: what training allows.
const MOST_SAMPLES: usize = 1 << 24;
const MOST_THREADS: usize = 1024;
const MOST_EVERY: u64 = 4096;
const MOST_SIGMA: f64 = 1e3;

/// Kinds of work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Kind {
    /// A whole optimiser step: forward, loss, backward, Adam of the networks and of all textures.
    Train,
    /// Answers of the whole material.
    Infer,
}

/// What is timed and how.
#[derive(Clone, Debug)]
pub struct Options {
    /// The model and its losses.
    pub subject: Subject,
    /// Kinds of work.
    pub kinds: Vec<Kind>,
    /// Samples of a step, queries of a call: multiples of [`PIECE`]^2.
    pub batches: Vec<usize>,
    /// Numbers of threads.
    pub threads: Vec<usize>,
    /// Rounds, after one that warms caches and allocators.
    pub rounds: usize,
    /// sigma of level 0 in texels, where textures are read smoothed.
    pub sigma: f64,
    /// Steps between two updates of the textures, where they are not updated at every one.
    pub texture_every: u64,
    /// Only the fused engine, on the instruction set in use, without smoothing: what other programs are compared with.
    pub bare: bool,
    /// Least seconds of one timing.
    pub seconds: f64,
}

/// One line of the table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// `train`; `infer`, `infer-half` with textures in half precision, `lights-N` for queries that are prepared once and
    /// then answered under N lights each.
    pub work: String,
    /// What did it.
    pub engine: EngineKind,
    /// Instruction set; `auto` where candle chooses.
    pub isa: String,
    /// Samples of a step, queries of a call.
    pub batch: usize,
    /// Threads.
    pub threads: usize,
    /// How the textures were read: `none`, or sigma of level 0 and how often they are updated, if not at every step.
    pub smoothing: String,
    /// Samples, queries or, for `lights-N`, answers a second: median over the rounds.
    pub samples_per_s: f64,
    /// Slowest round.
    pub low: f64,
    /// Fastest round.
    pub high: f64,
    /// Rounds.
    pub rounds: usize,
    /// `samples_per_s` over that of plain candle at the same work in the same rounds on as many threads; none where candle
    /// was left out.
    pub ratio_to_candle: Option<f64>,
    /// `lights-N`: over that of as many whole answers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ratio_to_whole: Option<f64>,
    /// Multiply-adds of the networks times 2, for training times 3, without padding, recomputation and whatever is no
    /// network: 10^9 a second.
    pub useful_gflops: f64,
    /// The most that as many threads do with the machine's widest set, measured in the same rounds: 10^9 a second.
    pub peak_gflops: f64,
    /// The same with this row's set.
    pub isa_peak_gflops: f64,
    /// `useful_gflops` over `peak_gflops`.
    pub peak_share: f64,
    /// Texels of the tile, \[height, width\].
    pub resolution: [usize; 2],
    /// [`DEFAULT`], or the preset.
    pub model: String,
}

/// Called before every timing with the share of the bench that is done and what is timed; `Break` stops.
pub type Listener<'a> = dyn FnMut(f64, &str) -> ControlFlow<()> + 'a;

impl Options {
    /// Checks every bound.
    ///
    /// # Errors
    /// `Config`, naming the option.
    pub fn validate(&self) -> Result<()> {
        let samples = PIECE * PIECE;
        let fails = |n: &&usize| **n == 0 || !n.is_multiple_of(samples) || **n > MOST_SAMPLES;
        if let Some(n) = self.batches.iter().find(fails) {
            let problem = format!("{n} is not a multiple of {samples} (up to {MOST_SAMPLES})");
            return Err(Error::config("batches", problem));
        }
        if let Some(n) = self.threads.iter().find(|n| !(1..=MOST_THREADS).contains(*n)) {
            return Err(Error::config("threads", format!("{n} is outside 1 to {MOST_THREADS}")));
        }
        for (field, empty) in [
            ("batches", self.batches.is_empty()),
            ("threads", self.threads.is_empty()),
            ("work", self.kinds.is_empty()),
            ("rounds", self.rounds == 0),
        ] {
            if empty {
                return Err(Error::config(field, "at least one is needed"));
            }
        }
        if !(1..=MOST_EVERY).contains(&self.texture_every) {
            let problem = format!("{} is outside 1 to {MOST_EVERY}", self.texture_every);
            return Err(Error::config("texture_every", problem));
        }
        if !(self.sigma > 0.0 && self.sigma <= MOST_SIGMA) {
            return Err(Error::config("sigma", format!("{} is not in (0, {MOST_SIGMA}]", self.sigma)));
        }
        Ok(())
    }

    /// The batch at which every instruction set is timed.
    fn batch_of_all_sets(&self) -> usize {
        let largest = self.batches.iter().copied().max().unwrap_or(0);
        if self.batches.contains(&BATCH_OF_ALL_SETS) { BATCH_OF_ALL_SETS } else { largest }
    }
}

/// Times everything that the options ask for.
///
/// # Errors
/// `Config` for an option that is out of range, `Usage` for an instruction set that this machine has not, `Interrupted` if
/// the listener says so, or whatever candle refuses.
pub fn run(options: &Options, listener: &mut Listener) -> Result<Vec<Row>> {
    options.validate()?;
    let group = Group::new(options)?;
    let groups = (options.kinds.len() * options.batches.len()) as f64;
    let mut rows = Vec::new();
    let mut done = 0.0;
    for kind in &options.kinds {
        for &batch in &options.batches {
            let mut tell = |share: f64, label: &str| match listener((done + share) / groups, label) {
                ControlFlow::Continue(()) => Ok(()),
                ControlFlow::Break(()) => Err(Error::Interrupted("no table was written".into())),
            };
            rows.extend(match kind {
                Kind::Train => group.train(batch, &mut tell)?,
                Kind::Infer => group.infer(batch, &mut tell)?,
            });
            done += 1.0;
        }
    }
    Ok(rows)
}
