//! The interactive page: one file with the numbers as JSON, drawn by `page.js`.

use super::family;
use super::metric::{COSTS, Metric, Unit};
use super::panel::{mean_words, panels};
use super::points::{Group, Variant};
use super::scene::escaped;
use super::{Chart, Settings, caption};
use crate::error::{Error, Result};
use crate::report::{filled, inert};
use serde::Serialize;
use std::collections::BTreeMap;

/// Digits that a value keeps: more than a mark's place or a table shows.
const DIGITS: usize = 6;

#[derive(Serialize)]
struct Page<'a> {
    metrics: Vec<PageMetric<'a>>,
    costs: Vec<PageCost>,
    materials: &'a [String],
    families: Vec<PageFamily>,
    variants: Vec<PageVariant<'a>>,
    groups: Vec<PageGroup<'a>>,
    start: Start<'a>,
}

#[derive(Serialize)]
struct PageMetric<'a> {
    name: &'a str,
    words: &'a str,
    higher: bool,
    mean: String,
}

#[derive(Serialize)]
struct PageCost {
    key: &'static str,
    words: &'static str,
    bytes: bool,
}

#[derive(Serialize)]
struct PageFamily {
    name: String,
    /// None for ink.
    colour: Option<String>,
    /// Corners at radius 1.
    outline: Vec<[f64; 2]>,
}

#[derive(Serialize)]
struct PageVariant<'a> {
    preset: &'a str,
    regime: &'a str,
    resolution: [usize; 2],
    budget: u64,
    family: usize,
}

#[derive(Serialize)]
struct PageGroup<'a> {
    /// Number of the material; none for the mean.
    material: Option<usize>,
    variant: usize,
    split: &'a str,
    level: Option<usize>,
    engine: &'a str,
    /// As texts: a browser's numbers do not hold all of them.
    seeds: Vec<String>,
    /// By name, a value a seed.
    values: BTreeMap<&'a str, Vec<Option<f64>>>,
}

/// What is shown first.
#[derive(Serialize)]
struct Start<'a> {
    metric: &'a str,
    cost: &'a str,
    split: &'a str,
    level: Option<usize>,
    regime: Option<&'a str>,
}

/// The page.
///
/// # Errors
/// As [`panels`].
pub(super) fn html(chart: &Chart) -> Result<String> {
    // What the settings select has to be there, as for a picture.
    let drawn = panels(chart)?;
    let cost = drawn.iter().find(|p| !p.marks.is_empty()).map_or("ns", |p| p.cost.key);
    let data = serde_json::to_string(&page(chart, cost)).map_err(|e| Error::config("chart", e))?;
    let title = escaped(&caption::title(chart));
    let notes: String =
        caption::measured(chart).iter().map(|line| format!("<p>{}</p>\n", escaped(line))).collect();
    let (style, script, data) = (include_str!("page.css"), include_str!("page.js"), inert(&data));
    let body = include_str!("page.html");
    let generator = escaped(&chart.generator);
    let parts = [
        ("TITLE", title.as_str()),
        ("STYLE", style),
        ("NOTES", &notes),
        ("GENERATOR", &generator),
        ("DATA", &data),
        ("SCRIPT", script),
    ];
    Ok(filled(body, &parts))
}

fn page<'a>(chart: &'a Chart, cost: &'a str) -> Page<'a> {
    let families = chart.families();
    let mut variants: Vec<&Variant> = chart.groups.iter().map(|g| &g.variant).collect();
    variants.sort();
    variants.dedup();
    let metric = |m: &'a Metric| PageMetric {
        name: &m.name,
        words: m.words,
        higher: m.higher,
        mean: mean_words(m, chart.materials.len()),
    };
    let variant = |v: &&'a Variant| PageVariant {
        preset: &v.preset,
        regime: &v.regime,
        resolution: v.resolution,
        budget: v.budget,
        family: families.iter().position(|f| f.name == family::name(&v.preset)).unwrap_or(0),
    };
    let Settings { metric: first, split, level, regime, .. } = &chart.settings;
    Page {
        metrics: chart.metrics.iter().map(metric).collect(),
        costs: COSTS
            .iter()
            .map(|c| PageCost { key: c.key, words: c.words, bytes: c.unit == Unit::Bytes })
            .collect(),
        materials: &chart.materials,
        groups: chart.groups.iter().map(|g| page_group(g, &variants, &chart.materials)).collect(),
        variants: variants.iter().map(variant).collect(),
        families: families
            .into_iter()
            .map(|f| PageFamily {
                name: f.name,
                colour: f.colour.map(|c| format!("#{:02x}{:02x}{:02x}", c[0], c[1], c[2])),
                outline: f
                    .shape
                    .outline(1.0)
                    .into_iter()
                    .map(|p| p.map(|v| (v * 1e3).round() / 1e3))
                    .collect(),
            })
            .collect(),
        start: Start { metric: first, cost, split, level: *level, regime: regime.as_deref() },
    }
}

fn page_group<'a>(group: &'a Group, variants: &[&Variant], materials: &[String]) -> PageGroup<'a> {
    let material = group.material.as_ref().and_then(|m| materials.binary_search(m).ok());
    let names = group.seeds.values().flat_map(|v| v.keys().map(String::as_str));
    let values = |name: &'a str| -> Vec<Option<f64>> {
        group.seeds.values().map(|v| v.get(name).map(|value| rounded(*value))).collect()
    };
    PageGroup {
        material,
        variant: variants.binary_search(&&group.variant).unwrap_or(0),
        split: &group.split,
        level: group.level,
        engine: &group.engine,
        seeds: group.seeds.keys().map(u64::to_string).collect(),
        values: names.map(|name| (name, values(name))).collect(),
    }
}

fn rounded(value: f64) -> f64 {
    format!("{value:.*e}", DIGITS - 1).parse().unwrap_or(value)
}
