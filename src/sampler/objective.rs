//! What a step of fitting sees: a few queries, directions that the mixture and an explorer drew for them, and the slopes of the
//! network's weights.

use super::Part;
use super::condition::Conditions;
use super::gradient::{Drawn, loss};
use super::horizon;
use super::lobe::Lobes;
use super::network::Network;
use super::value;
use crate::engine::FusedMaterial;
use crate::error::Result;
use crate::random::{Random, Stream};
use neumip_export::sampler::{Frame, OUTPUTS_PER_LOBE, SamplerConfig};

/// Directions of a query, in turn by the mixture, the explorer, the mixture and along the horizon.
const DIRECTIONS: usize = 32;
/// Shares of the three.
const SHARES: [f32; 3] = [0.5, 0.25, 0.25];
/// Shapes of the explorer's lobes: nearly uniform, and two around the mirror direction that find highlights of any width
/// within a few steps.
const EXPLORER: [(Frame, f32); 3] = [(Frame::Surface, 0.8), (Frame::Mirror, -2.5), (Frame::Mirror, -1.0)];

/// What is fitted, and to what.
pub(super) struct Objective<'a> {
    pub material: &'a FusedMaterial,
    pub config: &'a SamplerConfig,
    pub seed: u64,
    pub scale: Scale,
}

/// How the network's inputs are brought to mean 0 and deviation 1, so that one rate suits them all.
#[derive(Clone, Debug)]
pub(super) struct Scale {
    pub mean: Vec<f32>,
    pub inverse: Vec<f32>,
}

/// The deviation of wo.x and wo.y, over the viewers that are fitted.
const WO_DEVIATION: f32 = 0.6;

impl Scale {
    /// The scale of features [queries][channels] followed by wo.
    pub fn new(features: &[f32], channels: usize) -> Self {
        let n = (features.len() / channels) as f64;
        let (mut mean, mut square) = (vec![0.0f64; channels], vec![0.0f64; channels]);
        for row in features.chunks_exact(channels) {
            for ((mean, square), x) in mean.iter_mut().zip(&mut square).zip(row) {
                *mean += f64::from(*x) / n;
                *square += f64::from(*x).powi(2) / n;
            }
        }
        // A channel that never changes tells nothing: it is left as small as it is.
        let deviation = |(mean, square): (&f64, &f64)| {
            let variance = square - mean * mean;
            if variance > 1e-12 * square { variance.sqrt() } else { square.sqrt().max(1.0) }
        };
        let inverse = mean.iter().zip(&square).map(|pair| (1.0 / deviation(pair)) as f32);
        Self {
            inverse: inverse.chain([1.0 / WO_DEVIATION; 2]).collect(),
            mean: mean.iter().map(|m| *m as f32).chain([0.0; 2]).collect(),
        }
    }

    /// The network's inputs.
    fn apply(&self, features: &[f32], wo: [f32; 2]) -> Vec<f32> {
        let values = features.iter().chain(&wo).zip(&self.mean).zip(&self.inverse);
        values.map(|((x, mean), inverse)| (x - mean) * inverse).collect()
    }

    /// Makes a network that reads scaled inputs read plain ones.
    pub fn fold(&self, network: &mut Network) {
        let Some(first) = network.layers.first_mut() else { return };
        for (row, bias) in first.weight.chunks_exact_mut(self.mean.len()).zip(&mut first.bias) {
            for ((w, mean), inverse) in row.iter_mut().zip(&self.mean).zip(&self.inverse) {
                *w *= inverse;
                *bias -= *w * mean;
            }
        }
    }
}

/// What draws directions that the mixture does not know of yet.
fn explorer(config: &SamplerConfig, wo: [f32; 2]) -> Lobes {
    let config = SamplerConfig { lobes: EXPLORER.map(|(frame, _)| frame).to_vec(), ..config.clone() };
    let outputs = EXPLORER.map(|(_, width)| [0.0, 0.0, 0.0, width, 0.0, width]);
    Lobes::new(&config, outputs.as_flattened(), wo)
}

impl Objective<'_> {
    /// The sum of the losses of a few queries, of which the first is the `at`-th of all, and its slopes by the weights.
    ///
    /// # Errors
    /// As the material's answers.
    pub fn slopes(&self, network: &Network, asked: &Conditions, at: u64) -> Result<(Network, f64)> {
        let Conditions { u, level, wo } = asked;
        let features = self.material.features(u, level, wo)?;
        let prepared = self.material.prepare(u, level, wo)?;
        let channels = self.config.features;
        let mut values = vec![Vec::new(); wo.len()];
        let mut drawn = Vec::with_capacity(wo.len());
        for (k, (values, features)) in values.iter_mut().zip(features.chunks_exact(channels)).enumerate() {
            let outputs = network.forward(&self.scale.apply(features, wo[k]), values);
            let explorer = explorer(self.config, wo[k]);
            let lobes = Lobes::new(self.config, outputs, wo[k]);
            let mut random =
                Random::sub_stream(self.seed, Stream::Sampler, Part::Directions as u64, at + k as u64);
            let draw = |i: usize| {
                let xi = [random.uniform(), random.uniform()];
                let wi = match i % 4 {
                    1 => explorer.sample(xi).0,
                    3 => horizon::sample(xi),
                    _ => lobes.sample(xi).0,
                };
                let densities = [lobes.pdf(wi), explorer.pdf(wi), horizon::density(wi)];
                let density = densities.iter().zip(SHARES).map(|(density, share)| density * share).sum();
                Drawn { wi, answer: 0.0, density }
            };
            drawn.push((0..DIRECTIONS).map(draw).collect::<Vec<_>>());
        }
        for i in 0..DIRECTIONS {
            let wi: Vec<[f32; 2]> = drawn.iter().map(|d| [d[i].wi[0], d[i].wi[1]]).collect();
            for (drawn, rgb) in drawn.iter_mut().zip(self.material.light(&prepared, &wi)?) {
                drawn[i].answer = value(rgb);
            }
        }
        let mut gradient = network.zeros();
        let mut total = 0.0;
        for ((values, drawn), wo) in values.iter().zip(&drawn).zip(wo) {
            let mut slopes = vec![0.0; OUTPUTS_PER_LOBE * self.config.lobes.len()];
            let outputs = values.last().map_or(&[][..], Vec::as_slice);
            total += f64::from(loss(self.config, outputs, *wo, drawn, &mut slopes));
            network.back(values, &slopes, &mut gradient);
        }
        Ok((gradient, total))
    }
}
