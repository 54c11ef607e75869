//! How far a generation is, and when to stop it.

use crate::error::{Error, Result};
use std::ops::ControlFlow;

/// How far a generation is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Split (or `views`) that is being made.
    pub split: &'static str,
    /// Samples of the whole dataset that are done.
    pub done: u64,
    /// Samples of the whole dataset.
    pub total: u64,
    /// Rays that this run has traced.
    pub rays: u64,
}

/// Counts samples and hears when to stop.
pub(crate) struct Meter<'a> {
    report: &'a mut dyn FnMut(Progress) -> ControlFlow<()>,
    now: Progress,
    stopped: bool,
}

impl<'a> Meter<'a> {
    /// A meter that starts with `done` of `total` samples.
    pub(crate) fn new(report: &'a mut dyn FnMut(Progress) -> ControlFlow<()>, done: u64, total: u64) -> Self {
        Self { report, now: Progress { split: "views", done, total, rays: 0 }, stopped: false }
    }

    /// Names what follows.
    pub(crate) fn enter(&mut self, split: &'static str) {
        self.now.split = split;
    }

    /// Counts finished samples and rays.
    pub(crate) fn advance(&mut self, samples: usize, rays: u64) {
        self.now.done += samples as u64;
        self.now.rays += rays;
        self.stopped |= (self.report)(self.now).is_break();
    }

    /// The error that ends a stopped run.
    pub(crate) fn check(&self) -> Result<()> {
        if !self.stopped {
            return Ok(());
        }
        let Progress { done, total, .. } = self.now;
        Err(Error::Interrupted(format!("{done} of {total} samples were made; resume to make the rest")))
    }
}
