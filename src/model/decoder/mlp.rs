//! The fully connected networks: ReLU between layers, linear output.

use crate::error::Result;
use candle_core::Tensor;
use candle_nn::{Linear, Module};
use neumip_export::config::{bias_name, weight_name};

/// A multi-layer perceptron \[N, in\] -> \[N, out\].
pub struct Mlp(Vec<Linear>);

impl Mlp {
    /// The perceptron whose layers are named `prefix.0`, `prefix.1`, ...
    ///
    /// # Errors
    /// What `tensor` reports.
    pub fn new(prefix: &str, layers: usize, tensor: &dyn Fn(&str) -> Result<Tensor>) -> Result<Self> {
        let layer = |i| -> Result<Linear> {
            Ok(Linear::new(tensor(&weight_name(prefix, i))?, Some(tensor(&bias_name(prefix, i))?)))
        };
        Ok(Self((0..layers).map(layer).collect::<Result<_>>()?))
    }

    /// The outputs.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let mut x = x.clone();
        for (i, layer) in self.0.iter().enumerate() {
            x = layer.forward(&x)?;
            if i + 1 < self.0.len() {
                x = x.relu()?;
            }
        }
        Ok(x)
    }
}
