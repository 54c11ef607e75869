//! A solid layer as the numbers that maps average: all of them mean something as a mean over an area.

use crate::error::Result;
use crate::reference::shading::MIN_ALPHA;
use crate::reference::{Brdf, Heightfield, Layer, Texture};
use rayon::prelude::*;

/// Numbers of a spot.
pub(super) const NUMBERS: usize = 15;
/// Where they are.
pub(super) const HEIGHT: usize = 0;
/// Diffuse colour of the dielectric share.
pub(super) const DIFFUSE: usize = 1;
/// F0 of both shares together.
pub(super) const GLOSS: usize = 4;
/// F0 of the dielectric.
pub(super) const SPECULAR: usize = 7;
/// alpha^2 weighted by how much the lobe reflects, and that weight.
pub(super) const ALPHA: usize = 8;
pub(super) const WEIGHT: usize = 9;
/// Slopes along x and y.
pub(super) const SLOPE: usize = 10;
/// Variances of the slopes along x and y within the texel, and their covariance.
pub(super) const SPREAD: usize = 12;

/// Steepest slope that is told from steeper ones: 89.4 degrees.
const STEEPEST: f64 = 100.0;
/// Lobe that a spot without any counts for, so that its roughness means something.
const LEAST_LOBE: f64 = 1e-3;
/// Samples along a side of a source's texel: inside the four patches around its centre.
const PER_TEXEL: usize = 2;
/// Most samples along a side of a map's texel.
const MOST_SAMPLES: usize = 32;

pub(super) type Numbers = [f32; NUMBERS];

/// Means over every texel of a grid \[H, W\], row by row.
pub(super) fn means(layer: &Layer, [rows, columns]: [usize; 2]) -> Result<Vec<Numbers>> {
    let field = Heightfield::new(&layer.height)?;
    let paint = &layer.paint;
    let normals = paint.normal.as_ref().map_or(1, Texture::side);
    let sides = [
        layer.height.height,
        layer.height.width,
        paint.base_colour.side(),
        paint.roughness.side(),
        paint.metalness.side(),
        paint.specular.side(),
        normals,
    ];
    let finest = sides.into_iter().fold(1, usize::max);
    let across = (PER_TEXEL * finest.div_ceil(rows.min(columns))).min(MOST_SAMPLES);
    let share = 1.0 / (across * across) as f64;
    let texel = |k: usize| {
        let mut sum = [0.0; NUMBERS];
        for sub in 0..across * across {
            let place = |texel: usize, sub: usize| texel as f64 + (sub as f64 + 0.5) / across as f64;
            let x = place(k % columns, sub % across) / columns as f64;
            let y = place(k / columns, sub / across) / rows as f64;
            let slope = match paint.normal(x, y) {
                Some([nx, ny, nz]) => [nx, ny].map(|n| -n / nz.max(1.0 / STEEPEST)),
                None => slope(&field, [layer.height.width, layer.height.height], x, y),
            };
            add(&mut sum, paint.brdf(x, y), slope.map(|s| s.clamp(-STEEPEST, STEEPEST)));
            sum[HEIGHT] += field.height_at(x, y);
        }
        let mut mean = sum.map(|v| v * share);
        let [x, y] = [mean[SLOPE], mean[SLOPE + 1]];
        for (k, product) in [x * x, y * y, x * y].into_iter().enumerate() {
            mean[SPREAD + k] -= product;
        }
        mean.map(|v| v as f32)
    };
    Ok((0..rows * columns).into_par_iter().map(texel).collect())
}

/// Slopes along x and y of the bilinear patch at a position: differences across the patch.
fn slope(field: &Heightfield, sides: [usize; 2], x: f64, y: f64) -> [f64; 2] {
    let sides = sides.map(|side| side as f64);
    let [u, v] = [x * sides[0] - 0.5, y * sides[1] - 0.5].map(|p| p - p.floor());
    let along = |to: f64, axis: usize| match axis {
        0 => field.height_at(x + to / sides[0], y),
        _ => field.height_at(x, y + to / sides[1]),
    };
    // Both ends a little inside, where rounding cannot lead into the next patch.
    let inside = 1e-6;
    [(u, 0), (v, 1)].map(|(from, axis)| {
        let (low, high) = (inside - from, 1.0 - inside - from);
        (along(high, axis) - along(low, axis)) / (high - low) * sides[axis]
    })
}

fn add(sum: &mut [f64; NUMBERS], brdf: Brdf, [sx, sy]: [f64; 2]) {
    let metal = f64::from(brdf.metalness);
    let specular = f64::from(brdf.specular);
    let mut lobe = LEAST_LOBE;
    for (c, base) in brdf.base_colour.map(f64::from).into_iter().enumerate() {
        let gloss = (1.0 - metal) * specular + metal * base;
        sum[DIFFUSE + c] += (1.0 - metal) * base;
        sum[GLOSS + c] += gloss;
        lobe += gloss / 3.0;
    }
    sum[SPECULAR] += specular;
    let alpha = f64::from(brdf.roughness).powi(2).max(f64::from(MIN_ALPHA));
    sum[ALPHA] += lobe * alpha * alpha;
    sum[WEIGHT] += lobe;
    for (k, value) in [sx, sy, sx * sx, sy * sy, sx * sy].into_iter().enumerate() {
        sum[SLOPE + k] += value;
    }
}
