//! An exported `material.onnx`, run in-process by an engine that is not ours (rten): what a bundle's graph really answers.

use crate::error::{Error, Result};
use crate::query::{QueryBuffer, Reflectance, RgbImage};
use rten::{Model, Value, ValueOrView};
use std::path::Path;

/// A graph with inputs u, wi, wo \[N, 2\], level \[N\] and output rgb \[N, 3\]; of a decoder that reads neighbours
/// \[N, H, W, 2\], \[N, H, W\] and \[N, H, W, 3\].
pub struct OnnxMaterial(Model);

impl OnnxMaterial {
    /// Loads a graph.
    ///
    /// # Errors
    /// `File` if it cannot be read or is no graph that the engine runs.
    pub fn open(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|e| Error::file(path, format!("cannot be read: {e}")))?;
        Self::from_bytes(path, bytes)
    }

    /// Loads a graph from memory; `path` names it in errors.
    ///
    /// # Errors
    /// `File` if it is no graph that the engine runs.
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self> {
        Ok(Self(
            Model::load(bytes).map_err(|e| Error::file(path, format!("not a graph that can be run: {e}")))?,
        ))
    }
}

impl OnnxMaterial {
    /// Answers queries that are \[N, H, W\] `images`, one after another, or each on its own.
    ///
    /// # Errors
    /// `Config` if the graph takes no such queries.
    pub fn answers(&self, queries: &QueryBuffer, images: Option<[usize; 3]>) -> Result<Vec<[f32; 3]>> {
        let failed = |problem: &dyn std::fmt::Display| Error::config("material.onnx", problem);
        let extents = images.map_or(vec![queries.len()], Vec::from);
        let with = |columns: usize| [extents.clone(), vec![columns]].concat();
        let feeds = [
            ("u", with(2), queries.u.as_flattened()),
            ("wi", with(2), queries.wi.as_flattened()),
            ("wo", with(2), queries.wo.as_flattened()),
            ("level", extents.clone(), &queries.level[..]),
        ];
        let mut inputs = Vec::new();
        for (name, shape, data) in feeds {
            let node = self.0.node_id(name).map_err(|e| failed(&e))?;
            let value = Value::from_shape(&shape, data.to_vec()).map_err(|e| failed(&e))?;
            inputs.push((node, ValueOrView::Value(value)));
        }
        let output = self.0.node_id("rgb").map_err(|e| failed(&e))?;
        let [rgb] = self.0.run_n(inputs, [output], None).map_err(|e| failed(&e))?;
        let (shape, data) = match images {
            None => rgb.into_shape_vec::<f32, 2>().map(|(shape, data)| (shape.to_vec(), data)),
            Some(_) => rgb.into_shape_vec::<f32, 4>().map(|(shape, data)| (shape.to_vec(), data)),
        }
        .map_err(|e| failed(&e))?;
        if shape != with(3) {
            return Err(failed(&format!("answers with shape {shape:?} where {:?} was asked", with(3))));
        }
        Ok(data.as_chunks::<3>().0.to_vec())
    }
}

impl Reflectance for OnnxMaterial {
    fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage> {
        let pixels = self.answers(queries, None)?;
        Ok(RgbImage { height: queries.height(), width: queries.width(), pixels })
    }
}

/// Largest |difference| / (1 + |value|) between an answer and what was expected; NaN if any is.
pub fn largest_difference(answer: &[[f32; 3]], expected: &[[f32; 3]]) -> f64 {
    let error = |(a, e): (&f32, &f32)| f64::from((a - e).abs()) / (1.0 + f64::from(e.abs()));
    // total_cmp puts NaN above everything: one cannot hide.
    answer.as_flattened().iter().zip(expected.as_flattened()).map(error).max_by(f64::total_cmp).unwrap_or(0.0)
}
