//! Queries of chosen directions at random positions, and how far answers are from the truth there.

use crate::error::Result;
use crate::query::{QueryBuffer, Reflectance, RgbImage};
use crate::random::{Random, Stream};
use crate::stability::workshop::Workshop;

/// Squared radius in the projected disc of directions that are not the matter: down to 72 degrees from the normal.
pub(super) const HIGH: f32 = 0.9;

/// A direction at an angle from the normal, both in degrees.
pub(super) fn tilted(tilt: f32, pan: f32) -> [f32; 2] {
    let (sin, cos) = pan.to_radians().sin_cos();
    let radius = tilt.to_radians().sin();
    [radius * cos, radius * sin]
}

/// A random azimuth, degrees.
pub(super) fn any_pan(random: &mut Random) -> f32 {
    360.0 * random.uniform()
}

/// Directions \[wi, wo\] at `n` random positions of level 0; everything random follows from `seed` and the query's number.
pub(super) fn asked(
    n: usize,
    seed: u64,
    mut directions: impl FnMut(&mut Random) -> [[f32; 2]; 2],
) -> Result<QueryBuffer> {
    let (mut u, mut wi, mut wo) = (Vec::new(), Vec::new(), Vec::new());
    for k in 0..n {
        let mut random = Random::new(seed, Stream::Probe, k as u64);
        u.push([random.uniform(), random.uniform()]);
        let [light, view] = directions(&mut random);
        wi.push(light);
        wo.push(view);
    }
    QueryBuffer::new(1, n, u, wi, wo, vec![0.0; n])
}

/// The same queries under the opposite light.
pub(super) fn turned(queries: &QueryBuffer) -> Result<QueryBuffer> {
    let light = queries.wi.iter().map(|[x, y]| [-x, -y]).collect();
    let QueryBuffer { u, wo, level, .. } = queries;
    QueryBuffer::new(1, u.len(), u.clone(), light, wo.clone(), level.clone())
}

/// Queries and what is true there.
pub(super) struct Asked {
    /// What is asked.
    pub queries: QueryBuffer,
    /// Estimates of the truth.
    pub truth: RgbImage,
}

impl Asked {
    /// Asks the surface `spp` times a query.
    ///
    /// # Errors
    /// What the surface reports.
    pub fn new(workshop: &mut Workshop, material: &str, queries: QueryBuffer, spp: usize) -> Result<Self> {
        let truth = workshop.truth(material, &queries, spp, 0)?;
        Ok(Self { queries, truth })
    }

    /// Sums of squares over values clamped to \[0, 1\] as in `mse`: of the error and of the truth.
    ///
    /// # Errors
    /// What the answerer reports.
    pub fn squares(&self, answerer: &dyn Reflectance) -> Result<Squares> {
        let answer = answerer.evaluate(&self.queries)?;
        Ok(Squares::of(answer.pixels.as_flattened(), self.truth.pixels.as_flattened()))
    }
}

/// Sums of squares of values that are clamped to \[0, 1\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Squares {
    /// Values.
    pub values: usize,
    /// Of the error.
    pub error: f64,
    /// Of the truth.
    pub truth: f64,
}

impl Squares {
    /// Sums over values.
    pub fn of(answer: &[f32], truth: &[f32]) -> Self {
        let mut sums = Self { values: truth.len(), ..Self::default() };
        for (a, t) in answer.iter().zip(truth) {
            let [a, t] = [a, t].map(|v| f64::from(*v).clamp(0.0, 1.0));
            sums.error += (a - t) * (a - t);
            sums.truth += t * t;
        }
        sums
    }

    /// Both together.
    pub fn with(self, other: Self) -> Self {
        Self {
            values: self.values + other.values,
            error: self.error + other.error,
            truth: self.truth + other.truth,
        }
    }

    /// Mean squared error.
    pub fn mse(self) -> f64 {
        self.error / self.values.max(1) as f64
    }

    /// The error's energy over the truth's: 1 for an answer of 0.
    pub fn relative(self) -> f64 {
        self.error / self.truth
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of f32.
    const ROUNDING: f64 = 1e-6;

    #[test]
    fn errors_are_told_in_units_of_the_truth() {
        let truth = [0.5, 0.2, 0.1];
        let zero = Squares::of(&[0.0; 3], &truth);
        assert!((zero.relative() - 1.0).abs() < ROUNDING && (zero.mse() - 0.1).abs() < ROUNDING);
        assert_eq!(Squares::of(&truth, &truth).relative(), 0.0);
        let off = Squares::of(&[0.5, 0.2, 0.2], &truth);
        assert!((off.relative() - 0.01 / 0.3).abs() < ROUNDING && off.relative() > ROUNDING);
        assert_eq!(off.with(zero).values, 6);
        // An answer beyond 1 counts as 1.
        assert_eq!(Squares::of(&[9.0], &[1.0]).error, 0.0);
    }

    #[test]
    fn directions_are_where_they_are_asked_to_be() {
        let queries = asked(3, 1, |_| [tilted(90.0, 0.0), tilted(30.0, 90.0)]).unwrap();
        assert!((queries.wo[2][1] - 0.5).abs() < 1e-6 && queries.wi[1] == [1.0, 0.0]);
        assert_ne!(queries.u[0], queries.u[1]);
        assert_eq!(turned(&queries).unwrap().wi[0], [-1.0, 0.0]);
    }
}
