//! The promises of neumip, a file each.

#[path = "../export/tests/promises/materials.rs"]
#[allow(dead_code, reason = "the exporter's tests use all of it")]
mod materials;
#[path = "../export/tests/promises/plain.rs"]
#[allow(dead_code, reason = "the exporter's tests use all of it")]
mod plain;

mod analyze;
mod command_line;
mod dataset;
mod demo;
mod engine;
mod engines;
mod examining;
mod fitted;
mod fitting;
mod generating;
mod house;
mod inception;
mod metrics;
mod mitsuba;
mod mitsuba_bsdf;
mod model;
mod onnx;
mod python_environment;
mod reference;
mod rendering;
mod reproducing;
mod stability;
mod surfaces;
mod training;
mod viewer;
