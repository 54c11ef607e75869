//! Adam (Kingma and Ba 2015, algorithm 1), element by element, in place.

use rayon::prelude::*;

/// Elements a task works on: 3 x 64 KiB stay in the second-level cache.
const CHUNK: usize = 16 * 1024;

/// moment = beta * moment + (1 - beta) * gradient^power, power 1 or 2.
pub fn moment(moment: &mut [f32], gradient: &[f32], beta: f32, squared: bool) {
    let rest = 1.0 - beta;
    moment.par_chunks_mut(CHUNK).zip(gradient.par_chunks(CHUNK)).for_each(|(m, g)| {
        for (m, g) in m.iter_mut().zip(g) {
            *m = beta * *m + rest * if squared { g * g } else { *g };
        }
    });
}

/// Constants of one update.
#[derive(Clone, Copy, Debug)]
pub struct Update {
    /// Learning rate divided by (1 - beta1^t).
    pub rate: f32,
    /// 1 / sqrt(1 - beta2^t).
    pub root_correction: f32,
    /// epsilon.
    pub epsilon: f32,
}

impl Update {
    /// The constants of step `t`, counted from 1.
    pub fn new(rate: f64, beta1: f64, beta2: f64, epsilon: f64, t: u64) -> Self {
        let power = |beta: f64| beta.powf(t as f64);
        Self {
            rate: (rate / (1.0 - power(beta1))) as f32,
            root_correction: (1.0 / (1.0 - power(beta2)).sqrt()) as f32,
            epsilon: epsilon as f32,
        }
    }

    /// theta -= rate * first / (sqrt(second) * root_correction + epsilon).
    pub fn apply(&self, theta: &mut [f32], first: &[f32], second: &[f32]) {
        theta.par_chunks_mut(CHUNK).zip(first.par_chunks(CHUNK)).zip(second.par_chunks(CHUNK)).for_each(
            |((theta, m), v)| {
                for ((theta, m), v) in theta.iter_mut().zip(m).zip(v) {
                    *theta -= self.rate * m / (v.sqrt() * self.root_correction + self.epsilon);
                }
            },
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A handful of f32 roundings on values near 1.
    const ROUNDING: f64 = 1e-6;

    /// Runs 50 steps on f(x) = (x - 3)^2 and returns the largest distance from a float64 run.
    fn drift(gradient_error: f32) -> f64 {
        let (beta1, beta2, epsilon, rate) = (0.9, 0.999, 1e-8, 0.05);
        let (mut x, mut m, mut v) = ([1.0f32], [0.0f32], [0.0f32]);
        let (mut y, mut p, mut q) = (1.0f64, 0.0f64, 0.0f64);
        let mut worst = 0.0f64;
        for t in 1..=50 {
            let g = [2.0 * (x[0] - 3.0) + gradient_error];
            moment(&mut m, &g, beta1 as f32, false);
            moment(&mut v, &g, beta2 as f32, true);
            Update::new(rate, beta1, beta2, epsilon, t).apply(&mut x, &m, &v);
            let g = 2.0 * (y - 3.0);
            p = beta1 * p + (1.0 - beta1) * g;
            q = beta2 * q + (1.0 - beta2) * g * g;
            let t = t as i32;
            y -= rate * (p / (1.0 - beta1.powi(t))) / ((q / (1.0 - beta2.powi(t))).sqrt() + epsilon);
            worst = worst.max((f64::from(x[0]) - y).abs());
        }
        worst
    }

    #[test]
    fn follows_float64() {
        assert!(drift(0.0) < 10.0 * ROUNDING, "{}", drift(0.0));
        assert!(drift(0.01) > 10.0 * ROUNDING);
    }
}
