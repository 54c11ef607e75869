//! What a probe is and what it finds.

use super::workshop::{Scale, Workshop};
use crate::error::Result;
use crate::report::figures::Series;
use serde::{Deserialize, Serialize};

/// A number that may be none: not a number and infinities are the worst outcome, not an error of the report.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Figure(Option<f64>);

impl Figure {
    /// The figure; none if it is not finite.
    pub fn new(value: f64) -> Self {
        Self(Some(value).filter(|v| v.is_finite()))
    }

    /// Its value.
    pub fn value(self) -> Option<f64> {
        self.0
    }

    /// True if it is a number of at most `most`.
    pub fn holds(self, most: f64) -> bool {
        self.0.is_some_and(|value| value <= most)
    }
}

impl From<f64> for Figure {
    fn from(value: f64) -> Self {
        Self::new(value)
    }
}

/// What part of the method a probe is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Group {
    /// Losses, optimiser, data.
    Training,
    /// u.
    Position,
    /// Footprints.
    Level,
    /// wi and wo.
    Direction,
    /// Sequences of pictures.
    Motion,
    /// Precision, instruction sets, engines.
    Numbers,
    /// The Inception decoder.
    Inception,
}

/// The largest figure that is right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bound {
    /// It.
    pub most: f64,
    /// Why this one.
    pub reason: &'static str,
    /// Of the quick suite, where its short trainings cannot do as well.
    pub quick: Option<f64>,
}

impl Bound {
    /// A bound at every scale.
    pub const fn new(most: f64, reason: &'static str) -> Self {
        Self { most, reason, quick: None }
    }

    /// The bound at a scale.
    pub fn at(self, scale: &Scale) -> f64 {
        if scale.is_quick() { self.quick.unwrap_or(self.most) } else { self.most }
    }
}

/// One known failure.
#[derive(Clone, Copy)]
pub struct Probe {
    /// Its name on the command line: words with dashes.
    pub name: &'static str,
    /// Where it belongs.
    pub group: Group,
    /// What it provokes and what goes wrong.
    pub provokes: &'static str,
    /// The variant that fails.
    pub naive: &'static str,
    /// The variant that does not.
    pub cured: &'static str,
    /// What is measured; less is better, and 0 or 1 is perfect.
    pub figure: &'static str,
    /// What the figure may be.
    pub bound: Bound,
    /// Measures both variants.
    pub run: fn(&mut Workshop) -> Result<Outcome>,
}

/// Error against the perturbation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plot {
    /// What is varied.
    pub x: String,
    /// What it does.
    pub y: String,
    /// A line a variant.
    pub series: Vec<Series>,
}

/// What a probe found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    /// The naive variant's figure.
    pub naive: f64,
    /// The cured variant's figure.
    pub cured: f64,
    /// Where the naive variant holds the bound: why the method is safer than believed.
    pub safe: Option<String>,
    /// What else was seen, a line each.
    pub notes: Vec<String>,
    /// Figures that are kept beside the two, by name.
    pub values: Vec<(String, f64)>,
    /// The curve.
    pub plot: Option<Plot>,
    /// A picture (PNG) and what it shows.
    pub picture: Option<(String, Vec<u8>)>,
}

impl Outcome {
    /// An outcome of two figures.
    pub fn new(naive: f64, cured: f64) -> Self {
        Self { naive, cured, ..Self::default() }
    }
}

/// What the two figures mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// The naive variant fails, the cured one does not.
    Cured,
    /// Neither fails, and the probe says why.
    Safe,
    /// The cured variant breaks the bound.
    Broken,
    /// The naive variant holds the bound and the probe does not say why: it shows nothing.
    Idle,
}

impl Verdict {
    /// What two figures mean under a bound.
    pub fn of(naive: Figure, cured: Figure, most: f64, explained: bool) -> Self {
        match (cured.holds(most), naive.holds(most)) {
            (false, _) => Self::Broken,
            (true, false) => Self::Cured,
            (true, true) if explained => Self::Safe,
            (true, true) => Self::Idle,
        }
    }

    /// True if nothing is wrong.
    pub fn is_right(self) -> bool {
        matches!(self, Self::Cured | Self::Safe)
    }

    /// In a word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Cured => "cured",
            Self::Safe => "safe",
            Self::Broken => "BROKEN",
            Self::Idle => "IDLE",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn verdicts_follow_the_bound() {
        let of = |naive: f64, cured: f64, explained| Verdict::of(naive.into(), cured.into(), 1.0, explained);
        assert_eq!(of(2.0, 1.0, false), Verdict::Cured);
        assert_eq!(of(f64::NAN, 0.0, false), Verdict::Cured);
        assert_eq!(of(2.0, 1.1, true), Verdict::Broken);
        assert_eq!(of(2.0, f64::INFINITY, true), Verdict::Broken);
        assert_eq!(of(0.5, 0.5, true), Verdict::Safe);
        assert_eq!(of(0.5, 0.5, false), Verdict::Idle);
        assert!(!Verdict::Idle.is_right() && !Verdict::Broken.is_right() && Verdict::Safe.is_right());
    }
}
