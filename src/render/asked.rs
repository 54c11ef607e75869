//! What a part of a picture asks its materials, and how their answers become radiance.
//!
//! A pixel is a constant (the background) and a sum of terms: weight x answer, or weight x answer x answer where light came
//! by another object. Directions are drawn without knowing any answer, so all queries are known before the first of them
//! is answered, material by material.

use crate::error::Result;
use crate::query::QueryBuffer;
use rayon::prelude::*;
use std::ops::Range;

/// A query of a material.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// Place of the material in the scene's list.
    pub material: u32,
    /// Place in that material's buffer.
    pub index: u32,
}

/// weight x answer \[x answer\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Term {
    /// Place of the pixel in its part.
    pub pixel: u32,
    /// Light on its way to the camera.
    pub first: Slot,
    /// Light on its way to the first.
    pub second: Option<Slot>,
    /// Radiance or irradiance, over density and samples.
    pub weight: [f32; 3],
}

/// Queries of one material.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Queries {
    /// Positions.
    pub u: Vec<[f32; 2]>,
    /// Light directions.
    pub wi: Vec<[f32; 2]>,
    /// View directions.
    pub wo: Vec<[f32; 2]>,
    /// Levels.
    pub level: Vec<f32>,
}

/// What consecutive pixels ask.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Part {
    /// The pixels, row by row of the picture.
    pub pixels: Range<usize>,
    /// Queries by material.
    pub queries: Vec<Queries>,
    /// Radiance that asks nothing, by pixel.
    pub constants: Vec<[f64; 3]>,
    /// The rest.
    pub terms: Vec<Term>,
}

/// What many parts ask, put together for the materials.
#[derive(Clone, Debug)]
pub struct Asked {
    /// One buffer a material, of one row.
    pub queries: Vec<QueryBuffer>,
    /// The parts; their slots count from `starts`.
    pub parts: Vec<Part>,
    /// Of each part, where its queries start in each buffer.
    pub starts: Vec<Vec<usize>>,
}

/// Answers by material, with variances where a material measures.
pub type Answers = Vec<super::material::Answered>;

impl Part {
    /// A part that asks nothing yet.
    pub fn new(pixels: Range<usize>, materials: usize) -> Self {
        let constants = vec![[0.0f64; 3]; pixels.len()];
        Self { pixels, queries: vec![Queries::default(); materials], constants, terms: Vec::new() }
    }
}

impl Asked {
    /// Puts parts together in their order.
    ///
    /// # Errors
    /// `Config` if a value is not finite.
    pub fn new(mut parts: Vec<Part>, materials: usize) -> Result<Self> {
        let mut all = vec![Queries::default(); materials];
        let mut starts = Vec::with_capacity(parts.len());
        for part in &mut parts {
            starts.push(all.iter().map(|queries| queries.level.len()).collect());
            for (all, mut queries) in all.iter_mut().zip(std::mem::take(&mut part.queries)) {
                all.u.append(&mut queries.u);
                all.wi.append(&mut queries.wi);
                all.wo.append(&mut queries.wo);
                all.level.append(&mut queries.level);
            }
        }
        let buffer = |q: Queries| QueryBuffer::new(1, q.level.len(), q.u, q.wi, q.wo, q.level);
        let queries = all.into_iter().map(buffer).collect::<Result<_>>()?;
        Ok(Self { queries, parts, starts })
    }

    /// Number of queries.
    pub fn len(&self) -> usize {
        self.queries.iter().map(QueryBuffer::len).sum()
    }

    /// True if nothing is asked.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Radiance and its variance of the pixels of all parts, which follow each other.
    pub fn shade_all(&self, answers: &Answers, rgb: &mut [[f32; 3]], variance: &mut [f32]) {
        let mut rest = (rgb, variance);
        let mut parts = Vec::with_capacity(self.parts.len());
        for (k, part) in self.parts.iter().enumerate() {
            let (rgb, after) = rest.0.split_at_mut(part.pixels.len());
            let (noise, quiet) = rest.1.split_at_mut(part.pixels.len());
            rest = (after, quiet);
            parts.push((k, rgb, noise));
        }
        parts.into_par_iter().for_each(|(k, rgb, noise)| self.shade(k, answers, rgb, noise));
    }

    /// Radiance and its variance of the pixels of part `k` from the answers to all queries. The variance is that of the
    /// answers alone, averaged over RGB.
    pub fn shade(&self, k: usize, answers: &Answers, rgb: &mut [[f32; 3]], variance: &mut [f32]) {
        let (part, starts) = (&self.parts[k], &self.starts[k]);
        // Summed in double precision: thousands of samples of a bright sky would stick in single.
        let mut sums = part.constants.clone();
        let mut noise = vec![0.0f64; sums.len()];
        let look = |slot: Slot| {
            let answered = &answers[slot.material as usize];
            let at = starts[slot.material as usize] + slot.index as usize;
            let variance = answered.variance.as_ref().map_or(0.0, |v| f64::from(v[at]));
            (answered.rgb[at].map(f64::from), variance)
        };
        for Term { pixel, first, second, weight } in &part.terms {
            let (a, variance_a) = look(*first);
            let (b, variance_b) = second.map_or(([1.0; 3], 0.0), look);
            let mut spread = [0.0; 2];
            for c in 0..3 {
                let weight = f64::from(weight[c]);
                sums[*pixel as usize][c] += weight * a[c] * b[c];
                spread[0] += (weight * b[c]).powi(2) / 3.0;
                spread[1] += (weight * a[c]).powi(2) / 3.0;
            }
            noise[*pixel as usize] += spread[0] * variance_a + spread[1] * variance_b;
        }
        for (to, from) in rgb.iter_mut().zip(&sums) {
            *to = from.map(|v| v as f32);
        }
        for (to, from) in variance.iter_mut().zip(&noise) {
            *to = *from as f32;
        }
    }
}
