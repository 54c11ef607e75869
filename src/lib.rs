//! Neural materials that other renderers can use.
//!
//! ```text
//! query ─ what is asked and answered; the conventions
//!   │
//! reference ─ ground truth: displaced layers, meshes and fibres, their shading, their light
//!   │
//! dataset ─ blocks of queries with their answers: generated, stored, streamed
//!   │            kernels ─ loops on slices
//!   │               │
//!   │            engine ─ a tile of samples forward and back: fused steps and answers
//!   │               │
//! model ─ texture pyramid, neural offset, encoding, decoder (candle)     loss ─ remaps, gradient loss (candle)
//!   │               │                                                      │
//! trainer ─ steps by either engine, validation, checkpoints, events ───────┘
//!   │
//! checkpoint ─ a run's folder; the file format itself is neumip-export's
//!   │
//! inference ─ a checkpoint that answers, by either engine
//!   │
//! analytic ─ a material's own maps, marched and shaded: the rival that is not neural
//!   │
//! sampler ─ where the light of a query comes from: a mixture of lobes, fitted to the material's answers
//!   │
//! metrics, lpips (candle), evaluate, bench ─ errors by split and level, time per query, rates beside the machine's peak
//!   │            outside ─ how many queries are outside of what a material was fitted for
//!   │
//! reproduce, results, chart ─ the paper's questions, what came of them, speed against accuracy
//!   │
//! render ─ pictures of scenes: objects, lights and cameras around materials     artefacts ─ a bundle put to the test
//!   │
//! analyze ─ what a scene asks of its materials: levels, places, directions
//!   │
//! stability ─ known failures as probes: the naive form, the cure, the bound that guards it
//!   │
//! fit ─ a material that holds no more than a scene needs
//!   │
//! report, view, cli, neumip-export ─ pages, a bundle's viewer, commands, ONNX and textures for other renderers
//! ```

pub mod analytic;
pub mod analyze;
pub mod artefacts;
pub mod bench;
pub mod chart;
pub mod checkpoint;
pub mod cli;
pub mod config;
pub mod dataset;
pub mod engine;
pub mod error;
pub mod evaluate;
pub mod fit;
pub mod golden;
pub mod inference;
pub mod kernels;
pub mod loss;
pub mod lpips;
pub mod metrics;
pub mod model;
pub mod onnx_material;
pub mod outside;
pub mod query;
pub mod random;
pub mod reference;
pub mod render;
pub mod report;
pub mod reproduce;
pub mod results;
pub mod sampler;
pub mod srgb;
pub mod stability;
pub mod trainer;
pub mod view;

pub use error::{Error, Result};
pub use neumip_export as export;
