//! FLIP for images of standard range (Andersson et al. 2020): what an observer sees when two images alternate.
//!
//! Written here because the bindings of the authors' own code, `nv-flip`, need a C++ compiler; the tests compare it with
//! that code, PyPI's `flip-evaluator`. It takes images as they are shown, in sRGB, and decodes them first; ours are
//! linear, so that the clamping to \[0, 1\] is all that is left of encoding and decoding.

mod colour;
mod filter;

use colour::{hyab, lab, luminance, ycxcz};
use filter::Weights;
use rayon::prelude::*;
use std::f64::consts::PI;

/// Least side of an image, so that the same images have a value as for `ssim`: in smaller ones the filters see little
/// but the border, repeated.
pub const LEAST_SIDE: usize = super::ssim::WINDOW;
/// Pixels a degree of visual angle, about 67: a display of 3840 pixels seen from as far as it is wide, the authors' default.
pub const PIXELS_PER_DEGREE: f64 = 3840.0 * PI / 180.0;

/// Contrast sensitivity of a channel, a sum of a sqrt(pi / b) exp(-(pi d)^2 / b) with d in degrees: (a, b).
type Sensitivity = &'static [(f64, f64)];
const LIGHTNESS: Sensitivity = &[(1.0, 0.0047)];
const RED_GREEN: Sensitivity = &[(1.0, 0.0053)];
const BLUE_YELLOW: Sensitivity = &[(34.1, 0.04), (13.5, 0.025)];
/// The largest b; every Gaussian is cut off at three standard deviations of that one.
const WIDEST: f64 = 0.04;
/// Exponent of a difference of colours.
const COLOUR_EXPONENT: f32 = 0.7;
/// Differences up to this part of the largest are spread over \[0, `SPREAD_OVER`\], the rest is squeezed above.
const SPREAD_PART: f32 = 0.4;
const SPREAD_OVER: f32 = 0.95;
/// Width of the edges and points that are looked for, degrees.
const FEATURE_WIDTH: f64 = 0.082;
/// Exponent of a difference of edges or points.
const FEATURE_EXPONENT: f32 = 0.5;
/// Least number of pixels that a thread takes at once.
const PIXELS_OF_A_PIECE: usize = 4096;

/// Mean FLIP of two images of one shape (linear RGB, row by row): 0 for equal ones, 1 at most. None where a side is
/// below [`LEAST_SIDE`], shapes differ or a value is no number.
pub fn flip(height: usize, width: usize, answer: &[[f32; 3]], reference: &[[f32; 3]]) -> Option<f64> {
    if height.min(width) < LEAST_SIDE {
        return None;
    }
    let map = flip_map(height, width, answer, reference);
    let mean = map.iter().map(|v| f64::from(*v)).sum::<f64>() / map.len() as f64;
    mean.is_finite().then_some(mean)
}

/// FLIP of every pixel, row by row; empty where the images have not `height * width` pixels each.
pub fn flip_map(height: usize, width: usize, answer: &[[f32; 3]], reference: &[[f32; 3]]) -> Vec<f32> {
    let pixels = height.checked_mul(width).unwrap_or(0);
    if pixels == 0 || [answer.len(), reference.len()] != [pixels; 2] {
        return Vec::new();
    }
    let [answer, reference] = [answer, reference].map(|rgb| Seen::new(width, rgb));
    // Green and blue are the two colours that are farthest apart.
    let [green, blue] = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|rgb| lab(ycxcz(rgb)));
    let largest = hyab(green, blue).powf(COLOUR_EXPONENT);
    let at = |k: usize| {
        let colour = spread(hyab(answer.lab[k], reference.lab[k]).powf(COLOUR_EXPONENT), largest);
        let [edges, points] =
            [0, 1].map(|kind| (answer.features[kind][k] - reference.features[kind][k]).abs());
        let feature = (edges.max(points) / 2f32.sqrt()).powf(FEATURE_EXPONENT);
        colour.powf(1.0 - feature)
    };
    (0..pixels).into_par_iter().with_min_len(PIXELS_OF_A_PIECE).map(at).collect()
}

/// A difference of colours in \[0, `largest`\] as one in \[0, 1\].
fn spread(difference: f32, largest: f32) -> f32 {
    let knee = SPREAD_PART * largest;
    if difference < knee {
        return SPREAD_OVER / knee * difference;
    }
    SPREAD_OVER + (difference - knee) / (largest - knee) * (1.0 - SPREAD_OVER)
}

/// An image as it is seen: a colour a pixel after the eye's blur, and how much of an edge and of a point it is.
struct Seen {
    lab: Vec<[f32; 3]>,
    features: [Vec<f32>; 2],
}

impl Seen {
    fn new(width: usize, rgb: &[[f32; 3]]) -> Self {
        let pixels: Vec<[f32; 3]> =
            rgb.par_iter().with_min_len(PIXELS_OF_A_PIECE).map(|rgb| ycxcz(*rgb)).collect();
        let plane = |channel: usize| pixels.iter().map(|p| p[channel]).collect::<Vec<f32>>();
        let planes = [plane(0), plane(1), plane(2)];
        let blurred = [(0, LIGHTNESS), (1, RED_GREEN), (2, BLUE_YELLOW)]
            .map(|(channel, sensitivity)| blur(width, &planes[channel], sensitivity));
        let at = |k: usize| lab([blurred[0][k], blurred[1][k], blurred[2][k]]);
        Self {
            lab: (0..rgb.len()).into_par_iter().with_min_len(PIXELS_OF_A_PIECE).map(at).collect(),
            features: features(width, &planes[0]),
        }
    }
}

/// A channel under its contrast sensitivity, whose weights add up to 1.
fn blur(width: usize, plane: &[f32], sensitivity: Sensitivity) -> Vec<f32> {
    let radius = (3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * PIXELS_PER_DEGREE).ceil() as usize;
    let gaussian = |x: f64, b: f64| (-(PI * x / PIXELS_PER_DEGREE).powi(2) / b).exp();
    // A Gaussian is separable, a sum of two is not: each is filtered with for itself.
    let share = |(a, b): (f64, f64)| {
        let sum: f64 = (0..=2 * radius).map(|k| gaussian(k as f64 - radius as f64, b)).sum();
        a * (PI / b).sqrt() * sum * sum
    };
    let whole: f64 = sensitivity.iter().map(|part| share(*part)).sum();
    let mut out = vec![0.0; plane.len()];
    for part in sensitivity {
        let weights = Weights::new(radius, |x| gaussian(x, part.1));
        let blurred = weights.along_columns(width, &weights.along_rows(width, plane));
        let share = (share(*part) / whole) as f32;
        out.iter_mut().zip(blurred).for_each(|(out, value)| *out += share * value);
    }
    out
}

/// How much of an edge and of a point there is at every pixel: lengths of first and of second derivatives of luminance.
fn features(width: usize, lightness: &[f32]) -> [Vec<f32>; 2] {
    let deviation = 0.5 * FEATURE_WIDTH * PIXELS_PER_DEGREE;
    let radius = (3.0 * deviation).ceil() as usize;
    let gaussian = |x: f64| (-0.5 * (x / deviation).powi(2)).exp();
    let smooth = Weights::new(radius, gaussian);
    let derivatives = [
        Weights::new(radius, |x| -x * gaussian(x)),
        Weights::new(radius, |x| ((x / deviation).powi(2) - 1.0) * gaussian(x)),
    ];
    let luminance: Vec<f32> = lightness.iter().map(|y| luminance(*y)).collect();
    let smoothed = smooth.along_rows(width, &luminance);
    derivatives.map(|derivative| {
        let down = derivative.along_columns(width, &smoothed);
        let right = smooth.along_columns(width, &derivative.along_rows(width, &luminance));
        right.iter().zip(down).map(|(x, y)| x.hypot(y)).collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(seed: usize) -> Vec<[f32; 3]> {
        (0..20 * 24)
            .map(|k| [0, 1, 2].map(|c| ((k * 7 + c * 5 + k / 24 * seed) % 11) as f32 / 10.0))
            .collect()
    }

    #[test]
    fn equal_is_zero_and_the_farthest_colours_are_one() {
        let (a, b) = (picture(3), picture(4));
        assert_eq!(flip(20, 24, &a, &a), Some(0.0));
        let ab = flip(20, 24, &a, &b).unwrap();
        assert!(ab > 0.1 && ab < 1.0, "{ab}");
        assert_eq!(flip(20, 24, &b, &a), Some(ab));
        // Beyond [0, 1] nothing is seen.
        let brighter: Vec<[f32; 3]> = a.iter().map(|p| p.map(|v| if v == 1.0 { 9.0 } else { v })).collect();
        assert_eq!(flip(20, 24, &a, &brighter), Some(0.0));
        let green_on_blue = flip(8, 8, &[[0.0, 1.0, 0.0]; 64], &[[0.0, 0.0, 1.0]; 64]).unwrap();
        assert!((green_on_blue - 1.0).abs() < 1e-5, "{green_on_blue}");
    }

    #[test]
    fn no_value_where_there_is_none() {
        let a = picture(3);
        assert_eq!(flip(20, 23, &a, &a), None);
        assert_eq!(flip(4, 4, &a[..16], &a[..16]), None);
        assert_eq!(flip(usize::MAX, 8, &a, &a), None);
        assert_eq!(flip_map(4, 4, &a[..16], &a[..16]), vec![0.0; 16]);
        let mut broken = a.clone();
        broken[7] = [f32::NAN; 3];
        assert_eq!(flip(20, 24, &a, &broken), None);
    }
}
