//! The paper's tables and figures out of results, as text that Markdown and pages show alike.

use super::paper;
use super::study::{Directions, Study};
use super::variant::{ABLATION, ENCODINGS, GRADIENTS, STAGES, ablation_label};
use crate::results::{Cell, Metrics, Results};
use std::collections::{BTreeMap, BTreeSet};

/// A table.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Heading.
    pub title: String,
    /// What it shows and how.
    pub note: String,
    /// Names of the columns.
    pub head: Vec<String>,
    /// Rows as wide as the head.
    pub rows: Vec<Vec<String>>,
}

/// Levels of Table 2.
const LEVELS: usize = 6;
/// The presets of the paper's comparison come first, in this order.
const ORDER: [&str; 5] = ["neumip", "paper", "improved", "inception-small", "inception"];

/// A metric by name, with the factor by which tables show it.
#[derive(Clone, Copy)]
pub struct Shown {
    name: &'static str,
    get: fn(&Metrics) -> Option<f64>,
    factor: f64,
    digits: usize,
}

const MSE: Shown = Shown { name: "mse x 10^3", get: |m| m.mse, factor: 1e3, digits: 2 };
const FLIP: Shown = Shown { name: "FLIP", get: |m| m.flip, factor: 1.0, digits: 4 };
const LPIPS: Shown = Shown { name: "LPIPS", get: |m| m.lpips, factor: 1.0, digits: 4 };
const FLICKER: Shown = Shown { name: "flicker", get: |m| m.flicker, factor: 1.0, digits: 3 };

/// Mean, half of the distance between the least and the largest, and number of some values.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Spread {
    mean: f64,
    half: f64,
    n: usize,
}

impl Spread {
    fn of(values: &[f64]) -> Option<Self> {
        let n = values.len();
        let (low, high) =
            values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        (n > 0).then(|| Self { mean: values.iter().sum::<f64>() / n as f64, half: 0.5 * (high - low), n })
    }

    fn text(self, shown: Shown) -> String {
        let (mean, half, digits) = (self.mean * shown.factor, self.half * shown.factor, shown.digits);
        if self.n > 1 { format!("{mean:.digits$} ± {half:.digits$}") } else { format!("{mean:.digits$}") }
    }
}

/// Results of one study, ready to be asked.
pub struct View<'a> {
    cells: Vec<&'a Cell>,
}

impl<'a> View<'a> {
    /// The cells of a study's resolution and budget.
    pub fn new(results: &'a Results, study: &Study) -> Self {
        let of_study = |cell: &&Cell| {
            let budget = cell.samples_per_texel;
            let asked = study.budget as f64;
            // Budgets are whole steps; what is not trained has none.
            cell.resolution == [study.resolution; 2]
                && (budget == 0.0 || (budget - asked).abs() <= 1.0 + 0.02 * asked)
        };
        Self { cells: results.cells.iter().filter(of_study).collect() }
    }

    fn matching(
        &self,
        material: &'a str,
        preset: &'a str,
        regime: Directions,
    ) -> impl Iterator<Item = &'a Cell> + '_ {
        let regime = regime.to_string();
        self.cells.iter().copied().filter(move |c| {
            c.material == material && c.preset == preset && (c.seed == 0 || c.regime.starts_with(&regime))
        })
    }

    /// A metric of a variant over its seeds; where several splits match, their mean for each seed.
    fn spread(
        &self,
        key: (&'a str, &'a str, Directions),
        split: &str,
        level: Option<usize>,
        shown: Shown,
    ) -> Option<Spread> {
        let mut seeds: BTreeMap<u64, Vec<f64>> = BTreeMap::new();
        for cell in self.matching(key.0, key.1, key.2) {
            let of_split = cell.split == split || (split.ends_with('/') && cell.split.starts_with(split));
            if let Some(value) = (shown.get)(&cell.metrics).filter(|_| of_split && cell.level == level) {
                seeds.entry(cell.seed).or_default().push(value);
            }
        }
        let means: Vec<f64> = seeds.values().map(|v| v.iter().sum::<f64>() / v.len() as f64).collect();
        Spread::of(&means)
    }

    fn materials(&self) -> Vec<&'a str> {
        self.cells.iter().map(|c| c.material.as_str()).collect::<BTreeSet<_>>().into_iter().collect()
    }

    /// The presets of the paper's comparison that are there.
    fn presets(&self) -> Vec<&'a str> {
        let there: BTreeSet<&str> = self.cells.iter().map(|c| c.preset.as_str()).collect();
        ORDER.into_iter().filter_map(|name| there.get(name).copied()).collect()
    }

    /// A row a material and a column a preset, with the ratio of the first preset to the last and a geometric mean.
    fn by_material(&self, title: String, note: &str, regime: Directions, split: &str, shown: Shown) -> Table {
        let presets: Vec<&str> = self.presets().into_iter().filter(|p| !p.starts_with("inception")).collect();
        let mut head = vec!["material".to_string()];
        head.extend(presets.iter().map(|p| p.to_string()));
        let ratios = shown.name == MSE.name && presets.first() == Some(&"neumip") && presets.len() > 1;
        if ratios {
            head.extend(presets[1..].iter().map(|p| format!("neumip / {p}")));
            head.push("printed: NeuMIP / ours".into());
        }
        let mut rows = Vec::new();
        let mut logs: Vec<(f64, usize)> = vec![(0.0, 0); head.len()];
        for material in self.materials() {
            let values: Vec<Option<Spread>> =
                presets.iter().map(|p| self.spread((material, p, regime), split, None, shown)).collect();
            if values.iter().all(Option::is_none) {
                continue;
            }
            let mut row = vec![material.to_string()];
            row.extend(values.iter().map(|v| v.map_or("".into(), |v| v.text(shown))));
            let mut numbers: Vec<Option<f64>> = vec![None];
            numbers.extend(values.iter().map(|v| v.map(|v| v.mean)));
            if ratios {
                for value in &values[1..] {
                    let ratio = values[0].zip(*value).map(|(a, b)| a.mean / b.mean);
                    row.push(ratio.map_or("".into(), |r| format!("{r:.2}")));
                    numbers.push(ratio);
                }
                let printed = paper::printed(material).map(|p| p.mse[1] / p.mse[0]);
                row.push(printed.map_or("".into(), |r| format!("{r:.1}")));
                numbers.push(printed);
            }
            for (log, number) in logs.iter_mut().zip(numbers) {
                if let Some(number) = number.filter(|n| *n > 0.0) {
                    *log = (log.0 + number.ln(), log.1 + 1);
                }
            }
            rows.push(row);
        }
        if rows.len() > 1 {
            let mut mean = vec!["geometric mean".to_string()];
            for (k, (sum, n)) in logs.iter().enumerate().skip(1) {
                let of_metric = k <= presets.len();
                // A mean over other materials than the rows' would mislead.
                let whole = *n == rows.len() || !of_metric;
                let value = (*n > 0 && whole).then(|| (sum / *n as f64).exp());
                let (factor, digits) = if of_metric { (shown.factor, shown.digits) } else { (1.0, 2) };
                mean.push(value.map_or("".into(), |v| format!("{:.digits$}", v * factor)));
            }
            rows.push(mean);
        }
        Table { title, note: note.into(), head, rows }
    }

    /// Table 2: a row a material and level.
    fn by_level(&self, regime: Directions) -> Table {
        let presets: Vec<&str> = self.presets().into_iter().filter(|p| !p.starts_with("inception")).collect();
        let mut head = vec!["material".to_string(), "preset".into()];
        head.extend((0..LEVELS).map(|l| format!("level {l}")));
        head.push("FLIP, level 0".into());
        let mut rows = Vec::new();
        for material in self.materials() {
            for preset in &presets {
                let key = (material, *preset, regime);
                let values: Vec<_> = (0..LEVELS).map(|l| self.spread(key, "test", Some(l), MSE)).collect();
                if values.iter().all(Option::is_none) {
                    continue;
                }
                let mut row = vec![material.to_string(), preset.to_string()];
                row.extend(values.iter().map(|v| v.map_or("".into(), |v| v.text(MSE))));
                let flip = self.spread(key, "test", Some(0), FLIP);
                row.push(flip.map_or("".into(), |v| v.text(FLIP)));
                rows.push(row);
            }
        }
        let note = format!(
            "`mse` x 10^3 on whole slices under held-out directions, {regime} training data; mean over seeds ± half of \
             their range."
        );
        Table { title: format!("Table 2: levels of detail ({regime})"), note, head, rows }
    }

    /// Training against held-out directions.
    fn seen_and_unseen(&self) -> Table {
        let presets = self.presets();
        let mut head = vec!["material".to_string(), "regime".into()];
        for preset in &presets {
            head.extend([format!("{preset}: train"), format!("{preset}: test")]);
        }
        let mut rows = Vec::new();
        for material in self.materials() {
            for regime in [Directions::Scattered, Directions::Slices] {
                let mut row = vec![material.to_string(), regime.to_string()];
                for preset in &presets {
                    for split in ["train", "test"] {
                        let value = self.spread((material, preset, regime), split, None, MSE);
                        row.push(value.map_or("".into(), |v| v.text(MSE)));
                    }
                }
                if row[2..].iter().any(|cell| !cell.is_empty()) {
                    rows.push(row);
                }
            }
        }
        let note = "`mse` x 10^3 on a part of the training data and on the test split. Training targets are noisier \
                    (fewer sub-samples), and both splits mix levels in their own shares: compare models, not columns.";
        Table { title: "Directions seen and not seen".into(), note: note.into(), head, rows }
    }

    /// Figure 3.
    fn ablation(&self, split: &str, shown: Shown) -> Option<Table> {
        let material = self.cells.iter().find(|c| c.preset.starts_with(ABLATION))?.material.as_str();
        let labels: BTreeMap<String, &'a str> =
            self.cells.iter().map(|c| (c.preset.clone(), c.preset.as_str())).collect();
        let value = |encoding: &str, gradient: &str, stages: &str| {
            let label = labels.get(&ablation_label(encoding, gradient, stages))?;
            self.spread((material, label, Directions::Scattered), split, None, shown)
        };
        let mut head = vec!["encoding".to_string(), "gradient loss".into()];
        head.extend(STAGES.iter().map(|s| format!("stages {s}")));
        let mut rows = Vec::new();
        for encoding in ENCODINGS {
            for gradient in std::iter::once("off").chain(GRADIENTS) {
                let mut row = vec![encoding.to_string(), gradient.to_string()];
                for stages in STAGES {
                    let void = gradient == "off" && stages != "none";
                    let text = value(encoding, gradient, stages).map_or("".into(), |v| v.text(shown));
                    row.push(if void { "void".into() } else { text });
                }
                rows.push(row);
            }
        }
        let title = format!("Figure 3: {} on {split}, {material}", shown.name);
        let note = "Pixel loss L1, on 4th roots where a schedule has it so; one seed. A gradient loss on linear or on \
                    4th-root images; stages s1 to s3 as in the authors' code, adaptive by plateaus of validation."
            .to_string();
        Some(Table { title, note, head, rows })
    }

    /// Figure 8.
    fn inception(&self) -> Table {
        let head = [
            "material",
            "decoder",
            "mse x 10^3, level 0",
            "all levels",
            "train",
            "FLIP, level 0",
            "ns a query",
            "FLOPs a query",
        ];
        let mut rows = Vec::new();
        for material in self.materials() {
            let decoders = ["inception", "inception-small"];
            let there =
                decoders.iter().any(|d| self.matching(material, d, Directions::Slices).next().is_some());
            for preset in self.presets().into_iter().filter(|_| there) {
                let key = (material, preset, Directions::Slices);
                let Some(cell) = self.matching(material, preset, Directions::Slices).next() else { continue };
                let text = |split, level, shown| {
                    self.spread(key, split, level, shown).map_or(String::new(), |v| v.text(shown))
                };
                rows.push(vec![
                    material.into(),
                    preset.into(),
                    text("test", Some(0), MSE),
                    text("test", None, MSE),
                    text("train", None, MSE),
                    text("test", Some(0), FLIP),
                    cell.ns_per_query.map_or(String::new(), |ns| format!("{ns:.0}")),
                    cell.flops.to_string(),
                ]);
            }
        }
        let note = "Slices in training and test, since the decoder sees its neighbours; one thread, whole slices, for \
                    the Inception decoders' times.";
        let title = "Figure 8: the Inception decoder".into();
        Table { title, note: note.into(), head: head.map(String::from).into(), rows }
    }

    /// Every variant that was timed: cost, and error as the geometric mean over the materials that all of them have.
    fn costs(&self) -> Table {
        let mut by_preset: BTreeMap<&str, BTreeMap<&str, &Cell>> = BTreeMap::new();
        for cell in &self.cells {
            let wanted = cell.split == "test" && cell.level.is_none() && cell.regime != "slices";
            if wanted && cell.ns_per_query.is_some() && !cell.regime.starts_with("slices") {
                by_preset.entry(&cell.preset).or_default().insert(&cell.material, cell);
            }
        }
        let most = by_preset.values().map(BTreeMap::len).max().unwrap_or(0);
        let counts = |material: &str| by_preset.values().filter(|m| m.contains_key(material)).count();
        let shared: Vec<&str> =
            self.materials().into_iter().filter(|m| 2 * counts(m) > by_preset.len()).collect();
        let mut head: Vec<String> =
            ["variant", "ns a query", "bytes", "FLOPs a query"].map(String::from).into();
        head.extend(shared.iter().map(|m| format!("{m}: mse x 10^3")));
        head.push("geometric mean".into());
        let mut rows: Vec<(f64, Vec<String>)> = Vec::new();
        for (preset, cells) in &by_preset {
            let Some(cell) = cells.values().next() else { continue };
            let ns = cell.ns_per_query.unwrap_or(f64::NAN);
            let means: Vec<Option<f64>> = shared
                .iter()
                .map(|m| self.spread((m, preset, Directions::Scattered), "test", None, MSE).map(|s| s.mean))
                .collect();
            let mut row =
                vec![preset.to_string(), format!("{ns:.0}"), cell.bytes.to_string(), cell.flops.to_string()];
            row.extend(means.iter().map(|v| v.map_or(String::new(), |v| format!("{:.2}", v * 1e3))));
            let all: Option<Vec<f64>> = means.into_iter().collect();
            let mean = all
                .filter(|v| !v.is_empty() && v.iter().all(|v| *v > 0.0))
                .map(|v| (v.iter().map(|v| v.ln()).sum::<f64>() / v.len() as f64).exp() * 1e3);
            row.push(mean.map_or(String::new(), |v| format!("{v:.2}")));
            rows.push((ns, row));
        }
        rows.sort_by(|a, b| a.0.total_cmp(&b.0));
        let note = format!(
            "`mse` x 10^3 on the test split, all levels, scattered training data, mean over seeds; fused, one thread. \
             {} variants, up to {most} materials.",
            rows.len()
        );
        Table {
            title: "Speed and accuracy".into(),
            note,
            head,
            rows: rows.into_iter().map(|(_, r)| r).collect(),
        }
    }
}

/// The trials.
fn trials(results: &Results) -> Table {
    let head = ["preset", "regime", "trial", "settings", "validation mse x 10^3", ""].map(String::from);
    #[derive(Default)]
    struct Tried {
        values: Vec<String>,
        set: String,
        chosen: bool,
    }
    let mut rows: BTreeMap<(String, String, usize), Tried> = BTreeMap::new();
    for trial in &results.trials {
        let tried = rows.entry((trial.preset.clone(), trial.regime.clone(), trial.index)).or_default();
        let set: Vec<&str> = trial.set.iter().map(|s| s.trim_start_matches("train.")).collect();
        (tried.set, tried.chosen) = (set.join(" "), trial.chosen);
        let mse = trial.mse.map_or("diverged".into(), |mse| format!("{:.2}", mse * 1e3));
        tried.values.push(format!("{} {mse}", trial.material));
    }
    let rows = rows.into_iter().map(|((preset, regime, index), Tried { values, set, chosen })| {
        let set = if set.is_empty() { "as it is".into() } else { format!("`{set}`") };
        let chosen = if chosen { "chosen" } else { "" };
        vec![preset, regime, index.to_string(), set, values.join(", "), chosen.into()]
    });
    let note = "The same number of trials for every preset, drawn from the same factors; the lowest geometric mean over \
                the materials is chosen. Only the validation split was looked at.";
    let title = "Tuning trials".to_string();
    Table { title, note: note.into(), head: head.into(), rows: rows.collect() }
}

/// All tables that have rows.
pub fn tables(results: &Results, study: &Study) -> Vec<Table> {
    let view = View::new(results, study);
    let mut all = Vec::new();
    for regime in [Directions::Scattered, Directions::Slices] {
        for shown in [MSE, FLIP, LPIPS] {
            let title = format!("Table 1: {} of perspective views ({regime})", shown.name);
            let note = "Mean of the views `s2` and `s4`; mean over seeds ± half of their range. A printed ratio is the \
                        paper's, of `mse` on its own data at 120,000 samples a texel.";
            all.push(view.by_material(title, note, regime, "views/", shown));
        }
    }
    for regime in [Directions::Scattered, Directions::Slices] {
        all.push(view.by_level(regime));
    }
    let note = "Error of the difference between two frames over the energy of the true difference, mean of a light arc, a \
                camera arc and a zoom: 0 is right, 1 is what standing still would give, more is motion that is not there.";
    all.push(view.by_material("Flicker (scattered)".into(), note, Directions::Scattered, "motion/", FLICKER));
    all.push(view.seen_and_unseen());
    for split in ["test", "train"] {
        all.extend(view.ablation(split, MSE));
    }
    all.extend(view.ablation("test", FLIP));
    all.push(view.inception());
    all.push(view.costs());
    all.push(trials(results));
    // A column of nothing, such as LPIPS without weights, is no table.
    all.retain(|table| table.rows.iter().any(|row| row.iter().skip(1).any(|cell| !cell.is_empty())));
    all
}

/// A table in Markdown.
pub fn markdown(table: &Table) -> String {
    let line = |cells: &[String]| {
        let escaped: Vec<String> = cells.iter().map(|c| c.replace('|', "\\|")).collect();
        format!("| {} |\n", escaped.join(" | "))
    };
    let mut out = format!("## {}\n\n{}\n\n", table.title, table.note);
    out += &line(&table.head);
    out += &line(&vec!["---".to_string(); table.head.len()]);
    table.rows.iter().for_each(|row| out += &line(row));
    out
}
