//! The scene's own pictures, asked once: whoever answers for the fitted material is compared on the same rays.

use super::truth::Truth;
use crate::error::{Error, Result};
use crate::query::{QueryBuffer, Reflectance, RgbImage};
use crate::render::asked::Answers;
use crate::render::compare::Comparison;
use crate::render::frame_file::{self, Label};
use crate::render::material::Answered;
use crate::render::{Asked, Scene};
use rayon::prelude::*;
use std::ops::ControlFlow;
use std::path::Path;

/// When pictures are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Times {
    /// From the path's beginning to its end.
    Whole,
    /// Halfway between those: what choices are made on.
    Between,
}

/// How pictures are taken.
#[derive(Clone, Debug)]
pub struct Wanted<'a> {
    /// Which material of the scene is fitted.
    pub material: usize,
    /// Pictures over the path; a scene without a path has one.
    pub frames: usize,
    /// When.
    pub times: Times,
    /// Samples a pixel; 0 leaves the scene's.
    pub samples: usize,
    /// Rays a query of the truth.
    pub spp: usize,
    /// Folder in which the truth's pictures are kept, and the beginning of their names.
    pub folder: &'a Path,
    /// What tells these pictures from others in the folder.
    pub name: &'a str,
}

/// A picture's queries and its truth.
struct Frame {
    height: usize,
    width: usize,
    /// Batch by batch what is asked, and the answers of the other materials.
    batches: Vec<(Asked, Answers)>,
    truth: RgbImage,
    noise: Option<f64>,
}

/// Pictures.
pub struct Pictures {
    material: usize,
    frames: Vec<Frame>,
}

impl Pictures {
    /// The pictures of a scene, whose material `wanted.material` the truth answers for. Truths that are in the folder already
    /// are read from there.
    ///
    /// # Errors
    /// Whatever keeps a material from answering; `Interrupted` if `progress`, which is told the share that is done, breaks.
    pub fn take(
        scene: &Scene,
        truth: &Truth,
        wanted: &Wanted,
        progress: &mut dyn FnMut(f64) -> ControlFlow<()>,
    ) -> Result<Self> {
        let count = if scene.frames() == 1 { 1 } else { wanted.frames.max(1) };
        let mut frames = Vec::with_capacity(count);
        for k in 0..count {
            let frame = match (wanted.times, scene.frames()) {
                (_, 1) => scene.frame(0)?,
                (Times::Whole, _) => scene.frame_at(k, count)?,
                (Times::Between, _) => scene.frame_at(2 * k + 1, 2 * count + 1)?,
            };
            let frame = frame.with_samples(wanted.samples);
            let (width, height) = (frame.camera.width(), frame.camera.height());
            let path = wanted.folder.join(format!("{}-{k:04}.exr", wanted.name));
            let label = Label {
                identity: format!(
                    "{} {} {k}/{count} {:?} {} {}",
                    scene.identity, scene.seed, wanted.times, frame.samples, wanted.spp
                ),
                variance: None,
            };
            let known = frame_file::label(&path).filter(|found| found.identity == label.identity);
            let mut pixels = vec![[0.0f32; 3]; width * height];
            let mut variance = vec![0.0f32; width * height];
            let mut batches = Vec::new();
            let ranges = scene.batches(&frame);
            let parts = ranges.len();
            for (number, range) in ranges.into_iter().enumerate() {
                let asked = scene.ask(&frame, range.clone())?;
                let others = scene.materials.iter().zip(&asked.queries).enumerate();
                let mut answers: Answers = others
                    .map(|(m, (material, queries))| {
                        if m == wanted.material {
                            return Ok(Answered { rgb: Vec::new(), variance: None });
                        }
                        let batch = ((k as u64) << 20) + number as u64;
                        material.answer(queries, scene.seed, batch).map(quiet)
                    })
                    .collect::<Result<_>>()?;
                if known.is_none() {
                    let first = (((k as u64) << 20) + number as u64) << 32;
                    let seed = crate::random::hash(scene.seed ^ wanted.times as u64);
                    let queries = &asked.queries[wanted.material];
                    let (rgb, noise) = truth.ask(queries, wanted.spp, seed, first)?;
                    answers[wanted.material] = Answered { rgb, variance: Some(noise) };
                    asked.shade_all(&answers, &mut pixels[range.clone()], &mut variance[range]);
                    answers[wanted.material] = Answered { rgb: Vec::new(), variance: None };
                }
                batches.push((asked, answers));
                let done = (k as f64 + (number + 1) as f64 / parts as f64) / count as f64;
                if progress(done).is_break() {
                    return Err(Error::Interrupted("the pictures were not finished".into()));
                }
            }
            let (truth, noise) = match known {
                Some(label) => (frame_file::read(&path)?, label.variance.map(f64::from)),
                None => {
                    let image = RgbImage { height, width, pixels };
                    let mean = variance.iter().map(|v| f64::from(*v)).sum::<f64>() / variance.len() as f64;
                    let noise = truth.is_surface().then_some(mean);
                    let label = Label { variance: noise.map(|n| n as f32), ..label };
                    frame_file::write(&path, &image, false, &label)?;
                    (image, noise)
                }
            };
            frames.push(Frame { height, width, batches, truth, noise });
        }
        Ok(Self { material: wanted.material, frames })
    }

    /// The pictures that an answerer makes.
    ///
    /// # Errors
    /// Whatever keeps it from answering.
    pub fn of(&self, material: &dyn Reflectance) -> Result<Vec<RgbImage>> {
        self.frames.iter().map(|frame| self.picture(frame, material)).collect()
    }

    fn picture(&self, frame: &Frame, material: &dyn Reflectance) -> Result<RgbImage> {
        let mut pixels = vec![[0.0f32; 3]; frame.width * frame.height];
        let mut variance = vec![0.0f32; pixels.len()];
        for (asked, others) in &frame.batches {
            let rgb = material.evaluate(&asked.queries[self.material])?.pixels;
            let mut answers: Answers =
                others.iter().map(|other| Answered { rgb: other.rgb.clone(), variance: None }).collect();
            answers[self.material] = Answered { rgb, variance: None };
            let range = match (asked.parts.first(), asked.parts.last()) {
                (Some(first), Some(last)) => first.pixels.start..last.pixels.end,
                _ => continue,
            };
            asked.shade_all(&answers, &mut pixels[range.clone()], &mut variance[range]);
        }
        Ok(RgbImage { height: frame.height, width: frame.width, pixels })
    }

    /// Errors of every picture that an answerer makes.
    ///
    /// # Errors
    /// Whatever keeps it from answering.
    pub fn compare(&self, material: &dyn Reflectance) -> Result<Vec<Comparison>> {
        let pictures = self.of(material)?;
        let pairs = pictures.par_iter().zip(&self.frames);
        Ok(pairs.map(|(picture, frame)| Comparison::new(picture, &frame.truth, frame.noise)).collect())
    }

    /// The truth of every picture.
    pub fn truths(&self) -> impl Iterator<Item = &RgbImage> {
        self.frames.iter().map(|frame| &frame.truth)
    }

    /// What the fitted material is asked, in the order of the pictures' pixels.
    pub fn queries(&self) -> impl Iterator<Item = &QueryBuffer> {
        self.frames
            .iter()
            .flat_map(|frame| frame.batches.iter().map(|(asked, _)| &asked.queries[self.material]))
    }

    /// Number of pictures.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// True if there is none.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }
}

/// Answers whose noise does not count.
fn quiet(answered: Answered) -> Answered {
    Answered { variance: None, ..answered }
}
