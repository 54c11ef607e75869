//! What a mixture costs on directions of one query, and the slopes of that by the network's outputs.
//!
//! With answers F at directions drawn by density q, the noise of the estimator F / p is told by its second moment over the
//! square of its mean, M = mean(F^2 / (p q)) / mean(F / q)^2: 1 where p follows F exactly, and 1 more than its variance over
//! its squared mean. The loss is ln M: every query counts alike, dark ones as bright ones, and one that is far from its
//! light does not drown the others. The same p is the best under a light of which nothing is known but that no direction is
//! brighter than another.

use super::lobe::{Lobe, bounded, mirrored, softmax};
use neumip_export::sampler::{
    CENTRES, LOG_SCALES, LOGITS, MAX_LOBES, OUTPUTS_PER_LOBE, SHEARS, SamplerConfig,
};
use std::f32::consts::FRAC_1_PI;

/// Bounds of a lobe's outputs: logit, c.x, c.y, p, r, q.
const BOUNDS: [[f32; 2]; OUTPUTS_PER_LOBE] = [LOGITS, CENTRES, CENTRES, LOG_SCALES, SHEARS, LOG_SCALES];

/// A direction with what is known of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drawn {
    /// Unit vector above the horizon.
    pub wi: [f32; 3],
    /// The material's answer as one number.
    pub answer: f32,
    /// Density that drew it.
    pub density: f32,
}

/// A lobe and what its slopes need.
#[derive(Clone, Copy, Debug, Default)]
struct Shaped {
    lobe: Lobe,
    /// e^p, e^q, r.
    widths: [f32; 2],
    shear: f32,
}

impl Shaped {
    /// Density at a direction, and the slopes of its logarithm by c.x, c.y, p, r, q.
    fn at(&self, [x, y, z]: [f32; 3]) -> (f32, [f32; OUTPUTS_PER_LOBE - 1]) {
        let [v, w] = self.lobe.unmoved([x, y, z]);
        let size = z * z + v * v + w * w;
        let (by_v, by_w) = (-4.0 * v / size, -4.0 * w / size);
        let [wide, high] = self.widths;
        let slopes = [
            -z / wide * by_v + self.shear * z / high * by_w,
            -z / high * by_w,
            -1.0 - v * by_v,
            -v * wide / high * by_w,
            -1.0 - w * by_w,
        ];
        (self.lobe.scale * z / (size * size), slopes)
    }
}

/// ln M of a query seen from `wo`; its slopes by the outputs are added to `slopes`. 0, without slopes, where every answer is
/// black.
pub(super) fn loss(
    config: &SamplerConfig,
    outputs: &[f32],
    wo: [f32; 2],
    drawn: &[Drawn],
    slopes: &mut [f32],
) -> f32 {
    let mirror = mirrored(wo, config.min_z);
    let count = config.lobes.len();
    let mut logits = [0.0; MAX_LOBES];
    let mut shaped = [Shaped::default(); MAX_LOBES];
    for (k, out) in outputs.chunks_exact(OUTPUTS_PER_LOBE).enumerate() {
        let values: [f32; OUTPUTS_PER_LOBE] = std::array::from_fn(|i| bounded(out[i], BOUNDS[i]));
        let [logit, shape @ ..] = values;
        let [_, _, p, shear, q] = shape;
        logits[k] = logit;
        let lobe = Lobe::new(config.lobes[k], mirror, shape);
        shaped[k] = Shaped { lobe, widths: [p.exp(), q.exp()], shear };
    }
    let mut share = [0.0; MAX_LOBES + 1];
    softmax(&logits[..count], &mut share);
    let free = 1.0 - config.cosine_floor;
    let (mut mean, mut moment) = (0.0f32, 0.0f32);
    let mut pulls = [[0.0f32; OUTPUTS_PER_LOBE]; MAX_LOBES];
    for Drawn { wi, answer, density } in drawn {
        let cosine = wi[2] * FRAC_1_PI;
        let mut mixture = share[0] * cosine;
        let mut each = [(0.0, [0.0; OUTPUTS_PER_LOBE - 1]); MAX_LOBES];
        for ((each, shaped), share) in each.iter_mut().zip(&shaped).zip(&share[1..]).take(count) {
            *each = shaped.at(*wi);
            mixture += share * each.0;
        }
        let p = free * mixture + config.cosine_floor * cosine;
        let term = answer * answer / (density * p);
        mean += answer / density;
        moment += term;
        // The slope of a term is -term times that of ln p.
        let pull = term * free / p;
        let lobes = pulls.iter_mut().zip(&each).zip(&share[1..]).take(count);
        for ((pulls, (density, slopes)), share) in lobes {
            pulls[0] -= pull * share * (density - mixture);
            for (to, slope) in pulls[1..].iter_mut().zip(slopes) {
                *to -= pull * share * density * slope;
            }
        }
    }
    if !(mean > 0.0 && moment > 0.0 && (moment / mean).is_finite()) {
        return 0.0;
    }
    for ((slope, pull), (k, out)) in
        slopes.iter_mut().zip(pulls.as_flattened()).zip(outputs.iter().enumerate())
    {
        let [low, high] = BOUNDS[k % OUTPUTS_PER_LOBE];
        let by = pull / moment;
        // Beyond a bound only what leads back counts.
        let stuck = (*out <= low && by > 0.0) || (*out >= high && by < 0.0);
        *slope += if stuck { 0.0 } else { by };
    }
    (moment / mean * drawn.len() as f32 / mean).ln()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};
    use neumip_export::sampler::Frame;

    /// Slopes of differences over 2 x 2^-7 of 32-bit losses near 1: their roundings over that step, and its own curvature.
    const SLOPES: f32 = 4e-3;

    #[test]
    fn slopes_are_those_of_differences_and_a_changed_one_is_noticed() {
        let config = SamplerConfig {
            features: 1,
            hidden: vec![1],
            lobes: vec![Frame::Surface, Frame::Mirror],
            cosine_floor: 0.1,
            min_z: 0.2,
        };
        let mut random = Random::new(1, Stream::Probe, 0);
        for _ in 0..20 {
            let outputs: Vec<f32> = (0..12).map(|_| 0.5 * random.normal()).collect();
            let wo = random.disc(0.9);
            let drawn: Vec<Drawn> = (0..32)
                .map(|_| {
                    let w = random.disc(0.95);
                    let (wi, answer) = (crate::query::unit(w), random.uniform());
                    Drawn { wi, answer, density: 0.2 + random.uniform() }
                })
                .collect();
            let mut slopes = vec![0.0; 12];
            loss(&config, &outputs, wo, &drawn, &mut slopes);
            let step = 2f32.powi(-7);
            let at = |i: usize, by: f32| {
                let mut moved = outputs.clone();
                moved[i] += by;
                loss(&config, &moved, wo, &drawn, &mut [0.0; 12])
            };
            for (i, slope) in slopes.iter().enumerate() {
                let found = (at(i, step) - at(i, -step)) / (2.0 * step);
                assert!((found - slope).abs() < SLOPES, "{i}: {found} and {slope}");
                assert!((found - slope + 0.01).abs() > SLOPES);
            }
        }
    }

    #[test]
    fn black_answers_pull_nowhere_and_a_bound_lets_nothing_further() {
        let config = SamplerConfig {
            features: 1,
            hidden: vec![1],
            lobes: vec![Frame::Mirror],
            cosine_floor: 0.1,
            min_z: 0.2,
        };
        let black = [Drawn { wi: [0.0, 0.0, 1.0], answer: 0.0, density: 0.3 }; 4];
        let mut slopes = [0.0; 6];
        assert_eq!(loss(&config, &[0.0; 6], [0.1, 0.2], &black, &mut slopes), 0.0);
        assert_eq!(slopes, [0.0; 6]);
        // All light in the mirror direction pulls a lobe narrower, but not below its bound.
        let lit = [Drawn { answer: 1.0, ..black[0] }; 4];
        for (width, expected) in [(-1.0, true), (LOG_SCALES[0], false)] {
            let mut slopes = [0.0; 6];
            loss(&config, &[0.0, 0.0, 0.0, width, 0.0, width], [0.0; 2], &lit, &mut slopes);
            assert_eq!(slopes[3] > 0.0, expected, "{slopes:?}");
        }
    }
}
