//! `neumip evaluate`.

use super::console::Console;
use crate::checkpoint;
use crate::config::EngineKind;
use crate::dataset::{Dataset, SplitName};
use crate::error::{Error, Result};
use crate::evaluate::{
    Apart, Cost, Row, TIMED_QUERIES, apart_table, costs, error_table, motion_table, refusal, view_table,
};
use crate::inference::{Answerer, answerer};
use crate::lpips::Lpips;
use crate::model;
use crate::query::{Reflectance, Support};
use clap::Args;
use neumip_export::Precision;
use serde::Serialize;
use std::path::PathBuf;

/// Most queries of a timed round: their answers fit any memory that trains.
const MAX_QUERIES: usize = 1 << 24;

/// Error per split and level, and time per query, of one or more trained models side by side.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: neumip evaluate runs/neumip runs/improved --data data/metal --json errors.json"
)]
pub struct Evaluate {
    /// Runs' folders or checkpoints.
    #[arg(required = true)]
    runs: Vec<PathBuf>,
    /// The dataset.
    #[arg(long)]
    data: PathBuf,
    /// Splits, by default all but train.
    #[arg(long, value_delimiter = ',')]
    splits: Vec<SplitName>,
    /// Rounds of the timing; 0 leaves it out.
    #[arg(long, default_value_t = 5)]
    rounds: usize,
    /// Queries of a round.
    #[arg(long, default_value_t = TIMED_QUERIES)]
    queries: usize,
    /// Device that answers.
    #[arg(long, default_value = "cpu")]
    device: String,
    /// What answers: by default fused on the CPU, candle on other devices.
    #[arg(long)]
    engine: Option<EngineKind>,
    /// Store textures in half precision while answering.
    #[arg(long)]
    half_textures: bool,
    /// Weights of LPIPS, as scripts/lpips_weights.py writes them; without them the metric is left out.
    #[arg(long, value_name = "FILE")]
    lpips_weights: Option<PathBuf>,
    /// Write everything here.
    #[arg(long)]
    json: Option<PathBuf>,
}

/// What is said of one model.
#[derive(Clone, Debug, Serialize)]
pub struct Evaluation {
    /// How it was named on the command line.
    pub run: String,
    /// Material that it was trained on.
    pub material: String,
    /// Texels, \[height, width\].
    pub resolution: [usize; 2],
    /// Samples presented a texel.
    pub samples_per_texel: Option<f64>,
    /// Weights of the networks.
    pub weights: usize,
    /// Multiply-adds of the networks times 2, a query.
    pub flops: usize,
    /// Bytes of weights and textures as f32.
    pub bytes: usize,
    /// What answered the queries.
    pub engine: String,
    /// Time on one thread.
    pub cost: Option<Cost>,
    /// The error table.
    pub rows: Vec<Row>,
    /// Of a fitted material: how many queries of each split are outside of what it was fitted for, and the errors apart.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub fitted: Vec<Apart>,
}

impl Evaluate {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        super::check_json(self.json.as_deref())?;
        if !(1..=MAX_QUERIES).contains(&self.queries) {
            return Err(Error::usage(format!("--queries {}: use 1 to {MAX_QUERIES}", self.queries)));
        }
        let lpips = self.lpips_weights.as_ref().map(Lpips::open).transpose()?;
        let data = Dataset::open(&self.data)?;
        let splits = if self.splits.is_empty() {
            data.split_names().into_iter().filter(|s| *s != SplitName::Train).collect()
        } else {
            self.splits.clone()
        };
        let precision = if self.half_textures { Precision::Half } else { Precision::Single };
        let by = By { device: &self.device, engine: self.engine, precision, lpips: lpips.as_ref() };
        let evaluations = evaluate(&self.runs, &data, &splits, by, [self.queries, self.rounds], console)?;
        super::save_json(self.json.as_deref(), &evaluations)?;
        console.answer(text_table(&evaluations))
    }
}

/// What answers.
#[derive(Clone, Copy, Debug)]
pub struct By<'a> {
    /// Name of the device.
    pub device: &'a str,
    /// The engine, where it was chosen.
    pub engine: Option<EngineKind>,
    /// Of the textures.
    pub precision: Precision,
    /// What is asked for LPIPS, if anything.
    pub lpips: Option<&'a Lpips>,
}

impl Default for By<'_> {
    fn default() -> Self {
        Self { device: "cpu", engine: None, precision: Precision::Single, lpips: None }
    }
}

/// Evaluates runs on one dataset; `timing` is \[queries, rounds\].
pub fn evaluate(
    runs: &[PathBuf],
    data: &Dataset,
    splits: &[SplitName],
    by: By,
    timing: [usize; 2],
    console: &Console,
) -> Result<Vec<Evaluation>> {
    let device = model::device(by.device)?;
    let mut materials: Vec<Box<dyn Reflectance>> = Vec::new();
    let mut levels = 1;
    let mut evaluations = Vec::new();
    for run in runs {
        let checkpoint = checkpoint::load(run)?;
        let architecture = &checkpoint.header.architecture;
        if architecture.tile() != data.resolution() {
            return Err(Error::file(
                data.root(),
                format!(
                    "has {:?} texels where {} was trained on {:?}",
                    data.resolution(),
                    run.display(),
                    architecture.tile()
                ),
            ));
        }
        let Answerer { material, engine } = answerer(&checkpoint, by.engine, by.precision, &device)?;
        levels = architecture.coarsest() + 1;
        let mut meter = console.meter(format!("evaluate {}", run.display()), splits.len() as u64, "splits");
        let mut rows = Vec::new();
        for (done, split) in splits.iter().enumerate() {
            meter.update(done as u64, split.as_str());
            match refusal(&*material, data, *split)? {
                Some(why) => console.say(format!("{}: {why}", run.display())),
                None => rows.extend(error_table(&*material, data, std::slice::from_ref(split), by.lpips)?),
            }
            console.check("no table was written")?;
        }
        rows.extend(view_table(&*material, data, by.lpips)?);
        rows.extend(motion_table(&*material, data, by.lpips)?);
        let fitted = apart_table(&*material, architecture, data, splits)?;
        if material.support() != Support::Pointwise && !data.manifest().views.is_empty() {
            console.say(format!(
                "{}: views and their sequences are left out: they are no regular grids",
                run.display()
            ));
        }
        meter.finish(splits.len() as u64);
        let samples = checkpoint.header.provenance.get("samples").and_then(serde_json::Value::as_f64);
        let texels = (architecture.resolution[0] * architecture.resolution[1]) as f64;
        evaluations.push(Evaluation {
            run: run.display().to_string(),
            material: checkpoint.header.material.clone(),
            resolution: architecture.resolution,
            samples_per_texel: samples.map(|s| s / texels),
            weights: architecture.network_weights(),
            flops: architecture.flops_per_query(),
            bytes: architecture.bytes(),
            engine,
            cost: None,
            rows,
            fitted,
        });
        materials.push(material);
    }
    let [queries, rounds] = timing;
    if rounds > 0 {
        let answerers: Vec<&dyn Reflectance> = materials.iter().map(|m| &**m).collect();
        for (evaluation, cost) in evaluations.iter_mut().zip(costs(&answerers, levels, queries, rounds)?) {
            evaluation.cost = Some(cost);
        }
    }
    Ok(evaluations)
}

/// The table as text: a line a split and level, `mse` x 10^3 of every run.
pub fn text_table(evaluations: &[Evaluation]) -> String {
    let mut out = String::new();
    for (k, e) in evaluations.iter().enumerate() {
        let cost = e.cost.map_or(String::new(), |c| {
            format!(
                ", {:.0} ns a query ({:.0} to {:.0}, one thread, {})",
                c.ns_per_query, c.ns_low, c.ns_high, e.engine
            )
        });
        let samples = e.samples_per_texel.map_or(String::new(), |s| format!(", {s:.0} samples a texel"));
        out += &format!(
            "[{}] {}: {} at {} x {}{samples}, {} weights, {} FLOPs, {} bytes{cost}\n",
            k + 1,
            e.run,
            e.material,
            e.resolution[0],
            e.resolution[1],
            e.weights,
            e.flops,
            e.bytes
        );
    }
    let shown: Vec<&Column> = COLUMNS
        .iter()
        .filter(|column| {
            column.always || evaluations.iter().flat_map(|e| &e.rows).any(|r| (column.of)(r).is_some())
        })
        .collect();
    let splits = evaluations.iter().flat_map(|e| &e.rows).map(|row| row.split.len());
    let split_width = splits.max().unwrap_or(0).max(12);
    out += &format!("\n{:<split_width$} {:>5} {:>9}", "split", "level", "noise");
    for k in 1..=evaluations.len() {
        out += " |";
        for Column { name, width, .. } in &shown {
            let name = if *name == "mse" { format!("mse[{k}]") } else { name.to_string() };
            out += &format!(" {name:>width$}");
        }
    }
    // A decoder that reads neighbours has no rows for what is no regular grid.
    let mut lines: Vec<&Row> = Vec::new();
    let same = |a: &Row, b: &Row| a.split == b.split && a.level == b.level;
    for row in evaluations.iter().flat_map(|e| &e.rows) {
        if !lines.iter().any(|line| same(line, row)) {
            lines.push(row);
        }
    }
    let number = |v: Option<f64>, digits: usize| v.map_or("-".to_string(), |v| format!("{v:.digits$}"));
    for row in lines {
        let level = row.level.map_or("all".into(), |l| l.to_string());
        let noise = number(row.noise.map(|v| v * MILLI), 4);
        out += &format!("\n{:<split_width$} {level:>5} {noise:>9}", row.split);
        for e in evaluations {
            let r = e.rows.iter().find(|r| same(r, row));
            out += " |";
            for Column { width, digits, of, .. } in &shown {
                out += &format!(" {:>width$}", number(r.and_then(of), *digits));
            }
        }
    }
    out += "\nmse and noise x 10^3; mse of linear RGB clamped to [0, 1]";
    for (k, e) in evaluations.iter().enumerate().filter(|(_, e)| !e.fitted.is_empty()) {
        out += &format!(
            "\n\n[{}] by what it was fitted for and what it was not\n{:<split_width$} {:>10} {:>11}  outside",
            k + 1,
            "split",
            "mse inside",
            "mse outside"
        );
        for Apart { split, count, errors_inside, errors_outside } in &e.fitted {
            let [inside, outside] =
                [errors_inside, errors_outside].map(|errors| number(errors.map(|e| e.mse * MILLI), 4));
            out += &format!("\n{split:<split_width$} {inside:>10} {outside:>11}  {}", count.described());
        }
    }
    out
}

/// Errors are printed times a thousand.
const MILLI: f64 = 1e3;

/// A column of the text table.
struct Column {
    name: &'static str,
    width: usize,
    digits: usize,
    /// Shown even where no row has a value.
    always: bool,
    of: fn(&Row) -> Option<f64>,
}

const COLUMNS: [Column; 6] = [
    Column { name: "mse", width: 9, digits: 4, always: true, of: |r| Some(r.errors.mse * MILLI) },
    Column { name: "psnr", width: 7, digits: 2, always: true, of: |r| r.psnr },
    Column { name: "ssim", width: 6, digits: 3, always: true, of: |r| r.ssim },
    Column { name: "flip", width: 6, digits: 3, always: true, of: |r| r.flip },
    Column { name: "lpips", width: 6, digits: 3, always: false, of: |r| r.lpips },
    Column { name: "flicker", width: 7, digits: 3, always: false, of: |r| r.flicker },
];
