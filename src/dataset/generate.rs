//! Rendering a dataset from a ground truth: held-out splits first, training data last.

use super::{
    block::{Block, Layout, stack},
    config::{GenerateConfig, MAX_LIGHTS},
    format::{Manifest, SplitName},
    measure::Task,
    motion::{HALVES, SEQUENCES, picture_name},
    origin::earlier_amounts,
    plan::{Plan, plans},
    progress::{Meter, Progress},
    query_frame::to_half,
    scene::{Scene, scenes},
    shard::{Shard, ShardWriter},
    source::Source,
    write::{Existing, Writer},
};
use crate::{
    error::Result,
    query::{QueryBuffer, RgbImage},
};
use std::{ops::ControlFlow, path::Path};

/// Numbers of a split's samples start here times its place; views follow the splits.
const SAMPLES_OF_A_SPLIT: u64 = 1 << 48;
/// The first place after the splits.
const FIRST_VIEW: u64 = 8;
/// The first place after the views: two a sequence, whose frames share their random numbers half by half.
const FIRST_SEQUENCE: u64 = FIRST_VIEW + MAX_LIGHTS as u64;

/// Renders a dataset of `source` into the folder `out` and returns its description.
///
/// The bytes of every file depend on the source, the configuration and the file's place only: a run that was
/// stopped and resumed, or was made by shards, ends with the same folder as one that was not. One file's samples are
/// held in memory at a time.
///
/// With [`Existing::Append`] a finished dataset gets more training data, up to what `config` asks for: its files stay
/// as they are, and the new ones go on in the same sequences.
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
    config.validate()?;
    let earlier = earlier_amounts(out, config, existing)?;
    let work = Work::new(source, config, &earlier)?;
    let mut writer = Writer::create(out, work.manifest(earlier), existing)?;
    if writer.manifest().complete {
        writer.forget_shards()?;
        return Ok(writer.manifest().clone());
    }
    for plan in &work.plans {
        writer.plan_split(plan.name, plan.side, plan.blocks(), Some(plan.spp))?;
    }
    let total = work.items().map(|item| work.samples(item)).sum();
    let mut meter = Meter::new(progress, writer.samples(), total);
    for item in work.items() {
        work.make(item, &mut writer, &mut meter)?;
    }
    writer.finish()
}

/// Makes a shard's share of the files of a dataset in the folder `out`; see [`Shard`]. Once every shard is in one
/// folder, [`generate`] with [`Existing::Resume`] makes a dataset of them.
///
/// # Errors
/// As [`generate`]; `Usage` for [`Existing::Append`].
pub fn generate_shard(
    source: &dyn Source,
    config: &GenerateConfig,
    shard: Shard,
    out: &Path,
    existing: Existing,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<()> {
    let work = Work::new(source, config, &[])?;
    let mut writer = ShardWriter::create(out, work.manifest(Vec::new()), shard, existing)?;
    let own = || work.items().enumerate().filter(|(k, _)| shard.takes(*k)).map(|(_, item)| item);
    let total = own().map(|item| work.samples(item)).sum();
    let mut done = 0;
    for item in own() {
        done += if writer.has(&work, item)? { work.samples(item) } else { 0 };
    }
    let mut meter = Meter::new(progress, done, total);
    own().try_for_each(|item| work.make(item, &mut writer, &mut meter))
}

/// One file of a dataset.
#[derive(Clone, Copy, Debug)]
enum Item {
    Heights,
    /// A file of the plan at a place.
    File(usize, usize),
    /// The view of the scene at a place.
    View(usize),
    /// Of the sequence at a place, the picture of that number.
    Motion(usize, usize),
}

/// Where files go.
trait Sink {
    /// True if the file is there.
    fn has(&mut self, work: &Work, item: Item) -> Result<bool>;
    fn heights(&mut self, height: usize, width: usize, values: Vec<f32>) -> Result<()>;
    fn file(&mut self, name: SplitName, index: usize, side: usize, blocks: &[Block]) -> Result<()>;
    /// Takes a view, or the next picture of a sequence.
    fn view(&mut self, sequence: Option<&str>, name: &str, picture: Picture) -> Result<()>;
}

/// Queries, their answers, and the mean variance of those.
struct Picture {
    queries: QueryBuffer,
    rgb: RgbImage,
    variance: f32,
}

/// Everything that is to be made.
struct Work<'a> {
    source: &'a dyn Source,
    config: GenerateConfig,
    plans: Vec<Plan>,
    scenes: Vec<Scene>,
}

impl<'a> Work<'a> {
    fn new(source: &'a dyn Source, config: &GenerateConfig, earlier: &[u64]) -> Result<Self> {
        let config = config.resolved(earlier)?;
        let plans = plans(&config, earlier)?;
        let scenes = if config.view_size > 0 { scenes(&config.lights)? } else { Vec::new() };
        Ok(Self { source, config, plans, scenes })
    }

    fn manifest(&self, earlier: Vec<u64>) -> Manifest {
        let source = self.source;
        let resolution = [self.config.resolution; 2];
        let mut manifest =
            Manifest::new(source.name(), source.description(), resolution, source.height_range());
        manifest.generation = Some(self.config.clone());
        manifest.appended_at = earlier;
        manifest
    }

    /// All files in the order in which they are made: training data, the last plan, comes last.
    fn items(&self) -> impl Iterator<Item = Item> {
        let files = |plan: usize| (0..self.plans[plan].files()).map(move |file| Item::File(plan, file));
        let heights = self.config.heights.then_some(Item::Heights);
        let training = self.plans.len().saturating_sub(1);
        let pictures = self.config.motion.map_or(0, |motion| HALVES * motion.frames);
        heights
            .into_iter()
            .chain((0..training).flat_map(files))
            .chain((0..self.scenes.len()).map(Item::View))
            .chain(
                (0..SEQUENCES.len())
                    .flat_map(move |k| (0..pictures).map(move |picture| Item::Motion(k, picture))),
            )
            .chain((training..self.plans.len()).flat_map(files))
    }

    fn samples(&self, item: Item) -> u64 {
        match item {
            Item::Heights => 0,
            Item::File(plan, file) => {
                let plan = &self.plans[plan];
                (plan.blocks_of(file).len() * plan.side * plan.side) as u64
            }
            Item::View(_) | Item::Motion(..) => (self.config.view_size * self.config.view_size) as u64,
        }
    }

    /// Makes a file if it is not there yet.
    fn make(&self, item: Item, sink: &mut dyn Sink, meter: &mut Meter) -> Result<()> {
        if sink.has(self, item)? {
            return Ok(());
        }
        match item {
            Item::Heights => {
                return match self.source.height_map() {
                    Some((height, width, values)) => sink.heights(height, width, values),
                    None => Ok(()),
                };
            }
            Item::File(plan, file) => {
                let plan = &self.plans[plan];
                meter.enter(plan.name.as_str());
                sink.file(plan.name, file, plan.side, &self.blocks(plan, file, meter)?)?;
            }
            Item::View(index) => {
                meter.enter("views");
                let scene = &self.scenes[index];
                let picture = self.picture(scene, FIRST_VIEW + index as u64, &self.config, meter)?;
                sink.view(None, &scene.name, picture)?;
            }
            Item::Motion(sequence, index) => {
                let Some(motion) = self.config.motion else { return Ok(()) };
                meter.enter("motion");
                let scene = motion.scene(sequence, index / HALVES);
                // As many sub-samples in every frame: where they differ, noise would move.
                let held_out_spp = self.config.held_out_spp.div_ceil(HALVES);
                let config = GenerateConfig { noise: None, held_out_spp, ..self.config.clone() };
                let place = FIRST_SEQUENCE + (HALVES * sequence + index % HALVES) as u64;
                let picture = self.picture(&scene, place, &config, meter)?;
                sink.view(Some(SEQUENCES[sequence]), &picture_name(SEQUENCES[sequence], index), picture)?;
            }
        }
        meter.check()
    }

    /// The blocks of a file with their answers.
    fn blocks(&self, plan: &Plan, file: usize, meter: &mut Meter) -> Result<Vec<Block>> {
        let (side, blocks) = (plan.side, plan.blocks_of(file));
        let samples = side * side;
        let task = Task {
            source: self.source,
            config: &self.config,
            spp: plan.spp,
            first: plan.name as u64 * SAMPLES_OF_A_SPLIT + (blocks.start * samples) as u64,
            width: side,
            lines: side,
            groups: blocks.len(),
        };
        let layouts = blocks.map(|index| plan.layout(index)).collect::<Result<Vec<Layout>>>()?;
        let queries = |rows: std::ops::Range<usize>| {
            stack(rows.map(|row| (&layouts[row / side], row % side)), side, [self.config.resolution; 2])
        };
        let (rgb, quality) = task.run(&queries, meter)?;
        let answers = layouts.iter().zip(rgb.chunks_exact(samples)).zip(quality);
        answers
            .map(|((layout, rgb), quality)| {
                let rgb = rgb.iter().map(|pixel| pixel.map(to_half)).collect();
                let block = Block::new(layout.clone(), rgb, quality.variance as f32)?;
                // Where the noise was given, sub-samples are the block's own.
                let own = self.config.noise.and(u32::try_from(quality.spp).ok());
                Ok(own.map_or(block.clone(), |spp| block.with_spp(spp)))
            })
            .collect()
    }

    /// The picture of a scene, with the random numbers of a place.
    fn picture(
        &self,
        scene: &Scene,
        place: u64,
        config: &GenerateConfig,
        meter: &mut Meter,
    ) -> Result<Picture> {
        let size = self.config.view_size;
        let resolution = [self.config.resolution; 2];
        let queries = scene.queries(size, self.config.view_tiles, resolution);
        let task = Task {
            source: self.source,
            config,
            spp: config.held_out_spp,
            first: place * SAMPLES_OF_A_SPLIT,
            width: size,
            lines: size,
            groups: 1,
        };
        let part = |rows: std::ops::Range<usize>| queries.range(rows.start * size, rows.end * size);
        let (pixels, quality) = task.run(&part, meter)?;
        let variance = quality.first().map_or(0.0, |picture| picture.variance as f32);
        Ok(Picture { queries, rgb: RgbImage { height: size, width: size, pixels }, variance })
    }
}

impl Sink for Writer {
    fn has(&mut self, work: &Work, item: Item) -> Result<bool> {
        match item {
            Item::Heights => Ok(self.manifest().heights.is_some() || self.adopt_heights()?),
            Item::File(plan, file) => {
                let name = work.plans[plan].name;
                let made = self.manifest().splits.get(&name).map_or(0, |split| split.files.len());
                Ok(file < made || self.adopt(name)?)
            }
            Item::View(index) => {
                Ok(index < self.manifest().views.len() || self.adopt_view(None, &work.scenes[index].name)?)
            }
            Item::Motion(k, index) => {
                let sequence = SEQUENCES[k];
                let name = picture_name(sequence, index);
                Ok(index < self.pictures(sequence) || self.adopt_view(Some(sequence), &name)?)
            }
        }
    }

    fn heights(&mut self, height: usize, width: usize, values: Vec<f32>) -> Result<()> {
        self.set_heights(height, width, values)
    }

    fn file(&mut self, name: SplitName, _: usize, _: usize, blocks: &[Block]) -> Result<()> {
        self.push(name, blocks)
    }

    fn view(&mut self, sequence: Option<&str>, name: &str, picture: Picture) -> Result<()> {
        self.push_view(sequence, name, &picture.queries, &picture.rgb, picture.variance)
    }
}

impl Sink for ShardWriter {
    fn has(&mut self, work: &Work, item: Item) -> Result<bool> {
        Ok(match item {
            Item::Heights => self.has_heights(),
            Item::File(plan, file) => self.has_file(work.plans[plan].name, file),
            Item::View(index) => self.has_view(&work.scenes[index].name),
            Item::Motion(sequence, index) => self.has_view(&picture_name(SEQUENCES[sequence], index)),
        })
    }

    fn heights(&mut self, height: usize, width: usize, values: Vec<f32>) -> Result<()> {
        self.put_heights(height, width, values)
    }

    fn file(&mut self, name: SplitName, index: usize, side: usize, blocks: &[Block]) -> Result<()> {
        self.put_file(name, index, side, blocks)
    }

    fn view(&mut self, _: Option<&str>, name: &str, picture: Picture) -> Result<()> {
        self.put_view(name, &picture.queries, &picture.rgb, picture.variance)
    }
}
