//! What a check found: a figure, its verdict, and what to do about it.

use crate::error::{Error, Result};
use serde::Serialize;
use std::collections::BTreeMap;

/// What a figure means for whoever ships the material.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Nothing to do.
    Fine,
    /// Look at it: it may show.
    Watch,
    /// It will show.
    Wrong,
}

impl Verdict {
    /// Its word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Fine => "fine",
            Self::Watch => "watch",
            Self::Wrong => "wrong",
        }
    }
}

/// From where on a figure is to be watched, and from where on it is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bounds {
    /// Largest figure that is fine.
    pub watch: f64,
    /// Largest figure that is not wrong; none where the check is a hint that cannot tell a fault from a feature.
    pub wrong: Option<f64>,
    /// Why these.
    pub reason: &'static str,
}

impl Bounds {
    /// The verdict on a figure; what is no number is wrong.
    pub fn verdict(&self, figure: f64) -> Verdict {
        match self.wrong {
            _ if figure.is_nan() => Verdict::Wrong,
            Some(wrong) if figure > wrong => Verdict::Wrong,
            _ if figure > self.watch => Verdict::Watch,
            _ => Verdict::Fine,
        }
    }
}

/// A query, and what was seen there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Place {
    /// Position.
    pub u: [f32; 2],
    /// Light direction.
    pub wi: [f32; 2],
    /// View direction.
    pub wo: [f32; 2],
    /// Level.
    pub level: f32,
    /// What is wrong there, in the unit of the check; none where it is no number.
    pub value: Option<f64>,
}

/// What a check saw, before its bounds judge it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seen {
    /// The figure.
    pub figure: f64,
    /// The figure in a plain sentence.
    pub says: String,
    /// What to change where it is not fine.
    pub change: String,
    /// Other figures by name.
    pub values: BTreeMap<String, f64>,
    /// The worst places, worst first.
    pub places: Vec<Place>,
    /// A caption and a PNG file.
    pub picture: Option<(String, Vec<u8>)>,
    /// Why there is nothing to judge, if so.
    pub left_out: Option<&'static str>,
}

impl Seen {
    /// Where there is nothing to judge, and why.
    pub fn left_out(why: &'static str) -> Self {
        Self { left_out: Some(why), ..Self::default() }
    }

    /// Where there is nothing to compare.
    pub fn nothing() -> Self {
        Self::left_out("the tile is too small to say")
    }
}

/// A judged figure.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// The check's name.
    pub name: &'static str,
    /// What is measured.
    pub measures: &'static str,
    /// The figure; none if it is no number.
    pub figure: Option<f64>,
    /// What judged it.
    pub bounds: Bounds,
    /// What it means.
    pub verdict: Verdict,
    /// In plain words.
    pub says: String,
    /// What to change; none where it is fine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub change: Option<String>,
    /// Other figures by name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub values: BTreeMap<String, f64>,
    /// The worst places, worst first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<Place>,
    /// What the picture shows, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub caption: Option<String>,
    /// The picture as a PNG file.
    #[serde(skip)]
    pub picture: Option<Vec<u8>>,
}

impl Finding {
    /// Judges what a check saw; a check that met an error found a fault.
    ///
    /// # Errors
    /// `Interrupted`.
    pub fn new(
        name: &'static str,
        measures: &'static str,
        bounds: Bounds,
        seen: Result<Seen>,
    ) -> Result<Self> {
        let seen = match seen {
            Err(stop @ Error::Interrupted(_)) => return Err(stop),
            Err(problem) => Seen {
                figure: f64::NAN,
                says: format!("it could not be measured: {problem}"),
                change: "mend what the error names".into(),
                ..Seen::default()
            },
            Ok(seen) => seen,
        };
        let verdict = bounds.verdict(seen.figure);
        let (caption, picture) = seen.picture.unzip();
        Ok(Self {
            name,
            measures,
            figure: Some(seen.figure).filter(|v| v.is_finite()),
            bounds,
            verdict,
            says: seen.says,
            change: Some(seen.change).filter(|_| verdict != Verdict::Fine),
            values: seen.values.into_iter().filter(|(_, value)| value.is_finite()).collect(),
            places: seen.places,
            caption,
            picture,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: Bounds = Bounds { watch: 1.0, wrong: Some(2.0), reason: "" };

    #[test]
    fn figures_are_judged() {
        let verdicts = [0.0, 1.0, 1.1, 2.0, 2.1, f64::INFINITY, f64::NAN].map(|v| BOUNDS.verdict(v));
        use Verdict::{Fine, Watch, Wrong};
        assert_eq!(verdicts, [Fine, Fine, Watch, Watch, Wrong, Wrong, Wrong]);
        let hint = Bounds { wrong: None, ..BOUNDS };
        assert_eq!([1e9, f64::NAN].map(|v| hint.verdict(v)), [Watch, Wrong]);
    }

    #[test]
    fn an_error_is_a_fault_and_an_interrupt_is_none() {
        let failed = Finding::new("a", "b", BOUNDS, Err(Error::config("texture", "is missing"))).unwrap();
        assert_eq!((failed.verdict, failed.figure), (Verdict::Wrong, None));
        assert!(failed.says.contains("texture"), "{}", failed.says);
        assert!(Finding::new("a", "b", BOUNDS, Err(Error::Interrupted(String::new()))).is_err());
        let fine = Seen { figure: 0.5, change: "all".into(), ..Seen::default() };
        let fine = Finding::new("a", "b", BOUNDS, Ok(fine)).unwrap();
        assert_eq!((fine.verdict, fine.change), (Verdict::Fine, None));
    }
}
