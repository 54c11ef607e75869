//! What a picture shows: a panel for each material and cost, with its marks, its front and what was left out.

use super::axes::{bytes, drawable, short};
use super::family::Family;
use super::metric::{Cost, Metric, Unit, costs};
use super::points::{Group, Missing, Spread, Variant, spread};
use super::{Chart, Panels, counted, family, front};
use crate::error::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};

/// A variant in a panel.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Mark {
    pub(super) variant: Variant,
    /// Its name, with what tells it from others of the same preset.
    pub(super) label: String,
    /// Number of its family.
    pub(super) family: usize,
    /// Cost and error.
    pub(super) spreads: [Spread; 2],
    /// True on the Pareto front.
    pub(super) front: bool,
    /// All of it in words.
    pub(super) says: String,
}

/// Error against a cost on a material.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Panel {
    /// None for the mean over the materials.
    pub(super) material: Option<String>,
    pub(super) title: String,
    pub(super) cost: Cost,
    pub(super) marks: Vec<Mark>,
    /// What is not shown and why, how often each.
    pub(super) left_out: BTreeMap<String, usize>,
}

impl Chart {
    /// The groups that the settings' split, level and regime leave.
    pub(super) fn selected(&self) -> impl Iterator<Item = &Group> {
        let settings = &self.settings;
        let regime = |g: &Group| settings.regime.as_ref().is_none_or(|regime| g.variant.regime == *regime);
        let asked = |g: &Group| g.split == settings.split && g.level == settings.level;
        self.groups.iter().filter(move |g| asked(g) && regime(g))
    }

    /// The error that is shown; [`Chart::new`] has made sure that it is there.
    pub(super) fn metric(&self) -> Metric {
        let mine = self.metrics.iter().find(|m| m.name == self.settings.metric);
        mine.cloned().unwrap_or(Metric { name: self.settings.metric.clone(), words: "", higher: false })
    }

    /// All families, so that a variant looks the same in every picture of the same results.
    pub(super) fn families(&self) -> Vec<Family> {
        family::families(self.groups.iter().map(|g| g.variant.preset.as_str()))
    }
}

/// The panels of a picture, the mean first; those of a material stand together.
///
/// # Errors
/// `Usage` if nothing can be drawn.
pub(super) fn panels(chart: &Chart) -> Result<Vec<Panel>> {
    let kind = chart.settings.panels;
    let groups: Vec<&Group> = chart.selected().collect();
    let mut materials: BTreeMap<Option<String>, Vec<&Group>> = BTreeMap::new();
    for group in &groups {
        let mean = group.material.is_none();
        if (mean && kind != Panels::Materials) || (!mean && kind != Panels::Mean) {
            materials.entry(group.material.clone()).or_default().push(group);
        }
    }
    let families = chart.families();
    let mut panels = Vec::new();
    for (material, members) in materials {
        for cost in costs(chart.settings.against) {
            let mut panel = panel(chart, &material, &members, *cost, &families);
            if material.is_none() {
                let everywhere: BTreeSet<&Variant> = members.iter().map(|g| &g.variant).collect();
                let anywhere: BTreeSet<&Variant> = groups.iter().map(|g| &g.variant).collect();
                let lost = anywhere.difference(&everywhere).count();
                if lost > 0 {
                    panel.left_out.insert("not on every material with the same seeds".into(), lost);
                }
            }
            panels.push(panel);
        }
    }
    if panels.iter().all(|p| p.marks.is_empty()) {
        return Err(nothing(chart, &panels));
    }
    Ok(panels)
}

fn nothing(chart: &Chart, panels: &[Panel]) -> Error {
    let settings = &chart.settings;
    let mut why: BTreeMap<&str, usize> = BTreeMap::new();
    for (reason, n) in panels.iter().flat_map(|p| &p.left_out) {
        *why.entry(reason).or_default() += n;
    }
    let mut reasons: Vec<String> = why.into_iter().map(|(reason, n)| format!("{n} {reason}")).collect();
    if reasons.is_empty() {
        let mean = settings.panels == Panels::Mean;
        let problem =
            if mean { "no variant on two or more materials" } else { "no result of that regime and split" };
        reasons.push(problem.into());
    }
    let (split, metric) = (&settings.split, &settings.metric);
    let with = chart.groups.iter().filter(|g| g.seeds.values().any(|v| v.contains_key(metric)));
    let splits: BTreeSet<&str> = with.map(|g| g.split.as_str()).collect();
    if !splits.contains(split.as_str()) {
        let splits: Vec<&str> = splits.into_iter().collect();
        let problem = format!("no result of split {split} has it; those of {} do", splits.join(", "));
        return Error::usage(format!("--metric {metric}: {problem}"));
    }
    Error::usage(format!("--metric {metric}: nothing to draw in split {split}: {}", reasons.join(", ")))
}

fn panel(
    chart: &Chart,
    material: &Option<String>,
    groups: &[&Group],
    cost: Cost,
    families: &[Family],
) -> Panel {
    let metric = chart.metric();
    let mut left_out: BTreeMap<String, usize> = BTreeMap::new();
    let mut marks = Vec::new();
    for group in groups {
        let name = family::name(&group.variant.preset);
        let family = families.iter().position(|f| f.name == name).unwrap_or(0);
        match [(cost.key, true), (metric.name.as_str(), !metric.higher)]
            .map(|(key, log)| shown(group, key, log))
        {
            [(Ok(x), lost_x), (Ok(y), lost_y)] => {
                if lost_x + lost_y > 0 {
                    *left_out.entry("single seeds without a value".into()).or_default() += lost_x.max(lost_y);
                }
                let label = label(&group.variant, groups);
                let says = says(&label, group, &metric, cost, [x, y]);
                let variant = group.variant.clone();
                marks.push(Mark { variant, label, family, spreads: [x, y], front: false, says });
            }
            [(Err(why), _), _] | [_, (Err(why), _)] => *left_out.entry(why).or_default() += 1,
        }
    }
    let points: Vec<[f64; 2]> = marks.iter().map(|m| point(m, metric.higher)).collect();
    for (mark, on) in marks.iter_mut().zip(front::front(&points)) {
        mark.front = on;
    }
    let title = title(material, &metric, chart.materials.len());
    Panel { material: material.clone(), title, cost, marks, left_out }
}

/// A mark with less being better in both.
fn point(mark: &Mark, higher: bool) -> [f64; 2] {
    let [x, y] = mark.spreads.map(|s| s.mean);
    [x, if higher { -y } else { y }]
}

fn shown(group: &Group, key: &str, log: bool) -> (std::result::Result<Spread, String>, usize) {
    match spread(group, key, log) {
        (Ok(spread), lost) if [spread.low, spread.high].iter().all(|v| drawable(*v, log)) => {
            (Ok(spread), lost)
        }
        (Ok(_), lost) => (Err(format!("with {key} beyond the axes")), lost),
        (Err(Missing::Absent), lost) => (Err(format!("without {key}")), lost),
        (Err(Missing::NotPositive), lost) => (Err(format!("with {key} of 0 or less")), lost),
    }
}

/// What the rows of the mean are called.
pub(super) fn mean_words(metric: &Metric, materials: usize) -> String {
    let kind = if metric.higher { "mean" } else { "geometric mean" };
    format!("{kind} over {materials} materials")
}

fn title(material: &Option<String>, metric: &Metric, materials: usize) -> String {
    material.clone().unwrap_or_else(|| mean_words(metric, materials))
}

/// The preset, and what other variants of it have otherwise.
fn label(variant: &Variant, groups: &[&Group]) -> String {
    let alike = || groups.iter().map(|g| &g.variant).filter(|v| v.preset == variant.preset);
    let mut label = variant.preset.clone();
    if alike().any(|v| v.regime != variant.regime) {
        label += &format!(" \u{b7} {}", variant.regime);
    }
    if alike().any(|v| v.resolution != variant.resolution) {
        label += &format!(" \u{b7} {} \u{d7} {}", variant.resolution[0], variant.resolution[1]);
    }
    if alike().any(|v| v.budget != variant.budget) {
        label += &format!(" \u{b7} {}/texel", super::axes::grouped(variant.budget as f64));
    }
    label
}

fn says(label: &str, group: &Group, metric: &Metric, cost: Cost, [x, y]: [Spread; 2]) -> String {
    let range = |s: Spread, show: &dyn Fn(f64) -> String| match s.low < s.high {
        true => format!("{} ({} to {})", show(s.mean), show(s.low), show(s.high)),
        false => show(s.mean),
    };
    let seeds: Vec<String> = group.seeds.keys().map(u64::to_string).collect();
    let plain = |v: f64| if cost.unit == Unit::Bytes { bytes(v) } else { short(v) };
    let lost = if y.n < seeds.len() { format!(", {} with a value", y.n) } else { String::new() };
    format!(
        "{label}\n{} {}\n{} {}\n{}: {}{lost}",
        metric.name,
        range(y, &short),
        cost.key,
        range(x, &plain),
        counted(seeds.len(), "seed"),
        seeds.join(", ")
    )
}
