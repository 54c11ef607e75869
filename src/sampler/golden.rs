//! Golden samples: what every reader of a sampler has to reproduce.

use super::Part;
use super::lobe::Lobes;
use super::material::MaterialSampler;
use crate::error::{Error, Result};
use crate::golden::queries;
use crate::query::above_horizon;
use crate::random::{Random, Stream};
use neumip_export::SamplerGolden;
use neumip_export::checkpoint::Checkpoint;
use neumip_export::sampler::Sampler;

/// Largest difference of a component of wi: features that 32-bit networks move by 1e-5, through a network, and the slopes of
/// lobes.
pub const TOLERANCE: f64 = 2e-4;
/// Largest difference of a density over that density: the same, divided by a lobe's width.
pub const PDF_TOLERANCE: f64 = 4e-3;
/// How far the network's outputs are moved, and the two numbers, to see whether a query asks for more digits than 32-bit
/// readers have: near the border of two lobes, or in the tail of a narrow one.
const SHAKE: f32 = 1e-5;
/// What the shaken sample may use of the tolerances.
const ROOM: f64 = 0.5;
/// Largest random number below 1.
const LAST: f32 = 1.0 - f32::EPSILON / 2.0;
/// Queries looked at for each that is taken.
const TRIES: usize = 32;

/// `n` golden samples of a checkpoint's sampler, edges among them, without those that 32-bit readers cannot agree on.
///
/// # Errors
/// `Config` if the sampler is not the material's, the decoder reads neighbours, `n` is 0, or the sampler is so sharp that
/// too few queries are left.
pub fn golden(checkpoint: &Checkpoint, sampler: &Sampler, n: usize, seed: u64) -> Result<SamplerGolden> {
    if n == 0 {
        return Err(Error::config("golden.n", "at least one sample is needed"));
    }
    let sampler = MaterialSampler::from_checkpoint(checkpoint, sampler)?;
    let mut golden = SamplerGolden {
        tolerance: TOLERANCE,
        pdf_tolerance: PDF_TOLERANCE,
        u: Vec::new(),
        wo: Vec::new(),
        level: Vec::new(),
        xi: Vec::new(),
        wi: Vec::new(),
        pdf: Vec::new(),
    };
    let queries = queries(sampler.material().architecture(), n.saturating_mul(TRIES), seed);
    for at in (0..queries.len()).step_by(n) {
        let part = queries.range(at, at + n);
        let outputs =
            sampler.outputs(&sampler.material().features(&part.u, &part.level, &part.wo)?, &part.wo)?;
        for (k, outputs) in outputs.chunks_exact(sampler.width()).enumerate() {
            let wo = part.wo[k];
            let xi = numbers(seed, (at + k) as u64);
            let (wi, pdf) = Lobes::new(sampler.config(), outputs, wo).sample(xi);
            if golden.u.len() == n || !above_horizon(wo) || !steady(&sampler, outputs, wo, xi, (wi, pdf)) {
                continue;
            }
            golden.u.push(part.u[k]);
            golden.wo.push(wo);
            golden.level.push(part.level[k]);
            golden.xi.push(xi);
            golden.wi.push(wi);
            golden.pdf.push(pdf);
        }
        if golden.u.len() == n {
            return Ok(golden);
        }
    }
    let problem = format!("only {} of {n} golden samples can be told in 32-bit floats", golden.u.len());
    Err(Error::config("sampler", problem))
}

/// Two random numbers; one pair in eight has an edge.
fn numbers(seed: u64, index: u64) -> [f32; 2] {
    let mut random = Random::sub_stream(seed, Stream::Sampler, Part::Golden as u64, index);
    let xi = [random.uniform(), random.uniform()];
    match random.below(32) {
        0 => [0.0, xi[1]],
        1 => [LAST, xi[1]],
        2 => [xi[0], 0.0],
        3 => [xi[0], LAST],
        _ => xi,
    }
}

/// True if outputs and numbers that are a little off give nearly the same.
fn steady(
    sampler: &MaterialSampler,
    outputs: &[f32],
    wo: [f32; 2],
    xi: [f32; 2],
    (wi, pdf): ([f32; 3], f32),
) -> bool {
    // Every other output the other way, so that differences of logits move too.
    [[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]].iter().all(|[even, odd]| {
        let shaken = outputs.iter().enumerate().map(|(i, x)| {
            let sign = if i % 2 == 0 { even } else { odd };
            x + sign * SHAKE * (1.0 + x.abs())
        });
        let lobes = Lobes::new(sampler.config(), &shaken.collect::<Vec<_>>(), wo);
        // The length of the slope takes its number as it is; the angle's was reduced by weights that moved.
        let (other, _) = lobes.sample([(xi[0] + even * SHAKE).clamp(0.0, LAST), xi[1]]);
        let moved = wi.iter().zip(other).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
        let change = f64::from((lobes.pdf(wi) - pdf).abs());
        moved <= ROOM * TOLERANCE && change <= ROOM * PDF_TOLERANCE * f64::from(pdf) && pdf > 0.0
    })
}
