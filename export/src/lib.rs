//! The neumip checkpoint format, and everything that turns a checkpoint into what other programs read.
//!
//! ```text
//! checkpoint file -> Checkpoint -> ONNX graphs, EXR textures, weights, shader source, material.json -> bundle
//! sampler file ---> Sampler ------^
//!                                  golden answers (computed elsewhere) ------^
//! ```
//!
//! Nothing here evaluates a material: golden answers come in as data, so that no graph is compared with its
//! author.

pub mod bundle;
pub mod checkpoint;
pub mod config;
pub mod domain;
mod error;
pub mod golden;
pub mod onnx;
pub mod precision;
mod readme;
pub mod sampler;
pub mod shader;
pub mod sidecar;
pub mod tensors;
pub mod textures;
pub mod weights;
pub mod whole_file;

pub use bundle::{Bundle, BundleFile, Contents, read_bundle};
pub use checkpoint::{Checkpoint, Header, Measure};
pub use config::Architecture;
pub use domain::{Cone, Domain, Guide, Outside};
pub use error::{Error, Result};
pub use golden::{Golden, SamplerGolden};
pub use precision::{Precision, Rounding, Storage};
pub use sampler::{Sampler, SamplerConfig};
pub use tensors::{Tensor, read_tensors, write_tensors};
