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
    rows: Steps,
    /// Of each row.
    columns: Vec<Steps>,
    /// z of each row's upper border, and of the last one's lower.
    borders: Vec<f64>,
}

/// A density that is constant over equal steps of \[0, 1).
#[derive(Clone, Debug, PartialEq)]
struct Steps {
    /// Probability of all steps before each.
    sums: Vec<f64>,
    /// For as many equal parts of \[0, 1) as there are steps, the step in which each part begins (the cutpoint method,
    /// Chen and Asau 1974): a draw looks at two steps on average.
    guide: Vec<u32>,
}

impl Environment {
    /// An environment of `width * height` texels, each finite and not negative.
    pub fn new(width: usize, height: usize, texels: Vec<[f32; 3]>) -> Self {
        let rows = Steps::new(&[1.0]);
        let borders = (0..=height).map(|row| (PI * row as f64 / height as f64).cos()).collect();
        let mut this = Self { width, height, texels, rows, columns: Vec::with_capacity(height), borders };
        let mut bands = Vec::with_capacity(height);
        for row in 0..height {
            let weights: Vec<f64> = (0..width).map(|column| this.weight(row, column)).collect();
            bands.push(weights.iter().sum::<f64>() * this.band(row));
            this.columns.push(Steps::new(&weights));
        }
        this.rows = Steps::new(&bands);
        this
    }

    /// One radiance in all directions.
    pub fn constant(radiance: [f32; 3]) -> Self {
        Self::new(1, 1, vec![radiance])
    }

    /// Radiance from a unit direction: bilinear between texels.
    pub fn radiance(&self, direction: DVec3) -> [f32; 3] {
        self.bilinear(self.place(direction))
    }

    /// Radiance from a unit direction, and the density over solid angle with which [`Environment::sample`] draws it.
    pub fn look(&self, direction: DVec3) -> ([f32; 3], f64) {
        let place = self.place(direction);
        let row = (place[1] as usize).min(self.height - 1);
        let column = (place[0] as usize).min(self.width - 1);
        let part = self.rows.part(row) * self.columns[row].part(column);
        (self.bilinear(place), part / self.solid_angle(row))
    }

    /// A unit direction for two numbers in \[0, 1), the radiance from there, and its density over solid angle.
    pub fn sample(&self, [x, y]: [f64; 2]) -> (DVec3, [f32; 3], f64) {
        let (row, down) = self.rows.draw(y);
        let (column, across) = self.columns[row].draw(x);
        // Within a texel directions are uniform in solid angle.
        let (top, bottom) = (self.borders[row], self.borders[row + 1]);
        let z = top + down * (bottom - top);
        let along = column as f64 + across;
        let (sin, cos) = ((TAU * along / self.width as f64) as f32).sin_cos();
        let radius = (1.0 - z * z).max(0.0).sqrt();
        let direction = DVec3::new(radius * f64::from(sin), radius * f64::from(cos), z);
        let place = [along as f32, self.down(radius, z)];
        let part = self.rows.part(row) * self.columns[row].part(column);
        (direction.normalize(), self.bilinear(place), part / self.solid_angle(row))
    }

    /// Where a direction lies in the picture, in texels. Single precision is a ten-thousandth of a texel.
    fn place(&self, direction: DVec3) -> [f32; 2] {
        let turn = (direction.x as f32).atan2(direction.y as f32) / std::f32::consts::TAU;
        let turn = if turn < 0.0 { turn + 1.0 } else { turn };
        [turn * self.width as f32, self.down(direction.x.hypot(direction.y), direction.z)]
    }

    fn down(&self, radius: f64, z: f64) -> f32 {
        (radius as f32).atan2(z as f32) / std::f32::consts::PI * self.height as f32
    }

    fn bilinear(&self, [x, y]: [f32; 2]) -> [f32; 3] {
        let (x, y) = (x - 0.5, y - 0.5);
        let (column, row) = (x.floor(), y.floor());
        let (fx, fy) = (x - column, y - row);
        let left = (column as i64).rem_euclid(self.width as i64) as usize;
        let right = if left + 1 < self.width { left + 1 } else { 0 };
        let top = (row.max(0.0) as usize).min(self.height - 1);
        let bottom = ((row + 1.0).max(0.0) as usize).min(self.height - 1);
        let at = |row: usize, column: usize| self.texels[row * self.width + column];
        let (a, b, c, d) = (at(top, left), at(top, right), at(bottom, left), at(bottom, right));
        std::array::from_fn(|k| {
            let top = a[k] + fx * (b[k] - a[k]);
            top + fy * (c[k] + fx * (d[k] - c[k]) - top)
        })
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

    fn band(&self, row: usize) -> f64 {
        self.borders[row] - self.borders[row + 1]
    }

    /// Of a texel in a row.
    fn solid_angle(&self, row: usize) -> f64 {
        self.band(row) * TAU / self.width as f64
    }
}

impl Steps {
    /// The density of some weights: uniform where all of them are 0.
    fn new(weights: &[f64]) -> Self {
        let (count, total) = (weights.len(), weights.iter().sum::<f64>());
        let (mut sums, mut sum) = (vec![0.0], 0.0);
        for (k, weight) in weights.iter().enumerate() {
            sum += weight;
            sums.push(if total > 0.0 { (sum / total).min(1.0) } else { (k + 1) as f64 / count as f64 });
        }
        let mut step = 0;
        let guide = (0..count).map(|part| {
            while step + 1 < count && sums[step + 1] * count as f64 <= part as f64 {
                step += 1;
            }
            step as u32
        });
        Self { guide: guide.collect(), sums }
    }

    /// The step of a number in \[0, 1), and where in the step it lies.
    fn draw(&self, x: f64) -> (usize, f64) {
        let last = self.guide.len() - 1;
        let mut step = self.guide[((x * self.guide.len() as f64) as usize).min(last)] as usize;
        while step < last && self.sums[step + 1] <= x {
            step += 1;
        }
        let length = self.part(step);
        (step, if length > 0.0 { ((x - self.sums[step]) / length).clamp(0.0, 1.0) } else { 0.5 })
    }

    /// Probability of a step.
    fn part(&self, step: usize) -> f64 {
        self.sums[step + 1] - self.sums[step]
    }
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
            let (direction, radiance, pdf) = environment.sample([random.uniform_f64(), random.uniform_f64()]);
            assert!((direction.length() - 1.0).abs() < 1e-12);
            let (seen, density) = environment.look(direction);
            // Both are products of the same numbers. Where single precision rounds a direction over a texel's border it is
            // another texel's; none of these is.
            assert!((density / pdf - 1.0).abs() < 1e-9, "{direction}");
            // Texels differ by up to 20, over which a ten-thousandth of a texel is this.
            assert!((0..3).all(|c| (seen[c] - radiance[c]).abs() < 2e-3), "{seen:?} {radiance:?}");
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
            whole += 4.0 * PI * environment.look(anywhere).1 / n as f64;
            by_sphere += 4.0 * PI * f64::from(environment.radiance(anywhere)[1]) / n as f64;
            let (_, radiance, pdf) = environment.sample([random.uniform_f64(), random.uniform_f64()]);
            by_light += f64::from(radiance[1]) / pdf / n as f64;
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
        assert!((white.look(DVec3::Z).1 - 0.25 / PI).abs() < 1e-12);
        // All black: directions are uniform and nothing is divided by 0.
        assert!((Environment::constant([0.0; 3]).sample([0.3, 0.6]).2 - 0.25 / PI).abs() < 1e-12);
    }
}
