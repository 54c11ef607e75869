//! `neumip fit`: a material that holds no more than a scene needs.

mod open;
pub mod table;

use super::console::{Console, Meter};
use crate::dataset::Dataset;
use crate::error::{Error, Result};
use crate::fit::divide::fit_all;
use crate::fit::folder::Folder;
use crate::fit::goal::{Goal, Metric, Prefer, Target};
use crate::fit::job::{Effort, Fitted, Job};
use crate::fit::outcome::{FITTED, Outcome};
use crate::fit::page;
use crate::fit::truth::Truth;
use crate::reference::ReferenceOptions;
use crate::render::Scene;
use crate::render::format::DEFAULT_MATERIAL;
use clap::Args;
use neumip_export::Storage;
use serde::Serialize;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// No worse than the full model.
const LIKE_FULL: Target = Target { metric: Metric::Flip, most: None };
/// Samples a texel that a full model is presented where none is named.
const PER_TEXEL: u64 = 1200;

/// Train the smallest model that a scene cannot tell from the full one.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    neumip fit data/metal --scene far-floor --target flip=full --out fits/far\n  \
    neumip fit data/metal --full runs/improved --scene plane --target flip=0.05 --out fits/plane\n  \
    neumip fit data/metal --full runs/improved --scene sphere --budget-ns 60 --budget-bytes 40K --out fits/sphere\n  \
    neumip fit floor=data/rocks ball=data/metal --scene two.json --total-bytes 100K --out fits/two\n  \
    neumip export fits/far --out bundles/far --half --check")]
pub struct Fit {
    /// The dataset of the material that objects without one have; for others, and for several, NAME=DATA.
    #[arg(required = true)]
    data: Vec<String>,
    /// A scene.json, or a built-in scene.
    #[arg(long)]
    scene: String,
    /// The folder of the fit, with a folder for each of several materials; the same command goes on where it was stopped.
    #[arg(long)]
    out: PathBuf,
    /// The full model: a run, bundle or checkpoint; NAME=RUN where DATA has a name. Without it one is trained on the data.
    #[arg(long)]
    full: Vec<String>,
    /// The smallest model whose error of the scene's pictures is at most this: flip=0.02, mse=1e-3, or flip=full for no more than
    /// 5 % above the full model's. Without it the best model within the budgets.
    #[arg(long)]
    target: Option<Target>,
    /// Most nanoseconds a query, as the machine of docs/fit/FIT.md takes them on one thread.
    #[arg(long)]
    budget_ns: Option<f64>,
    /// Most bytes in half precision; K and M are understood.
    #[arg(long, value_parser = super::parse_bytes)]
    budget_bytes: Option<usize>,
    /// Most bytes of all materials together, divided by what each contributes to the pictures' error.
    #[arg(long, value_parser = super::parse_bytes, conflicts_with_all = ["target", "budget_ns", "budget_bytes"])]
    total_bytes: Option<usize>,
    /// What is to be saved first.
    #[arg(long, value_enum, default_value_t)]
    prefer: Prefer,
    /// The reference surface of the data: a built-in name, a material.json, or none to take the full model for the truth; NAME=
    /// where DATA has a name. By default what the data was rendered from, where that is built in.
    #[arg(long)]
    surface: Vec<String>,
    /// Samples along a side of a built-in surface's field, as the data was generated with.
    #[arg(long, default_value_t = ReferenceOptions::default().field_side)]
    field_side: usize,
    /// Seed of a built-in surface's shape, as the data was generated with.
    #[arg(long, default_value_t = 0)]
    material_seed: u64,
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
    /// Samples a pixel of those pictures; 0 takes the scene's, whose queries are then all held in memory.
    #[arg(long, default_value_t = Effort::default().samples)]
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
struct Settings {
    version: &'static str,
    data: String,
    scene: String,
    full: Option<PathBuf>,
    material: String,
    surface: Option<String>,
    goal: Goal,
    total: Option<usize>,
    made: (usize, u64),
    work: String,
}

/// A material that is fitted, before anything is trained.
struct Subject {
    name: String,
    data: Dataset,
    full: Option<PathBuf>,
    surface: Option<String>,
    folder: Folder,
}

/// A subject with its full model and its truth.
struct Ready {
    subject: Subject,
    full: open::Full,
    truth: Truth,
    training: u64,
}

impl Fit {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        super::check_json(self.json.as_deref())?;
        self.work.check()?;
        let goal = self.goal()?;
        let subjects = self.subjects(goal)?;
        let mut ready = Vec::new();
        for subject in subjects {
            let texels = (subject.data.resolution()[0] * subject.data.resolution()[1]) as u64;
            let training = self.work.training.unwrap_or(PER_TEXEL * texels);
            let own = subject.folder.root().join("full");
            let path = subject.full.as_deref();
            let full = open::full(path, &subject.data, &own, (training, self.work.seed), console)?;
            let made = (self.field_side, self.material_seed);
            let truth = open::truth(subject.surface.as_deref(), made, &subject.data, &full, console)?;
            if goal.target.is_some_and(|target| target.most.is_none()) && !truth.is_surface() {
                let problem = "the full model is the truth here and has no error to be compared with: give a number, as in \
                               --target flip=0.02";
                return Err(Error::usage(format!(
                    "--target {}: {problem}",
                    goal.target.unwrap_or(LIKE_FULL)
                )));
            }
            ready.push(Ready { subject, full, truth, training });
        }
        let models = ready.iter().map(|r| (r.subject.name.clone(), r.full.path.clone())).collect();
        let mut scene = open::scene(&self.scene, &models, self.work.seed)?;
        let name = scene_name(&self.scene);
        let jobs =
            ready.iter().map(|ready| self.job(ready, &name, &scene, goal)).collect::<Result<Vec<_>>>()?;
        let told = Told::new(console);
        let watch = |label: &str, done: f64| told.tell(label, done);
        let fitted = match (self.total_bytes, jobs.as_slice()) {
            (Some(total), jobs) => fit_all(jobs, &mut scene, total, &watch),
            (None, jobs) => jobs.iter().map(|job| job.run(&mut scene, &watch)).collect(),
        };
        told.finish();
        let fitted = fitted?;
        for (fitted, ready) in fitted.iter().zip(&ready) {
            ready.subject.folder.write(fitted, &ready.full.checkpoint, scene.file.stops)?;
            if !self.keep {
                for path in Job::workings(ready.subject.folder.root()) {
                    let _ = std::fs::remove_dir_all(path);
                }
            }
        }
        let outcomes: Vec<&Outcome> = fitted.iter().map(|fitted| &fitted.outcome).collect();
        match outcomes.as_slice() {
            [one] => super::save_json(self.json.as_deref(), one)?,
            all => super::save_json(self.json.as_deref(), &all)?,
        }
        for (fitted, ready) in fitted.iter().zip(&ready) {
            say(fitted, ready.subject.folder.root(), console)?;
        }
        self.held(&fitted, &ready)
    }

    fn goal(&self) -> Result<Goal> {
        let goal =
            Goal { target: self.target, ns: self.budget_ns, bytes: self.budget_bytes, prefer: self.prefer };
        let budgets = [goal.ns.is_some(), goal.bytes.is_some(), self.total_bytes.is_some()];
        if goal.target.is_none() && !budgets.contains(&true) {
            let problem = "say what is wanted: --target flip=0.02 (or flip=full), --budget-ns, --budget-bytes, or \
                           --total-bytes for several materials";
            return Err(Error::usage(problem));
        }
        if let Some(ns) = goal.ns.filter(|ns| !(*ns > 0.0 && ns.is_finite())) {
            return Err(Error::usage(format!("--budget-ns {ns}: is not above 0")));
        }
        Ok(goal)
    }

    /// The materials that are named, with their folders. The scene is read before anything is made.
    fn subjects(&self, goal: Goal) -> Result<Vec<Subject>> {
        let (file, path) = crate::render::builtin::scene(&self.scene)?;
        let named = |texts: &[String], flag: &str| -> Result<BTreeMap<String, String>> {
            let mut all = BTreeMap::new();
            for text in texts {
                let (name, value) = text.split_once('=').unwrap_or((DEFAULT_MATERIAL, text));
                if all.insert(name.to_string(), value.to_string()).is_some() {
                    return Err(Error::usage(format!("{flag} {text}: {name} is named twice")));
                }
            }
            Ok(all)
        };
        let data = named(&self.data, "DATA")?;
        let (mut full, mut surface) = (named(&self.full, "--full")?, named(&self.surface, "--surface")?);
        let several = data.len() > 1;
        let mut subjects = Vec::new();
        for (name, data) in data {
            if !file.objects.iter().any(|object| object.material == name) {
                let problem = format!("no object of {} has the material {name}", path.display());
                return Err(Error::usage(format!("{problem}; {}", open::names(&file))));
            }
            let data = Dataset::open(&data)?;
            let (full, surface) = (full.remove(&name).map(PathBuf::from), surface.remove(&name));
            let settings = Settings {
                version: env!("CARGO_PKG_VERSION"),
                data: data.identity()?,
                scene: serde_json::to_string(&file).map_err(|e| Error::config("scene", e))?,
                full: full.clone(),
                material: name.clone(),
                surface: surface.clone(),
                goal,
                total: self.total_bytes,
                made: (self.field_side, self.material_seed),
                work: format!("{:?}", self.work),
            };
            let root = if several { self.out.join(&name) } else { self.out.clone() };
            let folder = Folder::open(&root, &settings, self.force)?;
            subjects.push(Subject { name, data, full, surface, folder });
        }
        if let Some((name, _)) = full.iter().chain(&surface).next() {
            return Err(Error::usage(format!(
                "--full or --surface {name}=: DATA has no material of that name"
            )));
        }
        Ok(subjects)
    }

    fn job<'a>(&self, ready: &'a Ready, scene_name: &'a str, scene: &Scene, goal: Goal) -> Result<Job<'a>> {
        let Ready { subject, full, truth, training } = ready;
        let place = scene.materials.iter().position(|material| material.name == subject.name);
        let seen = || Error::usage(format!("DATA {}: the scene has no such material", subject.name));
        Ok(Job {
            name: scene_name,
            material: place.ok_or_else(seen)?,
            full: &full.checkpoint,
            config: &full.config,
            trained: full.trained,
            truth,
            data: Some(&subject.data),
            goal,
            effort: self.work.effort(full.trained.map_or(*training, |(samples, _)| samples)),
            folder: subject.folder.root(),
        })
    }

    /// An error for the first target that is not held.
    fn held(&self, fitted: &[Fitted], ready: &[Ready]) -> Result<()> {
        for (fitted, ready) in fitted.iter().zip(ready) {
            let outcome = &fitted.outcome;
            let (false, Some(bound), Some(row)) = (outcome.holds, outcome.bound, outcome.row(FITTED)) else {
                continue;
            };
            let metric = outcome.goal.metric();
            let (name, reached) = (metric.name(), metric.of(&row.errors)?);
            let problem = format!(
                "no model within the budgets reaches {name}={}: the nearest, which is kept here, has {} ({}); --target {name}={} would \
                 be held, and more --training, --unique or a wider --full may reach further",
                digits(bound),
                digits(reached),
                row.shape,
                digits(1.01 * reached)
            );
            return Err(Error::file(ready.subject.folder.root(), problem));
        }
        Ok(())
    }
}

fn say(fitted: &Fitted, root: &Path, console: &Console) -> Result<()> {
    let outcome = &fitted.outcome;
    let mut lines = vec![format!(
        "{:<22} {:>9} {:>7} {:>8} {:>8} {:>8}",
        outcome.material, "bytes", "FLOPs", "ns", "flip", "mse"
    )];
    for row in &outcome.rows {
        let flip = row.errors.flip.map_or("-".into(), |v| format!("{v:.4}"));
        lines.push(format!(
            "{:<22} {:>9} {:>7} {:>8.1} {flip:>8} {:>8.5}",
            row.name, row.bytes, row.flops, row.cost.ns_per_query, row.errors.mse
        ));
    }
    lines.push(page::verdict(outcome));
    console.answer(lines.join("\n"))?;
    let flag = match fitted.storage {
        Storage::BYTE => " --int8",
        Storage::HALF => " --half",
        _ => "",
    };
    let root = root.display();
    console.say(format!(
        "{root}: see report.html; neumip export {root} --out BUNDLE{flag} --check hands it over"
    ));
    Ok(())
}

/// Three digits of an error, however small.
fn digits(value: f64) -> String {
    if value < 1e-3 { format!("{value:.2e}") } else { format!("{value:.4}") }
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
