//! Axes of a point on a surface or a fibre.

/// Three orthogonal unit vectors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    axes: [[f64; 3]; 3],
}

impl Frame {
    /// Tangent, bitangent and the unit normal `n`, without a preferred direction (Duff et al. 2017).
    pub fn new(n: [f64; 3]) -> Self {
        let sign = 1.0_f64.copysign(n[2]);
        let a = -1.0 / (sign + n[2]);
        let b = n[0] * n[1] * a;
        Self {
            axes: [
                [1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]],
                [b, sign + n[1] * n[1] * a, -n[1]],
                n,
            ],
        }
    }

    /// x along the unit vector `tangent`, z along the unit vector `normal` at a right angle to it.
    pub fn along(tangent: [f64; 3], normal: [f64; 3]) -> Self {
        let ([a, b, c], [d, e, f]) = (normal, tangent);
        Self { axes: [tangent, [b * f - c * e, c * d - a * f, a * e - b * d], normal] }
    }

    /// A world vector in the frame.
    pub fn to_local(&self, w: [f64; 3]) -> [f32; 3] {
        self.axes.map(|a| (a[0] * w[0] + a[1] * w[1] + a[2] * w[2]) as f32)
    }

    /// A vector of the frame in the world.
    pub fn to_world(&self, w: [f32; 3]) -> [f64; 3] {
        let w = w.map(f64::from);
        std::array::from_fn(|c| (0..3).map(|k| self.axes[k][c] * w[k]).sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};

    /// Sums of three products of numbers up to 1 in f64.
    const ROUNDING: f64 = 1e-12;

    fn is_right_handed(frame: &Frame) -> bool {
        let [x, y, z] = frame.axes;
        let cross = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]];
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        (dot(cross, z) - 1.0).abs() < ROUNDING
            && (dot(x, x) - 1.0).abs() < ROUNDING
            && (dot(y, y) - 1.0).abs() < ROUNDING
            && dot(x, y).abs() < ROUNDING
    }

    #[test]
    fn axes_are_orthonormal_around_every_normal() {
        for k in 0..1000 {
            let mut random = Random::new(2, Stream::Probe, k);
            let v: [f64; 3] = std::array::from_fn(|_| f64::from(random.normal()));
            let length = v.iter().map(|c| c * c).sum::<f64>().sqrt();
            let n = v.map(|c| c / length);
            let frame = Frame::new(n);
            assert!(is_right_handed(&frame));
            let along = Frame::along(frame.axes[0], n);
            assert!(is_right_handed(&along));
            let bent = Frame::along([n[0], n[1], n[2] + 1e-3], frame.axes[1]);
            assert!(!is_right_handed(&bent));
        }
        assert!(is_right_handed(&Frame::new([0.0, 0.0, -1.0])));
    }
}
