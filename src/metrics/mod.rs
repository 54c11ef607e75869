//! Errors by name: `mse` (clamped to \[0, 1\], the headline), `mse_linear`, `mse_log1p`, `psnr` (of `mse`),
//! `ssim`, `flip`, `flicker` of sequences.

pub mod flicker;
pub mod flip;
pub mod ssim;

use serde::{Deserialize, Serialize};

/// Mean errors over pixels and channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Errors {
    /// Squared error of linear RGB, both images clamped to \[0, 1\].
    pub mse: f64,
    /// Squared error of linear RGB.
    pub mse_linear: f64,
    /// Squared error of ln(1 + max(x, 0)).
    pub mse_log1p: f64,
}

impl Errors {
    /// 10 log10(1 / `mse`) in dB; none for a perfect answer.
    pub fn psnr(&self) -> Option<f64> {
        (self.mse > 0.0).then(|| -10.0 * self.mse.log10())
    }
}

/// Sums of squared errors, pixel after pixel.
#[derive(Clone, Copy, Debug, Default)]
pub struct ErrorSum {
    values: u64,
    sums: [f64; 3],
}

impl ErrorSum {
    /// Adds pixels of an answer and of the reference.
    pub fn add(&mut self, answer: &[[f32; 3]], reference: &[[f32; 3]]) {
        for (a, r) in answer.as_flattened().iter().zip(reference.as_flattened()) {
            let (a, r) = (f64::from(*a), f64::from(*r));
            self.sums[0] += (a.clamp(0.0, 1.0) - r.clamp(0.0, 1.0)).powi(2);
            self.sums[1] += (a - r).powi(2);
            self.sums[2] += (a.max(0.0).ln_1p() - r.max(0.0).ln_1p()).powi(2);
            self.values += 1;
        }
    }

    /// Pixels added.
    pub fn pixels(&self) -> u64 {
        self.values / 3
    }

    /// The mean errors; 0 where nothing was added.
    pub fn errors(&self) -> Errors {
        let mean = |sum: f64| if self.values == 0 { 0.0 } else { sum / self.values as f64 };
        Errors { mse: mean(self.sums[0]), mse_linear: mean(self.sums[1]), mse_log1p: mean(self.sums[2]) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn definitions() {
        let mut sum = ErrorSum::default();
        sum.add(&[[1.5, 0.5, -0.5]], &[[1.0, 0.0, 0.0]]);
        let errors = sum.errors();
        assert_eq!(sum.pixels(), 1);
        assert!((errors.mse - 0.25 / 3.0).abs() < 1e-12);
        assert!((errors.mse_linear - 0.75 / 3.0).abs() < 1e-12);
        let log = ((2.5f64 / 2.0).ln().powi(2) + 1.5f64.ln().powi(2)) / 3.0;
        assert!((errors.mse_log1p - log).abs() < 1e-12);
        assert!((errors.psnr().unwrap() + 10.0 * (0.25f64 / 3.0).log10()).abs() < 1e-12);
        assert_eq!(ErrorSum::default().errors().psnr(), None);
    }
}
