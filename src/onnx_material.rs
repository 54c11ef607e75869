//! An exported `material.onnx`, run in-process by an engine that is not ours (rten): what a bundle's graph really answers.

use crate::error::{Error, Result};
use crate::query::{QueryBuffer, Reflectance, RgbImage};
use rten::{Model, Value, ValueOrView};
use std::path::Path;

/// Any exported graph.
pub struct OnnxGraph {
    name: String,
    model: Model,
}

/// Values under a name, with their extents.
pub type Feed<'a> = (&'a str, Vec<usize>, &'a [f32]);

impl OnnxGraph {
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
        let failed = |e| Error::file(path, format!("not a graph that can be run: {e}"));
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        Ok(Self { name, model: Model::load(bytes).map_err(failed)? })
    }

    /// Feeds the inputs and gives the outputs that are asked for, each with the extents that it is asked to have.
    ///
    /// # Errors
    /// `Config`, naming the graph, if it takes no such inputs or answers with other extents.
    pub fn run(&self, feeds: &[Feed], outputs: &[(&str, Vec<usize>)]) -> Result<Vec<Vec<f32>>> {
        let failed = |problem: &dyn std::fmt::Display| Error::config(&self.name, problem);
        let mut inputs = Vec::new();
        for (name, shape, data) in feeds {
            let node = self.model.node_id(name).map_err(|e| failed(&e))?;
            let value = Value::from_shape(shape.as_slice(), data.to_vec()).map_err(|e| failed(&e))?;
            inputs.push((node, ValueOrView::Value(value)));
        }
        let nodes = outputs.iter().map(|(name, _)| self.model.node_id(name).map_err(|e| failed(&e)));
        let nodes = nodes.collect::<Result<Vec<_>>>()?;
        let values = self.model.run(inputs, &nodes, None).map_err(|e| failed(&e))?;
        let mut answers = Vec::new();
        for ((name, expected), value) in outputs.iter().zip(values) {
            let (shape, data) = match expected.len() {
                1 => value.into_shape_vec::<f32, 1>().map(|(shape, data)| (shape.to_vec(), data)),
                2 => value.into_shape_vec::<f32, 2>().map(|(shape, data)| (shape.to_vec(), data)),
                3 => value.into_shape_vec::<f32, 3>().map(|(shape, data)| (shape.to_vec(), data)),
                _ => value.into_shape_vec::<f32, 4>().map(|(shape, data)| (shape.to_vec(), data)),
            }
            .map_err(|e| failed(&e))?;
            if shape != *expected {
                let problem = format!("answers {name} with shape {shape:?} where {expected:?} was asked");
                return Err(failed(&problem));
            }
            answers.push(data);
        }
        Ok(answers)
    }
}

/// A graph with inputs u, wi, wo \[N, 2\], level \[N\] and output rgb \[N, 3\]; of a decoder that reads neighbours
/// \[N, H, W, 2\], \[N, H, W\] and \[N, H, W, 3\].
pub struct OnnxMaterial(OnnxGraph);

impl OnnxMaterial {
    /// Loads a graph.
    ///
    /// # Errors
    /// `File` if it cannot be read or is no graph that the engine runs.
    pub fn open(path: &Path) -> Result<Self> {
        Ok(Self(OnnxGraph::open(path)?))
    }

    /// Loads a graph from memory; `path` names it in errors.
    ///
    /// # Errors
    /// `File` if it is no graph that the engine runs.
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self> {
        Ok(Self(OnnxGraph::from_bytes(path, bytes)?))
    }

    /// Answers queries that are \[N, H, W\] `images`, one after another, or each on its own.
    ///
    /// # Errors
    /// `Config` if the graph takes no such queries.
    pub fn answers(&self, queries: &QueryBuffer, images: Option<[usize; 3]>) -> Result<Vec<[f32; 3]>> {
        let rgb = self.0.run(&feeds(queries, images), &[("rgb", with(queries, images, 3))])?;
        Ok(rgb.concat().as_chunks::<3>().0.to_vec())
    }
}

/// Queries as the whole material's graph takes them.
pub fn feeds(queries: &QueryBuffer, images: Option<[usize; 3]>) -> Vec<Feed<'_>> {
    vec![
        ("u", with(queries, images, 2), queries.u.as_flattened()),
        ("wi", with(queries, images, 2), queries.wi.as_flattened()),
        ("wo", with(queries, images, 2), queries.wo.as_flattened()),
        ("level", images.map_or(vec![queries.len()], Vec::from), &queries.level[..]),
    ]
}

/// Extents of values with columns.
pub fn with(queries: &QueryBuffer, images: Option<[usize; 3]>, columns: usize) -> Vec<usize> {
    [images.map_or(vec![queries.len()], Vec::from), vec![columns]].concat()
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
