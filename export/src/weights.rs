//! The networks' weights as one block of numbers that a shader or a matrix unit can read without a parser.
//!
//! Little-endian, layer after layer: the weight, row-major \[padded outputs\]\[padded inputs\], then the bias
//! \[padded outputs\]. Both sides are padded with zeros to multiples of [`PAD`], the side of the tiles that matrix units
//! multiply, so every row starts at a multiple of 16 values. Two files hold the same values, as 32-bit and as 16-bit
//! floats (the nearest).

use crate::checkpoint::Checkpoint;
use crate::config::{Architecture, DECODER_MLP, OFFSET_MLP, bias_name, weight_name};
use crate::error::{Error, Result};
use crate::sampler::{SAMPLER_MLP, Sampler, SamplerConfig};
use crate::tensors::Tensor;
use half::f16;
use serde::{Deserialize, Serialize};

/// Sides of matrices are padded to multiples of this.
pub const PAD: usize = 16;
/// The file of 32-bit floats.
pub const SINGLE: &str = "weights-f32.bin";
/// The file of 16-bit floats.
pub const HALF: &str = "weights-f16.bin";

/// One layer in the block.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layer {
    /// `offset.mlp`, `decoder.mlp` or `sampler.mlp`.
    pub network: String,
    /// Index in its network.
    pub layer: usize,
    /// Inputs without padding.
    pub inputs: usize,
    /// Outputs without padding.
    pub outputs: usize,
    /// Columns of the weight.
    pub padded_inputs: usize,
    /// Rows of the weight and length of the bias.
    pub padded_outputs: usize,
    /// Where the weight starts, in values.
    pub weight: usize,
    /// Where the bias starts, in values.
    pub bias: usize,
}

/// Where everything is in the block, in values.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layout {
    /// The layers: of the offset network, the decoder and the sampler, where there are any.
    pub layers: Vec<Layer>,
    /// Length of the block.
    pub values: usize,
}

impl Layout {
    /// The layout of a model whose networks are fully connected, and of its sampler.
    pub fn new(architecture: &Architecture, sampler: Option<&SamplerConfig>) -> Self {
        let networks = [
            (OFFSET_MLP, architecture.offset_widths()),
            (DECODER_MLP, architecture.decoder_widths()),
            (SAMPLER_MLP, sampler.map(SamplerConfig::widths)),
        ];
        let mut layout = Self { layers: Vec::new(), values: 0 };
        for (network, widths) in networks {
            for (layer, pair) in widths.unwrap_or_default().windows(2).enumerate() {
                let [padded_inputs, padded_outputs] = [pair[0], pair[1]].map(|n| n.next_multiple_of(PAD));
                let weight = layout.values;
                let bias = weight + padded_inputs * padded_outputs;
                layout.values = bias + padded_outputs;
                layout.layers.push(Layer {
                    network: network.into(),
                    layer,
                    inputs: pair[0],
                    outputs: pair[1],
                    padded_inputs,
                    padded_outputs,
                    weight,
                    bias,
                });
            }
        }
        layout
    }

    /// The layers of one network, in order.
    pub fn network<'a>(&'a self, network: &'a str) -> impl Iterator<Item = &'a Layer> {
        self.layers.iter().filter(move |layer| layer.network == network)
    }

    /// The block of a checkpoint and its sampler.
    ///
    /// # Errors
    /// `Config`, naming the tensor that is missing.
    pub fn fill(&self, checkpoint: &Checkpoint, sampler: Option<&Sampler>) -> Result<Vec<f32>> {
        let find = |name: String| -> Result<&Tensor> {
            let found = checkpoint.tensors.get(&name).or_else(|| sampler?.tensors.get(&name));
            found.ok_or_else(|| Error::config(format!("tensor {name}"), "is missing"))
        };
        let mut block = vec![0.0; self.values];
        for layer in &self.layers {
            let weight = find(weight_name(&layer.network, layer.layer))?;
            let rows = block[layer.weight..layer.bias].chunks_exact_mut(layer.padded_inputs);
            for (row, values) in rows.zip(weight.data.chunks_exact(layer.inputs)) {
                row[..layer.inputs].copy_from_slice(values);
            }
            let bias = find(bias_name(&layer.network, layer.layer))?;
            block[layer.bias..layer.bias + layer.outputs].copy_from_slice(&bias.data);
        }
        Ok(block)
    }
}

/// The bytes of [`SINGLE`].
pub fn single_bytes(block: &[f32]) -> Vec<u8> {
    block.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// The bytes of [`HALF`].
pub fn half_bytes(block: &[f32]) -> Vec<u8> {
    block.iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()).collect()
}
