//! `neumip generate`.

use super::console::{Console, Meter, short};
use super::surface::{Surface, materials};
use crate::dataset::{
    Dataset, Existing, GenerateConfig, Manifest, Motion, Progress, Regime, Shard, SplitName, generate,
    generate_shard,
};
use crate::error::{Error, Result};
use crate::reference::Reference;
use clap::Args;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Render a dataset of a material.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  neumip generate metal-rings --out data/metal\n  \
    neumip generate all --out data --samples 4000000\n  \
    neumip generate my-material/material.json --out data/mine --resolution 256 --noise 0.01\n  \
    neumip generate rocks --out data/rocks --samples 8000000 --append")]
pub struct Generate {
    /// A built-in material (`neumip look all --out materials.png` shows them), `all` of them, a material.json or the
    /// folder that holds it.
    material: String,
    /// The dataset's folder; with `all`, the folder of the datasets' folders.
    #[arg(long)]
    out: PathBuf,
    /// Texels along a side of the tile, a power of two.
    #[arg(long, default_value_t = 128)]
    resolution: usize,
    /// scattered (a pair of directions a patch), slices-N (N pairs, full images) or slices (as many pairs as --samples
    /// pays for).
    #[arg(long, default_value = "scattered")]
    regime: Regime,
    /// Unique training samples, by default 200 a texel.
    #[arg(long)]
    samples: Option<u64>,
    /// Rays to the surface of a training sample.
    #[arg(long, default_value_t = 16)]
    spp: usize,
    /// Rays to the surface of a held-out sample.
    #[arg(long, default_value_t = 64)]
    held_out_spp: usize,
    /// Noise that a block's answers may have (standard deviation, linear RGB): more rays are cast until it holds.
    #[arg(long)]
    noise: Option<f32>,
    /// Most rays a sample that --noise may ask for.
    #[arg(long, requires = "noise")]
    most_spp: Option<usize>,
    /// Share of the directions that is uniform in solid angle, down to 0.5 degrees above the horizon; the rest is
    /// uniform in the projected disc.
    #[arg(long)]
    grazing_floor: Option<f32>,
    /// Pairs of directions of the test split.
    #[arg(long)]
    test_pairs: Option<usize>,
    /// Side of the perspective views in pixels; 0 leaves them out.
    #[arg(long)]
    view_size: Option<usize>,
    /// Tiles along a side of the viewed plane.
    #[arg(long)]
    view_tiles: Option<usize>,
    /// A further light of the views, TILT,PAN in degrees; may be repeated.
    #[arg(long, value_parser = parse_light, allow_hyphen_values = true)]
    light: Vec<[f32; 2]>,
    /// Frames of each of the sequences light-arc, camera-arc and zoom, of the views' size; 0 leaves them out. A frame is
    /// rendered in two halves, of --held-out-spp rays together.
    #[arg(long, default_value_t = 0, value_name = "FRAMES")]
    motion: usize,
    /// Degrees from frame to frame.
    #[arg(long, default_value_t = 1.0, value_name = "DEGREES", requires = "motion")]
    motion_step: f32,
    /// Leave the height map out.
    #[arg(long)]
    without_heights: bool,
    /// Seed of directions, positions and rays.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    surface: Surface,
    /// Go on with an interrupted dataset of the same options, and collect what shards have made.
    #[arg(long, conflicts_with_all = ["force", "append"])]
    resume: bool,
    /// Add training samples, up to --samples, to a finished dataset of otherwise the same options.
    #[arg(long, conflicts_with_all = ["force", "shard"])]
    append: bool,
    /// Make the I-th of N shares of the files; once all are in one folder, --resume makes a dataset of them.
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    /// Replace an existing dataset.
    #[arg(long)]
    force: bool,
    /// Write the dataset's description here too; with `all`, an array of them.
    #[arg(long)]
    json: Option<PathBuf>,
}

impl Generate {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        super::check_json(self.json.as_deref())?;
        let config = self.config();
        let existing = match (self.resume, self.append, self.force) {
            (true, ..) => Existing::Resume,
            (_, true, _) => Existing::Append,
            (.., true) => Existing::Replace,
            _ => Existing::Refuse,
        };
        let names = materials(&self.material);
        let mut manifests = Vec::new();
        for name in &names {
            let out = if names.len() > 1 { self.out.join(name) } else { self.out.clone() };
            let reference = reference(name, &self.surface, &config)?;
            match self.shard {
                Some(shard) => self::shard(&reference, &config, shard, &out, existing, console)?,
                None => {
                    manifests.push(dataset(&reference, &config, &out, existing, console)?.manifest().clone())
                }
            }
        }
        match manifests.as_slice() {
            [manifest] => super::save_json(self.json.as_deref(), manifest),
            manifests => super::save_json(self.json.as_deref(), &manifests),
        }
    }

    fn config(&self) -> GenerateConfig {
        let mut config = GenerateConfig::new(self.resolution);
        config.regime = self.regime;
        config.samples = self.samples.unwrap_or(config.samples);
        config.spp = self.spp;
        config.held_out_spp = self.held_out_spp;
        config.noise = self.noise;
        config.most_spp = self.most_spp.unwrap_or(config.most_spp);
        config.grazing_floor = self.grazing_floor.unwrap_or(config.grazing_floor);
        config.test_pairs = self.test_pairs.unwrap_or(config.test_pairs);
        config.view_size = self.view_size.unwrap_or(config.view_size);
        config.view_tiles = self.view_tiles.unwrap_or(config.view_tiles);
        config.lights.extend(&self.light);
        config.motion = (self.motion > 0).then_some(Motion { frames: self.motion, step: self.motion_step });
        config.seed = self.seed;
        config.heights = !self.without_heights;
        config
    }
}

/// Tilt and pan from `TILT,PAN`.
fn parse_light(text: &str) -> std::result::Result<[f32; 2], String> {
    let parsed = text.split_once(',').and_then(|(tilt, pan)| {
        let pan: f32 = pan.parse().ok()?;
        Some([tilt.parse().ok()?, pan.rem_euclid(360.0)])
    });
    parsed.ok_or_else(|| format!("{text} is no light such as 45,30: tilt and pan in degrees"))
}

/// The surface of a material at a dataset's resolution, once the configuration is known to work.
pub fn reference(material: &str, surface: &Surface, config: &GenerateConfig) -> Result<Reference> {
    config.validate()?;
    surface.open(material, config.resolution)
}

/// Shows how far a rendering is.
struct Rendering<'a> {
    console: &'a Console,
    label: String,
    begun: Instant,
    meter: Option<Meter>,
    last: Option<Progress>,
}

impl<'a> Rendering<'a> {
    fn new(reference: &Reference, console: &'a Console) -> Self {
        for note in reference.notes() {
            console.say(format!("note: {note}"));
        }
        let label = format!("generate {}", reference.name());
        Self { console, label, begun: Instant::now(), meter: None, last: None }
    }

    fn advance(&mut self, progress: Progress) -> ControlFlow<()> {
        let rays = progress.rays as f64 / self.begun.elapsed().as_secs_f64().max(1e-9);
        let meter = self
            .meter
            .get_or_insert_with(|| self.console.meter(self.label.clone(), progress.total, "samples"));
        meter.update(progress.done, &format!("{}/s  {}", short(rays, "rays"), progress.split));
        self.last = Some(progress);
        self.console.flow()
    }

    /// Seconds, samples/s and rays/s in one line.
    fn finish(self) -> String {
        let seconds = self.begun.elapsed().as_secs_f64();
        let (Some(meter), Some(last)) = (self.meter, self.last) else { return "nothing was missing".into() };
        let samples = short(meter.finish(last.done), "samples");
        let rays = short(last.rays as f64 / seconds.max(1e-9), "rays");
        format!("{seconds:.1} s, {samples}/s, {rays}/s")
    }
}

fn kept(error: Error, out: &Path) -> Error {
    match error {
        Error::Interrupted(_) => {
            Error::Interrupted(format!("{} holds what was finished; go on with --resume", out.display()))
        }
        other => other,
    }
}

/// Renders a dataset with progress.
pub fn dataset(
    reference: &Reference,
    config: &GenerateConfig,
    out: &Path,
    existing: Existing,
    console: &Console,
) -> Result<Dataset> {
    let mut rendering = Rendering::new(reference, console);
    generate(reference, config, out, existing, &mut |progress| rendering.advance(progress))
        .map_err(|error| kept(error, out))?;
    let rates = rendering.finish();
    let data = Dataset::open(out)?;
    console.say(format!("{}: {} ({rates})", out.display(), summary(data.manifest())));
    Ok(data)
}

/// What a dataset holds, in a few words.
fn summary(manifest: &Manifest) -> String {
    let [height, width] = manifest.resolution;
    let train = manifest.splits.get(&SplitName::Train);
    let samples = train.map_or(0, |split| split.samples());
    let noise = train.map_or(0.0, |split| split.noise);
    let noisy: usize = manifest.splits.values().map(|split| split.noisy_blocks).sum();
    let noisy = if noisy > 0 { format!(", {noisy} blocks noisier than asked for") } else { String::new() };
    format!(
        "{} at {width} x {height}, {samples} training samples, noise {noise:.4}{noisy}",
        manifest.material
    )
}

/// Renders a shard's share with progress.
fn shard(
    reference: &Reference,
    config: &GenerateConfig,
    shard: Shard,
    out: &Path,
    existing: Existing,
    console: &Console,
) -> Result<()> {
    let mut rendering = Rendering::new(reference, console);
    generate_shard(reference, config, shard, out, existing, &mut |progress| rendering.advance(progress))
        .map_err(|error| kept(error, out))?;
    console.say(format!(
        "{}: shard {shard} of {} ({}); with all shards in this folder, --resume without --shard makes the dataset",
        out.display(),
        reference.name(),
        rendering.finish()
    ));
    Ok(())
}
