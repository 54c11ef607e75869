//! `neumip analyze`: what a scene asks of its materials.

use super::console::{Console, short};
use super::render::{absolute, is_built_in};
use crate::analyze::{self, Analysis};
use crate::config::EngineKind;
use crate::error::{Error, Result};
use crate::inference::answerer;
use crate::render::builtin;
use crate::render::format::{DEFAULT_MATERIAL, MaterialSpec, SceneFile, Source};
use crate::render::{Model, OpenOptions, Sample, Scene, directions_of};
use candle_core::Device;
use clap::Args;
use neumip_export::Precision;
use std::path::{Path, PathBuf};

/// Frames of a path that are looked at where nothing else is said and the scene has fewer.
const FRAMES: usize = 9;
/// Most frames of a path, as a scene's own.
const MOST_FRAMES: usize = 10_000;
/// Most samples a pixel, as a scene's own.
const MOST_SAMPLES: usize = 1 << 16;
/// Most queries that can be kept: half a gigabyte a material.
const MOST_QUERIES: usize = 4_000_000;
/// Steps of the meter a frame.
const STEPS: f64 = 100.0;

/// Find out what a scene asks of its materials: levels, places on the tile, directions of light and view.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  neumip analyze bundles/metal-rings --scene sphere --out sphere-asks\n  \
    neumip analyze --surface metal-rings --resolution 256 --scene zoom --out zoom-asks\n  \
    neumip analyze runs/rocks --scene docs/scenes/still-life.json --out asks --samples 4 --json asks.json"
)]
pub struct Analyze {
    /// A run, bundle or checkpoint: the material of the objects that name none.
    #[arg(conflicts_with = "surface")]
    material: Option<PathBuf>,
    /// A scene.json, or a built-in scene: plane, sphere, moving-light, zoom, still-life.
    #[arg(long)]
    scene: String,
    /// A built-in material or a material.json in place of every model, so that nothing has to be trained.
    #[arg(long)]
    surface: Option<String>,
    /// Texels along a side of the surface.
    #[arg(long, default_value_t = 128, requires = "surface")]
    resolution: usize,
    /// The folder of the analysis.
    #[arg(long)]
    out: PathBuf,
    /// Frames at equal distances over the path; by default the scene's, but at least 9.
    #[arg(long)]
    frames: Option<usize>,
    /// Samples a pixel, in place of the scene's.
    #[arg(long)]
    samples: Option<usize>,
    /// Most queries that are kept for a material, drawn from all of them.
    #[arg(long, default_value_t = 200_000)]
    queries: usize,
    /// Seed of the samples and of the choice among the queries.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Replace an older analysis.
    #[arg(long)]
    force: bool,
    /// Write the figures here as well.
    #[arg(long)]
    json: Option<PathBuf>,
}

impl Analyze {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        super::check_json(self.json.as_deref())?;
        self.check()?;
        analyze::free(&self.out, self.force)?;
        let (mut file, path) = builtin::scene(&self.scene)?;
        let default_material = match &self.surface {
            Some(surface) => self.stand_in(&mut file, surface)?,
            None => match &self.material {
                Some(path) => Some(MaterialSpec::model(&absolute(path)?)),
                None => None,
            },
        };
        let scene = self.open(file, &path, default_material)?;
        for note in scene.notes() {
            console.say(format!("note: {note}"));
        }
        let sample = self.sample(&scene)?;
        let frames = if scene.frames() == 1 { 1 } else { sample.frames };
        let mut meter = console.meter("analyze", (frames as f64 * STEPS) as u64, "steps");
        let camera = &scene.frame(0)?.camera;
        let samples = if sample.samples > 0 { sample.samples } else { scene.file.camera.samples };
        let rays = (camera.width() * camera.height() * samples * frames) as f64;
        let demands = scene.demand(&sample, &mut |share| {
            let frame = ((share * frames as f64) as usize + 1).min(frames);
            let note = format!("frame {frame} of {frames}, {}", short(share * rays, "rays"));
            meter.show((share * frames as f64 * STEPS) as u64, &note);
            console.flow()
        })?;
        meter.finish((frames as f64 * STEPS) as u64);
        let analysis = Analysis::new(&self.scene, &path, &scene, &sample, &demands)?;
        analyze::write(&analysis, &self.out, self.force)?;
        super::save_json(self.json.as_deref(), &analysis)?;
        console.answer(analysis.table())?;
        console.say(format!("{}: see index.html", self.out.display()));
        Ok(())
    }

    fn check(&self) -> Result<()> {
        let numbers = [
            ("--frames", self.frames, MOST_FRAMES),
            ("--samples", self.samples, MOST_SAMPLES),
            ("--queries", Some(self.queries), MOST_QUERIES),
        ];
        for (flag, value, most) in numbers {
            if let Some(value) = value.filter(|value| !(1..=most).contains(value)) {
                return Err(Error::usage(format!("{flag} {value}: 1 to {most} work")));
            }
        }
        Ok(())
    }

    fn sample(&self, scene: &Scene) -> Result<Sample> {
        if let Some(frames) = self.frames.filter(|frames| *frames > 1 && scene.frames() == 1) {
            let problem = format!("--frames {frames}: the scene {} has no path, so one is all", self.scene);
            return Err(Error::usage(problem));
        }
        Ok(Sample {
            frames: self.frames.unwrap_or(scene.frames().max(FRAMES)),
            samples: self.samples.unwrap_or(0),
            most: self.queries,
            seed: self.seed,
        })
    }

    /// Puts a reference surface in the place of the scene's models, and gives it to the objects without a material.
    fn stand_in(&self, file: &mut SceneFile, surface: &str) -> Result<Option<MaterialSpec>> {
        let spec = MaterialSpec {
            // Paths of a scene are relative to it, those of the command line are not.
            reference: Some(match is_built_in(surface) {
                true => surface.to_string(),
                false => absolute(Path::new(surface))?.display().to_string(),
            }),
            resolution: Some(self.resolution),
            ..MaterialSpec::default()
        };
        let mut replaced = false;
        for material in file.materials.values_mut() {
            if matches!(material.source(), Ok(Source::Model(_))) {
                *material = spec.clone();
                replaced = true;
            }
        }
        let used = file.objects.iter().any(|object| object.material == DEFAULT_MATERIAL);
        let absent = used && !file.materials.contains_key(DEFAULT_MATERIAL);
        if !replaced && !absent {
            let problem =
                format!("--surface: no object of the scene {} has a model or no material", self.scene);
            return Err(Error::usage(problem));
        }
        Ok(Some(spec).filter(|_| absent))
    }

    fn open(&self, file: SceneFile, path: &Path, default_material: Option<MaterialSpec>) -> Result<Scene> {
        let engine = |checkpoint: &_, path: &Path| {
            let answers = answerer(checkpoint, None, Precision::Single, &Device::Cpu)?.material;
            let (directions, sampler) = directions_of(checkpoint, path)?;
            Ok(Model { answers, directions, identity: format!("{:?} {sampler}", EngineKind::Fused) })
        };
        Scene::open(file, path, &OpenOptions { default_material, seed: self.seed, engine: &engine })
    }
}
