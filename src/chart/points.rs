//! From cells to variants with their values by seed, and the spread of a value over seeds.

use super::metric::{self, BYTES, FLOPS, NS};
use crate::results::Cell;
use std::collections::{BTreeMap, BTreeSet};

/// What was trained, but for the material and the seed.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Variant {
    /// Preset or label.
    pub(super) preset: String,
    /// Directions of the training data.
    pub(super) regime: String,
    /// \[height, width\].
    pub(super) resolution: [usize; 2],
    /// Samples presented, a texel.
    pub(super) budget: u64,
}

/// Errors and costs by name, all finite.
pub(super) type Values = BTreeMap<String, f64>;

/// A variant on a material, asked about one split at one level.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Group {
    /// None for the mean over all materials, which sorts first.
    pub(super) material: Option<String>,
    /// What was trained.
    pub(super) variant: Variant,
    /// Split; `views` for the mean of all `views/NAME`.
    pub(super) split: String,
    /// None for all of the split.
    pub(super) level: Option<usize>,
    /// What answered.
    pub(super) engine: String,
    /// By seed.
    pub(super) seeds: BTreeMap<u64, Values>,
}

/// Material, beginning of the splits' names, level.
type Family<'a> = (&'a Option<String>, &'a str, Option<usize>);
type Key = (Option<String>, Variant, String, Option<usize>);

impl Group {
    fn key(&self) -> Key {
        (self.material.clone(), self.variant.clone(), self.split.clone(), self.level)
    }
}

/// The groups of all cells, with those of whole families of splits and of the mean over the materials, in order.
pub(super) fn groups(cells: &[&Cell]) -> Vec<Group> {
    let mut all: BTreeMap<Key, Group> = BTreeMap::new();
    for cell in cells {
        let group = Group {
            material: Some(cell.material.clone()),
            variant: Variant {
                preset: cell.preset.clone(),
                regime: cell.regime.clone(),
                resolution: cell.resolution,
                budget: cell.samples_per_texel.round() as u64,
            },
            split: cell.split.clone(),
            level: cell.level,
            engine: cell.engine.clone(),
            seeds: BTreeMap::new(),
        };
        all.entry(group.key()).or_insert(group).seeds.insert(cell.seed, values(cell));
    }
    // What was measured itself is not replaced. The families have means of their own.
    for derive in [families_of_splits, means_over_materials] {
        for group in derive(&all) {
            all.entry(group.key()).or_insert(group);
        }
    }
    all.into_values().collect()
}

fn values(cell: &Cell) -> Values {
    // By way of JSON, so that an error which the results gain is shown without a change here.
    let metrics = serde_json::to_value(cell.metrics).unwrap_or_default();
    let named = metrics.as_object().into_iter().flatten();
    let mut values: Values =
        named.filter_map(|(name, value)| Some((name.clone(), value.as_f64()?))).collect();
    values.extend(cell.ns_per_query.filter(|v| v.is_finite()).map(|v| (NS.to_string(), v)));
    values.insert(BYTES.into(), cell.bytes as f64);
    values.insert(FLOPS.into(), cell.flops as f64);
    values
}

/// `views` from all `views/NAME`, for the variants that were asked about every one of them.
fn families_of_splits(all: &BTreeMap<Key, Group>) -> Vec<Group> {
    let mut names: BTreeMap<Family, BTreeSet<&str>> = BTreeMap::new();
    let mut parts: BTreeMap<(Family, &Variant), Vec<&Group>> = BTreeMap::new();
    for group in all.values() {
        if let Some((family, name)) = group.split.split_once('/') {
            let family = (&group.material, family, group.level);
            names.entry(family).or_default().insert(name);
            parts.entry((family, &group.variant)).or_default().push(group);
        }
    }
    let whole = |((family, _), parts): ((Family, _), Vec<&Group>)| {
        let wanted = names.get(&family).map_or(0, BTreeSet::len);
        let mean = |_: &str, values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let group = (parts.len() == wanted).then(|| combined(&parts, mean)).flatten()?;
        Some(Group { split: family.1.to_string(), ..group })
    };
    parts.into_iter().filter_map(whole).collect()
}

/// The mean over the materials, geometric for errors and costs, for the variants that all materials of their split and
/// level have.
fn means_over_materials(all: &BTreeMap<Key, Group>) -> Vec<Group> {
    let mut materials: BTreeMap<(&str, Option<usize>), BTreeSet<&Option<String>>> = BTreeMap::new();
    let mut parts: BTreeMap<(&Variant, &str, Option<usize>), Vec<&Group>> = BTreeMap::new();
    for group in all.values().filter(|g| g.material.is_some()) {
        materials.entry((&group.split, group.level)).or_default().insert(&group.material);
        parts.entry((&group.variant, &group.split, group.level)).or_default().push(group);
    }
    let mean = |name: &str, values: &[f64]| {
        let n = values.len() as f64;
        match metric::higher_is_better(name) {
            true => values.iter().sum::<f64>() / n,
            // Not finite where a value has no logarithm: such a mean is left out.
            false => (values.iter().map(|v| v.ln()).sum::<f64>() / n).exp(),
        }
    };
    let whole = |((_, split, level), parts): ((&Variant, &str, Option<usize>), Vec<&Group>)| {
        let wanted = materials.get(&(split, level)).map_or(0, BTreeSet::len);
        let group = (wanted > 1 && parts.len() == wanted).then(|| combined(&parts, mean)).flatten()?;
        Some(Group { material: None, ..group })
    };
    parts.into_iter().filter_map(whole).collect()
}

/// One group from several by the seeds and values that all of them have; none without a common seed. A value that does
/// not come out finite is left out.
fn combined(parts: &[&Group], mean: impl Fn(&str, &[f64]) -> f64) -> Option<Group> {
    let first = *parts.first()?;
    let mut seeds = BTreeMap::new();
    for (seed, values) in &first.seeds {
        let Some(others) = parts.iter().map(|p| p.seeds.get(seed)).collect::<Option<Vec<_>>>() else {
            continue;
        };
        let value = |name: &String| {
            let values = others.iter().map(|v| v.get(name).copied()).collect::<Option<Vec<f64>>>()?;
            Some(mean(name, &values)).filter(|v| v.is_finite()).map(|v| (name.clone(), v))
        };
        seeds.insert(*seed, values.keys().filter_map(value).collect::<Values>());
    }
    (!seeds.is_empty()).then(|| Group { seeds, ..first.clone() })
}

/// A value over seeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Spread {
    /// Arithmetic mean.
    pub(super) mean: f64,
    /// Least.
    pub(super) low: f64,
    /// Most.
    pub(super) high: f64,
    /// Seeds.
    pub(super) n: usize,
}

/// Why a mark is left out, or a seed of one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Missing {
    /// There is no such value.
    Absent,
    /// It is zero or below, where an axis is a logarithm.
    NotPositive,
}

/// The spread of the values of that name which an axis can show, and how many seeds were left out of it.
pub(super) fn spread(group: &Group, name: &str, log: bool) -> (Result<Spread, Missing>, usize) {
    let present: Vec<f64> = group.seeds.values().filter_map(|v| v.get(name).copied()).collect();
    let shown: Vec<f64> = present.iter().copied().filter(|v| !log || *v > 0.0).collect();
    let lost = group.seeds.len() - shown.len();
    if shown.is_empty() {
        let why = if present.is_empty() { Missing::Absent } else { Missing::NotPositive };
        return (Err(why), lost);
    }
    let mean = shown.iter().sum::<f64>() / shown.len() as f64;
    let low = shown.iter().copied().fold(f64::INFINITY, f64::min);
    let high = shown.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    // The sum of equal values may round away from them.
    (Ok(Spread { mean: mean.clamp(low, high), low, high, n: shown.len() }), lost)
}
