//! The checkpoint: what a material is, and every number needed to answer a query.
//!
//! One safetensors file ([`crate::tensors`]). Tensors are f32, named and shaped as [`Architecture::tensors`]
//! says; the one metadata key, `neumip`, holds a [`Header`] as JSON.

use crate::config::Architecture;
use crate::error::{Error, Result};
use crate::tensors::{Tensor, TensorReader, encode};
use crate::whole_file::write_whole;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Version of the checkpoint format.
pub const FORMAT: u32 = 1;
/// The metadata key.
pub const METADATA_KEY: &str = "neumip";

/// What the RGB of a material is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Measure {
    /// f cos(theta_i): radiance under a distant light that gives irradiance 1 on a plane facing it.
    RadianceCosine,
    /// The bare f.
    Reflectance,
}

/// The JSON of the metadata key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Header {
    /// Version of the format: [`FORMAT`].
    pub format: u32,
    /// Model and resolution; names and shapes of the tensors follow from it.
    pub architecture: Architecture,
    /// Lowest and highest height of the surface around the plane z = 0, in tile widths.
    pub height_range: [f32; 2],
    /// What RGB is.
    pub measure: Measure,
    /// The material's name.
    pub material: String,
    /// How it was trained: data, seed, steps, losses.
    pub provenance: serde_json::Value,
    /// The error table.
    pub errors: serde_json::Value,
}

/// A material in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// What it is.
    pub header: Header,
    /// Textures \[height, width, channels\], weights \[out, in\], biases \[out\], by name.
    pub tensors: BTreeMap<String, Tensor>,
}

impl Header {
    /// Parses the JSON of the metadata key and checks every bound.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn from_json(json: &str) -> Result<Self> {
        #[derive(Deserialize)]
        struct Version {
            format: u32,
        }
        let broken = |e: serde_json::Error| Error::config(METADATA_KEY, e);
        let Version { format } = serde_json::from_str(json).map_err(broken)?;
        if format != FORMAT {
            return Err(Error::config("format", format!("version {format}; this program reads {FORMAT}")));
        }
        let header: Self = serde_json::from_str(json).map_err(broken)?;
        header.validate()?;
        Ok(header)
    }

    /// Checks every bound.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn validate(&self) -> Result<()> {
        if self.format != FORMAT {
            return Err(Error::config("format", format!("is {}; this program writes {FORMAT}", self.format)));
        }
        let [low, high] = self.height_range;
        if !(low.is_finite() && high.is_finite() && low <= high) {
            return Err(Error::config("height_range", format!("[{low}, {high}] is not a range")));
        }
        self.architecture.validate()
    }
}

impl Checkpoint {
    /// Reads and validates a file.
    ///
    /// # Errors
    /// `File`, naming the path, and the tensor or field at fault.
    pub fn read(path: &Path) -> Result<Self> {
        Self::finish(path, TensorReader::open(path, METADATA_KEY)?)
    }

    /// Reads and validates bytes; `path` names them in errors.
    ///
    /// # Errors
    /// `File`, naming the path, and the tensor or field at fault.
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self> {
        Self::finish(path, TensorReader::new(path, METADATA_KEY, Box::new(bytes), bytes.len() as u64)?)
    }

    fn finish(path: &Path, reader: TensorReader) -> Result<Self> {
        let named = |e: Error| Error::file(path, e);
        let header = Header::from_json(&reader.json).map_err(named)?;
        check_shapes(&header.architecture, reader.shapes().collect()).map_err(named)?;
        Ok(Self { header, tensors: reader.read()? })
    }

    /// Writes the file whole or not at all; the same content gives the same bytes.
    ///
    /// # Errors
    /// `File`, naming the path, and the tensor or field at fault.
    pub fn write(&self, path: &Path) -> Result<()> {
        let bytes = self.to_bytes().map_err(|e| Error::file(path, e))?;
        write_whole(path, &bytes)
    }

    /// The bytes of the file.
    ///
    /// # Errors
    /// `Config`, naming the tensor or field at fault.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        self.validate()?;
        let json = serde_json::to_string(&self.header).map_err(|e| Error::config(METADATA_KEY, e))?;
        encode(METADATA_KEY, &json, &self.tensors)
    }

    /// Checks the header's bounds, and names, shapes and values of all tensors.
    ///
    /// # Errors
    /// `Config`, naming the tensor or field at fault.
    pub fn validate(&self) -> Result<()> {
        self.header.validate()?;
        let shapes = self.tensors.iter().map(|(name, t)| (name.as_str(), t.shape.as_slice())).collect();
        check_shapes(&self.header.architecture, shapes)?;
        for (name, tensor) in &self.tensors {
            if let Some(problem) = tensor.problem() {
                return Err(Error::config(format!("tensor {name}"), problem));
            }
        }
        Ok(())
    }

    /// One tensor.
    ///
    /// # Errors
    /// `Config`, if there is none of that name.
    pub fn tensor(&self, name: &str) -> Result<&Tensor> {
        self.tensors.get(name).ok_or_else(|| missing(name))
    }
}

fn missing(name: &str) -> Error {
    Error::config(format!("tensor {name}"), "is missing")
}

/// Compares names and shapes with what the architecture asks for.
fn check_shapes(architecture: &Architecture, mut shapes: BTreeMap<&str, &[usize]>) -> Result<()> {
    for (name, expected) in architecture.tensors() {
        let shape = shapes.remove(name.as_str()).ok_or_else(|| missing(&name))?;
        if shape != expected {
            return Err(Error::config(
                format!("tensor {name}"),
                format!("has shape {shape:?} where the architecture has {expected:?}"),
            ));
        }
    }
    match shapes.keys().next() {
        Some(name) => Err(Error::config(format!("tensor {name}"), "is not part of the architecture")),
        None => Ok(()),
    }
}
