//! Flicker: the error of the difference of two frames over the energy of the true difference.
//!
//! 0 for a perfect answer, 1 for one in which nothing moves, more where motion is invented. A steady error, such as a
//! wrong colour, is none. Squares of a noisy reference would count its noise as motion; so there are two estimates of
//! every frame, independent of each other, and products of them stand for squares: their expectation has no noise in
//! it. What is left scatters around the truth, and a nearly perfect answer may come out a little below 0.

/// Sums over the frames of a sequence, taken one after the other.
#[derive(Clone, Debug, Default)]
pub struct Flicker {
    last: Option<Frame>,
    /// Estimates of the squares of the error's change and of the true change.
    error: f64,
    motion: f64,
}

#[derive(Clone, Debug)]
struct Frame {
    answer: Vec<[f32; 3]>,
    halves: [Vec<[f32; 3]>; 2],
}

impl Flicker {
    /// Adds the next frame of a sequence: the answer and two independent estimates of the truth, linear RGB that is
    /// clamped to \[0, 1\] as for `mse`, pixels as in the frame before.
    pub fn add(&mut self, answer: &[[f32; 3]], halves: [&[[f32; 3]]; 2]) {
        let clamped = |pixels: &[[f32; 3]]| pixels.iter().map(|p| p.map(|v| v.clamp(0.0, 1.0))).collect();
        let next = Frame { answer: clamped(answer), halves: halves.map(clamped) };
        if let Some(last) = &self.last {
            let [a, b] = [0, 1].map(|half| changes(&last.halves[half], &next.halves[half]));
            for (own, (a, b)) in changes(&last.answer, &next.answer).zip(a.zip(b)) {
                self.error += (own - a) * (own - b);
                self.motion += a * b;
            }
        }
        self.last = Some(next);
    }

    /// The flicker; none where nothing is seen to move or a value is no number.
    pub fn value(&self) -> Option<f64> {
        Some(self.error / self.motion).filter(|v| self.motion > 0.0 && v.is_finite())
    }
}

/// What every value changes by.
fn changes<'a>(last: &'a [[f32; 3]], next: &'a [[f32; 3]]) -> impl Iterator<Item = f64> + 'a {
    let pairs = last.as_flattened().iter().zip(next.as_flattened());
    pairs.map(|(last, next)| f64::from(*next) - f64::from(*last))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};

    /// Rounding of f32 in squares of differences.
    const ROUNDING: f64 = 1e-5;

    fn of(answers: [[f32; 3]; 3], references: [[f32; 3]; 3]) -> Flicker {
        let mut flicker = Flicker::default();
        for (answer, reference) in answers.iter().zip(&references) {
            flicker.add(&[*answer; 4], [&[*reference; 4]; 2]);
        }
        flicker
    }

    #[test]
    fn the_error_of_the_change_over_the_change() {
        let truth = [[0.2, 0.3, 0.4], [0.3, 0.3, 0.5], [0.5, 0.2, 0.5]];
        let (still, steady) = ([[0.1; 3]; 3], truth.map(|p| p.map(|v| v + 0.1)));
        let flickering = [truth[0], truth[1].map(|v| v + 0.1), truth[2]];
        // 0.01 + 0.01 and 0.04 + 0.01, all over them.
        let motion = 0.07;
        for (answer, expected) in
            [(truth, 0.0), (still, 1.0), (steady, 0.0), (flickering, 2.0 * 3.0 * 0.01 / motion)]
        {
            let value = of(answer, truth).value().unwrap();
            assert!((value - expected).abs() < ROUNDING, "{value} {expected}");
        }
        let changed = of([truth[0], truth[1], [0.51, 0.2, 0.5]], truth).value().unwrap();
        assert!(changed > ROUNDING, "{changed}");
    }

    #[test]
    fn noise_is_no_motion() {
        /// Values of a frame, and by how much they move and scatter: half as much motion as noise.
        const VALUES: usize = 30_000;
        const MOVED: f32 = 0.01;
        const NOISE: f32 = 0.02;
        /// Five standard errors: a product's deviation is 2 NOISE^2 + ... = 0.001, over sqrt(90,000) and MOVED^2.
        const SCATTER: f64 = 0.2;
        let frame = |k: usize, of: u64| -> Vec<[f32; 3]> {
            let mut random = Random::new(of, Stream::Probe, k as u64);
            let noise = if of == 0 { 0.0 } else { NOISE };
            let value = |_| 0.4 + MOVED * k as f32 + noise * random.normal();
            let values: Vec<f32> = (0..3 * VALUES).map(value).collect();
            values.as_chunks().0.to_vec()
        };
        let (mut apart, mut alike) = (Flicker::default(), Flicker::default());
        for k in 0..2 {
            let (truth, a, b) = (frame(k, 0), frame(k, 1), frame(k, 2));
            apart.add(&truth, [&a, &b]);
            alike.add(&truth, [&a, &a]);
        }
        assert!(apart.value().unwrap().abs() < SCATTER, "{:?}", apart.value());
        // One estimate taken twice: 8 parts of noise in 9.
        assert!(alike.value().unwrap() > 0.8, "{:?}", alike.value());
    }

    #[test]
    fn nothing_that_is_seen_to_move_has_no_value() {
        assert_eq!(Flicker::default().value(), None);
        assert_eq!(of([[0.1; 3]; 3], [[0.5; 3]; 3]).value(), None);
        // Beyond [0, 1].
        assert_eq!(of([[0.1; 3]; 3], [[1.5; 3], [2.5; 3], [9.0; 3]]).value(), None);
        let nothing = [[f32::NAN; 3], [0.2; 3], [0.3; 3]];
        assert_eq!(of(nothing, [[0.1; 3], [0.2; 3], [0.3; 3]]).value(), None);
    }
}
