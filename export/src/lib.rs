//! The neumip checkpoint format, and everything that turns a checkpoint into what other programs read.
//!
//! ```text
//! checkpoint file -> Checkpoint -> ONNX graphs, EXR textures, material.json -> bundle
//!                                  golden answers (computed elsewhere) ------^
//! ```
//!
//! Nothing here evaluates a material: golden answers come in as data, so that no graph is compared with its
//! author.

pub mod bundle;
pub mod checkpoint;
pub mod config;
mod error;
pub mod golden;
pub mod onnx;
pub mod precision;
pub mod sampler;
pub mod shader;
pub mod sidecar;
pub mod tensors;
pub mod textures;
pub mod weights;
pub mod whole_file;

pub use bundle::{Bundle, BundleFile, read_bundle, write_bundle, write_bundle_as};
pub use checkpoint::{Checkpoint, Header, Measure};
pub use config::Architecture;
pub use error::{Error, Result};
pub use golden::Golden;
pub use precision::{Precision, TexturePrecision};
pub use sampler::{Sampler, SamplerConfig};
pub use tensors::{Tensor, read_tensors, write_tensors};
