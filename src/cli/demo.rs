//! `neumip demo`: every stage on one material, and a page that shows what came out.

use super::console::Console;
use super::evaluate::{By, Evaluation};
use super::export::Written;
use super::surface::Surface;
use super::{evaluate, export, generate, train};
use crate::config::{Budget, Config};
use crate::dataset::{Block, Dataset, Existing, GenerateConfig, SplitName};
use crate::engine::FusedMaterial;
use crate::error::{Error, Result};
use crate::evaluate::Row;
use crate::query::{QueryBuffer, Reflectance, RgbImage};
use crate::report::{self, CostRow, Curve, ExportRow, Panel, Report, TableRow};
use crate::trainer::{Progress, Trainer};
use crate::{checkpoint, checkpoint::RunFolder};
use candle_core::Device;
use clap::Args;
use neumip_export::BundleFile;
use neumip_export::whole_file::write_whole;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The presets that are compared, baseline first.
const PRESETS: [&str; 2] = ["neumip", "improved"];
/// Everything that a demo's folder may hold.
const PARTS: [&str; 8] = [
    "data",
    "neumip",
    "improved",
    "neumip-bundle",
    "improved-bundle",
    "report.html",
    "report.json",
    "picture.png",
];
/// Held-out splits of the error table.
const SPLITS: [SplitName; 3] = [SplitName::Test, SplitName::Offgrid, SplitName::Grazing];
/// Queries and rounds of the timing: a demo's worth.
const TIMING: [usize; 2] = [65_536, 5];
/// Rendered slices and patches on the page.
const FINEST_PANELS: usize = 3;
const COARSE_LEVELS: [f32; 2] = [1.0, 2.0];
/// Unique training samples a texel, held-out pairs of directions, side of the views: half a minute of rendering on two cores.
const SAMPLES_PER_TEXEL: u64 = 120;
const TEST_PAIRS: usize = 8;
const VIEW_SIZE: usize = 192;
/// Memory for the training data: a demo's fits.
const MEMORY: usize = 1 << 30;

/// The whole way on a built-in material in a few minutes, ending in report.html.
#[derive(Debug, Args)]
#[command(after_help = "Example: neumip demo --material rocks --out demo-rocks")]
pub struct Demo {
    /// Folder of everything that is made.
    #[arg(long, default_value = "neumip-demo")]
    out: PathBuf,
    /// A built-in material or a material.json.
    #[arg(long, default_value = "metal-rings")]
    material: String,
    /// Texels along a side of the tile.
    #[arg(long, default_value_t = 128)]
    resolution: usize,
    /// Optimiser steps of each model.
    #[arg(long, default_value_t = 10_000)]
    steps: u64,
    /// Samples a step.
    #[arg(long, default_value_t = 8192)]
    batch: usize,
    /// Unique training samples, by default 120 a texel.
    #[arg(long)]
    samples: Option<u64>,
    /// Seed of data, weights and order.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    surface: Surface,
    /// Go on where an interrupted demo stopped.
    #[arg(long, conflicts_with = "force")]
    resume: bool,
    /// Replace an earlier demo.
    #[arg(long)]
    force: bool,
    /// Write the figures here too, as report.json has them.
    #[arg(long)]
    json: Option<PathBuf>,
}

/// One trained and exported model.
struct Model {
    name: &'static str,
    run: PathBuf,
    progress: Progress,
    bundle: Option<Written>,
}

impl Demo {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        super::check_json(self.json.as_deref())?;
        let clock = Instant::now();
        let config = self.generation();
        let reference = generate::reference(&self.material, &self.surface, &config)?;
        for preset in PRESETS {
            self.config(preset)?.train.validate()?;
        }
        self.prepare_folder()?;
        console.say(format!("[1/5] rendering {} into {}", self.material, self.out.join("data").display()));
        let existing = if self.resume { Existing::Resume } else { Existing::Refuse };
        let data = generate::dataset(&reference, &config, &self.out.join("data"), existing, console)?;
        let generated = clock.elapsed().as_secs_f64();

        let mut models = Vec::new();
        for (k, name) in PRESETS.into_iter().enumerate() {
            console.say(format!(
                "[{}/5] training {name}: {} steps of {} samples",
                k + 2,
                self.steps,
                self.batch
            ));
            models.push(self.model(name, &data, console)?);
        }
        console.say("[4/5] evaluating on held-out directions");
        let runs: Vec<PathBuf> = models.iter().map(|m| m.run.clone()).collect();
        let evaluations = evaluate::evaluate(&runs, &data, &SPLITS, By::default(), TIMING, console)?;
        console.say(evaluate::text_table(&evaluations));

        console.say("[5/5] exporting");
        for model in &mut models {
            let out = self.out.join(format!("{}-bundle", model.name));
            let bundle = export::bundle(&checkpoint::load(&model.run)?, &out, true, console)?;
            console.say(format!(
                "{}: graph within {:.1e} (1 + |value|) of the model",
                out.display(),
                bundle.difference
            ));
            model.bundle = Some(bundle);
        }
        let seconds = clock.elapsed().as_secs_f64();
        let report = self.report(&data, &models, &evaluations, [generated, seconds])?;
        let figures = report::json(&report)?;
        write_whole(&self.out.join("report.html"), report::html(&report)?.as_bytes())?;
        super::write_json(&self.out.join("report.json"), &figures)?;
        if let Some(panel) = report.panels.last() {
            let images: Vec<&RgbImage> = std::iter::once(&panel.reference)
                .chain(panel.answers.iter().map(|(_, image)| image))
                .collect();
            write_whole(&self.out.join("picture.png"), &report::picture::strip(&images, 1.0)?)?;
        }
        super::save_json(self.json.as_deref(), &figures)?;
        console.say(&report.verdict);
        console.say(format!("{seconds:.0} s; open {}", self.out.join("report.html").display()));
        Ok(())
    }

    fn prepare_folder(&self) -> Result<()> {
        if self.out.exists() && !self.resume {
            if !self.force {
                return Err(Error::file(
                    &self.out,
                    "exists; choose another --out, or use --resume or --force",
                ));
            }
            let entries = std::fs::read_dir(&self.out)
                .map_err(|e| Error::file(&self.out, format!("cannot be read: {e}")))?;
            for entry in entries.flatten() {
                let name = entry.file_name().to_string_lossy().into_owned();
                if !PARTS.contains(&name.as_str()) {
                    let problem =
                        format!("holds {name}, which no demo made; --force replaces only a demo's folder");
                    return Err(Error::file(&self.out, problem));
                }
            }
            let data = self.out.join("data");
            if data.exists() {
                Dataset::open(&data)?;
            }
            std::fs::remove_dir_all(&self.out)
                .map_err(|e| Error::file(&self.out, format!("cannot be replaced: {e}")))?;
        }
        std::fs::create_dir_all(&self.out).map_err(|e| Error::file(&self.out, format!("cannot be made: {e}")))
    }

    fn generation(&self) -> GenerateConfig {
        let mut config = GenerateConfig::new(self.resolution);
        let texels = (self.resolution as u64).saturating_mul(self.resolution as u64);
        config.samples = self.samples.unwrap_or(texels.saturating_mul(SAMPLES_PER_TEXEL));
        config.test_pairs = TEST_PAIRS;
        config.view_size = VIEW_SIZE;
        config.seed = self.seed;
        config
    }

    fn config(&self, preset: &str) -> Result<Config> {
        let mut config = Config::preset(preset)?;
        config.train.budget = Budget::Steps(self.steps);
        config.train.batch = self.batch;
        config.train.seed = self.seed;
        Ok(config)
    }

    fn model(&self, name: &'static str, data: &Dataset, console: &Console) -> Result<Model> {
        let (run, config) = (self.out.join(name), self.config(name)?);
        let mut trainer = if self.resume && run.join("run.json").is_file() {
            if RunFolder::open(&run)?.1.config != config {
                return Err(Error::file(
                    run,
                    "was begun with other options; give the same ones or use --force",
                ));
            }
            Trainer::resume(&run, data, &Device::Cpu)?
        } else {
            Trainer::new(config, data, &run, false, MEMORY, &Device::Cpu)?
        };
        train::train(&mut trainer, name, console)?;
        Ok(Model { name, run, progress: trainer.progress().clone(), bundle: None })
    }

    fn report(
        &self,
        data: &Dataset,
        models: &[Model],
        evaluations: &[Evaluation],
        [generated, seconds]: [f64; 2],
    ) -> Result<Report> {
        let texels = (self.resolution * self.resolution) as f64;
        let unique = data.split(SplitName::Train)?.info().samples() as f64;
        let presented = (self.steps * self.batch as u64) as f64;
        let fact = |name: &str, value: String| (name.to_string(), value);
        let mut facts = vec![
            fact(
                "Material",
                format!("{} at {} x {}", data.manifest().material, self.resolution, self.resolution),
            ),
            fact(
                "Training data",
                format!("{:.0} unique samples a texel, {} rays each", unique / texels, self.generation().spp),
            ),
            fact(
                "Presented",
                format!("{:.0} samples a texel: {} steps of {}", presented / texels, self.steps, self.batch),
            ),
            fact("Seed", self.seed.to_string()),
            fact("Threads", rayon::current_num_threads().to_string()),
            fact("Rendering", format!("{generated:.0} s")),
        ];
        for model in models {
            let rate =
                super::console::short(model.progress.samples as f64 / model.progress.seconds, "samples");
            facts.push(fact(
                &format!("Training {}", model.name),
                format!("{:.0} s, {rate}/s", model.progress.seconds),
            ));
        }
        for model in models {
            if let Some(bundle) = &model.bundle {
                let text = format!("within {:.1e} (1 + |value|)", bundle.difference);
                facts.push(fact(&format!("ONNX graph {}", model.name), text));
            }
        }
        facts.push(fact("Whole demo", format!("{seconds:.0} s")));
        Ok(Report {
            title: format!("neumip: {}", data.manifest().material),
            facts,
            verdict: verdict(models, evaluations),
            panels: panels(data, models)?,
            curves: models.iter().map(curve).collect(),
            table: models
                .iter()
                .zip(evaluations)
                .flat_map(|(m, e)| e.rows.iter().map(|r| table_row(m, r)))
                .collect(),
            costs: models.iter().zip(evaluations).map(|(m, e)| cost_row(m, e)).collect(),
            exports: models.iter().flat_map(exports).collect(),
            commands: self.commands(),
        })
    }

    fn commands(&self) -> Vec<String> {
        let out = self.out.display();
        let mut commands = vec![format!(
            "neumip demo --material {} --resolution {} {} --steps {} --batch {} --seed {} --out {out}",
            self.material,
            self.resolution,
            self.surface.flags(),
            self.steps,
            self.batch,
            self.seed
        )];
        let runs: Vec<String> = PRESETS.iter().map(|p| format!("{out}/{p}")).collect();
        commands.push(format!("neumip evaluate {} --data {out}/data", runs.join(" ")));
        commands.push(format!("neumip export {out}/improved --out bundle"));
        commands
    }
}

/// Errors over a whole split.
fn split_row(evaluation: &Evaluation, split: SplitName) -> Option<&Row> {
    evaluation.rows.iter().find(|r| r.split == split.as_str() && r.level.is_none())
}

fn test_row(evaluation: &Evaluation) -> Option<&Row> {
    split_row(evaluation, SplitName::Test)
}

/// Who won, by how much and at what price; whether the other metrics agree.
fn verdict(models: &[Model], evaluations: &[Evaluation]) -> String {
    let ([baseline, ours], [b, o]) = (models, evaluations) else {
        return String::new();
    };
    let (Some(rb), Some(ro)) = (test_row(b), test_row(o)) else {
        return String::new();
    };
    let ratio = ro.errors.mse / rb.errors.mse;
    let word = if ratio < 1.0 { "lower" } else { "higher" };
    let votes = [
        ("mse_linear", ro.errors.mse_linear / rb.errors.mse_linear),
        ("mse_log1p", ro.errors.mse_log1p / rb.errors.mse_log1p),
    ];
    let against: Vec<&str> = votes.iter().filter(|v| (v.1 < 1.0) != (ratio < 1.0)).map(|v| v.0).collect();
    let agreement = if against.is_empty() {
        "mse_linear and mse_log1p agree on the order".to_string()
    } else {
        format!("{} order them the other way round", against.join(" and "))
    };
    let cost = match (b.cost, o.cost) {
        (Some(b), Some(o)) => format!(" at {:.2} times the time a query", o.ns_per_query / b.ns_per_query),
        _ => String::new(),
    };
    let elsewhere: Vec<String> = [SplitName::Offgrid, SplitName::Grazing]
        .into_iter()
        .filter_map(|split| {
            let change = split_row(o, split)?.errors.mse / split_row(b, split)?.errors.mse - 1.0;
            Some(format!("{:+.0} % on {split}", 100.0 * change))
        })
        .collect();
    format!(
        "On held-out directions, all levels, {} has {:.0} % {word} mse than {} ({:.2} against {:.2} x 10^-3){cost}; \
         {agreement}; {}.",
        ours.name,
        100.0 * (ratio - 1.0).abs(),
        baseline.name,
        ro.errors.mse * 1e3,
        rb.errors.mse * 1e3,
        elsewhere.join(", ")
    )
}

/// Pictures of held-out slices at level 0, of patches at coarser levels, and of the views.
fn panels(data: &Dataset, models: &[Model]) -> Result<Vec<Panel>> {
    let materials = models
        .iter()
        .map(|m| Ok((m.name, FusedMaterial::from_checkpoint(&checkpoint::load(&m.run)?)?)))
        .collect::<Result<Vec<_>>>()?;
    let panel =
        |title: String, caption: String, queries: &QueryBuffer, reference: RgbImage| -> Result<Panel> {
            let answers = materials
                .iter()
                .map(|(name, m)| Ok((name.to_string(), m.evaluate(queries)?)))
                .collect::<Result<_>>()?;
            Ok(Panel { title, caption, reference, answers })
        };
    let mut panels = Vec::new();
    let test = data.split(SplitName::Test)?;
    let mut blocks = Vec::new();
    for file in 0..test.files() {
        blocks.extend(test.read_file(file)?);
    }
    let at = |level: f32| blocks.iter().filter(move |b| b.level() == level);
    let chosen = at(0.0).take(FINEST_PANELS).chain(COARSE_LEVELS.iter().filter_map(|l| at(*l).next()));
    for block in chosen {
        let (queries, reference) = first_patch(block, data.resolution())?;
        let (wi, wo) = (queries.wi[0], queries.wo[0]);
        panels.push(panel(
            format!("Level {}, light {}, view {}", block.level(), angles(wi), angles(wo)),
            "held-out directions".into(),
            &queries,
            reference,
        )?);
    }
    for view in &data.manifest().views {
        let (queries, reference) = data.read_view(&view.name)?;
        let caption = "plane at distance 2.3, camera tilted 45 degrees, level from the pixel's footprint";
        panels.push(panel(format!("View {}", view.name), caption.into(), &queries, reference)?);
    }
    Ok(panels)
}

/// Queries and reference of a block's first patch.
fn first_patch(block: &Block, resolution: [usize; 2]) -> Result<(QueryBuffer, RgbImage)> {
    let patch = block.patch();
    let first = match block.cut(patch, resolution)?.into_iter().next() {
        Some(first) => first,
        None => block.clone(),
    };
    let reference = RgbImage { height: patch, width: patch, pixels: first.target() };
    Ok((first.queries(resolution), reference))
}

/// `theta, phi` in degrees.
fn angles(w: [f32; 2]) -> String {
    let theta = (w[0] * w[0] + w[1] * w[1]).sqrt().min(1.0).asin().to_degrees();
    format!("({theta:.0}°, {:.0}°)", w[1].atan2(w[0]).to_degrees())
}

fn curve(model: &Model) -> Curve {
    let progress = &model.progress;
    Curve {
        name: model.name.into(),
        training: progress.losses.iter().map(|(step, loss)| (*step as f64, *loss)).collect(),
        validation: progress.validations.iter().map(|p| (p.step as f64, p.errors.mse)).collect(),
    }
}

fn table_row(model: &Model, row: &Row) -> TableRow {
    TableRow {
        model: model.name.into(),
        split: row.split.clone(),
        level: row.level.map_or("all".into(), |l| l.to_string()),
        samples: row.queries,
        mse: row.errors.mse,
        mse_linear: row.errors.mse_linear,
        mse_log1p: row.errors.mse_log1p,
        psnr: row.psnr,
        ssim: row.ssim,
        flip: row.flip,
        noise: row.noise,
    }
}

fn cost_row(model: &Model, evaluation: &Evaluation) -> CostRow {
    let ns = |pick: fn(&crate::evaluate::Cost) -> f64| evaluation.cost.as_ref().map_or(f64::NAN, pick);
    CostRow {
        model: model.name.into(),
        ns: ns(|c| c.ns_per_query),
        ns_low: ns(|c| c.ns_low),
        ns_high: ns(|c| c.ns_high),
        weights: evaluation.weights as u64,
        flops: evaluation.flops as u64,
        bytes: evaluation.bytes as u64,
        mse: test_row(evaluation).map_or(f64::NAN, |r| r.errors.mse),
    }
}

fn exports(model: &Model) -> Vec<ExportRow> {
    let what = |name: &str| match Path::new(name).extension().and_then(|e| e.to_str()) {
        Some("onnx") if name.starts_with("decoder") => "decoder network, for onnxruntime and others",
        Some("onnx") => "the whole material as a graph: u, wi, wo, level to rgb",
        Some("exr") => "neural textures, half float, mip-mapped",
        Some("safetensors") => "checkpoint: every weight and texture as f32",
        _ if name == "golden.json" => "queries and answers to check a reader with",
        _ if name == "material.json" => "conventions, inputs and outputs, sizes, checksums",
        _ => "how to evaluate, in one page",
    };
    let row = |f: &BundleFile| ExportRow {
        model: model.name.into(),
        file: format!("{}-bundle/{}", model.name, f.name),
        bytes: f.bytes,
        what: what(&f.name).into(),
    };
    model.bundle.iter().flat_map(|b| &b.files).map(row).collect()
}
