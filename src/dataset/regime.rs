//! How directions of the training data are spent.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::{fmt, str::FromStr};

/// Directions of the training data.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Regime {
    /// A pair of directions a patch, positions and levels between the texels' too.
    Scattered,
    /// This many pairs, a full aligned image each, at every level; 0 stands for as many as the samples pay for.
    Slices(usize),
}

impl fmt::Display for Regime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scattered => f.write_str("scattered"),
            Self::Slices(0) => f.write_str("slices"),
            Self::Slices(pairs) => write!(f, "slices-{pairs}"),
        }
    }
}

impl FromStr for Regime {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let counted = || text.strip_prefix("slices-")?.parse().ok().filter(|pairs| *pairs > 0);
        match text {
            "scattered" => Ok(Self::Scattered),
            "slices" => Ok(Self::Slices(0)),
            _ => counted().map(Self::Slices).ok_or_else(|| {
                let problem = format!("{text} is none of scattered, slices and slices-N with N above 0");
                Error::config("regime", problem)
            }),
        }
    }
}

impl TryFrom<String> for Regime {
    type Error = Error;

    fn try_from(text: String) -> Result<Self> {
        text.parse()
    }
}

impl From<Regime> for String {
    fn from(regime: Regime) -> Self {
        regime.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_come_back() {
        for regime in [Regime::Scattered, Regime::Slices(0), Regime::Slices(77)] {
            assert_eq!(regime.to_string().parse::<Regime>().unwrap(), regime);
        }
        for wrong in ["slices-", "slices-0", "slices--1", "scatter"] {
            assert!(wrong.parse::<Regime>().unwrap_err().to_string().contains(wrong));
        }
    }
}
