//! A frame's picture: its pixels in batches, traced, answered and summed.

use super::asked::Asked;
use super::material::Material;
use super::scene::{Frame, Scene};
use super::trace;
use crate::error::{Error, Result};
use crate::outside::Count;
use crate::query::{QueryBuffer, RgbImage};
use rayon::prelude::*;
use std::ops::{ControlFlow, Range};
use std::time::{Duration, Instant};

/// Camera rays of a batch: their queries keep every core of a large machine busy and fit its cache's next level.
const BATCH: usize = 1 << 17;
/// Camera rays of a batch whose answers are measured by many rays, at least: an interrupt waits for its end.
const LEAST_BATCH: usize = 1 << 13;
/// Camera rays that a core traces at a time.
const CHUNK: usize = 1 << 11;

/// A rendered frame.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Linear radiance.
    pub rgb: RgbImage,
    /// Variance of each pixel, averaged over RGB, by the noise of measured answers; None where no material measures.
    pub variance: Option<Vec<f32>>,
    /// What it took.
    pub cost: Cost,
    /// How many queries of each of the scene's materials are outside of what it was fitted for; None for those that were fitted
    /// for everything.
    pub outside: Vec<Option<Count>>,
}

/// What a frame took.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cost {
    /// Camera rays.
    pub rays: u64,
    /// Queries.
    pub queries: u64,
    /// Time in which rays were traced.
    pub tracing: Duration,
    /// Time in which queries were answered.
    pub answering: Duration,
    /// Time of everything.
    pub total: Duration,
}

/// How far a frame is.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Camera rays done.
    pub done: u64,
    /// Camera rays of the frame.
    pub total: u64,
    /// Queries answered.
    pub queries: u64,
}

impl Scene {
    /// Pixels of a frame, row by row, in the batches in which they are rendered.
    pub fn batches(&self, frame: &Frame) -> Vec<Range<usize>> {
        let pixels = frame.camera.width() * frame.camera.height();
        let slowest = self.materials.iter().filter_map(Material::rays).max().unwrap_or(1);
        let step = ((BATCH / slowest).max(LEAST_BATCH) / frame.samples).max(1);
        (0..pixels).step_by(step).map(|start| start..(start + step).min(pixels)).collect()
    }

    /// What a batch of pixels asks the scene's materials: a query buffer for each, and how answers become radiance. The
    /// same for any number of threads.
    ///
    /// # Errors
    /// Whatever keeps a material from drawing directions.
    pub fn ask(&self, frame: &Frame, pixels: Range<usize>) -> Result<Asked> {
        let step = (CHUNK / frame.samples).max(1);
        let chunks: Vec<_> =
            pixels.clone().step_by(step).map(|start| start..(start + step).min(pixels.end)).collect();
        let parts = chunks
            .into_par_iter()
            .map(|pixels| trace::trace(self, frame, pixels))
            .collect::<Result<Vec<_>>>()?;
        Asked::new(parts, self.materials.len())
    }

    /// Renders a frame.
    ///
    /// # Errors
    /// Whatever keeps a material from answering; `Interrupted` if `progress` breaks.
    pub fn render(
        &self,
        frame: &Frame,
        progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
    ) -> Result<Picture> {
        let begun = Instant::now();
        let (width, height) = (frame.camera.width(), frame.camera.height());
        let mut pixels = vec![[0.0f32; 3]; width * height];
        let mut variance = vec![0.0f32; width * height];
        let mut cost = Cost::default();
        let mut outside: Vec<Option<Count>> = vec![None; self.materials.len()];
        let total = (width * height * frame.samples) as u64;
        for (number, batch) in self.batches(frame).into_iter().enumerate() {
            let traced = Instant::now();
            let asked = self.ask(frame, batch.clone())?;
            cost.tracing += traced.elapsed();
            let answered = Instant::now();
            let answer = |(material, queries): (&Material, &QueryBuffer)| {
                let at = |error: Error| Error::config(format!("materials.{}", material.name), error);
                material.answer(queries, self.seed, number as u64).map_err(at)
            };
            let answers =
                self.materials.iter().zip(&asked.queries).map(answer).collect::<Result<Vec<_>>>()?;
            cost.answering += answered.elapsed();
            for ((sum, material), queries) in outside.iter_mut().zip(&self.materials).zip(&asked.queries) {
                if let Some(count) = material.outside(queries) {
                    sum.get_or_insert_default().join(&count);
                }
            }
            asked.shade_all(&answers, &mut pixels[batch.clone()], &mut variance[batch]);
            cost.queries += asked.len() as u64;
            cost.rays +=
                asked.parts.iter().map(|part| part.pixels.len() * frame.samples).sum::<usize>() as u64;
            if progress(Progress { done: cost.rays, total, queries: cost.queries }).is_break() {
                return Err(Error::Interrupted("the frame was not finished".into()));
            }
        }
        cost.total = begun.elapsed();
        let measured = self.materials.iter().any(|material| material.rays().is_some());
        let rgb = RgbImage { height, width, pixels };
        Ok(Picture { rgb, variance: measured.then_some(variance), cost, outside })
    }
}
