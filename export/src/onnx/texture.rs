//! Wrapped bilinear and trilinear texture lookup by arithmetic and one Gather (GridSample cannot wrap).

use super::builder::{Builder, Value};
use crate::config::LevelSize;

/// The L levels that take part in a lookup, as \[N, L, 1\] or, where L is 1, as scalars.
struct Levels {
    width: Value,
    height: Value,
    /// Width as an integer.
    stride: Value,
    /// First texel and weight, where L is 2.
    mix: Option<(Value, Value)>,
}

/// One axis of a lookup, \[N, L, 2\].
struct Axis {
    /// Wrapped texel indices.
    taps: Value,
    /// Their weights.
    weights: Value,
}

/// Looks a texture pyramid up: `u` \[N, 2\] and, where there are several levels, `level` \[N, 1\] within the pyramid.
/// `table` is \[texels, C\], all levels row by row as in [`LevelSize::base`]. Returns \[N, C\].
pub fn lookup(b: &mut Builder, u: &Value, level: &Value, table: &Value, sizes: &[LevelSize]) -> Value {
    let levels = match sizes {
        [size] => Levels {
            width: b.scalar(size.width as f32),
            height: b.scalar(size.height as f32),
            stride: b.int32(size.width as i32),
            mix: None,
        },
        _ => two_levels(b, level, sizes),
    };
    let (column, row) = b.split("u", u, 1, 1);
    let x = axis(b, "x", &column, &levels.width);
    let mut y = axis(b, "y", &row, &levels.height);

    // Texel = base + row * width + column, in integers: f32 counts to 2^24 only.
    let mut rows = b.mul("rows", &y.taps, &levels.stride);
    if let Some((base, weight)) = &levels.mix {
        rows = b.add("rows.from_base", &rows, base);
        y.weights = b.mul("y.weights.mixed", &y.weights, weight);
    }
    let grid = |b: &mut Builder, name: &str, op: &str, y: &Value, x: &Value| {
        let y = b.unsqueeze(&format!("{name}.y"), y, &[3]);
        let x = b.unsqueeze(&format!("{name}.x"), x, &[2]);
        let grid = b.node(op, &format!("{name}.grid"), &[&y, &x], &[]);
        b.node("Flatten", name, &[&grid], &[("axis", 1)])
    };
    let texels = grid(b, "texels", "Add", &rows, &x.taps);
    let weights = grid(b, "weights", "Mul", &y.weights, &x.weights);

    let values = b.gather("values", table, &texels);
    let weights = b.unsqueeze("weights.row", &weights, &[1]);
    let sum = b.node("MatMul", "sum", &[&weights, &values], &[]);
    let axes = b.axes(&[1]);
    b.node("Squeeze", "features", &[&sum, &axes], &[])
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
    let mut stack = |name: &str, fine: &Value, coarse: &Value| {
        let pair = b.concat(&format!("{name}.pair"), &[fine, coarse], 1);
        b.unsqueeze(name, &pair, &[2])
    };
    let pair = stack("level.both", &fine, &coarse);
    let weight = stack("level.weights", &rest, &fraction);
    let pair = b.to_int32("level.index", &pair);
    let width = b.gather("width", &widths, &pair);
    let height = b.gather("height", &heights, &pair);
    let base = b.gather("base", &bases, &pair);
    let stride = b.to_int32("stride", &width);
    Levels { width, height, stride, mix: Some((base, weight)) }
}

/// Taps and weights along one axis: `position` \[N, 1\] in tiles, `size` in texels.
fn axis(b: &mut Builder, name: &str, position: &Value, size: &Value) -> Axis {
    let position = b.unsqueeze(&format!("{name}.position"), position, &[2]);
    let texels = b.mul(&format!("{name}.texels"), &position, size);
    let half = b.scalar(0.5);
    let centre = b.sub(&format!("{name}.centre"), &texels, &half);
    let first = b.floor(&format!("{name}.first"), &centre);
    let fraction = b.sub(&format!("{name}.fraction"), &centre, &first);
    let rest = b.one_minus(&format!("{name}.rest"), &fraction);
    let weights = b.concat(&format!("{name}.weights"), &[&rest, &fraction], 2);

    let steps = b.floats("taps", &[2], &[0.0, 1.0]);
    let taps = b.add(&format!("{name}.unwrapped"), &first, &steps);
    let wrapped = b.wrap(&format!("{name}.wrapped"), &taps, size);
    let taps = b.to_int32(&format!("{name}.taps"), &wrapped);
    Axis { taps, weights }
}
