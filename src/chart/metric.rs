//! What the axes can show: errors by their names in the results, and costs.

use super::Against;
use super::points::Group;
use std::collections::BTreeSet;

/// Names of the costs among the values of a group.
pub(super) const NS: &str = "ns";
/// See [`NS`].
pub(super) const BYTES: &str = "bytes";
/// See [`NS`].
pub(super) const FLOPS: &str = "flops";

/// Errors with what they mean; others are shown under their names alone.
const KNOWN: [(&str, &str); 8] = [
    ("mse", "squared error of linear RGB clamped to [0, 1]"),
    ("mse_linear", "squared error of linear RGB"),
    ("mse_log1p", "squared error of ln(1 + x) of linear RGB"),
    ("psnr", "of mse, dB, higher is better"),
    ("ssim", "structural similarity, higher is better"),
    ("flip", "FLIP"),
    ("lpips", "LPIPS"),
    ("flicker", "error of the frame difference over the energy of the true one"),
];

/// An error.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Metric {
    /// As the results name it.
    pub(super) name: String,
    /// What it means; may be empty.
    pub(super) words: &'static str,
    /// True where more is better: such a scale is bounded or a logarithm already, and its axis is linear.
    pub(super) higher: bool,
}

/// True for the values whose mean is arithmetic and whose axis is linear.
pub(super) fn higher_is_better(name: &str) -> bool {
    matches!(name, "psnr" | "ssim")
}

/// The errors that any group has, known ones first.
pub(super) fn of(groups: &[Group]) -> Vec<Metric> {
    let names: BTreeSet<&str> =
        groups.iter().flat_map(|g| g.seeds.values()).flat_map(|v| v.keys().map(String::as_str)).collect();
    let known = |name: &str| KNOWN.iter().position(|(known, _)| *known == name);
    let mut names: Vec<&str> = names.into_iter().filter(|n| ![NS, BYTES, FLOPS].contains(n)).collect();
    names.sort_by_key(|name| known(name).unwrap_or(KNOWN.len()));
    let metric = |name: &str| Metric {
        name: name.into(),
        words: known(name).map_or("", |at| KNOWN[at].1),
        higher: higher_is_better(name),
    };
    names.into_iter().map(metric).collect()
}

/// How the numbers of an axis are written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Unit {
    /// As they are.
    Plain,
    /// With B, kB, MB.
    Bytes,
}

/// A cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cost {
    /// Among the values of a group.
    pub(super) key: &'static str,
    /// Beside the axis.
    pub(super) words: &'static str,
    /// Of its numbers.
    pub(super) unit: Unit,
}

/// All costs, in the order in which a page offers them.
pub(super) const COSTS: [Cost; 3] = [
    Cost { key: NS, words: "ns a query, one thread", unit: Unit::Plain },
    Cost { key: BYTES, words: "bytes of weights and textures", unit: Unit::Bytes },
    Cost { key: FLOPS, words: "FLOP a query in the networks", unit: Unit::Plain },
];

/// The costs that a picture has beside each other.
pub(super) fn costs(against: Against) -> &'static [Cost] {
    match against {
        Against::Ns => &COSTS[..1],
        Against::Bytes => &COSTS[1..2],
        Against::Flops => &COSTS[2..],
        Against::Both => &COSTS[..2],
    }
}
