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
    update: Update,
}

impl Optimiser {
    /// Adam with these moments.
    pub fn new(first: Variables, second: Variables, config: AdamConfig) -> Self {
        Self { config, first, second, update: Update::new(0.0, 0.0, 0.0, 1.0, 1) }
    }

    /// First and second moments.
    pub fn moments(&self) -> (&Variables, &Variables) {
        (&self.first, &self.second)
    }

    /// Begins update `t`, counted from 1.
    pub fn begin(&mut self, rate: f64, t: u64) {
        self.update = Update::new(rate, self.config.beta1, self.config.beta2, self.config.epsilon, t);
    }

    /// Updates one variable.
    pub fn update(&self, name: &str, variable: &Var, gradient: Gradient) -> Result<()> {
        let (first, second) = (self.first.get(name)?, self.second.get(name)?);
        let (betas, update) = ([self.config.beta1, self.config.beta2], self.update);
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
