//! Held-out queries at chosen places and footprints, and errors in which the noise of the reference is no error.

use super::workshop::Workshop;
use crate::error::Result;
use crate::query::{QueryBuffer, Reflectance, RgbImage};
use crate::random::{Random, Stream};

/// Seed of positions and directions: no dataset has it.
const SEED: u64 = 0x91ace;
/// Squared radius of the projected disc of directions, that of the datasets.
const DISC: f32 = 0.99;
/// Sub-samples of each of the two halves of a reference value: the noise leaves the product of the two errors, so that a few
/// are enough, and more places say more than more sub-samples.
const HALF_SPP: usize = 16;
/// Places between the random numbers of two references: more than any buffer has queries.
const APART: u64 = 1 << 40;

/// Random places in the tile, each with its own pair of directions.
#[derive(Clone, Debug)]
pub(super) struct Places {
    /// In \[0, 1)^2, to be moved to the centre of its texel.
    places: Vec<[f32; 2]>,
    wi: Vec<[f32; 2]>,
    wo: Vec<[f32; 2]>,
}

impl Places {
    /// So many places; another `part` has others.
    pub fn new(number: usize, part: u64) -> Self {
        let mut this = Self { places: Vec::new(), wi: Vec::new(), wo: Vec::new() };
        for k in 0..number {
            let mut random = Random::sub_stream(SEED, Stream::Probe, part, k as u64);
            this.places.push([random.uniform(), random.uniform()]);
            this.wi.push(random.disc(DISC));
            this.wo.push(random.disc(DISC));
        }
        this
    }

    /// The places at the centres of a grid of `side` cells, `shift` cells off.
    ///
    /// # Errors
    /// As [`QueryBuffer::new`].
    pub fn at(&self, side: usize, shift: [f32; 2], level: f32) -> Result<QueryBuffer> {
        let cells = side as f32;
        let coordinate = |x: f32, shift: f32| {
            let centre = ((x * cells).floor() + 0.5 + shift) / cells;
            centre - centre.floor()
        };
        let u =
            self.places.iter().map(|p| [coordinate(p[0], shift[0]), coordinate(p[1], shift[1])]).collect();
        let n = self.places.len();
        QueryBuffer::new(1, n, u, self.wi.clone(), self.wo.clone(), vec![level; n])
    }
}

/// Texels along the side of a level of a tile.
pub(super) fn texels(side: usize, level: usize) -> usize {
    (side >> level).max(1)
}

/// Two independent estimates of the same answers.
pub(super) struct Halves([RgbImage; 2]);

impl Halves {
    /// What a material's surface answers; another `part` has other random numbers.
    ///
    /// # Errors
    /// What the surface reports.
    pub fn of(workshop: &mut Workshop, material: &str, queries: &QueryBuffer, part: u64) -> Result<Self> {
        workshop.check()?;
        let mut half = |half| workshop.truth(material, queries, HALF_SPP, (2 * part + half) * APART);
        Ok(Self([half(0)?, half(1)?]))
    }

    /// `mse` of a material's answers.
    ///
    /// # Errors
    /// What answering meets.
    pub fn mse(&self, material: &dyn Reflectance, queries: &QueryBuffer) -> Result<f64> {
        Ok(self.mse_of(&material.evaluate(queries)?))
    }

    /// `mse` of answers: values clamped to \[0, 1\], the reference's noise left out.
    pub fn mse_of(&self, answer: &RgbImage) -> f64 {
        let [a, b] = &self.0;
        let clamped = |v: f32| f64::from(v.clamp(0.0, 1.0));
        let values = answer.pixels.as_flattened().iter();
        let halves = a.pixels.as_flattened().iter().zip(b.pixels.as_flattened());
        let product = |(x, (a, b)): (&f32, (&f32, &f32))| {
            let x = clamped(*x);
            (x - clamped(*a)) * (x - clamped(*b))
        };
        values.zip(halves).map(product).sum::<f64>() / answer.pixels.as_flattened().len().max(1) as f64
    }

    /// Mean over queries and channels, of each half.
    pub fn means(&self) -> [f64; 2] {
        [mean(&self.0[0]), mean(&self.0[1])]
    }

    /// The halves.
    pub fn images(&self) -> [&RgbImage; 2] {
        [&self.0[0], &self.0[1]]
    }
}

/// Mean over pixels and channels.
pub(super) fn mean(image: &RgbImage) -> f64 {
    let values = image.pixels.as_flattened();
    values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len().max(1) as f64
}

/// Largest |difference| of two images' values; infinite if one is no number.
pub(super) fn farthest(a: &RgbImage, b: &RgbImage) -> f64 {
    let values = a.pixels.as_flattened().iter().zip(b.pixels.as_flattened());
    let apart = values.map(|(a, b)| f64::from((a - b).abs()));
    apart.fold(0.0, |most, d| if d.is_nan() { f64::INFINITY } else { most.max(d) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// f32 positions of a tile of 64.
    const ROUNDING: f32 = 1e-5;

    #[test]
    fn places_are_centres_and_shifted_ones_are_not() {
        let off = |shift: f32| {
            let queries = Places::new(100, 0).at(64, [shift, 0.0], 0.0).unwrap();
            queries.u.iter().fold(0.0f32, |most, u| most.max(((u[0] * 64.0).fract() - 0.5).abs()))
        };
        assert!(off(0.0) < ROUNDING && off(1.0) < ROUNDING);
        assert!((off(0.25) - 0.25).abs() < ROUNDING);
    }

    #[test]
    fn noise_of_the_reference_is_no_error_and_an_error_is() {
        const TOLERANCE: f64 = 1e-4;
        let image = |value: &dyn Fn(u64) -> f32| {
            let pixels: Vec<[f32; 3]> = (0..100_000).map(|k| [value(k); 3]).collect();
            RgbImage { height: 1, width: pixels.len(), pixels }
        };
        let noisy = |half: u64| image(&|k| 0.5 + 0.2 * (Random::new(half, Stream::Probe, k).uniform() - 0.5));
        let halves = Halves([noisy(1), noisy(2)]);
        let mse = |answer: f32| halves.mse_of(&image(&|_| answer));
        assert!(mse(0.5).abs() < TOLERANCE, "{}", mse(0.5));
        assert!((mse(0.6) - 0.01).abs() < TOLERANCE, "{}", mse(0.6));
        let same = Halves([noisy(1), noisy(1)]);
        assert!(same.mse_of(&image(&|_| 0.5)) > TOLERANCE);
    }

    #[test]
    fn a_value_that_is_no_number_is_infinitely_far() {
        let image = |v: f32| RgbImage { height: 1, width: 1, pixels: vec![[0.0, v, 1.0]] };
        assert_eq!(farthest(&image(0.25), &image(0.5)), 0.25);
        assert_eq!(farthest(&image(f32::NAN), &image(0.5)), f64::INFINITY);
    }
}
