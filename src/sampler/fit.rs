//! Fits a sampler to a trained material: steps of Adam on the variance that its mixture would have.

use super::Part;
use super::condition::{Conditions, conditions};
use super::gain::{CONDITIONS, gains};
use super::material::MaterialSampler;
use super::network::{Layer, Network};
use super::objective::{Objective, Scale};
use crate::engine::FusedMaterial;
use crate::error::{Error, Result};
use crate::kernels::simd::Isa;
use crate::random::{Random, Stream};
use neumip_export::Precision;
use neumip_export::checkpoint::Checkpoint;
use neumip_export::sampler::{
    FORMAT, Frame, LOGITS, OUTPUTS_PER_LOBE, Sampler, SamplerConfig, SamplerHeader,
};
use rayon::prelude::*;
use std::f64::consts::PI;
use std::ops::ControlFlow;

/// Queries of a step.
const BATCH: usize = 256;
/// Queries of a task: eight of them share a step, and are added up in order whatever the threads.
const CHUNK: usize = 32;
/// Queries whose features tell their mean and deviation.
const MEASURED: usize = 4096;
/// Most steps: an hour of the largest material.
const MOST_STEPS: u64 = 1_000_000;
/// Highest learning rate; it falls by a cosine.
const RATE: f64 = 1e-2;
/// Steps to the highest rate: the first ones see what the explorer found, and are rough.
const WARM: f64 = 50.0;
/// Adam's constants: the second moment forgets within a hundred steps, since lobes that find a highlight change its scale.
const BETAS: [f64; 2] = [0.9, 0.99];
const EPSILON: f64 = 1e-8;
/// What a mean of the losses forgets a step.
const FORGETS: f64 = 0.02;
/// ln of the first widths of lobes around the normal and around the mirror direction.
const FIRST_WIDTHS: [f32; 2] = [0.3, -1.0];

/// How a sampler is fitted.
#[derive(Clone, Debug)]
pub struct Options {
    /// Widths of the network's hidden layers.
    pub hidden: Vec<usize>,
    /// The lobes besides the cosine.
    pub lobes: Vec<Frame>,
    /// Least weight of the cosine.
    pub cosine_floor: f32,
    /// Least wo.z that divides.
    pub min_z: f32,
    /// Optimiser steps of 256 queries, 32 directions each.
    pub steps: u64,
    /// Queries that the gain is measured on.
    pub measured: usize,
    /// Seed of weights, queries and directions.
    pub seed: u64,
}

impl Default for Options {
    /// What did best for its cost on six materials: a third lobe or layers of 32 take off another tenth, 8 add a fifth.
    fn default() -> Self {
        Self {
            hidden: vec![16, 16],
            lobes: vec![Frame::Surface, Frame::Mirror],
            cosine_floor: 0.1,
            min_z: 0.2,
            steps: 2000,
            measured: CONDITIONS,
            seed: 1,
        }
    }
}

/// Called after every step with the steps done and the mean of the latest losses: the logarithm of the second moment of the
/// estimator over its squared mean. `Break` stops.
pub type Listener<'a> = dyn FnMut(u64, f64) -> ControlFlow<()> + 'a;

/// Fits a sampler to a checkpoint's material, measures it, and falls back to the cosine alone where the mixture is no
/// better. Seed and options decide every byte, whatever the threads. The header's provenance holds `seed`, `steps`, `loss`,
/// `fallback` and `gains` (an array of [`super::Gain`]).
///
/// # Errors
/// `Config` if an option is out of bounds, the decoder reads neighbours or an answer is not finite; `Interrupted` if the
/// listener broke.
pub fn fit(checkpoint: &Checkpoint, options: &Options, listener: &mut Listener) -> Result<Sampler> {
    if !(1..=MOST_STEPS).contains(&options.steps) {
        let problem = format!("{} is outside 1 to {MOST_STEPS}", options.steps);
        return Err(Error::config("sampler.steps", problem));
    }
    let mut architecture = checkpoint.header.architecture.clone();
    // Every query is led to one of the textures' own, so that those are what there is to sample.
    architecture.domain = None;
    let tensors = &checkpoint.tensors;
    let material = FusedMaterial::new(&architecture, tensors, Precision::Single, Isa::chosen()?)?;
    let coarsest = material.architecture().coarsest();
    let config = SamplerConfig {
        features: material.architecture().model.texture.channels,
        hidden: options.hidden.clone(),
        lobes: options.lobes.clone(),
        cosine_floor: options.cosine_floor,
        min_z: options.min_z,
    };
    config.validate()?;
    let Conditions { u, level, wo } = conditions(coarsest, Part::Fitted, options.seed, 0, MEASURED);
    let scale = Scale::new(&material.features(&u, &level, &wo)?, config.features);
    let objective = Objective { material: &material, config: &config, seed: options.seed, scale };
    let mut network = initial(&config, options.seed);
    let loss = descend(&objective, &mut network, options.steps, coarsest, listener)?;
    objective.scale.fold(&mut network);
    let mut sampler = Sampler {
        tensors: network.tensors(&config),
        header: SamplerHeader { format: FORMAT, config, provenance: serde_json::Value::Null },
    };
    let mut measured =
        gains(&MaterialSampler::new(material.clone(), &sampler)?, options.measured, options.seed)?;
    let fallback = !measured.iter().all(|gain| gain.ratio < 1.0);
    if fallback {
        leave_the_cosine(&mut network);
        sampler.tensors = network.tensors(&sampler.header.config);
        measured = gains(&MaterialSampler::new(material, &sampler)?, options.measured, options.seed)?;
    }
    sampler.header.provenance = serde_json::json!({
        "seed": options.seed,
        "steps": options.steps,
        "loss": loss,
        "fallback": fallback,
        "gains": measured,
    });
    sampler.validate()?;
    Ok(sampler)
}

/// Makes a network give every lobe the least weight there is.
fn leave_the_cosine(network: &mut Network) {
    *network = network.zeros();
    if let Some(last) = network.layers.last_mut() {
        last.bias.chunks_exact_mut(OUTPUTS_PER_LOBE).for_each(|out| out[0] = LOGITS[0]);
    }
}

/// Takes all steps; returns the mean of the latest losses.
fn descend(
    objective: &Objective,
    network: &mut Network,
    steps: u64,
    coarsest: usize,
    listener: &mut Listener,
) -> Result<f64> {
    let (mut first, mut second) = (network.zeros(), network.zeros());
    let mut loss = 0.0;
    for step in 0..steps {
        let chunks = (0..BATCH / CHUNK).into_par_iter().map(|chunk| {
            let at = step * BATCH as u64 + (chunk * CHUNK) as u64;
            let asked = conditions(coarsest, Part::Fitted, objective.seed, at, CHUNK);
            objective.slopes(network, &asked, at)
        });
        let mut gradient = network.zeros();
        let mut total = 0.0;
        for chunk in chunks.collect::<Vec<_>>() {
            let (mut slopes, sum) = chunk?;
            total += sum / BATCH as f64;
            for (to, from) in gradient.values().zip(slopes.values()) {
                to.iter_mut().zip(from).for_each(|(to, from)| *to += *from / BATCH as f32);
            }
        }
        loss = if step == 0 { total } else { loss + FORGETS * (total - loss) };
        let t = (step + 1) as f64;
        let rate = RATE * (0.5 + 0.5 * (PI * step as f64 / steps as f64).cos()) * (t / WARM).min(1.0);
        let corrected = rate * (1.0 - BETAS[1].powf(t)).sqrt() / (1.0 - BETAS[0].powf(t));
        let moments = first.values().zip(second.values());
        for ((theta, gradient), (first, second)) in network.values().zip(gradient.values()).zip(moments) {
            adam(theta, gradient, first, second, corrected);
        }
        if listener(step + 1, loss).is_break() {
            return Err(Error::Interrupted("no sampler was written".into()));
        }
    }
    Ok(loss)
}

/// Adam (Kingma and Ba 2015) with a rate that was corrected for the moments' start.
fn adam(theta: &mut [f32], gradient: &[f32], first: &mut [f32], second: &mut [f32], rate: f64) {
    let [keep, keep_square] = BETAS.map(|beta| beta as f32);
    for (((theta, g), first), second) in theta.iter_mut().zip(gradient).zip(first).zip(second) {
        *first = keep * *first + (1.0 - keep) * g;
        *second = keep_square * *second + (1.0 - keep_square) * g * g;
        *theta -= rate as f32 * *first / (second.sqrt() + EPSILON as f32);
    }
}

/// Random hidden layers (He et al. 2015), and lobes at rest that are not all alike.
fn initial(config: &SamplerConfig, seed: u64) -> Network {
    let widths = config.widths();
    let last = widths.len() - 2;
    let layer = |(k, pair): (usize, &[usize])| {
        let mut random = Random::sub_stream(seed, Stream::Sampler, Part::Weights as u64, k as u64);
        let size = if k == last { 0.1 } else { 1.0 } * (2.0 / pair[0] as f32).sqrt();
        let weight = (0..pair[0] * pair[1]).map(|_| size * random.normal()).collect();
        let mut bias = vec![0.0; pair[1]];
        if k == last {
            for (out, frame) in bias.chunks_exact_mut(OUTPUTS_PER_LOBE).zip(&config.lobes) {
                let width = FIRST_WIDTHS[usize::from(*frame == Frame::Mirror)];
                (out[3], out[5]) = (width, width);
            }
        }
        Layer { weight, bias }
    };
    Network { layers: widths.windows(2).enumerate().map(layer).collect() }
}
