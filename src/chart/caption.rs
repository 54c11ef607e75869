//! The words of a picture: its heading, what is shown and how it was measured.

use super::axes::grouped;
use super::metric::{BYTES, FLOPS, NS, costs};
use super::panel::{self, Panel};
use super::points::{Group, Variant};
use super::{Chart, Labels, counted};
use std::collections::BTreeSet;

/// Machines that are named one by one.
const NAMED_MACHINES: usize = 3;

/// The heading.
pub(super) fn title(chart: &Chart) -> String {
    let costs: Vec<&str> = costs(chart.settings.against).iter().map(|c| cost_word(c.key)).collect();
    let default = || format!("{} against {}", chart.settings.metric, costs.join(" and "));
    chart.settings.title.clone().unwrap_or_else(default)
}

fn cost_word(key: &str) -> &'static str {
    match key {
        NS => "time",
        BYTES => "size",
        _ => "work",
    }
}

/// What is shown, below the heading: one line a subject.
pub(super) fn subtitle(chart: &Chart) -> Vec<String> {
    let (metric, settings) = (chart.metric(), &chart.settings);
    let words = if metric.words.is_empty() { String::new() } else { format!(": {}", metric.words) };
    let level = settings.level.map_or("all levels".into(), |level| format!("level {level}"));
    let first = format!("{}{words}. Split {}, {level}.", metric.name, settings.split);
    vec![first, trained(chart)]
}

/// Resolutions, budgets, regimes and seeds; `0` is no budget and no resolution but that of nothing trained.
fn trained(chart: &Chart) -> String {
    let axes = costs(chart.settings.against);
    // What has no value on any axis is in no panel.
    let drawn = |g: &&Group| axes.iter().any(|cost| g.seeds.values().any(|v| v.contains_key(cost.key)));
    let variants: BTreeSet<&Variant> = chart.selected().filter(drawn).map(|g| &g.variant).collect();
    let texels: BTreeSet<[usize; 2]> = variants.iter().map(|v| v.resolution).collect();
    let budgets: BTreeSet<u64> = variants.iter().map(|v| v.budget).filter(|b| *b > 0).collect();
    let trained = variants.iter().filter(|v| v.budget > 0);
    let regimes: BTreeSet<&str> = trained.map(|v| v.regime.as_str()).collect();
    let mut parts = vec![
        counted(variants.len(), "variant"),
        chart.material_count(),
        format!("{} texels", list(texels.iter().map(|r| format!("{} \u{d7} {}", r[0], r[1])))),
    ];
    if !budgets.is_empty() {
        let budgets = list(budgets.iter().map(|b| grouped(*b as f64)));
        parts.push(format!("{budgets} samples a texel presented in training"));
    }
    if !regimes.is_empty() {
        parts.push(format!("training directions {}", list(regimes.iter().map(|r| r.to_string()))));
    }
    format!("{}. {}", parts.join(", "), seeds(chart))
}

fn seeds(chart: &Chart) -> String {
    let counts: BTreeSet<usize> = chart.selected().map(|g| g.seeds.len()).collect();
    match (counts.first(), counts.last()) {
        (Some(1), Some(1)) => "One seed each: no error bars.".into(),
        (Some(least), Some(most)) if least == most => {
            format!("Marks are means over {most} seeds, bars reach from the least to the most.")
        }
        (Some(least), Some(most)) => {
            format!("Marks are means over {least} to {most} seeds, bars reach from the least to the most.")
        }
        _ => String::new(),
    }
}

/// How to read it and how it was measured, at the foot.
pub(super) fn notes(chart: &Chart, panels: &[Panel]) -> Vec<String> {
    let mut reading = String::from(
        "Filled marks and the stepped line: the Pareto front, by means; nothing shown is both cheaper and better.",
    );
    if panels.iter().any(|p| p.material.is_none()) {
        let mean = panel::mean_words(&chart.metric(), chart.materials.len());
        reading += &format!(" The {mean} is of the variants that all of them have, seed by seed");
        reading += if chart.metric().higher { "; costs geometric." } else { "." };
    }
    if chart.settings.labels == Labels::Front {
        reading += " Named are the marks of the front.";
    }
    let mut out = vec![reading];
    out.extend(measured(chart));
    out
}

/// How costs were measured, for pictures and pages.
pub(super) fn measured(chart: &Chart) -> Vec<String> {
    let shown: Vec<&str> = costs(chart.settings.against).iter().map(|c| c.key).collect();
    let has = |key: &str| {
        shown.contains(&key) && chart.selected().any(|g| g.seeds.values().any(|v| v.contains_key(key)))
    };
    let mut costs = Vec::new();
    if has(NS) {
        let queries = grouped(chart.settings.timed_queries as f64);
        let engines: BTreeSet<&str> =
            chart.selected().map(|g| g.engine.as_str()).filter(|e| !e.is_empty()).collect();
        let engines = if engines.is_empty() {
            String::new()
        } else {
            format!(", answered by {}", list(engines.iter().map(|e| e.to_string())))
        };
        costs.push(format!("Times: a whole query on one thread, {queries} queries{engines}."));
    }
    if has(BYTES) {
        costs.push("Bytes: weights and textures as they are answered from.".into());
    }
    if has(FLOPS) {
        costs.push("FLOP: multiply-adds of the networks times 2, without the fetches.".to_string());
    }
    let mut out = Vec::from_iter((!costs.is_empty()).then(|| costs.join(" ")));
    let machines = &chart.machines;
    match machines.len() {
        0 => {}
        1..=NAMED_MACHINES => out.push(format!("Measured on: {}.", machines.join("; "))),
        n => out
            .push(format!("Measured on {n} machines, among them {}.", machines[..NAMED_MACHINES].join("; "))),
    }
    out
}

/// Words with commas, and how many more where there are many.
fn list(words: impl ExactSizeIterator<Item = String>) -> String {
    const MANY: usize = 6;
    let n = words.len();
    let mut words: Vec<String> = words.take(if n > MANY { MANY - 1 } else { n }).collect();
    if n > words.len() {
        words.push(format!("{} more", n - words.len()));
    }
    words.join(", ")
}
