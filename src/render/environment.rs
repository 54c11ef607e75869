//! Light from everywhere: an equirectangular picture, and directions drawn by its luminance.
//!
//! Seen from above, the picture runs clockwise from +y at its left border; the top row is +z.

use glam::DVec3;
use std::f64::consts::{PI, TAU};

/// A picture of all directions.
#[derive(Clone, Debug, PartialEq)]
pub struct Environment {
    width: usize,
    height: usize,
    texels: Vec<[f32; 3]>,
    /// Probability that a row is drawn, summed over the rows before.
    rows: Vec<f64>,
    /// Within each row, the same over its columns.
    columns: Vec<f64>,
}

impl Environment {
    /// An environment of `width * height` texels, each finite and not negative.
    pub fn new(width: usize, height: usize, texels: Vec<[f32; 3]>) -> Self {
        let mut this = Self { width, height, texels, rows: Vec::new(), columns: Vec::new() };
        this.rows.push(0.0);
        for row in 0..height {
            let start = this.columns.len();
            this.columns.push(0.0);
            for column in 0..width {
                let sum = this.columns[start + column] + this.weight(row, column);
                this.columns.push(sum);
            }
            let total = this.columns[start + width];
            let sum = this.rows[row] + total * this.band(row);
            this.rows.push(sum);
            normalise(&mut this.columns[start..]);
        }
        normalise(&mut this.rows);
        this
    }

    /// One radiance in all directions.
    pub fn constant(radiance: [f32; 3]) -> Self {
        Self::new(1, 1, vec![radiance])
    }

    /// Radiance from a unit direction: bilinear between texels.
    pub fn radiance(&self, direction: DVec3) -> [f32; 3] {
        let [x, y] = self.place(direction);
        let (x, y) = (x - 0.5, y - 0.5);
        let (column, row) = (x.floor(), y.floor());
        let (fx, fy) = ((x - column) as f32, (y - row) as f32);
        let at = |i: f64, j: f64| {
            let i = i.clamp(0.0, (self.height - 1) as f64) as usize;
            self.texels[i * self.width + (j as i64).rem_euclid(self.width as i64) as usize]
        };
        let (a, b) = (at(row, column), at(row, column + 1.0));
        let (c, d) = (at(row + 1.0, column), at(row + 1.0, column + 1.0));
        std::array::from_fn(|k| {
            let top = a[k] + fx * (b[k] - a[k]);
            top + fy * (c[k] + fx * (d[k] - c[k]) - top)
        })
    }

    /// A unit direction for two numbers in \[0, 1), with its density over solid angle.
    pub fn sample(&self, [x, y]: [f64; 2]) -> (DVec3, f64) {
        let (row, down, share) = draw(&self.rows, y);
        let start = row * (self.width + 1);
        let (column, across, part) = draw(&self.columns[start..=start + self.width], x);
        // Within a texel directions are uniform in solid angle.
        let (top, bottom) = (self.height_of(row), self.height_of(row + 1));
        let z = top + down * (bottom - top);
        let (sin, cos) = (TAU * (column as f64 + across) / self.width as f64).sin_cos();
        let radius = (1.0 - z * z).max(0.0).sqrt();
        (DVec3::new(radius * sin, radius * cos, z), share * part / self.solid_angle(row))
    }

    /// Density over solid angle with which [`Environment::sample`] draws a unit direction.
    pub fn pdf(&self, direction: DVec3) -> f64 {
        let [x, y] = self.place(direction);
        let row = (y as usize).min(self.height - 1);
        let column = (x as usize).min(self.width - 1);
        let at = row * (self.width + 1) + column;
        let (share, part) = (self.rows[row + 1] - self.rows[row], self.columns[at + 1] - self.columns[at]);
        share * part / self.solid_angle(row)
    }

    /// Where a direction lies in the picture, in texels.
    fn place(&self, direction: DVec3) -> [f64; 2] {
        let turn = direction.x.atan2(direction.y) / TAU;
        let down = direction.x.hypot(direction.y).atan2(direction.z) / PI;
        let turn = if turn < 0.0 { turn + 1.0 } else { turn };
        [turn * self.width as f64, down * self.height as f64]
    }

    /// What a texel is drawn by: its luminance and its neighbours', since radiance is interpolated between them.
    fn weight(&self, row: usize, column: usize) -> f64 {
        let mut sum = 0.0;
        for (i, down) in [(row.saturating_sub(1), 1.0), (row, 2.0), ((row + 1).min(self.height - 1), 1.0)] {
            for (j, across) in [(column + self.width - 1, 1.0), (column, 2.0), (column + 1, 1.0)] {
                let [r, g, b] = self.texels[i * self.width + j % self.width].map(f64::from);
                sum += down * across * (0.2126 * r + 0.7152 * g + 0.0722 * b);
            }
        }
        sum / 16.0
    }

    /// z of a row's upper border.
    fn height_of(&self, row: usize) -> f64 {
        (PI * row as f64 / self.height as f64).cos()
    }

    fn band(&self, row: usize) -> f64 {
        self.height_of(row) - self.height_of(row + 1)
    }

    /// Of a texel in a row.
    fn solid_angle(&self, row: usize) -> f64 {
        self.band(row) * TAU / self.width as f64
    }
}

/// Sums that end in 1: uniform where all of them are 0.
fn normalise(sums: &mut [f64]) {
    let last = sums.len() - 1;
    let total = sums[last];
    for (k, sum) in sums.iter_mut().enumerate() {
        *sum = if total > 0.0 { *sum / total } else { k as f64 / last as f64 };
    }
}

/// The interval of a number in \[0, 1) among sums, where in the interval it lies, and the interval's length.
fn draw(sums: &[f64], x: f64) -> (usize, f64, f64) {
    let k = sums.partition_point(|sum| *sum <= x).clamp(1, sums.len() - 1) - 1;
    let length = sums[k + 1] - sums[k];
    (k, if length > 0.0 { ((x - sums[k]) / length).clamp(0.0, 1.0) } else { 0.5 }, length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};

    fn spotty() -> Environment {
        let mut random = Random::new(3, Stream::Probe, 0);
        let texels = (0..16 * 8).map(|_| {
            let bright = if random.uniform() < 0.1 { 20.0 } else { 0.2 };
            [bright * random.uniform(), bright * random.uniform(), bright]
        });
        Environment::new(16, 8, texels.collect())
    }

    #[test]
    fn a_sample_has_the_density_of_its_direction_and_lies_where_it_is_looked_up() {
        let environment = spotty();
        let mut random = Random::new(4, Stream::Probe, 0);
        for _ in 0..2000 {
            let (direction, pdf) = environment.sample([random.uniform_f64(), random.uniform_f64()]);
            assert!((direction.length() - 1.0).abs() < 1e-12);
            // Both are sums and products of the same numbers; a sample on a border may round to the neighbour.
            assert!((environment.pdf(direction) / pdf - 1.0).abs() < 1e-9, "{direction}");
        }
    }

    /// Five standard deviations of a mean of 20,000 samples that vary by less than their size.
    const NOISE: f64 = 5.0 / 141.0;

    #[test]
    fn the_density_integrates_to_one_and_the_estimate_of_the_light_is_right() {
        let environment = spotty();
        let mut random = Random::new(5, Stream::Probe, 0);
        let (mut whole, mut by_light, mut by_sphere) = (0.0, 0.0, 0.0);
        let n = 20_000;
        for _ in 0..n {
            let (z, turn) = (2.0 * random.uniform_f64() - 1.0, TAU * random.uniform_f64());
            let r = (1.0 - z * z).sqrt();
            let anywhere = DVec3::new(r * turn.cos(), r * turn.sin(), z);
            whole += 4.0 * PI * environment.pdf(anywhere) / n as f64;
            by_sphere += 4.0 * PI * f64::from(environment.radiance(anywhere)[1]) / n as f64;
            let (direction, pdf) = environment.sample([random.uniform_f64(), random.uniform_f64()]);
            by_light += f64::from(environment.radiance(direction)[1]) / pdf / n as f64;
        }
        assert!((whole - 1.0).abs() < NOISE, "{whole}");
        assert!((by_light / by_sphere - 1.0).abs() < NOISE, "{by_light} {by_sphere}");
        assert!((1.1 * by_light / by_sphere - 1.0).abs() > NOISE);
    }

    #[test]
    fn a_picture_lies_where_its_page_says() {
        // Left quarter red, second green; top row white.
        let mut texels = vec![[0.0f32; 3]; 8 * 4];
        for row in 0..4 {
            (texels[row * 8], texels[row * 8 + 2]) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        }
        let environment = Environment::new(8, 4, texels);
        let towards = |turn: f64| {
            // The centre of a column, clockwise from +y.
            let angle = TAU * (turn + 0.5) / 8.0;
            environment.radiance(DVec3::new(angle.sin(), angle.cos(), 0.0))
        };
        assert!(towards(0.0)[0] > 0.999 && towards(2.0)[1] > 0.999 && towards(1.0) == [0.0; 3]);
        let white = Environment::constant([2.0, 1.0, 0.5]);
        assert_eq!(white.radiance(DVec3::new(0.6, 0.0, -0.8)), [2.0, 1.0, 0.5]);
        assert!((white.pdf(DVec3::Z) - 0.25 / PI).abs() < 1e-12);
        // All black: directions are uniform and nothing is divided by 0.
        assert!((Environment::constant([0.0; 3]).sample([0.3, 0.6]).1 - 0.25 / PI).abs() < 1e-12);
    }
}
