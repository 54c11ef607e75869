//! The promises of neumip, a file each.

mod command_line;
mod dataset;
mod demo;
mod engine;
mod house;
mod model;
mod onnx;
mod python_environment;
mod reference;
mod training;
