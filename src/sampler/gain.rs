//! What a sampler gains: the variance of an estimate of reflected radiance from one direction, beside cosine sampling.
//!
//! The reflected radiance is the integral of answer x radiance over the hemisphere. One direction of density p estimates it with
//! the variance integral((answer radiance)^2 / p) - integral(answer radiance)^2. For every query, under a light that is turned
//! at random, both integrals are estimated from the same directions for the cosine and for the mixture: some drawn by the
//! cosine, some by the mixture, some along the horizon, some towards what is bright, all weighted by their joint density. So neither technique's
//! lucky misses of the sun, or of the horizon, count for it.

use super::Part;
use super::condition::{Conditions, conditions};
use super::horizon;
use super::light::{FURNACE, Light, SKY, Turned};
use super::lobe::Lobes;
use super::material::MaterialSampler;
use super::value;
use crate::error::{Error, Result};
use crate::random::{Random, Stream};
use rayon::prelude::*;
use serde::Serialize;

/// Queries that are measured where nothing else is asked for.
pub const CONDITIONS: usize = 2048;
/// Most queries.
const MOST_CONDITIONS: usize = 1 << 20;
/// Directions of each.
const DIRECTIONS: usize = 1024;
/// Share of the directions for each cone of bright light, and of the rest for the horizon.
const BRIGHT: f64 = 0.25;
const HORIZON: f64 = 0.25;
/// Queries of a task.
const CHUNK: usize = 16;

/// Variances under one light, means over queries.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Gain {
    /// The light.
    pub light: String,
    /// Queries.
    pub conditions: usize,
    /// Directions of each.
    pub directions: usize,
    /// Mean variance of cosine sampling.
    pub cosine: f64,
    /// Mean variance of the mixture.
    pub mixture: f64,
    /// `mixture` over `cosine`; 1 where both are 0.
    pub ratio: f64,
    /// Standard error of `ratio` over the queries.
    pub error: f64,
    /// Median of the queries' own ratios.
    pub median: f64,
    /// One query in ten has a larger ratio.
    pub worst_decile: f64,
}

/// The gain under a furnace and under a sky, each over `n` queries that were not fitted.
///
/// # Errors
/// As [`gain`].
pub fn gains(sampler: &MaterialSampler, n: usize, seed: u64) -> Result<Vec<Gain>> {
    [FURNACE, SKY].iter().map(|light| gain(sampler, light, n, seed)).collect()
}

/// The gain under one light over `n` queries that were not fitted.
///
/// # Errors
/// `Config` if `n` is out of bounds, the decoder reads neighbours or an answer is not finite.
pub fn gain(sampler: &MaterialSampler, light: &Light, n: usize, seed: u64) -> Result<Gain> {
    if !(2..=MOST_CONDITIONS).contains(&n) {
        let problem = format!("{n} is outside 2 to {MOST_CONDITIONS}");
        return Err(Error::config("sampler.conditions", problem));
    }
    let chunks = (0..n).into_par_iter().step_by(CHUNK).map(|at| {
        let asked = conditions(
            sampler.material().architecture().coarsest(),
            Part::HeldOut,
            seed,
            at as u64,
            CHUNK.min(n - at),
        );
        let lobes = sampler.lobes(&asked.u, &asked.level, &asked.wo)?;
        let each = lobes.iter().enumerate().map(|(k, lobes)| {
            let mut random =
                Random::sub_stream(seed, Stream::Sampler, Part::Measured as u64, (at + k) as u64);
            let light = Turned::new(light, &mut random);
            variances(sampler, &asked, k, lobes, &light, &mut random)
        });
        each.collect::<Result<Vec<_>>>()
    });
    let mut pairs = Vec::with_capacity(n);
    for chunk in chunks.collect::<Vec<_>>() {
        pairs.extend(chunk?);
    }
    Ok(summary(light.name, &pairs))
}

fn summary(light: &str, pairs: &[[f64; 2]]) -> Gain {
    let n = pairs.len() as f64;
    let mean = |k: usize| pairs.iter().map(|pair| pair[k]).sum::<f64>() / n;
    let (cosine, mixture) = (mean(0), mean(1));
    let of = |[cosine, mixture]: [f64; 2]| if cosine == mixture { 1.0 } else { mixture / cosine };
    let ratio = of([cosine, mixture]);
    // The delta method: the spread of what a query adds to the ratio.
    let spread = pairs.iter().map(|[c, m]| (m - ratio * c).powi(2)).sum::<f64>() / (n - 1.0);
    let error = if cosine > 0.0 { (spread / n).sqrt() / cosine } else { 0.0 };
    let mut ratios: Vec<f64> = pairs.iter().map(|pair| of(*pair)).collect();
    ratios.sort_by(f64::total_cmp);
    Gain {
        light: light.into(),
        conditions: pairs.len(),
        directions: DIRECTIONS,
        cosine,
        mixture,
        ratio,
        error,
        median: ratios[ratios.len() / 2],
        worst_decile: ratios[ratios.len() * 9 / 10],
    }
}

/// Variances of one estimate of query `k`: by the cosine, by the mixture.
pub(super) fn variances(
    sampler: &MaterialSampler,
    asked: &Conditions,
    k: usize,
    lobes: &Lobes,
    light: &Turned,
    random: &mut Random,
) -> Result<[f64; 2]> {
    let cosine = Lobes::cosine();
    let cones = light.cones();
    let per_cone = (BRIGHT * DIRECTIONS as f64) as usize;
    let plain = DIRECTIONS - per_cone * cones;
    let mut wi = Vec::with_capacity(DIRECTIONS);
    for i in 0..DIRECTIONS {
        let xi = [random.uniform(), random.uniform()];
        wi.push(match i.checked_sub(plain) {
            None if i % 8 < 3 => cosine.sample(xi).0,
            None if i % 8 < 6 => lobes.sample(xi).0,
            None => horizon::sample(xi),
            Some(beyond) => light.towards(beyond / per_cone, xi),
        });
    }
    // Directions below the horizon are asked for where nothing is reflected.
    let stored: Vec<[f32; 2]> = wi.iter().map(|w| crate::query::project(*w)).collect();
    let (u, level, wo) = (asked.u[k], asked.level[k], asked.wo[k]);
    let n = DIRECTIONS;
    let prepared = sampler.material().prepare(&vec![u; n], &vec![level; n], &vec![wo; n])?;
    let rgb = sampler.material().light(&prepared, &stored)?;
    let share = plain as f64 / n as f64;
    let (mut mean, mut square, mut moments) = (0.0, 0.0, [0.0; 2]);
    for (wi, rgb) in wi.iter().zip(rgb) {
        let lit = f64::from(value(rgb)) * f64::from(light.radiance(*wi));
        // Lower ones are above or below the horizon by the last bits of x and y.
        if lit == 0.0 || wi[2] < horizon::LOWEST {
            continue;
        }
        let densities = [&cosine, lobes].map(|by| f64::from(by.pdf(*wi)));
        let plain = 0.5 * (1.0 - HORIZON) * (densities[0] + densities[1]);
        let plain = plain + HORIZON * f64::from(horizon::density(*wi));
        let joint = share * plain + BRIGHT * light.density(*wi);
        mean += lit / joint / n as f64;
        square += (lit / joint).powi(2) / n as f64;
        for (moment, density) in moments.iter_mut().zip(densities) {
            *moment += lit * lit / (density * joint) / n as f64;
        }
    }
    // The square of an estimated mean is too large by the estimate's own variance.
    let squared = mean * mean - (square - mean * mean).max(0.0) / n as f64;
    Ok(moments.map(|moment| (moment - squared).max(0.0)))
}
