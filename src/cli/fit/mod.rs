//! `neumip fit`: a material that holds no more than a scene needs.

mod open;
pub mod table;

use super::console::{Console, Meter};
use crate::dataset::Dataset;
use crate::error::{Error, Result};
use crate::fit::folder::Folder;
use crate::fit::goal::{Goal, Prefer, Target};
use crate::fit::job::{Effort, Fitted, Job};
use crate::fit::page;
use crate::render::format::DEFAULT_MATERIAL;
use clap::Args;
use neumip_export::Storage;
use serde::Serialize;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// Samples a texel that a full model is presented where none is named.
const PER_TEXEL: u64 = 1200;

/// Train the smallest model that a scene cannot tell from the full one.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    neumip fit data/metal --scene far-floor --target flip=full --out fits/far\n  \
    neumip fit data/metal --full runs/improved --scene plane --target flip=0.05 --out fits/plane\n  \
    neumip fit data/metal --full runs/improved --scene sphere --budget-ns 60 --budget-bytes 40000 --out fits/sphere\n  \
    neumip export fits/far --out bundles/far --half --check")]
pub struct Fit {
    /// The dataset of the material.
    data: PathBuf,
    /// A scene.json, or a built-in scene.
    #[arg(long)]
    scene: String,
    /// The folder of the fit; the same command goes on where it was stopped.
    #[arg(long)]
    out: PathBuf,
    /// The full model: a run, bundle or checkpoint. Without it one is trained on the data.
    #[arg(long)]
    full: Option<PathBuf>,
    /// The material of the scene that is fitted; by default that of objects without one.
    #[arg(long, default_value = DEFAULT_MATERIAL)]
    material: String,
    /// The smallest model whose error of the scene's pictures is at most this: flip=0.02, mse=1e-3, or flip=full for no more than
    /// 5 % above the full model's. Without it the best model within the budgets.
    #[arg(long)]
    target: Option<Target>,
    /// Most nanoseconds a query, as the machine of results/ takes them on one thread.
    #[arg(long)]
    budget_ns: Option<f64>,
    /// Most bytes in half precision; K and M are understood.
    #[arg(long, value_parser = super::parse_bytes)]
    budget_bytes: Option<usize>,
    /// What is to be saved first.
    #[arg(long, value_enum, default_value_t)]
    prefer: Prefer,
    /// The reference surface of the data: a built-in name, a material.json, or none to take the full model for the truth. By
    /// default what the data was rendered from, where that is built in.
    #[arg(long)]
    surface: Option<String>,
    #[command(flatten)]
    work: Work,
    /// Replace a fit of other settings.
    #[arg(long)]
    force: bool,
    /// Keep the training data, the truth's pictures and the trials, which only an interrupted fit needs.
    #[arg(long)]
    keep: bool,
    /// Write the figures here as well.
    #[arg(long)]
    json: Option<PathBuf>,
}

/// How much work a fit is.
#[derive(Clone, Debug, Args)]
pub struct Work {
    /// Training samples that are measured for the scene.
    #[arg(long, default_value_t = Effort::default().unique)]
    unique: usize,
    /// Rays of a training sample.
    #[arg(long, default_value_t = Effort::default().spp)]
    spp: usize,
    /// Share of the training samples that is spread over everything that the scene does not ask.
    #[arg(long, default_value_t = Effort::default().floor)]
    floor: f64,
    /// Pictures over the path: choices are made on so many, and as many others are reported.
    #[arg(long, default_value_t = Effort::default().frames)]
    frames: usize,
    /// Samples a pixel, in place of the scene's.
    #[arg(long, default_value_t = 0)]
    samples: usize,
    /// Rays a query of the pictures' truth.
    #[arg(long, default_value_t = Effort::default().picture_spp)]
    picture_spp: usize,
    /// Samples that the full model is presented where it is trained here, and by which the search is bounded; by default those
    /// of the full model, or 1200 a texel.
    #[arg(long)]
    training: Option<u64>,
    /// Sizes that are tried.
    #[arg(long, default_value_t = Effort::default().candidates)]
    candidates: usize,
    /// Highest learning rate of the trials.
    #[arg(long, default_value_t = Effort::default().rate)]
    rate: f64,
    /// Seed of everything.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

impl Work {
    /// The effort; `training` are the samples that the full model was presented.
    fn effort(&self, training: u64) -> Effort {
        let Self { unique, spp, floor, frames, samples, picture_spp, candidates, rate, seed, .. } = *self;
        let validation = Effort::default().validation.min(unique);
        let training = self.training.unwrap_or(training);
        Effort {
            unique,
            validation,
            spp,
            floor,
            frames,
            samples,
            picture_spp,
            training,
            candidates,
            rate,
            seed,
        }
    }

    fn check(&self) -> Result<()> {
        let within = |flag: &str, value: f64, low: f64, high: f64| match value >= low && value <= high {
            true => Ok(()),
            false => Err(Error::usage(format!("{flag} {value}: use {low} to {high}"))),
        };
        within("--unique", self.unique as f64, 1024.0, 1e9)?;
        within("--spp", self.spp as f64, 1.0, 65536.0)?;
        within("--floor", self.floor, 0.0, 0.9)?;
        within("--frames", self.frames as f64, 1.0, 1000.0)?;
        within("--samples", self.samples as f64, 0.0, 65536.0)?;
        within("--picture-spp", self.picture_spp as f64, 1.0, 65536.0)?;
        within("--training", self.training.unwrap_or(1 << 20) as f64, 65536.0, 1e12)?;
        within("--candidates", self.candidates as f64, 1.0, 64.0)?;
        within("--rate", self.rate, 1e-6, 0.1)
    }
}

/// What a folder is of.
#[derive(Serialize)]
struct Settings<'a> {
    version: &'a str,
    data: String,
    scene: String,
    full: Option<&'a Path>,
    material: &'a str,
    surface: Option<&'a str>,
    goal: Goal,
    work: String,
}

impl Fit {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        super::check_json(self.json.as_deref())?;
        self.work.check()?;
        let goal =
            Goal { target: self.target, ns: self.budget_ns, bytes: self.budget_bytes, prefer: self.prefer };
        if goal.target.is_none() && goal.ns.is_none() && goal.bytes.is_none() {
            let problem =
                "say what is wanted: --target flip=0.02 (or flip=full), --budget-ns, --budget-bytes";
            return Err(Error::usage(problem));
        }
        if goal.ns.is_some_and(|ns| !(ns > 0.0 && ns.is_finite())) {
            return Err(Error::usage(format!("--budget-ns {}: is not above 0", goal.ns.unwrap_or(0.0))));
        }
        let data = Dataset::open(&self.data)?;
        // The scene is read before anything is made.
        let (file, _) = crate::render::builtin::scene(&self.scene)?;
        let settings = Settings {
            version: env!("CARGO_PKG_VERSION"),
            data: data.identity()?,
            scene: serde_json::to_string(&file).map_err(|e| Error::config("scene", e))?,
            full: self.full.as_deref(),
            material: &self.material,
            surface: self.surface.as_deref(),
            goal,
            work: format!("{:?}", self.work),
        };
        let folder = Folder::open(&self.out, &settings, self.force)?;
        let texels = (data.resolution()[0] * data.resolution()[1]) as u64;
        let training = self.work.training.unwrap_or(PER_TEXEL * texels);
        let own = folder.root().join("full");
        let full = open::full(self.full.as_deref(), &data, &own, (training, self.work.seed), console)?;
        let models = BTreeMap::from([(self.material.clone(), full.path.clone())]);
        let mut scene = open::scene(&self.scene, &models, self.work.seed)?;
        let truth = open::truth(self.surface.as_deref(), &data, &full, console)?;
        let place = scene.materials.iter().position(|material| material.name == self.material);
        let name = scene_name(&self.scene);
        let job = Job {
            name: &name,
            material: place
                .ok_or_else(|| Error::usage(format!("--material {}: is not seen", self.material)))?,
            full: &full.checkpoint,
            config: &full.config,
            trained: full.trained,
            truth: &truth,
            data: Some(&data),
            goal,
            effort: self.work.effort(full.trained.map_or(training, |(samples, _)| samples)),
            folder: folder.root(),
        };
        let told = Told::new(console);
        let fitted = job.run(&mut scene, &|label, done| told.tell(label, done));
        told.finish();
        let fitted = fitted?;
        folder.write(&fitted, &full.checkpoint, scene.file.stops)?;
        if !self.keep {
            for path in Job::workings(folder.root()) {
                let _ = std::fs::remove_dir_all(path);
            }
        }
        super::save_json(self.json.as_deref(), &fitted.outcome)?;
        self.say(&fitted, console)
    }

    fn say(&self, fitted: &Fitted, console: &Console) -> Result<()> {
        let outcome = &fitted.outcome;
        let mut lines =
            vec![format!("{:<22} {:>9} {:>7} {:>8} {:>8} {:>8}", "", "bytes", "FLOPs", "ns", "flip", "mse")];
        for row in &outcome.rows {
            let flip = row.errors.flip.map_or("-".into(), |v| format!("{v:.4}"));
            lines.push(format!(
                "{:<22} {:>9} {:>7} {:>8.1} {flip:>8} {:>8.5}",
                row.name, row.bytes, row.flops, row.cost.ns_per_query, row.errors.mse
            ));
        }
        lines.push(page::verdict(outcome));
        console.answer(lines.join("\n"))?;
        let root = self.out.display();
        if let (false, Some(bound)) = (outcome.holds, outcome.bound) {
            let metric = outcome.goal.metric();
            let reached = match outcome.row(crate::fit::outcome::FITTED) {
                Some(row) => metric.of(&row.errors)?,
                None => f64::NAN,
            };
            let name = metric.name();
            let problem = format!(
                "no model within the budgets reaches {name}={bound:.4}: the nearest has {reached:.4} ({}) and is in {root}; \
                 --target {name}={reached:.4} would be held, and more --training, --unique or a wider --full may reach further",
                outcome.row(crate::fit::outcome::FITTED).map_or("", |row| &row.shape)
            );
            return Err(Error::Diverged(problem));
        }
        let flag = match fitted.storage {
            Storage::BYTE => " --int8",
            Storage::HALF => " --half",
            _ => "",
        };
        console.say(format!(
            "{root}: see report.html; neumip export {root} --out BUNDLE{flag} --check hands it over"
        ));
        Ok(())
    }
}

/// The name of a scene's file, or of a built-in scene.
fn scene_name(spec: &str) -> String {
    Path::new(spec).file_stem().map_or_else(|| spec.to_string(), |stem| stem.to_string_lossy().into_owned())
}

/// Progress of what is told by labels and shares.
pub struct Told<'a> {
    console: &'a Console,
    meter: RefCell<Option<(String, Meter)>>,
}

impl<'a> Told<'a> {
    /// Nothing is told yet.
    pub fn new(console: &'a Console) -> Self {
        Self { console, meter: RefCell::new(None) }
    }

    /// Shows that a share of what the label says is done.
    pub fn tell(&self, label: &str, done: f64) -> ControlFlow<()> {
        const PARTS: f64 = 1000.0;
        let mut meter = self.meter.borrow_mut();
        if meter.as_ref().is_none_or(|(known, _)| known != label) {
            if let Some((_, old)) = meter.take() {
                old.finish(PARTS as u64);
            }
            *meter = Some((label.into(), self.console.meter(label, PARTS as u64, "parts")));
        }
        if let Some((_, meter)) = meter.as_mut() {
            meter.show((done * PARTS) as u64, "");
        }
        self.console.flow()
    }

    /// Ends what was told last.
    pub fn finish(&self) {
        if let Some((_, meter)) = self.meter.borrow_mut().take() {
            meter.finish(0);
        }
    }
}
