//! Separable filters of planes of values; beyond the border its values go on.

use rayon::prelude::*;

/// Least number of rows that a thread takes at once.
const ROWS_OF_A_PIECE: usize = 16;

/// Weights from -radius to radius.
#[derive(Clone, Debug)]
pub struct Weights(Vec<f32>);

impl Weights {
    /// `weight` at every whole place from -`radius` to `radius`; those above 0 are made to add up to 1, those below to
    /// -1.
    pub fn new(radius: usize, weight: impl Fn(f64) -> f64) -> Self {
        let radius = radius as i64;
        let raw: Vec<f64> = (-radius..=radius).map(|x| weight(x as f64)).collect();
        let above: f64 = raw.iter().filter(|w| **w > 0.0).sum();
        let below: f64 = -raw.iter().filter(|w| **w < 0.0).sum::<f64>();
        Self(raw.into_iter().map(|w| (w / if w < 0.0 { below } else { above }) as f32).collect())
    }

    fn radius(&self) -> usize {
        self.0.len() / 2
    }

    /// Filters along the rows of a plane.
    pub fn along_rows(&self, width: usize, plane: &[f32]) -> Vec<f32> {
        let mut out = vec![0.0; plane.len()];
        let radius = self.radius();
        let lines = out.par_chunks_exact_mut(width).zip(plane.par_chunks_exact(width));
        lines.with_min_len(ROWS_OF_A_PIECE).for_each_init(
            || vec![0.0; width + 2 * radius],
            |padded, (out, row)| {
                padded[..radius].fill(row[0]);
                padded[radius..radius + width].copy_from_slice(row);
                padded[radius + width..].fill(row[width - 1]);
                for (shift, weight) in self.0.iter().enumerate() {
                    add(out, *weight, &padded[shift..]);
                }
            },
        );
        out
    }

    /// Filters along the columns of a plane.
    pub fn along_columns(&self, width: usize, plane: &[f32]) -> Vec<f32> {
        let mut out = vec![0.0; plane.len()];
        let (radius, last) = (self.radius(), (plane.len() / width).saturating_sub(1));
        let lines = out.par_chunks_exact_mut(width).enumerate();
        lines.with_min_len(ROWS_OF_A_PIECE).for_each(|(y, out)| {
            for (shift, weight) in self.0.iter().enumerate() {
                let from = (y + shift).saturating_sub(radius).min(last);
                add(out, *weight, &plane[from * width..]);
            }
        });
        out
    }
}

fn add(out: &mut [f32], weight: f32, values: &[f32]) {
    for (out, value) in out.iter_mut().zip(values) {
        *out += weight * value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_normalised_by_sign() {
        let slope = Weights::new(2, |x| -x);
        assert_eq!(slope.0, [2.0 / 3.0, 1.0 / 3.0, 0.0, -1.0 / 3.0, -2.0 / 3.0]);
    }

    #[test]
    fn beyond_the_border_its_values_go_on() {
        let (width, height) = (5, 3);
        let plane: Vec<f32> = (0..width * height).map(|k| (k * k % 7) as f32).collect();
        let weights = Weights::new(2, |x| 1.0 + (x + 2.0) * (x + 2.0));
        let at = |y: i64, x: i64| plane[y.clamp(0, 2) as usize * width + x.clamp(0, 4) as usize];
        let rows = weights.along_rows(width, &plane);
        let columns = weights.along_columns(width, &plane);
        for (y, x) in (0..3).flat_map(|y| (0..5).map(move |x| (y, x))) {
            let sum = |value: &dyn Fn(i64) -> f32| -> f32 { (-2..=2).map(value).sum() };
            let weight = |t: i64| weights.0[(t + 2) as usize];
            let k = y as usize * width + x as usize;
            assert!((rows[k] - sum(&|t| weight(t) * at(y, x + t))).abs() < 1e-5);
            assert!((columns[k] - sum(&|t| weight(t) * at(y + t, x))).abs() < 1e-5);
        }
    }
}
