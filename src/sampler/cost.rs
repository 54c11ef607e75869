//! What choosing the lobes costs beside the material's own answer.

use super::Part;
use super::condition::{Conditions, conditions};
use super::material::MaterialSampler;
use crate::error::{Error, Result};
use crate::query::{QueryBuffer, Reflectance};
use crate::random::{Random, Stream};
use serde::Serialize;
use std::time::Instant;

/// Queries of a round.
const QUERIES: usize = 1 << 15;

/// Nanoseconds a query on one thread, medians over rounds that take turns.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Cost {
    /// An answer of the material.
    pub answer: f64,
    /// The features of a query, which a renderer that prepares queries looks up anyway.
    pub features: f64,
    /// The lobes of a query whose features are known.
    pub lobes: f64,
    /// A direction and its density.
    pub sample: f64,
}

/// Times a sampler in `rounds` rounds, after one that warms caches.
///
/// # Errors
/// `Config` if the decoder reads neighbours, `Usage` if there are no rounds or no thread can be started.
pub fn cost(sampler: &MaterialSampler, rounds: usize) -> Result<Cost> {
    if rounds == 0 {
        return Err(Error::usage("a timing needs at least one round"));
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    pool.map_err(|e| Error::usage(format!("no thread for a timing: {e}")))?.install(|| timed(sampler, rounds))
}

fn timed(sampler: &MaterialSampler, rounds: usize) -> Result<Cost> {
    let coarsest = sampler.material().architecture().coarsest();
    let Conditions { u, level, wo } = conditions(coarsest, Part::HeldOut, 1, 0, QUERIES);
    let mut random = Random::sub_stream(1, Stream::Sampler, Part::Measured as u64, 0);
    let xi: Vec<[f32; 2]> = (0..QUERIES).map(|_| [random.uniform(), random.uniform()]).collect();
    let queries = QueryBuffer::new(1, QUERIES, u.clone(), xi.clone(), wo.clone(), level.clone())?;
    let mut times: [Vec<f64>; 4] = Default::default();
    for round in 0..=rounds {
        let begun = Instant::now();
        std::hint::black_box(sampler.material().evaluate(&queries)?);
        let answered = Instant::now();
        let features = sampler.material().features(&u, &level, &wo)?;
        let looked = Instant::now();
        let lobes = sampler.lobes_of(&features, &wo)?;
        let chosen = Instant::now();
        let sampled: Vec<_> = lobes.iter().zip(&xi).map(|(lobes, xi)| lobes.sample(*xi)).collect();
        let done = Instant::now();
        std::hint::black_box(sampled);
        if round > 0 {
            let spans = [answered - begun, looked - answered, chosen - looked, done - chosen];
            for (times, span) in times.iter_mut().zip(spans) {
                times.push(1e9 * span.as_secs_f64() / QUERIES as f64);
            }
        }
    }
    let [answer, features, lobes, sample] = times.map(|mut times| {
        times.sort_by(f64::total_cmp);
        times[times.len() / 2]
    });
    Ok(Cost { answer, features, lobes, sample })
}
