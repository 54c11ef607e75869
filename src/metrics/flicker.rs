//! Flicker: the error of the difference of two frames over the energy of the true difference.
//!
//! 0 for a perfect answer, 1 for one in which nothing moves, more where motion is invented. A steady error, such as a
//! wrong colour, is none. The reference's own noise counts as motion of the reference: its frames share their random
//! numbers, so that most of it cancels, and [`Flicker::noise`] bounds what is left.

/// Sums over the frames of a sequence, taken one after the other.
#[derive(Clone, Debug, Default)]
pub struct Flicker {
    last: Option<Frame>,
    /// Squares of the error's change and of the reference's change.
    error: f64,
    motion: f64,
    /// Expected squares of the noise's change if the noise of two frames had nothing in common.
    noise: f64,
}

#[derive(Clone, Debug)]
struct Frame {
    answer: Vec<[f32; 3]>,
    reference: Vec<[f32; 3]>,
    variance: f64,
}

impl Flicker {
    /// Adds the next frame of a sequence (linear RGB, clamped to \[0, 1\] as for `mse`, of the pixels of the one before)
    /// and the mean variance of the reference's values.
    pub fn add(&mut self, answer: &[[f32; 3]], reference: &[[f32; 3]], variance: f64) {
        let clamped = |pixels: &[[f32; 3]]| pixels.iter().map(|p| p.map(|v| v.clamp(0.0, 1.0))).collect();
        let next = Frame { answer: clamped(answer), reference: clamped(reference), variance };
        if let Some(last) = &self.last {
            let of = |frame: &Frame, k: usize, c: usize| {
                [frame.answer[k][c], frame.reference[k][c]].map(f64::from)
            };
            let pixels = [&last.answer, &last.reference, &next.answer, &next.reference].map(Vec::len);
            let pixels = pixels.into_iter().min().unwrap_or(0);
            for (k, c) in (0..pixels).flat_map(|k| (0..3).map(move |c| (k, c))) {
                let ([a, r], [next_a, next_r]) = (of(last, k, c), of(&next, k, c));
                self.error += ((next_a - a) - (next_r - r)).powi(2);
                self.motion += (next_r - r).powi(2);
            }
            self.noise += (3 * pixels) as f64 * (last.variance + next.variance);
        }
        self.last = Some(next);
    }

    /// The flicker; none where nothing moves or a value is no number.
    pub fn value(&self) -> Option<f64> {
        self.over_motion(self.error)
    }

    /// The most that a perfect, noiseless answer is expected to have: the flicker of the reference's noise if none of it
    /// cancelled.
    pub fn noise(&self) -> Option<f64> {
        self.over_motion(self.noise)
    }

    fn over_motion(&self, sum: f64) -> Option<f64> {
        Some(sum / self.motion).filter(|v| self.motion > 0.0 && v.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of f32 in squares of differences.
    const ROUNDING: f64 = 1e-5;

    fn of(answers: [[f32; 3]; 3], references: [[f32; 3]; 3]) -> Flicker {
        let mut flicker = Flicker::default();
        for (answer, reference) in answers.iter().zip(&references) {
            flicker.add(&[*answer; 4], &[*reference; 4], 0.01);
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
        let noise = of(truth, truth).noise().unwrap();
        assert!((noise - 2.0 * 3.0 * 0.02 / motion).abs() < ROUNDING * noise, "{noise}");
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
