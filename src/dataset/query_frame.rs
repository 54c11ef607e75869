//! A query buffer with its answers as one self-contained EXR, for evaluation views and for other tools.
//!
//! Channels R, G, B in half floats and u.x, u.y, wi.x, wi.y, wo.x, wo.y, level in single floats, in the
//! conventions of `query.rs`; readers take either precision for any of them.

use super::frame::{Plane, read_frame, write_frame};
use crate::{
    error::{Error, Result},
    query::{QueryBuffer, RgbImage},
};
use half::f16;
use std::path::Path;

const CHANNELS: [&str; 10] = ["R", "G", "B", "u.x", "u.y", "wi.x", "wi.y", "wo.x", "wo.y", "level"];

/// Writes queries and answers of the same shape; returns the bytes written.
///
/// # Errors
/// `Config` if the shapes differ, `File` if it cannot be written.
pub fn write_query_frame(path: &Path, queries: &QueryBuffer, rgb: &RgbImage) -> Result<u64> {
    let size = [queries.height(), queries.width()];
    if [rgb.height, rgb.width] != size || rgb.pixels.len() != queries.len() {
        return Err(Error::config(
            "rgb",
            format!("is {} x {} where the queries are {} x {}", rgb.height, rgb.width, size[0], size[1]),
        ));
    }
    let mut planes: Vec<(&str, Plane)> = Vec::with_capacity(CHANNELS.len());
    for c in 0..3 {
        planes.push((CHANNELS[c], Plane::Half(rgb.pixels.iter().map(|p| to_half(p[c])).collect())));
    }
    for (k, vectors) in [&queries.u, &queries.wi, &queries.wo].into_iter().enumerate() {
        for c in 0..2 {
            planes.push((CHANNELS[3 + 2 * k + c], Plane::Float(vectors.iter().map(|v| v[c]).collect())));
        }
    }
    planes.push((CHANNELS[9], Plane::Float(queries.level.clone())));
    write_frame(path, size, planes)
}

/// Reads queries and answers.
///
/// # Errors
/// `File` if it is not such a frame or a value is not finite.
pub fn read_query_frame(path: &Path) -> Result<(QueryBuffer, RgbImage)> {
    let (size, planes) = read_frame(path, None, &CHANNELS)?;
    query_frame(path, size, planes)
}

/// Reads a frame whose size is known.
pub(crate) fn read_query_frame_of(path: &Path, size: [usize; 2]) -> Result<(QueryBuffer, RgbImage)> {
    let (size, planes) = read_frame(path, Some(size), &CHANNELS)?;
    query_frame(path, size, planes)
}

fn query_frame(path: &Path, size: [usize; 2], planes: Vec<Plane>) -> Result<(QueryBuffer, RgbImage)> {
    let mut values: Vec<Vec<f32>> = planes.into_iter().map(Plane::into_f32).collect();
    let level = values.pop().unwrap_or_default();
    let pairs = |k: usize| values[k].iter().zip(&values[k + 1]).map(|(x, y)| [*x, *y]).collect();
    let queries = QueryBuffer::new(size[0], size[1], pairs(3), pairs(5), pairs(7), level)
        .map_err(|e| Error::file(path, e))?;
    let pixels: Vec<[f32; 3]> =
        (0..queries.len()).map(|k| [values[0][k], values[1][k], values[2][k]]).collect();
    if let Some(k) = pixels.as_flattened().iter().position(|v| !v.is_finite()) {
        return Err(Error::file(path, format!("pixel {} is not finite", k / 3)));
    }
    Ok((queries, RgbImage { height: size[0], width: size[1], pixels }))
}

/// The nearest half float; values beyond its range become its largest.
pub(crate) fn to_half(value: f32) -> f16 {
    f16::from_f32(value.clamp(-f16::MAX.to_f32(), f16::MAX.to_f32()))
}
