//! The inputs of a graph as it uses them: the position wrapped, the level clamped, both led to what the material was fitted
//! for, directions measured.

use super::builder::{Builder, Value};
use crate::config::Architecture;
use crate::domain::Guide;

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
    wrapped_as(b, "u", u)
}

/// The level from 0 to the coarsest, \[N, 1\].
pub fn clamped(b: &mut Builder, level: &Value, coarsest: usize) -> Value {
    b.scope("query");
    let level = b.unsqueeze("level.column", level, &[1]);
    b.clip("level", &level, 0.0, coarsest as f32)
}

/// The position and the level \[N, 1\] that answer: wrapped and clamped, by the domain of a material that has one.
pub fn led(b: &mut Builder, architecture: &Architecture, u: &Value, level: &Value) -> (Value, Value) {
    let Some(guide) = architecture.guide() else {
        return (wrapped(b, u), clamped(b, level, architecture.coarsest()));
    };
    let Guide { corner, scale, part, levels: [finest, coarsest], outside } = guide;
    if !guide.is_window() {
        let u = wrapped(b, u);
        let level = b.unsqueeze("level.column", level, &[1]);
        return (u, b.clip("level", &level, finest, coarsest));
    }
    b.scope("domain");
    let corner = b.floats("domain.corner", &[2], &corner);
    let from_corner = b.sub("u.from_corner", u, &corner);
    let from_corner = wrapped_as(b, "u.from_corner", &from_corner);
    let scale = b.floats("domain.scale", &[2], &scale);
    let local = b.mul("u.local", &from_corner, &scale);
    let windows = b.floor("u.windows", &local);
    let u = b.sub("u.wrapped", &local, &windows);
    // Along an axis that has all of the tile nothing is beyond the window, even where rounding makes a position 1.
    let part = b.floats("domain.part", &[2], &part.map(f32::from));
    let beyond = b.mul("u.beyond", &windows, &part);
    let beyond = b.row_sum("u.all_beyond", &beyond);
    let half = b.scalar(0.5);
    let inside = b.node("Less", "u.inside", &[&beyond, &half], &[]);
    let level = b.unsqueeze("level.column", level, &[1]);
    let within = b.clip("level.within", &level, finest, coarsest);
    let outside = b.scalar(outside);
    (u, b.node("Where", "level", &[&inside, &within, &outside], &[]))
}

fn wrapped_as(b: &mut Builder, name: &str, u: &Value) -> Value {
    let floor = b.floor(&format!("{name}.floor"), u);
    b.sub(&format!("{name}.wrapped"), u, &floor)
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
