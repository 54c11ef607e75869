//! A row of pictures, what is said of them in numbers, and how they are shown.

use super::picture;
use crate::error::{Error, Result};
use crate::metrics::{ErrorSum, Errors};
use crate::query::RgbImage;
use serde::Serialize;

/// Pictures are brightened by at most this: beyond, noise is what one sees.
const MAX_STOPS: f32 = 4.0;
/// Share of the values that the exposure and the scale of the differences hold; the few beyond saturate.
const KEPT: f64 = 0.99;
/// Scale of the differences where all answers are exact.
const LEAST_MAXIMUM: f32 = 1e-3;

/// One pair of directions at one level: the reference and the answers to the same queries.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Panel {
    /// What is shown.
    pub title: String,
    /// More about it.
    pub caption: String,
    /// Ground truth.
    pub reference: RgbImage,
    /// Model and answer, of the reference's shape.
    pub answers: Vec<(String, RgbImage)>,
}

impl Panel {
    /// Refuses what cannot be shown.
    ///
    /// # Errors
    /// `Config` if an image has no pixels or not the reference's shape.
    pub fn checked(&self) -> Result<()> {
        picture::shape(&self.reference)?;
        for (model, answer) in &self.answers {
            let same = picture::shape(answer)? == picture::shape(&self.reference)?;
            if !same {
                return Err(Error::config(model, "the answer has not the reference's shape"));
            }
        }
        Ok(())
    }

    /// Errors of each answer, in order.
    pub fn errors(&self) -> Vec<Errors> {
        let of = |answer: &RgbImage| {
            let mut sum = ErrorSum::default();
            sum.add(&answer.pixels, &self.reference.pixels);
            sum.errors()
        };
        self.answers.iter().map(|(_, answer)| of(answer)).collect()
    }

    /// Whole stops by which the pictures are brightened so that nearly all of the reference still fits.
    pub(super) fn exposure(&self) -> f32 {
        let bright = quantile(self.reference.pixels.as_flattened().iter().copied());
        if bright > 0.0 { (-bright.log2()).floor().clamp(0.0, MAX_STOPS) } else { 0.0 }
    }

    /// The difference at which colours saturate, the same for all answers: 1, 2 or 5 times a power of ten.
    pub(super) fn maximum(&self) -> f64 {
        let differences = self.answers.iter().flat_map(|(_, answer)| {
            answer.pixels.iter().zip(&self.reference.pixels).map(|(a, r)| picture::distance(*a, *r))
        });
        let value = f64::from(quantile(differences).max(LEAST_MAXIMUM));
        let decade = 10f64.powf(value.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].into_iter().find(|step| value <= step * decade * (1.0 + 1e-6));
        step.unwrap_or(10.0) * decade
    }
}

/// The value that a share [`KEPT`] of the finite ones does not exceed; 0 where there are none.
fn quantile(values: impl Iterator<Item = f32>) -> f32 {
    let mut finite: Vec<f32> = values.filter(|v| v.is_finite()).collect();
    if finite.is_empty() {
        return 0.0;
    }
    let index = (((finite.len() - 1) as f64) * KEPT).round() as usize;
    *finite.select_nth_unstable_by(index, f32::total_cmp).1
}

#[derive(Serialize)]
struct Answer<'a> {
    model: &'a str,
    mse: f64,
    mse_linear: f64,
    mse_log1p: f64,
    psnr: Option<f64>,
}

#[derive(Serialize)]
struct Numbers<'a> {
    title: &'a str,
    caption: &'a str,
    height: usize,
    width: usize,
    exposure_stops: f32,
    difference_maximum: f64,
    answers: Vec<Answer<'a>>,
}

impl Serialize for Panel {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        let numbers = Numbers {
            title: &self.title,
            caption: &self.caption,
            height: self.reference.height,
            width: self.reference.width,
            exposure_stops: self.exposure(),
            difference_maximum: self.maximum(),
            answers: self
                .answers
                .iter()
                .zip(self.errors())
                .map(|((model, _), e)| Answer {
                    model,
                    mse: e.mse,
                    mse_linear: e.mse_linear,
                    mse_log1p: e.mse_log1p,
                    psnr: e.psnr(),
                })
                .collect(),
        };
        numbers.serialize(serializer)
    }
}
