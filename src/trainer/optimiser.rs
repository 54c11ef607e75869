//! Adam over named variables.

use super::engine::Gradient;
use crate::config::AdamConfig;
use crate::error::Result;
use crate::kernels::adam::Update;
use crate::kernels::custom_op::{HostGradient, adam_step, adam_step_host};
use crate::model::Variables;
use candle_core::Var;

/// Adam with its moments.
pub(super) struct Optimiser {
    config: AdamConfig,
    first: Variables,
    second: Variables,
    rate: f64,
    step: u64,
}

impl Optimiser {
    /// Adam with these moments.
    pub fn new(first: Variables, second: Variables, config: AdamConfig) -> Self {
        Self { config, first, second, rate: 0.0, step: 1 }
    }

    /// First and second moments.
    pub fn moments(&self) -> (&Variables, &Variables) {
        (&self.first, &self.second)
    }

    /// Begins update `t`, counted from 1.
    pub fn begin(&mut self, rate: f64, t: u64) {
        (self.rate, self.step) = (rate, t);
    }

    /// Updates one variable, at the learning rate or at `most` if that is less.
    pub fn update(&self, name: &str, variable: &Var, gradient: Gradient, most: f64) -> Result<()> {
        let (first, second) = (self.first.get(name)?, self.second.get(name)?);
        let AdamConfig { beta1, beta2, epsilon } = self.config;
        let update = Update::new(self.rate.min(most), beta1, beta2, epsilon, self.step);
        let betas = [beta1, beta2];
        match gradient {
            Gradient::Tensor(gradient) => adam_step(variable, first, second, &gradient, betas, update)?,
            Gradient::Dense(values) => {
                adam_step_host(variable, first, second, betas, update, HostGradient::Dense(values))?
            }
            Gradient::Padded { table, stride, channels } => {
                let gradient = HostGradient::Padded { values: table, stride, channels };
                adam_step_host(variable, first, second, betas, update, gradient)?
            }
        }
        Ok(())
    }
}
