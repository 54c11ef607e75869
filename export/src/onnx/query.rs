//! The inputs of a graph as it uses them: the position wrapped, the level clamped, directions measured.

use super::builder::{Builder, Value};

/// A direction \[N, 2\] and its length.
pub struct Direction {
    /// (x, y).
    pub xy: Value,
    /// x^2 + y^2, \[N, 1\].
    pub square: Value,
}

impl Direction {
    /// Measures an input.
    pub fn new(b: &mut Builder, name: &str, xy: Value) -> Self {
        b.scope(name);
        let squares = b.mul("squares", &xy, &xy);
        let square = b.row_sum("square", &squares);
        Self { xy, square }
    }

    /// z = sqrt(max(0, 1 - x^2 - y^2)), \[N, 1\].
    pub fn z(&self, b: &mut Builder, name: &str) -> Value {
        let rest = b.one_minus(&format!("{name}.z.signed_square"), &self.square);
        let square = b.at_least(&format!("{name}.z.square"), &rest, 0.0);
        b.node("Sqrt", &format!("{name}.z"), &[&square], &[])
    }

    /// Whether the direction is above the horizon, \[N, 1\].
    pub fn above(&self, b: &mut Builder, name: &str) -> Value {
        let one = b.scalar(1.0);
        b.node("Less", &format!("{name}.above"), &[&self.square, &one], &[])
    }

    /// (x, y, z), \[N, 3\].
    pub fn with_z(&self, b: &mut Builder, name: &str) -> Value {
        let z = self.z(b, name);
        b.concat(name, &[&self.xy, &z], 1)
    }
}

/// u - floor(u).
pub fn wrapped(b: &mut Builder, u: &Value) -> Value {
    b.scope("query");
    let floor = b.floor("u.floor", u);
    b.sub("u.wrapped", u, &floor)
}

/// The level from 0 to the coarsest, \[N, 1\].
pub fn clamped(b: &mut Builder, level: &Value, coarsest: usize) -> Value {
    b.scope("query");
    let level = b.unsqueeze("level.column", level, &[1]);
    b.clip("level", &level, 0.0, coarsest as f32)
}

/// The level counted from the finest stored one, \[N, 1\].
pub fn stored(b: &mut Builder, level: &Value, finest: usize) -> Value {
    if finest == 0 {
        return level.clone();
    }
    let finest = b.scalar(finest as f32);
    let level = b.sub("level.from_finest", level, &finest);
    b.at_least("level.stored", &level, 0.0)
}

/// 0 \[N, 1\] made from a value \[N, columns\] that the answer does not depend on, so that every graph reads
/// every input.
pub fn nothing_of(b: &mut Builder, name: &str, value: &Value) -> Value {
    b.scope("query");
    let zeros = b.clip(&format!("{name}.ignored"), value, 0.0, 0.0);
    b.row_sum(&format!("{name}.nothing"), &zeros)
}
