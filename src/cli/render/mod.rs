//! `neumip render`: pictures of scenes.

mod report;

use super::console::{Console, short};
use crate::config::EngineKind;
use crate::error::{Error, Result};
use crate::inference::answerer;
use crate::outside::Count;
use crate::render::builtin;
use crate::render::compare::{Comparison, side_by_side};
use crate::render::folder::Folder;
use crate::render::format::{DEFAULT_MATERIAL, MaterialSpec, SceneFile};
use crate::render::frame_file::{self, Label};
use crate::render::{Cost, Model, OpenOptions, Scene, directions_of};
use crate::report::picture;
use candle_core::Device;
use clap::Args;
use neumip_export::Precision;
use neumip_export::whole_file::write_whole;
use report::Report;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Rays to the reference surface a query of a compared picture.
const COMPARED_SPP: usize = 16;
/// What `--compare` stands for without a surface.
const TRAINED_ON: &str = "what the model was trained on";

/// Render pictures of a scene.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  neumip render bundles/metal-rings --scene sphere --out pictures\n  \
    neumip render runs/rocks --scene docs/scenes/still-life.json --out still-life --samples 256\n  \
    neumip render runs/rocks --scene plane --out plane --compare --json plane.json")]
pub struct Render {
    /// A run, bundle or checkpoint: the material of the objects that name none.
    material: Option<PathBuf>,
    /// A scene.json, or a built-in scene: plane, sphere, moving-light, zoom, still-life.
    #[arg(long)]
    scene: String,
    /// The folder of the frames. Those that are finished are kept, so that an interrupted path goes on.
    #[arg(long)]
    out: PathBuf,
    /// Samples a pixel, in place of the scene's.
    #[arg(long)]
    samples: Option<usize>,
    /// Columns, in place of the scene's; rows follow.
    #[arg(long)]
    width: Option<usize>,
    /// Seed of all samples.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Render the reference surface too and compare: the one that the model was trained on, if it is built in, or a
    /// material.json.
    #[arg(long, value_name = "SURFACE", num_args = 0..=1, require_equals = true, default_missing_value = TRAINED_ON)]
    compare: Option<String>,
    /// Rays to the reference surface a query.
    #[arg(long, default_value_t = COMPARED_SPP, requires = "compare")]
    compare_spp: usize,
    /// EXR in half floats instead of single ones.
    #[arg(long)]
    half: bool,
    /// What answers for models: by default fused on the CPU.
    #[arg(long)]
    engine: Option<EngineKind>,
    /// Store textures in half precision while answering.
    #[arg(long)]
    half_textures: bool,
    /// Replace frames of other scenes in the folder.
    #[arg(long)]
    force: bool,
    /// Write queries, times and errors here.
    #[arg(long)]
    json: Option<PathBuf>,
}

/// A frame that is there.
struct Finished {
    index: usize,
    label: Label,
    /// What it took; None if an earlier run finished it.
    cost: Option<Cost>,
    comparison: Option<Comparison>,
    /// Queries outside of what each material was fitted for; empty if an earlier run finished it.
    outside: Vec<Option<Count>>,
}

impl Render {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        super::check_json(self.json.as_deref())?;
        let (mut file, path) = builtin::scene(&self.scene)?;
        self.override_camera(&mut file);
        let scene = self.open(file.clone(), &path, self.default_material()?)?;
        let reference = self.compare.as_deref().map(|_| self.reference(&scene, &path)).transpose()?;
        for note in scene.notes().chain(reference.iter().flat_map(Scene::notes)) {
            console.say(format!("note: {note}"));
        }
        let mut identities = vec![scene.identity.as_str()];
        identities.extend(reference.as_ref().map(|reference| reference.identity.as_str()));
        let folder = Folder::open(&self.out, &identities, self.force)?;

        let mut frames = self.frames(&scene, "", &folder, console)?;
        if let Some(reference) = &reference {
            let truths = self.frames(reference, "-reference", &folder, console)?;
            for (frame, truth) in frames.iter_mut().zip(&truths) {
                frame.comparison = Some(self.compared(&scene, frame, truth, &folder)?);
            }
        }
        if scene.file.path.is_some() {
            self.path(&scene, &folder)?;
        }
        let report = Report::new(&self.scene, &scene, self.seed, &frames);
        super::save_json(self.json.as_deref(), &report)?;
        console.say(report.summary(&self.out));
        report.outside().for_each(|line| console.say(line));
        match report.table() {
            Some(table) => console.answer(table),
            None => Ok(()),
        }
    }

    fn override_camera(&self, file: &mut SceneFile) {
        let camera = &mut file.camera;
        camera.samples = self.samples.unwrap_or(camera.samples);
        if let Some(width) = self.width {
            let rows = |height: usize| (height * width).div_ceil(camera.width.max(1)).max(1);
            camera.height = camera.height.map(rows);
            camera.width = width;
        }
    }

    fn default_material(&self) -> Result<Option<MaterialSpec>> {
        let Some(path) = &self.material else { return Ok(None) };
        Ok(Some(MaterialSpec::model(&absolute(path)?)))
    }

    fn open(&self, file: SceneFile, path: &Path, default_material: Option<MaterialSpec>) -> Result<Scene> {
        let precision = if self.half_textures { Precision::Half } else { Precision::Single };
        let engine = |checkpoint: &_, path: &Path| {
            let answers = answerer(checkpoint, self.engine, precision, &Device::Cpu)?.material;
            let (directions, sampler) = directions_of(checkpoint, path)?;
            let identity = format!("{:?} {precision:?} {sampler}", self.engine.unwrap_or(EngineKind::Fused));
            Ok(Model { answers, directions, identity })
        };
        Scene::open(file, path, &OpenOptions { default_material, seed: self.seed, engine: &engine })
    }

    /// The scene with reference surfaces in place of its models.
    fn reference(&self, scene: &Scene, path: &Path) -> Result<Scene> {
        let mut file = scene.file.clone();
        let models = scene.materials.iter().filter_map(|m| m.trained_on.as_ref().map(|name| (m, name)));
        for (material, trained_on) in models {
            let surface = match self.compare.as_deref() {
                Some(surface) if surface != TRAINED_ON && is_built_in(surface) => surface.to_string(),
                // Paths of a scene are relative to it, those of the command line are not.
                Some(surface) if surface != TRAINED_ON => absolute(Path::new(surface))?.display().to_string(),
                _ if is_built_in(trained_on) => trained_on.clone(),
                _ => {
                    return Err(Error::usage(format!(
                        "--compare: {trained_on}, which the model was trained on, is no built-in material; name its \
                         surface, --compare=material.json"
                    )));
                }
            };
            let spec = MaterialSpec {
                reference: Some(surface),
                resolution: Some(material.resolution[0]),
                spp: Some(self.compare_spp),
                ..MaterialSpec::default()
            };
            file.materials.insert(material.name.clone(), spec);
        }
        if file.materials == scene.file.materials {
            return Err(Error::usage("--compare: the scene has no model to compare"));
        }
        let named = file.materials.remove(DEFAULT_MATERIAL);
        let used = file.objects.iter().any(|object| object.material == DEFAULT_MATERIAL);
        self.open(file, path, named.filter(|_| used))
    }

    /// All frames, rendered or kept.
    fn frames(&self, scene: &Scene, kind: &str, folder: &Folder, console: &Console) -> Result<Vec<Finished>> {
        let count = scene.frames();
        let kept: Vec<_> = (0..count).map(|k| folder.finished(k, kind, &scene.identity)).collect();
        let of = if kind.is_empty() { "render" } else { "render the reference" };
        let missing = kept.iter().filter(|label| label.is_none()).count() as u64;
        let first = scene.frame(0)?;
        let each = (first.camera.width() * first.camera.height() * first.samples) as u64;
        let mut meter = console.meter(of, missing * each, "rays");
        let (begun, mut rays, mut queries) = (Instant::now(), 0, 0);
        // Rates count from here, not from the first batch.
        meter.show(0, "");
        let mut frames = Vec::with_capacity(count);
        for (index, label) in kept.into_iter().enumerate() {
            let png = folder.path(index, kind, "png");
            if let Some(label) = label {
                let image = frame_file::read(&folder.path(index, kind, "exr"))?;
                write_whole(&png, &picture::png(&picture::srgb(&image, scene.file.stops)?)?)?;
                frames.push(Finished { index, label, cost: None, comparison: None, outside: Vec::new() });
                continue;
            }
            let rendered = scene.render(&scene.frame(index)?, &mut |progress| {
                let rate = (queries + progress.queries) as f64 / begun.elapsed().as_secs_f64().max(1e-9);
                let note = format!("frame {} of {count}, {}/s", index + 1, short(rate, "queries"));
                meter.show(rays + progress.done, &note);
                console.flow()
            });
            let picture = rendered.map_err(|error| self.kept(error, frames.len()))?;
            rays += picture.cost.rays;
            queries += picture.cost.queries;
            let mean = |v: &Vec<f32>| v.iter().map(|v| f64::from(*v)).sum::<f64>() / v.len().max(1) as f64;
            let variance = picture.variance.as_ref().map(|v| mean(v) as f32);
            let label = Label { identity: scene.identity.clone(), variance };
            write_whole(&png, &picture::png(&picture::srgb(&picture.rgb, scene.file.stops)?)?)?;
            // Last: a frame with its EXR is finished.
            frame_file::write(&folder.path(index, kind, "exr"), &picture.rgb, self.half, &label)?;
            frames.push(Finished {
                index,
                label,
                cost: Some(picture.cost),
                comparison: None,
                outside: picture.outside,
            });
        }
        meter.finish(rays);
        Ok(frames)
    }

    fn kept(&self, error: Error, finished: usize) -> Error {
        match error {
            Error::Interrupted(_) => Error::Interrupted(format!(
                "{} holds {finished} finished frames; the same command goes on with them",
                self.out.display()
            )),
            other => other,
        }
    }

    /// Compares a frame with the reference's, both as they were stored.
    fn compared(
        &self,
        scene: &Scene,
        frame: &Finished,
        truth: &Finished,
        folder: &Folder,
    ) -> Result<Comparison> {
        let answer = frame_file::read(&folder.path(frame.index, "", "exr"))?;
        let reference = frame_file::read(&folder.path(truth.index, "-reference", "exr"))?;
        let pictures = side_by_side(&answer, &reference, scene.file.stops)?;
        write_whole(&folder.path(frame.index, "-compare", "png"), &picture::png(&pictures)?)?;
        Ok(Comparison::new(&answer, &reference, truth.label.variance.map(f64::from)))
    }

    /// The contact sheet and the animation of all frames.
    fn path(&self, scene: &Scene, folder: &Folder) -> Result<()> {
        let shown = |index: usize| {
            let image = frame_file::read(&folder.path(index, "", "exr"))?;
            picture::srgb(&image, scene.file.stops)
        };
        let chosen = frame_file::shown(scene.frames()).into_iter().map(shown).collect::<Result<Vec<_>>>()?;
        write_whole(&folder.sheet(), &picture::png(&frame_file::sheet(&chosen)?)?)?;
        let fps = scene.file.path.as_ref().map_or(1, |path| path.fps);
        Ok(write_whole(&folder.animation(), &frame_file::animation(scene.frames(), fps, shown)?)?)
    }
}

pub(super) fn is_built_in(surface: &str) -> bool {
    crate::reference::builtin::NAMES.contains(&surface)
}

pub(super) fn absolute(path: &Path) -> Result<PathBuf> {
    std::path::absolute(path).map_err(|e| Error::file(path, e))
}
