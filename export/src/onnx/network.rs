//! Fully connected networks, the parallax module and the output head.

use super::builder::{Builder, Value};
use super::encoding::Column;
use super::inception;
use super::query::Direction;
use super::texture::{Table, lookup};
use crate::checkpoint::Checkpoint;
use crate::config::{
    DECODER_MLP, LevelSize, OFFSET_MLP, OFFSET_TEXTURE, OffsetConfig, OutputSpace, OutputTransform,
    YUV_TO_RGB, bias_name, weight_name,
};
use crate::error::{Error, Result};
use crate::precision::{Precision, Storage};
use crate::tensors::Tensor;
use std::collections::BTreeMap;

/// A network whose weights are stored as a precision says.
#[derive(Clone, Copy)]
pub struct Network<'a> {
    /// Its tensors.
    tensors: &'a BTreeMap<String, Tensor>,
    prefix: &'a str,
    layers: usize,
    weights: Precision,
}

impl<'a> Network<'a> {
    /// The network of `layers` layers whose tensors start with `prefix`.
    pub fn new(
        tensors: &'a BTreeMap<String, Tensor>,
        prefix: &'a str,
        layers: usize,
        weights: Precision,
    ) -> Self {
        Self { tensors, prefix, layers, weights }
    }

    /// relu(x W^T + b) layer by layer, the last one linear. `columns` says where the first layer's columns come from;
    /// absent: they are as stored.
    pub fn run(&self, b: &mut Builder, x: &Value, columns: Option<&[Column]>) -> Result<Value> {
        let first = self.first(b, x, columns, None)?;
        self.rest(b, first)
    }

    /// The first layer without its ReLU; `partial` sums stand for the bias where they are given.
    pub fn first(
        &self,
        b: &mut Builder,
        x: &Value,
        columns: Option<&[Column]>,
        partial: Option<&Value>,
    ) -> Result<Value> {
        self.layer(b, 0, x, columns, partial)
    }

    /// Everything after the first layer's sums.
    pub fn rest(&self, b: &mut Builder, sums: Value) -> Result<Value> {
        let mut x = sums;
        for layer in 1..self.layers {
            x = b.node("Relu", &format!("layer{}.relu", layer - 1), &[&x], &[]);
            x = self.layer(b, layer, &x, None, None)?;
        }
        Ok(x)
    }

    fn layer(
        &self,
        b: &mut Builder,
        layer: usize,
        x: &Value,
        columns: Option<&[Column]>,
        partial: Option<&Value>,
    ) -> Result<Value> {
        let name = weight_name(self.prefix, layer);
        let weight = self.tensor(&name)?;
        let weight = match columns {
            None => self.constant(b, &name, &weight.shape, &weight.data),
            // An amplitude other than 1 makes numbers that are no half floats.
            Some(columns) => {
                let data: Vec<f32> = weight
                    .data
                    .chunks(weight.shape[1])
                    .flat_map(|row| columns.iter().map(|c| c.map_or(0.0, |(input, f)| row[input] * f)))
                    .collect();
                b.floats(&format!("{name}.reordered"), &[weight.shape[0], columns.len()], &data)
            }
        };
        let bias = match partial {
            Some(partial) => partial.clone(),
            None => {
                let name = bias_name(self.prefix, layer);
                let bias = self.tensor(&name)?;
                self.constant(b, &name, &bias.shape, &bias.data)
            }
        };
        Ok(b.node("Gemm", &format!("layer{layer}"), &[x, &weight, &bias], &[("transB", 1)]))
    }

    fn constant(&self, b: &mut Builder, name: &str, shape: &[usize], data: &[f32]) -> Value {
        match self.weights {
            Precision::Half => {
                let halfs = b.halfs(name, shape, data);
                b.float_of(name, &halfs)
            }
            _ => b.floats(name, shape, data),
        }
    }

    fn tensor(&self, name: &str) -> Result<&'a Tensor> {
        self.tensors.get(name).ok_or_else(|| Error::config(format!("tensor {name}"), "is missing"))
    }
}

/// The decoder of a model whose answers do not depend on their neighbours.
pub fn decoder(checkpoint: &Checkpoint, weights: Precision) -> Network<'_> {
    let layers = checkpoint.header.architecture.decoder_widths().map_or(0, |w| w.len() - 1);
    Network::new(&checkpoint.tensors, DECODER_MLP, layers, weights)
}

/// u' = u + 0.5 r wo.xy / max(wo.z, min_z), r = scale * MLP(texture(u), wo.xy).
pub fn parallax(
    b: &mut Builder,
    checkpoint: &Checkpoint,
    storage: Storage,
    offset: &OffsetConfig,
    u: &Value,
    wo: &Direction,
) -> Result<Value> {
    b.scope("parallax");
    let [height, width] = checkpoint.header.architecture.finest_size();
    let table = Table::new(b, OFFSET_TEXTURE, checkpoint, &[OFFSET_TEXTURE.into()], storage.textures)?;
    let features = lookup(b, u, u, &table, &[LevelSize { height, width, base: 0 }]);
    let input = b.concat("input", &[&features, &wo.xy], 1);
    let network = Network::new(&checkpoint.tensors, OFFSET_MLP, offset.hidden.len() + 1, storage.weights);
    let depth = network.run(b, &input, None)?;
    let depth = b.scale("depth", &depth, 0.5 * offset.scale);
    let along = b.mul("along", &depth, &wo.xy);
    let z = wo.z(b, "wo");
    let z = b.at_least("wo.z.least", &z, offset.min_z);
    let shift = b.node("Div", "shift", &[&along, &z], &[]);
    Ok(b.add("u.shifted", u, &shift))
}

/// The decoder network: outputs \[N, 3 or 6\]. `shape` is that of the queries before they became N rows.
pub fn decode(
    b: &mut Builder,
    checkpoint: &Checkpoint,
    weights: Precision,
    parts: &[&Value],
    columns: &[Column],
    shape: Option<&Value>,
) -> Result<Value> {
    b.scope("decoder");
    let input = b.concat("input", parts, 1);
    match shape {
        Some(shape) => inception::decode(b, checkpoint, &input, columns, shape),
        None => decoder(checkpoint, weights).run(b, &input, Some(columns)),
    }
}

/// Turns the decoder's outputs into RGB \[N, 3\], 0 where light or view are not above the horizon.
pub fn rgb(b: &mut Builder, checkpoint: &Checkpoint, outputs: Value, lit: &Value, seen: &Value) -> Value {
    b.scope("output");
    let config = &checkpoint.header.architecture.model.output;
    let (mut colour, mask) = if config.mask {
        let (colour, mask) = b.split_in_two("parts", &outputs, 1, [3, 3]);
        (colour, Some(mask))
    } else {
        (outputs, None)
    };
    if config.space == OutputSpace::Yuv {
        let transposed: Vec<f32> = (0..9).map(|i| YUV_TO_RGB[i % 3][i / 3]).collect();
        let matrix = b.floats("output.yuv_to_rgb", &[3, 3], &transposed);
        colour = b.node("MatMul", "yuv_to_rgb", &[&colour, &matrix], &[]);
    }
    if config.transform == OutputTransform::ExpMinusOne {
        let grown = b.node("Exp", "exp", &[&colour], &[]);
        let one = b.scalar(1.0);
        colour = b.sub("exp_minus_one", &grown, &one);
    }
    if let Some(mask) = mask {
        let sigmoid = b.node("Sigmoid", "sigmoid", &[&mask], &[]);
        let least = b.scalar(0.1);
        let mask = b.add("mask", &sigmoid, &least);
        colour = b.mul("masked", &colour, &mask);
    }
    let colour = b.at_least("clamped", &colour, 0.0);
    let above = b.node("And", "above_horizon", &[lit, seen], &[]);
    let zero = b.scalar(0.0);
    b.node("Where", "shown", &[&above, &colour, &zero], &[])
}
