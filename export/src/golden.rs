//! Golden answers: queries and the RGB that every reader of a bundle has to reproduce.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Queries and answers, entry by entry, and how far an answer may be off: |difference| <= tolerance (1 +
/// |rgb|).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Golden {
    /// Largest |difference| / (1 + |rgb|).
    pub tolerance: f64,
    /// Positions.
    pub u: Vec<[f32; 2]>,
    /// Light directions.
    pub wi: Vec<[f32; 2]>,
    /// View directions.
    pub wo: Vec<[f32; 2]>,
    /// Levels.
    pub level: Vec<f32>,
    /// Answers.
    pub rgb: Vec<[f32; 3]>,
    /// \[N, H, W\] of the images that the entries are, one after another, where the decoder reads neighbours.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub images: Option<[usize; 3]>,
}

impl Golden {
    /// Checks lengths, and that every value is finite.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn validate(&self) -> Result<()> {
        if !(self.tolerance.is_finite() && self.tolerance > 0.0) {
            return Err(Error::config("golden.tolerance", format!("{} must be positive", self.tolerance)));
        }
        let n = self.u.len();
        if n == 0 {
            return Err(Error::config("golden.u", "is empty"));
        }
        if let Some([count, height, width]) = self.images
            && count.checked_mul(height).and_then(|rows| rows.checked_mul(width)) != Some(n)
        {
            let problem = format!("{count} of {height} x {width} are not the {n} entries of u");
            return Err(Error::config("golden.images", problem));
        }
        check("u", &self.u, n)?;
        check("wi", &self.wi, n)?;
        check("wo", &self.wo, n)?;
        check("level", self.level.as_chunks::<1>().0, n)?;
        check("rgb", &self.rgb, n)
    }
}

/// What a sampler gives: queries, samples and densities, entry by entry. A reader is right if every component of its wi is
/// within `tolerance` of the one here, and its density of the wi here within `pdf_tolerance` times the one here.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SamplerGolden {
    /// Largest difference of a component of wi.
    pub tolerance: f64,
    /// Largest difference of a density, relative to it.
    pub pdf_tolerance: f64,
    /// Positions, some far outside \[0, 1).
    pub u: Vec<[f32; 2]>,
    /// View directions above the horizon, some grazing.
    pub wo: Vec<[f32; 2]>,
    /// Levels, some below 0 or beyond the last.
    pub level: Vec<f32>,
    /// Two uniform numbers, some 0 or the last below 1.
    pub xi: Vec<[f32; 2]>,
    /// The sampled directions to the light: unit vectors.
    pub wi: Vec<[f32; 3]>,
    /// Their densities over solid angle.
    pub pdf: Vec<f32>,
}

impl SamplerGolden {
    /// Checks lengths, and that every value is finite.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn validate(&self) -> Result<()> {
        if !(self.tolerance.is_finite() && self.tolerance > 0.0) {
            return Err(Error::config("golden.tolerance", format!("{} must be positive", self.tolerance)));
        }
        if !(self.pdf_tolerance.is_finite() && self.pdf_tolerance > 0.0) {
            let problem = format!("{} must be positive", self.pdf_tolerance);
            return Err(Error::config("golden.pdf_tolerance", problem));
        }
        let n = self.u.len();
        if n == 0 {
            return Err(Error::config("golden.u", "is empty"));
        }
        check("u", &self.u, n)?;
        check("wo", &self.wo, n)?;
        check("level", self.level.as_chunks::<1>().0, n)?;
        check("xi", &self.xi, n)?;
        check("wi", &self.wi, n)?;
        check("pdf", self.pdf.as_chunks::<1>().0, n)
    }
}

fn check<const C: usize>(field: &str, rows: &[[f32; C]], n: usize) -> Result<()> {
    if rows.len() != n {
        return Err(Error::config(
            format!("golden.{field}"),
            format!("has {} entries where u has {n}", rows.len()),
        ));
    }
    match rows.iter().position(|row| row.iter().any(|v| !v.is_finite())) {
        Some(i) => Err(Error::config(format!("golden.{field}[{i}]"), "is not finite")),
        None => Ok(()),
    }
}
