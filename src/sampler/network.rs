//! The network that chooses the lobes: forward for one query, and back.

use crate::error::{Error, Result};
use neumip_export::Tensor;
use neumip_export::config::{bias_name, weight_name};
use neumip_export::sampler::{SAMPLER_MLP, Sampler, SamplerConfig};
use std::collections::BTreeMap;

/// One fully connected layer.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Layer {
    /// [out, in].
    pub weight: Vec<f32>,
    /// [out].
    pub bias: Vec<f32>,
}

/// The network.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Network {
    pub layers: Vec<Layer>,
}

impl Network {
    /// The network of a sampler.
    pub fn new(sampler: &Sampler) -> Result<Self> {
        sampler.validate()?;
        let values = |name: String| match sampler.tensors.get(&name) {
            Some(tensor) => Ok(tensor.data.clone()),
            None => Err(Error::config(name, "this tensor is missing")),
        };
        let depth = sampler.header.config.hidden.len() + 1;
        let layer = |k| {
            Ok(Layer {
                weight: values(weight_name(SAMPLER_MLP, k))?,
                bias: values(bias_name(SAMPLER_MLP, k))?,
            })
        };
        Ok(Self { layers: (0..depth).map(layer).collect::<Result<_>>()? })
    }

    /// The tensors of the file.
    pub fn tensors(&self, config: &SamplerConfig) -> BTreeMap<String, Tensor> {
        let values = self.layers.iter().flat_map(|layer| [&layer.weight, &layer.bias]);
        let named = config.tensors().into_iter().zip(values);
        named.map(|((name, shape), data)| (name, Tensor { shape, data: data.clone() })).collect()
    }

    /// Every number, layer by layer, weights before biases.
    pub fn values(&mut self) -> impl Iterator<Item = &mut Vec<f32>> {
        self.layers.iter_mut().flat_map(|layer| [&mut layer.weight, &mut layer.bias])
    }

    /// A network of the same shape, all 0.
    pub fn zeros(&self) -> Self {
        let mut this = self.clone();
        this.values().for_each(|values| values.fill(0.0));
        this
    }

    /// The outputs for one input. `rooms` keeps the inputs of every layer, and the outputs, for [`Network::back`].
    pub fn forward<'a>(&self, input: &[f32], rooms: &'a mut Vec<Vec<f32>>) -> &'a [f32] {
        rooms.resize(self.layers.len() + 1, Vec::new());
        rooms[0].clear();
        rooms[0].extend_from_slice(input);
        let last = self.layers.len() - 1;
        for (k, layer) in self.layers.iter().enumerate() {
            let (before, after) = rooms.split_at_mut(k + 1);
            let (x, out) = (&before[k], &mut after[0]);
            out.clear();
            for (row, bias) in layer.weight.chunks_exact(x.len()).zip(&layer.bias) {
                let sum = row.iter().zip(x).fold(*bias, |sum, (w, x)| sum + w * x);
                out.push(if k < last && sum < 0.0 { 0.0 } else { sum });
            }
        }
        &rooms[self.layers.len()]
    }

    /// Adds the slopes by every weight and bias to `into`, from those by the outputs that [`Network::forward`] left in `rooms`.
    pub fn back(&self, rooms: &[Vec<f32>], outputs: &[f32], into: &mut Self) {
        let mut gradient = outputs.to_vec();
        for (k, layer) in self.layers.iter().enumerate().rev() {
            let x = &rooms[k];
            let mut below = vec![0.0; x.len()];
            let to = &mut into.layers[k];
            let rows = layer.weight.chunks_exact(x.len()).zip(to.weight.chunks_exact_mut(x.len()));
            for ((gradient, bias), (weight, to)) in gradient.iter().zip(&mut to.bias).zip(rows) {
                *bias += gradient;
                for (((below, w), to), x) in below.iter_mut().zip(weight).zip(to).zip(x) {
                    *to += gradient * x;
                    *below += gradient * w;
                }
            }
            if k > 0 {
                for (below, x) in below.iter_mut().zip(x) {
                    *below = if *x > 0.0 { *below } else { 0.0 };
                }
            }
            gradient = below;
        }
    }
}
