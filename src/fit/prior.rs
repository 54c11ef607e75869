//! What a size is expected to cost and to lose before any trial: two small models.
//!
//! `chart.json` holds the variants of `results/results.json` that differ from `improved` in one size or two: the geometric mean
//! over materials of their error over that of `improved`, on training directions, so that no choice has seen the test split.
//! `times.json` holds nanoseconds a query of those and of smaller ones, which the chart has not (one thread, AVX-512; from
//! `cargo run --release --example sizes`). Times are linear in the work of an answer, errors are powers of the sizes.

use super::need::Need;
use super::shape::Shape;
use crate::error::{Error, Result};
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Pulls the coefficients of the error towards 0: thirteen variants carry five of them.
const RIDGE: f64 = 0.05;
/// Least time of a query: positions, directions and colours are read and written whatever is computed.
const LEAST_NS: f64 = 10.0;

/// A variant of the chart.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    variant: String,
    shape: Shape,
    error: f64,
}

/// A size and its times.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Timed {
    /// The size.
    pub shape: Shape,
    /// Levels that an answer mixes: 1 or 2.
    pub levels: usize,
    /// Nanoseconds a query.
    pub ns: f64,
    /// The same with textures of half floats.
    pub ns_half: f64,
}

/// The sizes that were timed.
///
/// # Errors
/// `Config` if the stored table cannot be read.
pub fn sizes() -> Result<Vec<Timed>> {
    serde_json::from_str(include_str!("times.json")).map_err(|e| Error::config("times.json", e))
}

/// Expected costs and errors.
#[derive(Clone, Debug)]
pub struct Prior {
    ns: DVector<f64>,
    error: DVector<f64>,
}

fn rows() -> Result<Vec<Row>> {
    serde_json::from_str(include_str!("chart.json")).map_err(|e| Error::config("chart.json", e))
}

fn products(widths: &[usize]) -> f64 {
    widths.windows(2).map(|pair| (pair[0] * pair[1]) as f64).sum()
}

fn network(inputs: usize, hidden: &[usize], outputs: usize) -> f64 {
    let widths: Vec<usize> = std::iter::once(inputs).chain(hidden.iter().copied()).chain([outputs]).collect();
    products(&widths)
}

/// Octaves that a tile of the chart's size has.
const BANDS: usize = 8;
/// Components of both directions.
const DIRECTIONS: usize = 6;

/// Multiply-adds of the decoder.
fn decoder(shape: &Shape) -> f64 {
    network(shape.channels + DIRECTIONS + 4 * shape.bands.min(BANDS), &shape.hidden, 3)
}

/// What an answer does: something at all, multiply-adds of both networks, an offset, sines, texels of as many levels as it
/// mixes, in single precision.
fn work(shape: &Shape, levels: f64, single: bool) -> [f64; 6] {
    let offset = shape.offset.as_ref().map_or(0.0, |(channels, hidden)| network(channels + 2, hidden, 1));
    [
        1.0,
        decoder(shape) + offset,
        f64::from(u8::from(shape.offset.is_some())),
        4.0 * shape.bands.min(BANDS) as f64,
        levels * shape.channels as f64,
        f64::from(u8::from(single)),
    ]
}

/// By what an error grows, as logarithms of sizes: multiply-adds of the decoder, channels, texels left out, no offset, no
/// octaves.
fn losses(shape: &Shape, finest: usize) -> [f64; 5] {
    let base = network(7 + DIRECTIONS + 4 * BANDS, &[25, 25, 25], 3);
    [
        (decoder(shape) / base).ln(),
        (shape.channels as f64 / 7.0).ln(),
        shape.finest.saturating_sub(finest) as f64,
        // Depth moves a texel by less where texels are larger.
        if shape.offset.is_none() { 0.5f64.powi(finest as i32) } else { 0.0 },
        f64::from(u8::from(shape.bands == 0)),
    ]
}

impl Prior {
    /// Least squares over the chart: relative ones for times.
    ///
    /// # Errors
    /// `Config` if the stored table cannot be read.
    pub fn new() -> Result<Self> {
        let rows = rows()?;
        let sizes = sizes()?;
        let timed = sizes.iter().flat_map(|size| {
            let work = |single| work(&size.shape, size.levels as f64, single);
            [(work(true), size.ns), (work(false), size.ns_half)]
        });
        let ns = timed.map(|(work, ns)| (work.map(|v| v / ns), 1.0)).collect::<Vec<_>>();
        let error = rows.iter().map(|row| (losses(&row.shape, 0), row.error.ln())).collect::<Vec<_>>();
        Ok(Self { ns: solved(&ns, 1e-9)?, error: solved(&error, RIDGE)? })
    }

    /// Expected nanoseconds a query, with textures of half floats, on the chart's machine.
    pub fn ns(&self, shape: &Shape, need: &Need) -> f64 {
        let levels = if need.coarsest() > shape.finest { 2.0 } else { 1.0 };
        let work = work(shape, levels, false);
        self.ns.iter().zip(work).map(|(a, b)| a * b).sum::<f64>().max(LEAST_NS)
    }

    /// Expected nanoseconds a query of a full model in single precision.
    pub fn ns_of(&self, shape: &Shape) -> f64 {
        let work = work(shape, 2.0, true);
        self.ns.iter().zip(work).map(|(a, b)| a * b).sum::<f64>().max(LEAST_NS)
    }

    /// Expected error over that of the full model, trained alike.
    pub fn error(&self, shape: &Shape, need: &Need) -> f64 {
        let losses = losses(shape, need.finest());
        self.error.iter().zip(losses).map(|(a, b)| a * b).sum::<f64>().exp()
    }
}

fn solved<const N: usize>(rows: &[([f64; N], f64)], ridge: f64) -> Result<DVector<f64>> {
    let a = DMatrix::from_fn(rows.len(), N, |r, c| rows[r].0[c]);
    let b = DVector::from_fn(rows.len(), |r, _| rows[r].1);
    let mut normal = a.transpose() * &a;
    (0..N).for_each(|k| normal[(k, k)] *= 1.0 + ridge);
    let right = a.transpose() * b;
    let factor =
        normal.cholesky().ok_or_else(|| Error::config("chart.json", "does not tell its sizes apart"))?;
    Ok(factor.solve(&right))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn the_table_is_the_charts() {
        /// The table has four digits.
        const DIGITS: f64 = 1e-4;
        let all: serde_json::Value =
            serde_json::from_str(include_str!("../../results/results.json")).unwrap();
        let mut error: BTreeMap<&str, BTreeMap<&str, f64>> = BTreeMap::new();
        for cell in all["cells"].as_array().unwrap() {
            let is = |field: &str, value: &str| cell[field] == value;
            if !(is("split", "train")
                && is("regime", "scattered")
                && cell["level"].is_null()
                && cell["seed"] == 1)
            {
                continue;
            }
            let (preset, material) = (cell["preset"].as_str().unwrap(), cell["material"].as_str().unwrap());
            error.entry(preset).or_default().insert(material, cell["mse"].as_f64().unwrap());
        }
        for row in rows().unwrap() {
            let (of, base) = (&error[row.variant.as_str()], &error["improved"]);
            let logs: f64 = base.iter().map(|(material, base)| (of[material] / base).ln()).sum();
            let ratio = (logs / base.len() as f64).exp();
            assert!((ratio - row.error).abs() < DIGITS, "{}: {ratio}", row.variant);
            assert!((ratio + 2.0 * DIGITS - row.error).abs() > DIGITS);
        }
    }

    #[test]
    fn times_are_found_again() {
        /// What a linear model misses of caches and of rows that are padded.
        const SCATTER: f64 = 0.2;
        let prior = Prior::new().unwrap();
        for size in sizes().unwrap() {
            let levels = [0.0, if size.levels == 2 { 6.0 } else { size.shape.finest as f32 }];
            let mut need = super::super::need::tests::whole(levels);
            need.levels[0] = need.levels[0].min(levels[1]);
            let ratio = prior.ns(&size.shape, &need) / size.ns_half;
            assert!((ratio - 1.0).abs() < SCATTER, "{} at {} levels: {ratio}", size.shape, size.levels);
            assert!((1.5 * ratio - 1.0).abs() > SCATTER);
        }
    }

    #[test]
    fn less_is_faster_and_worse_but_for_what_is_never_seen() {
        let prior = Prior::new().unwrap();
        let near = super::super::need::tests::whole([0.0, 6.0]);
        let far = super::super::need::tests::whole([2.0, 4.0]);
        let all = rows().unwrap();
        let full = &all[0].shape;
        let small = Shape { finest: 2, channels: 4, hidden: vec![8, 8], offset: None, bands: 0 };
        assert!(prior.ns(&small, &near) < 0.5 * prior.ns(full, &near));
        assert!(prior.error(&small, &near) > 1.5 * prior.error(full, &near));
        assert!(prior.error(&small, &far) < 0.8 * prior.error(&small, &near));
    }
}
