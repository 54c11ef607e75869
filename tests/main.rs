//! The promises of neumip, a file each.

mod dataset;
mod demo;
mod model;
mod onnx;
mod python_environment;
mod reference;
mod training;
