//! Adam over named variables.

use crate::config::AdamConfig;
use crate::error::Result;
use crate::kernels::adam::Update;
use crate::kernels::custom_op::adam_step;
use crate::model::Variables;
use candle_core::{Tensor, Var};

/// Adam with its moments.
pub(super) struct Optimiser {
    config: AdamConfig,
    first: Variables,
    second: Variables,
    update: Update,
}

impl Optimiser {
    /// Moments of zero.
    pub fn new(variables: &Variables, config: AdamConfig) -> Result<Self> {
        Ok(Self::restored(variables.zeros_like()?, variables.zeros_like()?, config))
    }

    /// Saved moments.
    pub fn restored(first: Variables, second: Variables, config: AdamConfig) -> Self {
        Self { config, first, second, update: Update::new(0.0, 0.0, 0.0, 1.0, 1) }
    }

    /// First and second moments.
    pub fn moments(&self) -> (&Variables, &Variables) {
        (&self.first, &self.second)
    }

    /// Begins step `t`, counted from 1.
    pub fn begin(&mut self, rate: f64, t: u64) {
        self.update = Update::new(rate, self.config.beta1, self.config.beta2, self.config.epsilon, t);
    }

    /// Updates one variable.
    pub fn update(&self, name: &str, variable: &Var, gradient: &Tensor) -> Result<()> {
        let (first, second) = (self.first.get(name)?, self.second.get(name)?);
        let betas = [self.config.beta1, self.config.beta2];
        Ok(adam_step(variable, first, second, gradient, betas, self.update)?)
    }
}
