//! The fully connected networks: ReLU between layers, linear output.

use super::variables::Variables;
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
    /// `Config` if a variable is missing.
    pub fn new(prefix: &str, layers: usize, variables: &Variables) -> Result<Self> {
        let layer = |i| -> Result<Linear> {
            let weight = variables.get(&weight_name(prefix, i))?.as_tensor().clone();
            Ok(Linear::new(weight, Some(variables.get(&bias_name(prefix, i))?.as_tensor().clone())))
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
