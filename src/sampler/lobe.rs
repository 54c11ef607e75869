//! Lobes over the directions of light: closed-form samples and exact densities, as [`neumip_export::sampler`] defines them.

use neumip_export::sampler::{
    CENTRES, Frame, LOG_SCALES, LOGITS, MAX_LOBES, OUTPUTS_PER_LOBE, SHEARS, SamplerConfig,
};
use std::f32::consts::{FRAC_1_PI, TAU};

/// Largest random number: what it is to 1 keeps slopes finite.
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// One lobe: a cosine lobe whose slopes t became A t + b.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lobe {
    pub matrix: [[f32; 2]; 2],
    pub inverse: [[f32; 2]; 2],
    pub centre: [f32; 2],
    /// 1 / (pi |det A|).
    pub scale: f32,
}

/// The mixture of one query: where light matters to it.
#[derive(Clone, Copy, Debug)]
pub struct Lobes {
    lobes: [Lobe; MAX_LOBES + 1],
    weights: [f32; MAX_LOBES + 1],
    count: usize,
}

/// The value within bounds; NaN becomes the lower one.
pub(super) fn bounded(value: f32, [low, high]: [f32; 2]) -> f32 {
    if value > low { value.min(high) } else { low }
}

/// The mirrored slope of wo.
pub(super) fn mirrored(wo: [f32; 2], min_z: f32) -> [f32; 2] {
    let z = crate::query::unit(wo)[2].max(min_z);
    [-wo[0] / z, -wo[1] / z]
}

/// Weights of the cosine and of the lobes from their logits.
pub(super) fn softmax(logits: &[f32], out: &mut [f32]) {
    let most = logits.iter().fold(0.0f32, |most, logit| most.max(*logit));
    out[0] = (-most).exp();
    for (weight, logit) in out[1..].iter_mut().zip(logits) {
        *weight = (logit - most).exp();
    }
    let sum: f32 = out[..=logits.len()].iter().sum();
    out[..=logits.len()].iter_mut().for_each(|weight| *weight /= sum);
}

impl Lobe {
    /// The cosine lobe.
    pub fn cosine() -> Self {
        let one = [[1.0, 0.0], [0.0, 1.0]];
        Self { matrix: one, inverse: one, centre: [0.0; 2], scale: FRAC_1_PI }
    }

    /// The lobe of a frame from centre and shape [c.x, c.y, p, r, q], which are in bounds.
    pub fn new(frame: Frame, mirror: [f32; 2], [cx, cy, p, r, q]: [f32; 5]) -> Self {
        let (a, d) = (p.exp(), q.exp());
        let lower = [[a, 0.0], [r * a, d]];
        let inverse = [[1.0 / a, 0.0], [-r / d, 1.0 / d]];
        let scale = FRAC_1_PI / (a * d);
        if frame == Frame::Surface {
            return Self { matrix: lower, inverse, centre: [cx, cy], scale };
        }
        let [x, y] = mirror;
        let stretch = [[1.0 + x * x, x * y], [x * y, 1.0 + y * y]];
        let area = 1.0 + x * x + y * y;
        // The adjugate of the stretch over its determinant: no difference of nearly equal numbers.
        let back = [[stretch[1][1] / area, -x * y / area], [-x * y / area, stretch[0][0] / area]];
        let [tx, ty] = apply(stretch, [cx, cy]);
        Self {
            matrix: product(stretch, lower),
            inverse: product(inverse, back),
            centre: [x + tx, y + ty],
            scale: scale / area,
        }
    }

    /// v = A^-1 ((x, y) - b z).
    pub fn unmoved(&self, [x, y, z]: [f32; 3]) -> [f32; 2] {
        apply(self.inverse, [x - self.centre[0] * z, y - self.centre[1] * z])
    }

    /// Density over solid angle at a unit vector above the horizon.
    fn pdf(&self, wi: [f32; 3]) -> f32 {
        let [v, w] = self.unmoved(wi);
        let size = wi[2] * wi[2] + v * v + w * w;
        self.scale * wi[2] / (size * size)
    }
}

fn apply(m: [[f32; 2]; 2], [x, y]: [f32; 2]) -> [f32; 2] {
    [m[0][0] * x + m[0][1] * y, m[1][0] * x + m[1][1] * y]
}

fn product(a: [[f32; 2]; 2], b: [[f32; 2]; 2]) -> [[f32; 2]; 2] {
    let entry = |i: usize, j: usize| a[i][0] * b[0][j] + a[i][1] * b[1][j];
    [[entry(0, 0), entry(0, 1)], [entry(1, 0), entry(1, 1)]]
}

impl Lobes {
    /// The cosine alone.
    pub fn cosine() -> Self {
        let mut this =
            Self { lobes: [Lobe::cosine(); MAX_LOBES + 1], weights: [0.0; MAX_LOBES + 1], count: 1 };
        this.weights[0] = 1.0;
        this
    }

    /// What the network's outputs mean where the viewer is at `wo`.
    pub fn new(config: &SamplerConfig, outputs: &[f32], wo: [f32; 2]) -> Self {
        let mut this = Self::cosine();
        let mirror = mirrored(wo, config.min_z);
        let mut logits = [0.0; MAX_LOBES];
        let lobes = config.lobes.iter().zip(outputs.chunks_exact(OUTPUTS_PER_LOBE)).take(MAX_LOBES);
        for (k, (frame, out)) in lobes.enumerate() {
            logits[k] = bounded(out[0], LOGITS);
            let bounds = [CENTRES, CENTRES, LOG_SCALES, SHEARS, LOG_SCALES];
            let shape = std::array::from_fn(|i| bounded(out[1 + i], bounds[i]));
            this.lobes[k + 1] = Lobe::new(*frame, mirror, shape);
            this.count = k + 2;
        }
        softmax(&logits[..this.count - 1], &mut this.weights);
        for weight in &mut this.weights[..this.count] {
            *weight *= 1.0 - config.cosine_floor;
        }
        this.weights[0] += config.cosine_floor;
        this
    }

    /// A direction, and its density over solid angle, from two numbers in [0, 1). The direction is a unit vector above the
    /// horizon.
    pub fn sample(&self, xi: [f32; 2]) -> ([f32; 3], f32) {
        let mut rest = bounded(xi[0], [0.0, BELOW_ONE]);
        let mut chosen = 0;
        while chosen + 1 < self.count && rest >= self.weights[chosen] {
            rest -= self.weights[chosen];
            chosen += 1;
        }
        let (sin, cos) = (TAU * (rest / self.weights[chosen]).min(1.0)).sin_cos();
        let along = bounded(xi[1], [0.0, BELOW_ONE]);
        let radius = (along / (1.0 - along)).sqrt();
        let lobe = &self.lobes[chosen];
        let [x, y] = apply(lobe.matrix, [radius * cos, radius * sin]);
        let [x, y] = [x + lobe.centre[0], y + lobe.centre[1]];
        let z = 1.0 / (1.0 + x * x + y * y).sqrt();
        let wi = [x * z, y * z, z];
        (wi, self.pdf(wi))
    }

    /// Density over solid angle of a unit vector; 0 on and below the horizon.
    pub fn pdf(&self, wi: [f32; 3]) -> f32 {
        if wi[2] > 0.0 {
            let lobes = self.lobes.iter().zip(&self.weights).take(self.count);
            lobes.map(|(lobe, weight)| weight * lobe.pdf(wi)).sum()
        } else {
            0.0
        }
    }

    /// Weights of the cosine and of the lobes; their sum is 1.
    pub fn weights(&self) -> &[f32] {
        &self.weights[..self.count]
    }
}
