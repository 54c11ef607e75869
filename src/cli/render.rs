//! `neumip render`: pictures of scenes.

use super::console::{Console, short};
use crate::config::EngineKind;
use crate::error::{Error, Result};
use crate::inference::answerer;
use crate::query::RgbImage;
use crate::render::builtin;
use crate::render::compare::{Comparison, side_by_side};
use crate::render::folder::Folder;
use crate::render::format::{DEFAULT_MATERIAL, MaterialSpec, SceneFile};
use crate::render::frame_file::{self, Label};
use crate::render::{Cost, OpenOptions, Scene};
use crate::report::picture;
use candle_core::Device;
use clap::Args;
use neumip_export::Precision;
use neumip_export::whole_file::write_whole;
use serde::Serialize;
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

/// What `--json` says.
#[derive(Debug, Serialize)]
struct Rendering {
    scene: String,
    identity: String,
    materials: Vec<MaterialRow>,
    width: usize,
    height: usize,
    samples: usize,
    bounces: usize,
    seed: u64,
    threads: usize,
    frames: Vec<FrameRow>,
    /// Queries of the frames that were rendered now, and how fast: of all time, and of the time of answering.
    queries: u64,
    seconds: f64,
    queries_per_second: f64,
    answers_per_second: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    comparison: Option<Comparison>,
}

#[derive(Debug, Serialize)]
struct MaterialRow {
    name: String,
    is: String,
}

#[derive(Debug, Serialize)]
struct FrameRow {
    frame: usize,
    file: String,
    /// Finished by an earlier run: nothing is known of its cost.
    kept: bool,
    rays: u64,
    queries: u64,
    seconds: f64,
    tracing_seconds: f64,
    answering_seconds: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    comparison: Option<Comparison>,
}

/// A frame that is there.
struct Finished {
    image: RgbImage,
    label: Label,
    cost: Option<Cost>,
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

        let mut rows = Vec::new();
        let mut costs = Cost::default();
        for frame in 0..scene.frames() {
            let finished = self.frame(&scene, frame, "", &folder, console)?;
            let mut row = row(&folder, frame, &finished);
            if let Some(cost) = finished.cost {
                costs.queries += cost.queries;
                costs.answering += cost.answering;
                costs.total += cost.total;
            }
            if let Some(reference) = &reference {
                let truth = self.frame(reference, frame, "-reference", &folder, console)?;
                let noise = truth.label.variance.map(f64::from);
                row.comparison = Some(Comparison::new(&finished.image, &truth.image, noise));
                let pictures = side_by_side(&finished.image, &truth.image, scene.file.stops)?;
                write_whole(&folder.path(frame, "-compare", "png"), &picture::png(&pictures)?)?;
            }
            rows.push(row);
        }
        if scene.file.path.is_some() {
            self.path(&scene, &folder)?;
        }
        self.report(&scene, rows, costs, console)
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
        // Paths of a scene are relative to it, those of the command line are not.
        let whole = std::path::absolute(path).map_err(|e| Error::file(path, e))?;
        Ok(Some(MaterialSpec::model(&whole)))
    }

    fn open(&self, file: SceneFile, path: &Path, default_material: Option<MaterialSpec>) -> Result<Scene> {
        let precision = if self.half_textures { Precision::Half } else { Precision::Single };
        let engine =
            |checkpoint: &_| Ok(answerer(checkpoint, self.engine, precision, &Device::Cpu)?.material);
        Scene::open(file, path, &OpenOptions { default_material, seed: self.seed, engine: &engine })
    }

    /// The scene with reference surfaces in place of its models.
    fn reference(&self, scene: &Scene, path: &Path) -> Result<Scene> {
        let mut file = scene.file.clone();
        let models = scene.materials.iter().filter_map(|m| m.trained_on.as_ref().map(|name| (m, name)));
        for (material, trained_on) in models {
            let surface = match self.compare.as_deref() {
                Some(surface) if surface != TRAINED_ON => surface.to_string(),
                _ => trained_on.clone(),
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

    /// A frame, rendered or kept.
    fn frame(
        &self,
        scene: &Scene,
        index: usize,
        kind: &str,
        folder: &Folder,
        console: &Console,
    ) -> Result<Finished> {
        let (exr, png) = (folder.path(index, kind, "exr"), folder.path(index, kind, "png"));
        if let Some(label) = folder.finished(index, kind, &scene.identity) {
            let image = frame_file::read(&exr)?;
            write_whole(&png, &picture::png(&picture::srgb(&image, scene.file.stops)?)?)?;
            return Ok(Finished { image, label, cost: None });
        }
        let frame = scene.frame(index)?;
        let total = (frame.camera.width() * frame.camera.height() * frame.samples) as u64;
        let of = if kind.is_empty() { "render" } else { "render the reference of" };
        let label = format!("{of} frame {} of {}", index + 1, scene.frames());
        let mut meter = console.meter(label, total, "rays");
        let begun = Instant::now();
        let rendered = scene.render(&frame, &mut |progress| {
            let rate = progress.queries as f64 / begun.elapsed().as_secs_f64().max(1e-9);
            meter.update(progress.done, &format!("{}/s", short(rate, "queries")));
            console.flow()
        });
        let picture = rendered.map_err(|error| match error {
            Error::Interrupted(_) => Error::Interrupted(format!(
                "{} holds {index} finished frames; the same command goes on with them",
                self.out.display()
            )),
            other => other,
        })?;
        meter.finish(total);
        let mean = |v: &Vec<f32>| v.iter().map(|v| f64::from(*v)).sum::<f64>() / v.len().max(1) as f64;
        let variance = picture.variance.as_ref().map(|v| mean(v) as f32);
        let label = Label { identity: scene.identity.clone(), variance };
        write_whole(&png, &picture::png(&picture::srgb(&picture.rgb, scene.file.stops)?)?)?;
        // Last: a frame with its EXR is finished.
        frame_file::write(&exr, &picture.rgb, self.half, &label)?;
        Ok(Finished { image: picture.rgb, label, cost: Some(picture.cost) })
    }

    /// The contact sheet and the animation of all frames.
    fn path(&self, scene: &Scene, folder: &Folder) -> Result<()> {
        let shown = |index: usize| {
            let image = frame_file::read(&folder.path(index, "", "exr"))?;
            picture::srgb(&image, scene.file.stops)
        };
        let pictures = (0..scene.frames()).map(shown).collect::<Result<Vec<_>>>()?;
        write_whole(&folder.sheet(), &picture::png(&frame_file::sheet(&pictures)?)?)?;
        let fps = scene.file.path.as_ref().map_or(1, |path| path.fps);
        Ok(write_whole(&folder.animation(), &frame_file::animation(&pictures, fps)?)?)
    }

    fn report(&self, scene: &Scene, rows: Vec<FrameRow>, costs: Cost, console: &Console) -> Result<()> {
        let camera = &scene.file.camera;
        let rate = |seconds: f64| if seconds > 0.0 { costs.queries as f64 / seconds } else { 0.0 };
        let compared: Option<Vec<Comparison>> = rows.iter().map(|row| row.comparison.clone()).collect();
        let rendering = Rendering {
            scene: self.scene.clone(),
            identity: scene.identity.clone(),
            materials: scene
                .materials
                .iter()
                .map(|m| MaterialRow { name: m.name.clone(), is: m.described.clone() })
                .collect(),
            width: camera.width,
            height: camera.height.unwrap_or(camera.width),
            samples: camera.samples,
            bounces: scene.file.bounces,
            seed: self.seed,
            threads: rayon::current_num_threads(),
            queries: costs.queries,
            seconds: costs.total.as_secs_f64(),
            queries_per_second: rate(costs.total.as_secs_f64()),
            answers_per_second: rate(costs.answering.as_secs_f64()),
            comparison: compared.and_then(|frames| Comparison::mean(&frames)),
            frames: rows,
        };
        super::save_json(self.json.as_deref(), &rendering)?;
        let kept = rendering.frames.iter().filter(|row| row.kept).count();
        let kept = if kept > 0 { format!(", {kept} were finished before") } else { String::new() };
        console.say(format!(
            "{}: {} x {}, {} frames{kept}; {} in {:.1} s, {}/s ({}/s while answering)",
            self.out.display(),
            rendering.width,
            rendering.height,
            rendering.frames.len(),
            short(costs.queries as f64, "queries"),
            rendering.seconds,
            short(rendering.queries_per_second, "queries"),
            short(rendering.answers_per_second, "queries"),
        ));
        match table(&rendering) {
            Some(table) => console.answer(table),
            None => Ok(()),
        }
    }
}

fn row(folder: &Folder, frame: usize, finished: &Finished) -> FrameRow {
    let cost = finished.cost.unwrap_or_default();
    let file = folder.path(frame, "", "exr");
    FrameRow {
        frame,
        file: file.file_name().map_or(String::new(), |name| name.to_string_lossy().into_owned()),
        kept: finished.cost.is_none(),
        rays: cost.rays,
        queries: cost.queries,
        seconds: cost.total.as_secs_f64(),
        tracing_seconds: cost.tracing.as_secs_f64(),
        answering_seconds: cost.answering.as_secs_f64(),
        comparison: None,
    }
}

/// The errors of the frames as text.
fn table(rendering: &Rendering) -> Option<String> {
    let mean = rendering.comparison.as_ref()?;
    let number = |v: Option<f64>, digits: usize| v.map_or("-".to_string(), |v| format!("{v:.digits$}"));
    let line = |name: String, c: &Comparison| {
        format!(
            "{name:>5} {:>10.4} {:>7} {:>6} {:>6} {:>10}",
            1e3 * c.mse,
            number(c.psnr, 2),
            number(c.ssim, 3),
            number(c.flip, 3),
            number(c.noise.map(|v| 1e3 * v), 4)
        )
    };
    let mut lines = vec![format!(
        "{:>5} {:>10} {:>7} {:>6} {:>6} {:>10}",
        "frame", "mse", "psnr", "ssim", "flip", "noise"
    )];
    lines.extend(
        rendering.frames.iter().filter_map(|row| Some(line(row.frame.to_string(), row.comparison.as_ref()?))),
    );
    lines.push(line("mean".into(), mean));
    lines.push(
        "mse x 10^3 of linear RGB clamped to [0, 1]; noise: what the reference's own rays add to it, x 10^3"
            .into(),
    );
    Some(lines.join("\n"))
}
