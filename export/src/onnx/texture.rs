//! Wrapped bilinear and trilinear texture lookup by arithmetic and one Gather (GridSample cannot wrap).

use super::builder::{Builder, Value};
use crate::checkpoint::Checkpoint;
use crate::config::LevelSize;
use crate::error::Result;
use crate::precision::{Precision, byte_factors, bytes_of};

/// Texels \[texels, C\] of all levels of a texture, row by row as in [`LevelSize::base`].
pub struct Table {
    values: Value,
    /// Values are cast to 32-bit floats after they are gathered: the table stays small in an engine that keeps it as it is.
    cast: bool,
    /// Factors of the channels, where values are bytes.
    factors: Option<Value>,
}

impl Table {
    /// Stores the texture of a checkpoint whose `levels` are given, finest first, as the constant `name`.
    ///
    /// # Errors
    /// `Config`, naming the tensor that is missing or not rounded.
    pub fn new(
        b: &mut Builder,
        name: &str,
        checkpoint: &Checkpoint,
        levels: &[String],
        precision: Precision,
    ) -> Result<Self> {
        let mut texels = Vec::new();
        let mut channels = 1;
        for level in levels {
            let tensor = checkpoint.tensor(level)?;
            channels = tensor.shape[2];
            texels.extend_from_slice(&tensor.data);
        }
        let shape = [texels.len() / channels, channels];
        Ok(match precision {
            Precision::Single => Self { values: b.floats(name, &shape, &texels), cast: false, factors: None },
            Precision::Half => Self { values: b.halfs(name, &shape, &texels), cast: true, factors: None },
            Precision::Byte => {
                let factors = byte_factors(checkpoint, levels)?;
                let values = b.bytes(name, &shape, bytes_of(&texels, &factors));
                let factors = b.floats(&format!("{name}.factors"), &[channels], &factors);
                Self { values, cast: true, factors: Some(factors) }
            }
        })
    }

    /// The texels of these rows as 32-bit floats, before the factors.
    fn gather(&self, b: &mut Builder, rows: &Value) -> Value {
        if !self.cast {
            return b.gather("values", &self.values, rows);
        }
        let stored = b.gather("values.stored", &self.values, rows);
        b.float_of("values", &stored)
    }
}

/// The L levels that take part in a lookup, as \[N, L\] or, where L is 1, as scalars.
struct Levels {
    width: Value,
    height: Value,
    /// Width as an integer.
    stride: Value,
    /// First texel and weight, where L is 2.
    mix: Option<(Value, Value)>,
}

/// Two taps along one axis, \[N, L\] each.
struct Axis {
    /// Wrapped texel indices.
    taps: [Value; 2],
    /// Their weights.
    weights: [Value; 2],
}

/// Looks a texture pyramid up: `u` \[N, 2\] and, where there are several levels, `level` \[N, 1\] within the
/// pyramid. Returns \[N, C\].
///
/// All arithmetic is on \[N, L\]: broadcasting a short last axis costs onnxruntime more than the operation
/// itself.
pub fn lookup(b: &mut Builder, u: &Value, level: &Value, table: &Table, sizes: &[LevelSize]) -> Value {
    let levels = match sizes {
        [size] => Levels {
            width: b.scalar(size.width as f32),
            height: b.scalar(size.height as f32),
            stride: b.int32(size.width as i32),
            mix: None,
        },
        _ => two_levels(b, level, sizes),
    };
    let (column, row) = b.split_in_two("u", u, 1, [1, 1]);
    let x = axis(b, "x", &column, &levels.width);
    let y = axis(b, "y", &row, &levels.height);

    let (mut texels, mut weights) = (Vec::new(), Vec::new());
    for (row, mut row_weight) in y.taps.iter().zip(y.weights) {
        // Texel = base + row * width + column, in integers: f32 counts to 2^24 only.
        let mut start = b.mul("row", row, &levels.stride);
        if let Some((base, weight)) = &levels.mix {
            start = b.add("row.from_base", &start, base);
            row_weight = b.mul("row.weight", &row_weight, weight);
        }
        for (column, column_weight) in x.taps.iter().zip(&x.weights) {
            texels.push(b.add("texel", &start, column));
            weights.push(b.mul("weight", &row_weight, column_weight));
        }
    }
    let texels = b.concat("texels", &texels.iter().collect::<Vec<_>>(), 1);
    let weights = b.concat("weights", &weights.iter().collect::<Vec<_>>(), 1);
    let values = table.gather(b, &texels);
    let weights = b.unsqueeze("weights.row", &weights, &[1]);
    let sum = b.node("MatMul", "sum", &[&weights, &values], &[]);
    let features = b.squeeze("features", &sum, &[1]);
    match &table.factors {
        None => features,
        Some(factors) => b.mul("features.scaled", &features, factors),
    }
}

/// The two levels around `level`.
fn two_levels(b: &mut Builder, level: &Value, sizes: &[LevelSize]) -> Levels {
    let column = |get: fn(&LevelSize) -> usize| sizes.iter().map(|s| get(s) as f32).collect::<Vec<_>>();
    let shape = [sizes.len()];
    let widths = b.floats("texture.widths", &shape, &column(|s| s.width));
    let heights = b.floats("texture.heights", &shape, &column(|s| s.height));
    let bases: Vec<i32> = sizes.iter().map(|s| s.base as i32).collect();
    let bases = b.int32s("texture.bases", &shape, &bases);

    let fine = b.floor("level.fine", level);
    let one = b.scalar(1.0);
    let next = b.add("level.next", &fine, &one);
    let coarse = b.clip("level.coarse", &next, 0.0, (sizes.len() - 1) as f32);
    let fraction = b.sub("level.fraction", level, &fine);
    let rest = b.one_minus("level.rest", &fraction);
    let pair = b.concat("level.pair", &[&fine, &coarse], 1);
    let pair = b.int32_of("level.index", &pair);
    let weight = b.concat("level.weights", &[&rest, &fraction], 1);
    let width = b.gather("width", &widths, &pair);
    let height = b.gather("height", &heights, &pair);
    let base = b.gather("base", &bases, &pair);
    let stride = b.int32_of("stride", &width);
    Levels { width, height, stride, mix: Some((base, weight)) }
}

/// Taps and weights along one axis: `position` \[N, 1\] in tiles, `size` in texels.
fn axis(b: &mut Builder, name: &str, position: &Value, size: &Value) -> Axis {
    let texels = b.mul(&format!("{name}.texels"), position, size);
    let half = b.scalar(0.5);
    let centre = b.sub(&format!("{name}.centre"), &texels, &half);
    let first = b.floor(&format!("{name}.first"), &centre);
    let fraction = b.sub(&format!("{name}.fraction"), &centre, &first);
    let rest = b.one_minus(&format!("{name}.rest"), &fraction);

    let first = b.wrap(&format!("{name}.first.wrapped"), &first, size);
    let one = b.scalar(1.0);
    let second = b.add(&format!("{name}.second"), &first, &one);
    let second = b.wrap(&format!("{name}.second.wrapped"), &second, size);
    let taps = [("first", first), ("second", second)]
        .map(|(tap, value)| b.int32_of(&format!("{name}.{tap}.index"), &value));
    Axis { taps, weights: [rest, fraction] }
}
