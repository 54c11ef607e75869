//! The Inception decoder over periodic images: Conv and MaxPool without padding, on images that were wrapped before.
//!
//! Padding has no mode that wraps before opset 19, so rows and columns are gathered by indices modulo the image's size, which
//! also serves images smaller than the margin.

use super::builder::{Builder, Value};
use super::encoding::Column;
use crate::checkpoint::Checkpoint;
use crate::config::{Convolution, DECODER};
use crate::error::Result;

/// Axes of rows and columns.
const ROWS: i64 = 2;
const COLUMNS: i64 = 3;

/// Indices that wrap an image by a margin.
struct Margin {
    size: usize,
    rows: Value,
    columns: Value,
}

impl Margin {
    /// The margin of images whose queries have the shape \[N, H, W\].
    fn new(b: &mut Builder, size: usize, shape: &Value) -> Self {
        let indices = |b: &mut Builder, axis: i64, name: &str| {
            let name = format!("margin{size}.{name}");
            let at = b.int64(axis);
            let count = b.gather(&format!("{name}.count"), shape, &at);
            let margin = b.int64(size as i64);
            let (start, step) = (b.int64(-(size as i64)), b.int64(1));
            let end = b.add(&format!("{name}.end"), &count, &margin);
            let unwrapped = b.node("Range", &format!("{name}.unwrapped"), &[&start, &end, &step], &[]);
            b.node("Mod", &name, &[&unwrapped, &count], &[("fmod", 0)])
        };
        // Of [N, H, W].
        let (rows, columns) = (indices(b, 1, "rows"), indices(b, 2, "columns"));
        Self { size, rows, columns }
    }

    fn wrap(&self, b: &mut Builder, name: &str, x: &Value) -> Value {
        let name = format!("{name}.wrapped{}", self.size);
        let rows = b.node("Gather", &format!("{name}.rows"), &[x, &self.rows], &[("axis", ROWS)]);
        b.node("Gather", &name, &[&rows, &self.columns], &[("axis", COLUMNS)])
    }
}

/// Convolutions under construction.
struct Layers<'a> {
    checkpoint: &'a Checkpoint,
    convolutions: std::vec::IntoIter<Convolution>,
    margins: [Margin; 2],
}

impl Layers<'_> {
    /// The next convolution of x \[N, in, H, W\]; `columns` says where its inputs come from, absent: they are as stored.
    fn next(&mut self, b: &mut Builder, x: &Value, columns: Option<&[Column]>) -> Result<Value> {
        let Some(shape) = self.convolutions.next() else { return Ok(x.clone()) };
        let name = shape.name.trim_start_matches(DECODER).trim_start_matches('.').to_string();
        let x = match self.margins.iter().find(|m| m.size == shape.side / 2) {
            Some(margin) => margin.wrap(b, &name, x),
            None => x.clone(),
        };
        let [(weight, _), (bias, _)] = shape.tensors();
        let (stored, side) = (self.checkpoint.tensor(&weight)?, shape.side);
        let weight = match columns {
            None => b.floats(&weight, &stored.shape, &stored.data),
            Some(columns) => {
                let rows = stored.data.chunks(shape.inputs);
                let data: Vec<f32> = rows
                    .flat_map(|row| columns.iter().map(|c| c.map_or(0.0, |(input, f)| row[input] * f)))
                    .collect();
                b.floats(&format!("{weight}.reordered"), &[shape.outputs, columns.len(), 1, 1], &data)
            }
        };
        let stored = self.checkpoint.tensor(&bias)?;
        let bias = b.floats(&bias, &stored.shape, &stored.data);
        let side = side as i64;
        let lists: [(&str, &[i64]); 4] = [
            ("kernel_shape", &[side, side]),
            ("strides", &[1, 1]),
            ("pads", &[0, 0, 0, 0]),
            ("dilations", &[1, 1]),
        ];
        Ok(b.node_of("Conv", &name, &[&x, &weight, &bias], &[("group", 1)], &lists))
    }

    /// The largest of the 3 x 3 around each pixel.
    fn largest(&self, b: &mut Builder, name: &str, x: &Value) -> Value {
        let x = self.margins[0].wrap(b, name, x);
        let lists: [(&str, &[i64]); 3] =
            [("kernel_shape", &[3, 3]), ("strides", &[1, 1]), ("pads", &[0, 0, 0, 0])];
        b.node_of("MaxPool", name, &[&x], &[("ceil_mode", 0)], &lists)
    }
}

/// The decoder network: outputs \[M, 3 or 6\] of the joined input \[M, columns\], the M = N H W samples of images whose queries
/// have the shape \[N, H, W\].
pub fn decode(
    b: &mut Builder,
    checkpoint: &Checkpoint,
    input: &Value,
    columns: &[Column],
    shape: &Value,
) -> Result<Value> {
    let channels = b.axes(&[columns.len() as i64]);
    let images = b.node("Concat", "images.shape", &[shape, &channels], &[("axis", 0)]);
    let images = b.node("Reshape", "images", &[input, &images], &[]);
    let mut x = b.node_of("Transpose", "channels_first", &[&images], &[], &[("perm", &[0, 3, 1, 2])]);

    let convolutions = checkpoint.header.architecture.convolutions();
    // One first, one last, six a module.
    let modules = (convolutions.len() - 2) / 6;
    let margins = [Margin::new(b, 1, shape), Margin::new(b, 2, shape)];
    let mut layers = Layers { checkpoint, convolutions: convolutions.into_iter(), margins };
    x = layers.next(b, &x, Some(columns))?;
    x = b.node("Relu", "in.relu", &[&x], &[]);
    for module in 0..modules {
        let mut paths = vec![layers.next(b, &x, None)?];
        for path in [2, 3] {
            let reduced = layers.next(b, &x, None)?;
            let reduced = b.node("Relu", &format!("module{module}.path{path}.reduce.relu"), &[&reduced], &[]);
            paths.push(layers.next(b, &reduced, None)?);
        }
        let most = layers.largest(b, &format!("module{module}.path4.largest"), &x);
        paths.push(layers.next(b, &most, None)?);
        x = b.concat(&format!("module{module}.paths"), &paths.iter().collect::<Vec<_>>(), 1);
        x = b.node("Relu", &format!("module{module}.relu"), &[&x], &[]);
    }
    x = layers.next(b, &x, None)?;
    let x = b.node_of("Transpose", "channels_last", &[&x], &[], &[("perm", &[0, 2, 3, 1])]);
    let flat = b.axes(&[-1, checkpoint.header.architecture.decoder_outputs() as i64]);
    Ok(b.node("Reshape", "outputs", &[&x, &flat], &[]))
}
