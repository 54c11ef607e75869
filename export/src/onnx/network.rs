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
use crate::error::Result;
use crate::precision::Precision;

/// relu(x W^T + b) layer by layer, the last one linear. `columns` says where the first layer's columns come
/// from; absent: they are as stored.
fn mlp(
    b: &mut Builder,
    checkpoint: &Checkpoint,
    prefix: &str,
    layers: usize,
    input: Value,
    columns: Option<&[Column]>,
) -> Result<Value> {
    let mut x = input;
    for layer in 0..layers {
        let name = weight_name(prefix, layer);
        let weight = checkpoint.tensor(&name)?;
        let weight = match columns.filter(|_| layer == 0) {
            None => b.floats(&name, &weight.shape, &weight.data),
            Some(columns) => {
                let data: Vec<f32> = weight
                    .data
                    .chunks(weight.shape[1])
                    .flat_map(|row| columns.iter().map(|c| c.map_or(0.0, |(input, f)| row[input] * f)))
                    .collect();
                b.floats(&format!("{name}.reordered"), &[weight.shape[0], columns.len()], &data)
            }
        };
        let name = bias_name(prefix, layer);
        let bias = checkpoint.tensor(&name)?;
        let bias = b.floats(&name, &bias.shape, &bias.data);
        x = b.node("Gemm", &format!("layer{layer}"), &[&x, &weight, &bias], &[("transB", 1)]);
        if layer + 1 < layers {
            x = b.node("Relu", &format!("layer{layer}.relu"), &[&x], &[]);
        }
    }
    Ok(x)
}

/// u' = u + 0.5 r wo.xy / max(wo.z, min_z), r = scale * MLP(texture(u), wo.xy).
pub fn parallax(
    b: &mut Builder,
    checkpoint: &Checkpoint,
    precision: Precision,
    offset: &OffsetConfig,
    u: &Value,
    wo: &Direction,
) -> Result<Value> {
    b.scope("parallax");
    let [height, width] = checkpoint.header.architecture.finest_size();
    let values = &checkpoint.tensor(OFFSET_TEXTURE)?.data;
    let shape = [height * width, offset.channels];
    let table = Table::new(b, OFFSET_TEXTURE, shape, values, precision);
    let features = lookup(b, u, u, &table, &[LevelSize { height, width, base: 0 }]);
    let input = b.concat("input", &[&features, &wo.xy], 1);
    let depth = mlp(b, checkpoint, OFFSET_MLP, offset.hidden.len() + 1, input, None)?;
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
    parts: &[&Value],
    columns: &[Column],
    shape: Option<&Value>,
) -> Result<Value> {
    b.scope("decoder");
    let input = b.concat("input", parts, 1);
    match shape {
        Some(shape) => inception::decode(b, checkpoint, &input, columns, shape),
        None => {
            let layers = checkpoint.header.architecture.decoder_widths().map_or(0, |w| w.len() - 1);
            mlp(b, checkpoint, DECODER_MLP, layers, input, Some(columns))
        }
    }
}

/// Turns the decoder's outputs into RGB \[N, 3\], 0 below the horizon.
pub fn rgb(
    b: &mut Builder,
    checkpoint: &Checkpoint,
    outputs: Value,
    wi: &Direction,
    wo: &Direction,
) -> Value {
    b.scope("output");
    let config = &checkpoint.header.architecture.model.output;
    let (mut colour, mask) = if config.mask {
        let (colour, mask) = b.split("parts", &outputs, 3, 3);
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
    let one = b.scalar(1.0);
    let lit = b.node("Less", "wi.above", &[&wi.square, &one], &[]);
    let seen = b.node("Less", "wo.above", &[&wo.square, &one], &[]);
    let above = b.node("And", "above_horizon", &[&lit, &seen], &[]);
    let zero = b.scalar(0.0);
    b.node("Where", "shown", &[&above, &colour, &zero], &[])
}
