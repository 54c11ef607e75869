//! Rendering a dataset from a ground truth: held-out splits first, training data last.

use super::{
    block::{Block, Layout, stack},
    config::GenerateConfig,
    format::Manifest,
    plan::{Plan, plans},
    query_frame::to_half,
    scene::SCENES,
    source::Source,
    write::{Existing, Writer},
};
use crate::{
    error::{Error, Result},
    query::{QueryBuffer, RgbImage},
};
use std::{ops::ControlFlow, path::Path};

/// Samples that are measured at a time: the longest wait between two calls of the progress callback.
const CHUNK: usize = 1 << 16;
/// Numbers of a split's samples start here times its place; views follow the splits.
const SAMPLES_OF_A_SPLIT: u64 = 1 << 48;
/// The first place after the splits.
const FIRST_VIEW: u64 = 8;

/// How far a generation is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Split (or `views`) that is being made.
    pub split: &'static str,
    /// Samples of the whole dataset that are done.
    pub done: u64,
    /// Samples of the whole dataset.
    pub total: u64,
}

/// Counts samples and hears when to stop.
struct Meter<'a> {
    report: &'a mut dyn FnMut(Progress) -> ControlFlow<()>,
    now: Progress,
    stopped: bool,
}

impl Meter<'_> {
    fn advance(&mut self, samples: usize) {
        self.now.done += samples as u64;
        self.stopped |= (self.report)(self.now).is_break();
    }

    /// The error that ends a stopped run.
    fn check(&self) -> Result<()> {
        if !self.stopped {
            return Ok(());
        }
        let Progress { done, total, .. } = self.now;
        Err(Error::Interrupted(format!("{done} of {total} samples were made; resume to make the rest")))
    }
}

/// Renders a dataset of `source` into the folder `out` and returns its description.
///
/// The bytes of every file depend on the source, the configuration and the file's place only: a run that was
/// stopped and resumed ends with the same folder as one that was not. One file's samples are held in memory
/// at a time.
///
/// `progress` is called after every chunk of samples; when it breaks, the work ends with `Interrupted` and
/// the files that are whole form a valid dataset.
///
/// # Errors
/// `Config` for a bad configuration or source, `File` for the folder, `Interrupted`.
pub fn generate(
    source: &dyn Source,
    config: &GenerateConfig,
    out: &Path,
    existing: Existing,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<Manifest> {
    let plans = plans(config)?;
    let resolution = [config.resolution; 2];
    let mut manifest = Manifest::new(source.name(), source.description(), resolution, source.height_range());
    manifest.generation = Some(config.clone());
    let mut writer = Writer::create(out, manifest, existing)?;
    if writer.manifest().complete {
        return Ok(writer.manifest().clone());
    }
    for plan in &plans {
        writer.plan_split(plan.name, plan.side, plan.blocks, Some(plan.spp))?;
    }
    if config.heights
        && writer.manifest().heights.is_none()
        && let Some((height, width, values)) = source.height_map()
    {
        writer.set_heights(height, width, values)?;
    }

    let of_view = (config.view_size * config.view_size) as u64;
    let views = if of_view > 0 { SCENES.len() } else { 0 };
    let blocks: u64 = plans.iter().map(|plan| (plan.blocks * plan.side * plan.side) as u64).sum();
    let made = writer.manifest();
    let done = made.splits.values().map(|s| s.samples()).sum::<u64>() + made.views.len() as u64 * of_view;
    let now = Progress { split: "views", done, total: blocks + views as u64 * of_view };
    let mut meter = Meter { report: progress, now, stopped: false };

    let (training, held_out) =
        plans.split_last().ok_or_else(|| Error::usage("there is nothing to generate"))?;
    for plan in held_out {
        make_split(source, config, plan, &mut writer, &mut meter)?;
    }
    meter.now.split = "views";
    for (index, scene) in SCENES.iter().enumerate().take(views).skip(writer.manifest().views.len()) {
        let queries = scene.queries(config.view_size, config.view_tiles, resolution);
        let mut pixels = Vec::with_capacity(queries.len());
        let mut variance = 0.0;
        for start in (0..queries.len()).step_by(CHUNK) {
            let part = queries.range(start, (start + CHUNK).min(queries.len()));
            let first = (FIRST_VIEW + index as u64) * SAMPLES_OF_A_SPLIT + start as u64;
            let (rgb, noise) = measure(source, &part, config.held_out_spp, config.seed, first)?;
            pixels.extend(rgb);
            variance += noise.iter().map(|v| f64::from(*v)).sum::<f64>();
            meter.advance(part.len());
            if pixels.len() < queries.len() {
                meter.check()?;
            }
        }
        let rgb = RgbImage { height: queries.height(), width: queries.width(), pixels };
        let variance = (variance / queries.len() as f64) as f32;
        writer.push_view(scene.name, &queries, &rgb, variance)?;
        meter.check()?;
    }
    make_split(source, config, training, &mut writer, &mut meter)?;
    writer.finish()
}

/// Makes the files of a split that are not there yet.
fn make_split(
    source: &dyn Source,
    config: &GenerateConfig,
    plan: &Plan,
    writer: &mut Writer,
    meter: &mut Meter,
) -> Result<()> {
    meter.now.split = plan.name.as_str();
    let made = writer.manifest().splits.get(&plan.name).map_or(0, |split| split.files.len());
    for file in made..plan.files() {
        let blocks = plan.blocks_of(file);
        let first = plan.name as u64 * SAMPLES_OF_A_SPLIT + (blocks.start * plan.side * plan.side) as u64;
        let layouts = blocks.map(|index| plan.layout(index)).collect::<Result<Vec<_>>>()?;
        writer.push(plan.name, &measure_blocks(source, config, plan, layouts, first, meter)?)?;
        meter.check()?;
    }
    Ok(())
}

/// Answers of all blocks of a file, chunk by chunk.
fn measure_blocks(
    source: &dyn Source,
    config: &GenerateConfig,
    plan: &Plan,
    layouts: Vec<Layout>,
    first: u64,
    meter: &mut Meter,
) -> Result<Vec<Block>> {
    let side = plan.side;
    let (rows, samples) = (layouts.len() * side, side * side);
    let chunk = (CHUNK / side).max(1);
    let mut rgb = Vec::with_capacity(rows * side);
    let mut variance = vec![0.0f64; layouts.len()];
    for start in (0..rows).step_by(chunk) {
        let end = (start + chunk).min(rows);
        let lines = (start..end).map(|row| (&layouts[row / side], row % side));
        let queries = stack(lines, side, [config.resolution; 2]);
        let offset = start * side;
        let (answers, noise) = measure(source, &queries, plan.spp, config.seed, first + offset as u64)?;
        for (k, value) in noise.iter().enumerate() {
            variance[(offset + k) / samples] += f64::from(*value);
        }
        rgb.extend(answers.iter().map(|pixel| pixel.map(to_half)));
        meter.advance(queries.len());
        // The last chunk is kept even if it is time to stop.
        if end < rows {
            meter.check()?;
        }
    }
    let answers = layouts.into_iter().zip(rgb.chunks_exact(samples)).zip(variance);
    answers
        .map(|((layout, rgb), variance)| Block::new(layout, rgb.to_vec(), (variance / samples as f64) as f32))
        .collect()
}

/// Asks the source and checks what it says.
fn measure(
    source: &dyn Source,
    queries: &QueryBuffer,
    spp: usize,
    seed: u64,
    first: u64,
) -> Result<(Vec<[f32; 3]>, Vec<f32>)> {
    let material = || format!("material {}", source.name());
    let (rgb, variance) = source.measure(queries, spp, seed, first)?;
    if rgb.len() != queries.len() || variance.len() != queries.len() {
        return Err(Error::config(
            material(),
            format!("answered {} of {} queries", rgb.len(), queries.len()),
        ));
    }
    let sound =
        |k: &usize| rgb[*k].iter().all(|v| v.is_finite()) && variance[*k].is_finite() && variance[*k] >= 0.0;
    match (0..rgb.len()).find(|k| !sound(k)) {
        Some(k) => Err(Error::config(
            material(),
            format!(
                "gives {:?} with variance {} for u {:?}, wi {:?}, wo {:?}, level {}",
                rgb[k], variance[k], queries.u[k], queries.wi[k], queries.wo[k], queries.level[k]
            ),
        )),
        None => Ok((rgb, variance)),
    }
}
