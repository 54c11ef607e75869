//! A tileable displaced surface: heights at texel centres, a bilinear patch between every four neighbours, and the
//! pyramids of extremes that let rays skip what lies below or above them.

use crate::error::{Error, Result};

/// Smallest and largest side of a field in samples.
pub const SIDES: std::ops::RangeInclusive<usize> = 2..=4096;

/// Largest distance of the surface from the reference plane, in tile widths.
pub const MAX_DEPTH: f32 = 1.0;

/// Heights over the reference plane as plain data, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HeightMap {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// `height * width` heights in tile widths, at texel centres.
    pub values: Vec<f32>,
}

/// Heights with their pyramids of maxima and minima.
///
/// Patch (i, j) spans the samples (i, j), (i, j + 1), (i + 1, j), (i + 1, j + 1), wrapping. Grid coordinates are
/// X = x W - 0.5 and Y = y H - 0.5, so that the patch is \[j, j + 1\] x \[i, i + 1\] there.
#[derive(Clone, Debug)]
pub struct Heightfield {
    pub(super) height: usize,
    pub(super) width: usize,
    /// `(height + 1) * (width + 1)` samples: the first row and column are repeated behind the last.
    samples: Vec<f32>,
    /// Maxima over blocks of 2^level x 2^level patches, levels 1, 2, ... one after the other.
    maxima: Vec<f32>,
    /// Minima over the same blocks.
    minima: Vec<f32>,
    /// Where each level starts in `maxima` and `minima`, and how many blocks a row has there.
    pub(super) levels: Vec<Level>,
    pub(super) low: f64,
    pub(super) high: f64,
}

/// One level of the pyramid.
#[derive(Clone, Copy, Debug)]
pub(super) struct Level {
    base: usize,
    width: usize,
}

/// Heights at the corners of a patch, and its two-way difference h00 - h10 - h01 + h11.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch {
    pub(super) h00: f64,
    /// Rise along x at Y = i.
    pub(super) rise_x: f64,
    /// Rise along y at X = j.
    pub(super) rise_y: f64,
    pub(super) twist: f64,
}

impl Heightfield {
    /// A field from its samples.
    ///
    /// # Errors
    /// `Config` if a side is outside [`SIDES`], the number of values is not height x width, a value is not finite
    /// or lies farther than [`MAX_DEPTH`] from the reference plane.
    pub fn new(map: &HeightMap) -> Result<Self> {
        let HeightMap { height, width, values } = map;
        let (height, width) = (*height, *width);
        if !SIDES.contains(&height) || !SIDES.contains(&width) {
            let (least, most) = (SIDES.start(), SIDES.end());
            return Err(Error::config(
                "height",
                format!("is {width} x {height} texels; sides of {least} to {most} work"),
            ));
        }
        if values.len() != height * width {
            return Err(Error::config(
                "height",
                format!("has {} values where height x width is {}", values.len(), height * width),
            ));
        }
        if let Some(k) = values.iter().position(|z| !z.is_finite()) {
            return Err(Error::config(
                "height",
                format!("is not finite at row {}, column {}", k / width, k % width),
            ));
        }
        let low = values.iter().fold(f32::INFINITY, |a, &b| a.min(b));
        let high = values.iter().fold(f32::NEG_INFINITY, |a, &b| a.max(b));
        if low < -MAX_DEPTH || high > MAX_DEPTH {
            return Err(Error::config(
                "height",
                format!(
                    "spans {low} to {high} tile widths; at most {MAX_DEPTH} above and below the plane works"
                ),
            ));
        }
        let mut samples = Vec::with_capacity((height + 1) * (width + 1));
        for i in 0..=height {
            let row = &values[(i % height) * width..][..width];
            samples.extend_from_slice(row);
            samples.push(row[0]);
        }
        let (maxima, levels) = pyramid(height, width, &samples, f32::max);
        let (minima, _) = pyramid(height, width, &samples, f32::min);
        Ok(Self { height, width, samples, maxima, minima, levels, low: low.into(), high: high.into() })
    }

    /// Least and greatest height, in tile widths.
    pub fn range(&self) -> [f32; 2] {
        [self.low as f32, self.high as f32]
    }

    /// The samples as plain data.
    pub fn height_map(&self) -> HeightMap {
        let rows = self.samples.chunks(self.width + 1).take(self.height);
        let values = rows.flat_map(|row| &row[..self.width]).copied().collect();
        HeightMap { height: self.height, width: self.width, values }
    }

    /// Height of the surface over (x, y), any finite position in tile widths.
    pub fn height_at(&self, x: f64, y: f64) -> f64 {
        let (i, j, u, v) = self.locate(x, y);
        self.patch(i, j).height(u, v)
    }

    /// Patch (row, column) that (x, y) falls in, and the position inside it.
    fn locate(&self, x: f64, y: f64) -> (usize, usize, f64, f64) {
        let (w, h) = (self.width as f64, self.height as f64);
        let gx = (x * w - 0.5).rem_euclid(w);
        let gy = (y * h - 0.5).rem_euclid(h);
        let (j, i) = ((gx as usize).min(self.width - 1), (gy as usize).min(self.height - 1));
        (i, j, gx - j as f64, gy - i as f64)
    }

    pub(super) fn patch(&self, i: usize, j: usize) -> Patch {
        let at = i * (self.width + 1) + j;
        let below = at + self.width + 1;
        let [h00, h10] = [f64::from(self.samples[at]), f64::from(self.samples[at + 1])];
        let [h01, h11] = [f64::from(self.samples[below]), f64::from(self.samples[below + 1])];
        Patch { h00, rise_x: h10 - h00, rise_y: h01 - h00, twist: h00 - h10 - h01 + h11 }
    }

    /// Largest height of a patch.
    pub(super) fn patch_max(&self, i: usize, j: usize) -> f32 {
        patch_extreme(&self.samples, self.width, i, j, f32::max)
    }

    /// Least height of a patch.
    pub(super) fn patch_min(&self, i: usize, j: usize) -> f32 {
        patch_extreme(&self.samples, self.width, i, j, f32::min)
    }

    /// Largest height of the block at `level` >= 1 that holds patch (i, j).
    pub(super) fn block_max(&self, level: usize, i: usize, j: usize) -> f32 {
        let Level { base, width } = self.levels[level - 1];
        self.maxima[base + (i >> level) * width + (j >> level)]
    }

    /// Least height of the same block.
    pub(super) fn block_min(&self, level: usize, i: usize, j: usize) -> f32 {
        let Level { base, width } = self.levels[level - 1];
        self.minima[base + (i >> level) * width + (j >> level)]
    }

    /// Upward unit normal of patch (i, j) at the position (u, v) inside it.
    pub(super) fn normal(&self, i: usize, j: usize, u: f64, v: f64) -> [f64; 3] {
        let patch = self.patch(i, j);
        let slope_x = (patch.rise_x + patch.twist * v) * self.width as f64;
        let slope_y = (patch.rise_y + patch.twist * u) * self.height as f64;
        let scale = 1.0 / (1.0 + slope_x * slope_x + slope_y * slope_y).sqrt();
        [-slope_x * scale, -slope_y * scale, scale]
    }
}

impl Patch {
    /// Height at the position (u, v) in the patch, both in \[0, 1\].
    pub(super) fn height(&self, u: f64, v: f64) -> f64 {
        self.h00 + self.rise_x * u + (self.rise_y + self.twist * u) * v
    }
}

fn patch_extreme(samples: &[f32], width: usize, i: usize, j: usize, choose: fn(f32, f32) -> f32) -> f32 {
    let at = i * (width + 1) + j;
    let below = at + width + 1;
    choose(choose(samples[at], samples[at + 1]), choose(samples[below], samples[below + 1]))
}

/// Extremes of all levels up to the one that is a single block.
fn pyramid(
    height: usize,
    width: usize,
    samples: &[f32],
    choose: fn(f32, f32) -> f32,
) -> (Vec<f32>, Vec<Level>) {
    let (mut extremes, mut levels) = (Vec::new(), Vec::<Level>::new());
    let (mut rows, mut columns) = (height, width);
    while rows > 1 || columns > 1 {
        let finer = levels.last().copied();
        let base = extremes.len();
        let (fine_rows, fine_columns) = (rows, columns);
        (rows, columns) = (rows.div_ceil(2), columns.div_ceil(2));
        for i in 0..rows {
            for j in 0..columns {
                let fine = (2 * i..(2 * i + 2).min(fine_rows))
                    .flat_map(|fi| (2 * j..(2 * j + 2).min(fine_columns)).map(move |fj| (fi, fj)));
                let extreme = fine
                    .map(|(fi, fj)| match finer {
                        None => patch_extreme(samples, width, fi, fj, choose),
                        Some(level) => extremes[level.base + fi * level.width + fj],
                    })
                    .reduce(choose);
                extremes.extend(extreme);
            }
        }
        levels.push(Level { base, width: columns });
    }
    (extremes, levels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};

    fn random_map(height: usize, width: usize) -> HeightMap {
        let mut random = Random::new(1, Stream::Probe, 0);
        HeightMap {
            height,
            width,
            values: (0..height * width).map(|_| random.uniform() * 0.2 - 0.1).collect(),
        }
    }

    #[test]
    fn every_level_bounds_its_patches() {
        let field = Heightfield::new(&random_map(13, 6)).unwrap();
        for level in 1..=field.levels.len() {
            for i in 0..13 {
                for j in 0..6 {
                    assert!(field.block_max(level, i, j) >= field.patch_max(i, j));
                    assert!(field.block_min(level, i, j) <= field.patch_min(i, j));
                }
            }
        }
        assert_eq!(f64::from(field.block_max(field.levels.len(), 12, 5)), field.high);
        assert_eq!(f64::from(field.block_min(field.levels.len(), 12, 5)), field.low);
    }

    #[test]
    fn samples_sit_at_texel_centres_and_wrap() {
        let map = random_map(5, 8);
        let field = Heightfield::new(&map).unwrap();
        assert_eq!(field.height_map(), map);
        for i in 0..5 {
            for j in 0..8 {
                let (x, y) = ((j as f64 + 0.5) / 8.0, (i as f64 + 0.5) / 5.0);
                let want = f64::from(map.values[i * 8 + j]);
                // Positions are rounded to f64 once, so heights can differ by a few units in the 16th digit.
                assert!((field.height_at(x - 3.0, y + 2.0) - want).abs() < 1e-13);
            }
        }
    }

    #[test]
    fn bad_fields_are_refused() {
        let mut map = random_map(4, 4);
        map.values[5] = f32::NAN;
        assert!(Heightfield::new(&map).unwrap_err().to_string().contains("row 1, column 1"));
        map.values[5] = 3.0;
        assert!(Heightfield::new(&map).is_err());
        assert!(Heightfield::new(&HeightMap { height: 1, width: 4, values: vec![0.0; 4] }).is_err());
        assert!(Heightfield::new(&HeightMap { height: 4, width: 4, values: vec![0.0; 4] }).is_err());
        assert!(Heightfield::new(&HeightMap { height: 4097, width: 2, values: vec![0.0; 8194] }).is_err());
    }
}
