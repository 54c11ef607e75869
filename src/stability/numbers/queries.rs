//! Queries that try to break an answerer: every edge of what a query may be, and ordinary ones between them.

use crate::query::QueryBuffer;
use crate::random::{Random, Stream};
use neumip_export::config::Architecture;

/// Seed of all probes of numbers.
pub const SEED: u64 = 7;
/// Positions far away: a thousand tiles of a long walk, and beyond what floats tell apart.
const FAR: f32 = 1e4;
const LOST: f32 = 1e30;
/// Below the normal numbers of f32.
const DENORMAL: f32 = 1e-40;
/// The next number below 1.
const UNDER_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// `n` queries of one row; the `part`-th such buffer, no two of which share random numbers. Every other query is ordinary.
pub fn adversarial(architecture: &Architecture, n: usize, part: u64) -> QueryBuffer {
    let mut random = Random::sub_stream(SEED, Stream::Probe, 2, part);
    let mut queries = QueryBuffer::slice(1, n, [0.0; 2], [0.0; 2], 0.0);
    let coarsest = architecture.coarsest();
    for k in 0..n {
        let bits = random.next_u32();
        let side = architecture.resolution[1] >> (bits as usize % (coarsest + 1));
        let ordinary = k.is_multiple_of(2);
        for axis in 0..2 {
            let x = random.uniform();
            queries.u[k][axis] = if ordinary { x } else { position(x, side.max(1), bits >> (5 * axis + 4)) };
        }
        let (wi, wo) = (random.disc(1.0), random.disc(1.0));
        (queries.wi[k], queries.wo[k]) = match (ordinary, bits >> 29) {
            (true, _) => (wi, wo),
            (_, 0) => (wi, wi),
            (_, 1) => (wi, wi.map(|x| -x)),
            _ => (direction(wi, bits >> 14), direction(wo, bits >> 19)),
        };
        let x = random.uniform();
        let last = coarsest as f32;
        queries.level[k] = if ordinary { x * last } else { level(x, last, bits >> 24) };
    }
    queries
}

/// A position made of a uniform one.
fn position(x: f32, side: usize, kind: u32) -> f32 {
    let texel = (x * side as f32).floor();
    let sign = if x < 0.5 { -1.0 } else { 1.0 };
    match kind % 16 {
        0 | 1 => texel / side as f32,
        2 | 3 => (texel + 0.5) / side as f32,
        4 => 0.0,
        5 => 1.0,
        6 => UNDER_ONE,
        7 => -f32::EPSILON * x,
        8 => sign * DENORMAL,
        9 => sign * FAR * x,
        10 => sign * FAR,
        11 => sign * LOST,
        12 => sign * f32::MAX,
        13 => -0.0,
        _ => 20.0 * x - 10.0,
    }
}

/// A direction made of one above the horizon.
fn direction(w: [f32; 2], kind: u32) -> [f32; 2] {
    let length = (w[0] * w[0] + w[1] * w[1]).sqrt().max(f32::MIN_POSITIVE);
    let unit = w.map(|x| x / length);
    match kind % 16 {
        // Squared lengths of 1 and a few roundings around it.
        0..=2 => unit.map(|x| x * UNDER_ONE),
        3 => unit,
        4 => unit.map(|x| x * (1.0 + f32::EPSILON)),
        5 => [UNDER_ONE.sqrt(), 0.0],
        6 => [0.0, -1.0],
        7 => [1.0 + f32::EPSILON, 0.0],
        8 => unit.map(|x| 1.5 * x),
        9 => unit.map(|x| x * LOST),
        10 => [f32::MAX, -f32::MAX],
        11 => [DENORMAL, -DENORMAL],
        12 => [0.0, 0.0],
        13 => [-0.0, w[1]],
        _ => unit.map(|x| 0.9999 * x),
    }
}

/// A level made of a uniform number.
fn level(x: f32, coarsest: f32, kind: u32) -> f32 {
    match kind % 16 {
        0 => -LOST,
        1 => LOST,
        2 => -f32::MAX,
        3 => f32::MAX,
        4 => -0.0,
        5 => DENORMAL,
        6 => coarsest.next_up(),
        7 => coarsest.next_down(),
        8..=10 => (x * coarsest).round(),
        11 => -x,
        12 => coarsest + 3.0 * x,
        _ => x * coarsest,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::query::above_horizon;

    #[test]
    fn every_edge_is_met_and_parts_differ() {
        let model = Config::preset("improved").unwrap().model;
        let architecture = Architecture::new(model, [64, 64]).unwrap();
        let queries = adversarial(&architecture, 1 << 14, 0);
        let x: Vec<f32> = queries.u.iter().map(|u| u[0]).collect();
        for edge in [0.0, 1.0, UNDER_ONE, FAR, -FAR, LOST, -LOST, f32::MAX, -f32::MAX, DENORMAL] {
            assert!(x.contains(&edge), "no position {edge}");
        }
        let coarsest = architecture.coarsest() as f32;
        for edge in [-LOST, LOST, f32::MAX, DENORMAL, coarsest.next_up(), coarsest.next_down(), coarsest] {
            assert!(queries.level.contains(&edge), "no level {edge}");
        }
        let squares: Vec<f32> = queries.wo.iter().map(|w| w[0] * w[0] + w[1] * w[1]).collect();
        for edge in [1.0, UNDER_ONE, f32::INFINITY, 0.0] {
            assert!(squares.contains(&edge), "no squared length {edge}");
        }
        let lit =
            queries.wi.iter().zip(&queries.wo).filter(|(i, o)| above_horizon(**i) && above_horizon(**o));
        assert!(lit.count() > queries.len() / 2);
        assert!(queries.wi.iter().zip(&queries.wo).any(|(i, o)| i == o));
        assert_ne!(queries, adversarial(&architecture, 1 << 14, 1));
        assert_eq!(queries, adversarial(&architecture, 1 << 14, 0));
    }
}
