//! How far held-out pairs of directions are from the nearest training pair.

use super::{block::Layout, format::Distance};
use crate::query::unit;
use rayon::prelude::*;

/// So many held-out pairs are compared: enough for a mean, few enough to compare with every training pair.
const MAX_PAIRS: usize = 512;

type Pair = [[f64; 3]; 2];

/// The held-out pairs of one split and the nearest training pair seen so far.
#[derive(Debug, Default)]
pub(crate) struct Nearest {
    /// Each pair with the distance to the nearest training pair, radians.
    pairs: Vec<(Pair, f64)>,
}

fn pairs_of<'a>(layouts: impl IntoIterator<Item = &'a Layout>) -> impl Iterator<Item = Pair> {
    layouts
        .into_iter()
        .flat_map(|layout| layout.patches())
        .map(|patch| [patch.wi, patch.wo].map(|w| unit(w).map(f64::from)))
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]).clamp(-1.0, 1.0)
}

impl Nearest {
    /// Adds the directions of a held-out file.
    pub(crate) fn hold_out<'a>(&mut self, layouts: impl IntoIterator<Item = &'a Layout>) {
        for pair in pairs_of(layouts) {
            if self.pairs.len() == MAX_PAIRS {
                return;
            }
            if !self.pairs.iter().any(|(known, _)| *known == pair) {
                self.pairs.push((pair, f64::INFINITY));
            }
        }
    }

    /// Compares with the directions of a training file.
    pub(crate) fn compare<'a>(&mut self, layouts: impl IntoIterator<Item = &'a Layout>) {
        let training: Vec<Pair> = pairs_of(layouts).collect();
        self.pairs.par_iter_mut().for_each(|(held_out, nearest)| {
            let too_far = |nearest: f64| if nearest < std::f64::consts::PI { nearest.cos() } else { -2.0 };
            let mut least = too_far(*nearest);
            for pair in &training {
                // Most training pairs are already too far by their light alone.
                let cosine = dot(held_out[0], pair[0]);
                if cosine >= least {
                    let distance = cosine.acos().hypot(dot(held_out[1], pair[1]).acos());
                    if distance < *nearest {
                        *nearest = distance;
                        least = too_far(distance);
                    }
                }
            }
        });
    }

    /// The distances, once both sides are known.
    pub(crate) fn distance(&self) -> Option<Distance> {
        let degrees: Vec<f64> =
            self.pairs.iter().map(|(_, nearest)| nearest.to_degrees()).filter(|d| d.is_finite()).collect();
        let min = degrees.iter().copied().reduce(f64::min)?;
        let mean = degrees.iter().sum::<f64>() / degrees.len() as f64;
        Some(Distance { mean_degrees: mean as f32, min_degrees: min as f32 })
    }
}
