//! The pyramids.

use super::sources::{
    self, ALPHA, DIFFUSE, GLOSS, HEIGHT, NUMBERS, Numbers, SLOPE, SPECULAR, SPREAD as SPREADS, WEIGHT,
};
use crate::error::{Error, Result};
use crate::kernels::fetch::{Pyramid, Texels};
use crate::reference::Layer;
use half::f16;
use rayon::prelude::*;

/// Channels of a shading texel, in half precision.
pub(super) const CHANNELS: usize = 16;
/// Diffuse colour.
pub(super) const COLOUR: usize = 0;
/// F0 of all that is glossy.
pub(super) const F0: usize = 3;
/// F0 of the dielectric alone, whose diffuse part it dims.
pub(super) const LAYER: usize = 6;
/// GGX alpha.
pub(super) const ROUGH: usize = 7;
/// Mean slopes along x and y.
pub(super) const MEAN: usize = 8;
/// Variances of the slopes along x and y within the texel, and their covariance.
pub(super) const SPREAD: usize = 10;
/// Colour of bounced light.
pub(super) const BOUNCED: usize = 13;

/// Maps of all levels.
#[derive(Clone, Debug)]
pub(super) struct Maps {
    /// Heights of all levels, one after the other; each has its first row and column repeated behind its last.
    pub heights: Vec<f32>,
    /// Where each level starts in `heights`, as the bits of an integer.
    pub starts: Vec<f32>,
    /// Columns and rows of each level.
    pub widths: Vec<f32>,
    pub rows: Vec<f32>,
    /// Least and greatest height of each level.
    pub lows: Vec<f32>,
    pub highs: Vec<f32>,
    /// Levels of the maps that are finer than level 0; negative where maps are coarser.
    pub level_shift: f32,
    /// Coarsest level of a query.
    pub coarsest: f32,
    /// Sides of a texel of level 0, in tile widths.
    pub texel: [f32; 2],
    texels: Vec<Vec<f16>>,
    sides: [usize; 2],
}

impl Maps {
    pub fn new(
        layer: &Layer,
        resolution: [usize; 2],
        finest: [usize; 2],
        bounced: &[[f32; 3]],
    ) -> Result<Self> {
        let source = sources::means(layer, finest)?;
        let mut maps = Self {
            heights: Vec::new(),
            starts: Vec::new(),
            widths: Vec::new(),
            rows: Vec::new(),
            lows: Vec::new(),
            highs: Vec::new(),
            level_shift: (finest[0].max(finest[1]) as f32 / resolution[0].max(resolution[1]) as f32).log2(),
            coarsest: (resolution[0].max(resolution[1]) as f32).log2(),
            texel: [1.0 / resolution[1] as f32, 1.0 / resolution[0] as f32],
            texels: Vec::new(),
            sides: finest,
        };
        for level in 0..=finest[0].max(finest[1]).ilog2() {
            let averaged = average(&source, bounced, finest, level);
            if averaged.iter().any(|t| !t.0.iter().chain(&t.1).all(|v| v.is_finite())) {
                return Err(Error::config("material", "a map has values that are not finite"));
            }
            maps.push(&averaged, finest.map(|side| (side >> level).max(1)));
        }
        Ok(maps)
    }

    /// The shading maps.
    pub fn texels(&self) -> Pyramid<'_> {
        let levels = self.texels.iter().map(|level| Texels::Half(level)).collect();
        Pyramid { levels, height: self.sides[0], width: self.sides[1] }
    }

    pub fn first(&self) -> Vec<f32> {
        self.texels[0][..16].iter().map(|v| v.to_f32()).collect()
    }
    pub fn bytes(&self) -> usize {
        let texels: usize = self.texels.iter().map(Vec::len).sum();
        size_of_val(&self.heights[..]) + texels * size_of::<f16>()
    }

    fn push(&mut self, averaged: &[Sum], [rows, columns]: [usize; 2]) {
        self.starts.push(f32::from_bits(self.heights.len() as u32));
        self.widths.push(columns as f32);
        self.rows.push(rows as f32);
        let heights = averaged.iter().map(|t| t.0[HEIGHT] as f32);
        self.lows.push(heights.clone().fold(f32::INFINITY, f32::min));
        self.highs.push(heights.fold(f32::NEG_INFINITY, f32::max));
        for i in 0..=rows {
            for j in 0..=columns {
                self.heights.push(averaged[i % rows * columns + j % columns].0[HEIGHT] as f32);
            }
        }
        self.texels.push(averaged.iter().flat_map(Sum::texel).collect());
    }
}

/// Sums over areas: the numbers of a texel with products of slopes for their spread, and bounced light.
#[derive(Clone, Copy)]
struct Sum([f64; NUMBERS], [f64; 3]);

impl Sum {
    const ZERO: Self = Self([0.0; NUMBERS], [0.0; 3]);

    fn of(numbers: &Numbers, bounced: &[f32; 3]) -> Self {
        let mut sum = numbers.map(f64::from);
        for (k, product) in products(&sum).into_iter().enumerate() {
            sum[SPREADS + k] += product;
        }
        Self(sum, bounced.map(f64::from))
    }

    fn add(&mut self, other: &Self, weight: f64) {
        for (to, from) in self.0.iter_mut().zip(other.0) {
            *to += weight * from;
        }
        for (to, from) in self.1.iter_mut().zip(other.1) {
            *to += weight * from;
        }
    }

    fn texel(&self) -> [f16; CHANNELS] {
        let Self(sum, bounced) = self;
        let mut texel = [0.0; CHANNELS];
        for c in 0..3 {
            texel[COLOUR + c] = sum[DIFFUSE + c];
            texel[F0 + c] = sum[GLOSS + c];
            texel[BOUNCED + c] = bounced[c];
        }
        texel[LAYER] = sum[SPECULAR];
        texel[ROUGH] = (sum[ALPHA] / sum[WEIGHT]).sqrt();
        (texel[MEAN], texel[MEAN + 1]) = (sum[SLOPE], sum[SLOPE + 1]);
        for (k, product) in products(sum).into_iter().enumerate() {
            texel[SPREAD + k] = sum[SPREADS + k] - product;
        }
        texel[SPREAD] = texel[SPREAD].max(0.0);
        texel[SPREAD + 1] = texel[SPREAD + 1].max(0.0);
        texel.map(f16::from_f64)
    }
}

/// xx, yy, xy of the mean slopes.
fn products(sum: &[f64; NUMBERS]) -> [f64; 3] {
    let [x, y] = [sum[SLOPE], sum[SLOPE + 1]];
    [x * x, y * y, x * y]
}

/// Means over boxes of 2^level texels around the centres of a level's texels.
fn average(source: &[Numbers], bounced: &[[f32; 3]], [rows, columns]: [usize; 2], level: u32) -> Vec<Sum> {
    let (down, across) = (boxes(rows, level), boxes(columns, level));
    let row = |row: &Vec<(usize, f64)>| {
        let line = |j: usize| {
            let mut sum = Sum::ZERO;
            for &(i, weight) in row {
                let at = i * columns + j;
                sum.add(&Sum::of(&source[at], bounced.get(at).unwrap_or(&[0.0; 3])), weight);
            }
            sum
        };
        let lines: Vec<Sum> = (0..columns).map(line).collect();
        let box_of = |column: &Vec<(usize, f64)>| {
            let mut sum = Sum::ZERO;
            column.iter().for_each(|&(j, weight)| sum.add(&lines[j], weight));
            sum
        };
        across.iter().map(box_of).collect::<Vec<_>>()
    };
    down.par_iter().flat_map_iter(row).collect()
}

/// For every texel of a level the texels of the finest that its box covers, and their shares.
fn boxes(side: usize, level: u32) -> Vec<Vec<(usize, f64)>> {
    let texels = (side >> level).max(1);
    // A box is never wider than the tile.
    let width = f64::from(1 << level).min(side as f64);
    (0..texels)
        .map(|k| {
            let start = (k as f64 + 0.5) * side as f64 / texels as f64 - 0.5 * width;
            let end = start + width;
            let (first, last) = (start.floor() as i64, end.ceil() as i64);
            (first..last)
                .map(|t| {
                    let covered = (end.min(t as f64 + 1.0) - start.max(t as f64)).max(0.0);
                    (t.rem_euclid(side as i64) as usize, covered / width)
                })
                .collect()
        })
        .collect()
}
