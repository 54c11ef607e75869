//! What a fit is to reach.

use crate::error::{Error, Result};
use crate::render::compare::Comparison;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// How much more than the full model's error counts as the same: what the paper's tables round away.
pub const SAME: f64 = 1.05;

/// An error of pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Metric {
    /// FLIP, the mean over the pictures.
    Flip,
    /// Squared error of linear RGB, both clamped to \[0, 1\].
    Mse,
}

impl Metric {
    /// Of a comparison; FLIP of pictures that are too small for it is unknown.
    ///
    /// # Errors
    /// `Usage` where it is unknown.
    pub fn of(self, comparison: &Comparison) -> Result<f64> {
        match self {
            Self::Mse => Ok(comparison.mse),
            Self::Flip => comparison.flip.ok_or_else(|| {
                Error::usage(
                    "--target flip: FLIP needs pictures of 8 x 8 pixels; use mse, or a larger camera.width",
                )
            }),
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Flip => "flip",
            Self::Mse => "mse",
        }
    }
}

/// The most that an error may be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Of what.
    pub metric: Metric,
    /// The bound; none: as the full model's, within [`SAME`].
    pub most: Option<f64>,
}

impl FromStr for Target {
    type Err = String;

    /// From `flip=0.02`, `mse=1e-3`, `flip=full`.
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (name, value) = text.split_once('=').ok_or("write flip=0.02, mse=1e-3 or flip=full")?;
        let metric = match name {
            "flip" => Metric::Flip,
            "mse" => Metric::Mse,
            other => return Err(format!("{other} is no error of pictures; flip and mse are")),
        };
        if value == "full" {
            return Ok(Self { metric, most: None });
        }
        let most: f64 = value.parse().map_err(|_| format!("{value} is no number, nor full"))?;
        if !(most > 0.0 && most.is_finite()) {
            return Err(format!("{value} is not above 0"));
        }
        Ok(Self { metric, most: Some(most) })
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self.most {
            Some(most) => write!(f, "{}={most}", self.metric.name()),
            None => write!(f, "{}=full", self.metric.name()),
        }
    }
}

/// What is to be saved first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Prefer {
    /// Both: a factor of time counts as much as two of bytes, since a material shares memory with everything else, and time with
    /// nothing.
    #[default]
    Both,
    /// Time, and bytes only where they cost none.
    Time,
    /// Bytes, and time only where it costs none.
    Bytes,
}

impl Prefer {
    /// How much a factor of bytes counts beside one of nanoseconds.
    pub fn bytes(self) -> f64 {
        match self {
            Self::Both => 0.5,
            Self::Time => 0.05,
            Self::Bytes => 10.0,
        }
    }
}

/// Bounds of a fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Goal {
    /// Where it is given, the smallest model that holds it is wanted; else the best one.
    pub target: Option<Target>,
    /// Most nanoseconds a query, as the chart's machine takes them.
    pub ns: Option<f64>,
    /// Most bytes in half precision.
    pub bytes: Option<usize>,
    /// What is to be saved first.
    pub prefer: Prefer,
}

impl Goal {
    /// The best model, whatever it costs.
    pub const FREE: Self = Self { target: None, ns: None, bytes: None, prefer: Prefer::Both };
}

impl Goal {
    /// The error that counts.
    pub fn metric(&self) -> Metric {
        self.target.map_or(Metric::Flip, |target| target.metric)
    }

    /// The bound of the error; None where the best model is wanted.
    pub fn bound(&self, full: f64) -> Option<f64> {
        self.target.map(|target| target.most.unwrap_or(SAME * full))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_are_read_and_refused() {
        let read = |text: &str| text.parse::<Target>();
        assert_eq!(read("flip=0.02").unwrap(), Target { metric: Metric::Flip, most: Some(0.02) });
        assert_eq!(read("mse=full").unwrap().to_string(), "mse=full");
        for wrong in ["flip", "psnr=30", "flip=-1", "flip=nan", "mse=much"] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
        let goal = Goal { target: Some(read("flip=full").unwrap()), ..Goal::FREE };
        assert!((goal.bound(0.2).unwrap() - 0.21).abs() < 1e-12);
    }
}
