//! A model that learns: variables, their optimiser, and the engine that finds their gradients.

use super::engine::{Engine, Step, engine};
use super::fused_engine::FusedEngine;
use super::optimiser::Optimiser;
use crate::config::{AdamConfig, EngineKind};
use crate::error::Result;
use crate::kernels::simd::Isa;
use crate::model::Variables;
use crate::model::texture::Sigmas;
use candle_core::{Device, Var};
use neumip_export::config::{Architecture, OFFSET_TEXTURE};

/// A model that learns step by step.
pub struct Learner {
    architecture: Architecture,
    variables: Variables,
    optimiser: Optimiser,
    engine: Box<dyn Engine>,
    /// How the textures were read; none where the next step has to read them anew.
    sigmas: Option<Sigmas>,
    /// Most that a tensor of the networks moves in an update, as a share of its size.
    clip: Option<f64>,
}

/// Least size of a tensor that a share is taken of: one that is 0 still has to move.
const LEAST_SIZE: f64 = 0.02;

impl Learner {
    /// A model with fresh moments.
    ///
    /// # Errors
    /// As [`Learner::restored`].
    pub fn new(
        architecture: &Architecture,
        variables: Variables,
        adam: AdamConfig,
        kind: Option<EngineKind>,
        device: &Device,
    ) -> Result<Self> {
        let moments = [variables.zeros_like()?, variables.zeros_like()?];
        Self::restored(architecture, variables, moments, adam, kind, device)
    }

    /// A model whose steps are fused, on a given instruction set.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn with_isa(
        architecture: &Architecture,
        variables: Variables,
        adam: AdamConfig,
        isa: Isa,
    ) -> Result<Self> {
        let optimiser = Optimiser::new(variables.zeros_like()?, variables.zeros_like()?, adam);
        let engine = Box::new(FusedEngine::new(architecture, isa));
        Ok(Self {
            architecture: architecture.clone(),
            engine,
            variables,
            optimiser,
            sigmas: None,
            clip: None,
        })
    }

    /// A model with saved first and second moments.
    ///
    /// # Errors
    /// `Config` or `Usage` for an engine that does not run here.
    pub fn restored(
        architecture: &Architecture,
        variables: Variables,
        [first, second]: [Variables; 2],
        adam: AdamConfig,
        kind: Option<EngineKind>,
        device: &Device,
    ) -> Result<Self> {
        Ok(Self {
            architecture: architecture.clone(),
            engine: engine(kind, architecture, &variables, device)?,
            variables,
            optimiser: Optimiser::new(first, second, adam),
            sigmas: None,
            clip: None,
        })
    }

    /// The same, with the size of the networks' updates bounded: the learning rate of each weight matrix or bias is at most
    /// this share of its root mean square. Adam moves an element by about the learning rate whatever the gradient's size, so
    /// that a bound on the gradient's norm bounds nothing; after a large relative move ReLUs answer 0 for every query, and
    /// never learn again (the trust ratio of You et al. 2020, LAMB, as a bound).
    pub fn with_clip(self, clip: Option<f64>) -> Self {
        Self { clip, ..self }
    }

    /// What learns.
    pub fn architecture(&self) -> &Architecture {
        &self.architecture
    }

    /// The parameters.
    pub fn variables(&self) -> &Variables {
        &self.variables
    }

    /// Adam's first and second moments.
    pub fn moments(&self) -> (&Variables, &Variables) {
        self.optimiser.moments()
    }

    /// The loss of a step, whose gradients wait for the updates; not finite if any of them is not. Textures are read
    /// through `sigmas` by the first step after they were updated.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn step(&mut self, step: &Step, sigmas: &Sigmas) -> Result<f64> {
        if self.sigmas.is_none() {
            self.engine.read(&self.variables, sigmas)?;
            self.sigmas = Some(sigmas.clone());
        }
        self.engine.step(&self.variables, step)
    }

    /// Updates the networks with the last step's gradients at learning rate `rate`; `t` counts these updates from 1.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn update_networks(&mut self, rate: f64, t: u64) -> Result<()> {
        self.optimiser.begin(rate, t);
        let (optimiser, variables) = (&self.optimiser, &self.variables);
        let clip = self.clip;
        self.engine.networks(&mut |name, gradient| {
            let variable = variables.get(name)?;
            let most = match clip {
                Some(share) => share * size(variable)?.max(LEAST_SIZE),
                None => f64::INFINITY,
            };
            optimiser.update(name, variable, gradient, most)
        })
    }

    /// Updates the textures with the gradients of all steps since the last time; `t` counts these updates from 1.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn update_textures(&mut self, rate: f64, t: u64, offset_texture: bool) -> Result<()> {
        let Some(sigmas) = self.sigmas.take() else { return Ok(()) };
        self.optimiser.begin(rate, t);
        let (optimiser, variables) = (&self.optimiser, &self.variables);
        self.engine.textures(&sigmas, &mut |name, gradient| match name == OFFSET_TEXTURE && !offset_texture {
            true => Ok(()),
            false => optimiser.update(name, variables.get(name)?, gradient, f64::INFINITY),
        })
    }
}

/// The root mean square of a variable's values, which the first to the last are added up for.
fn size(variable: &Var) -> Result<f64> {
    let values: Vec<f32> = variable.as_tensor().flatten_all()?.to_vec1()?;
    let squares: f64 = values.iter().map(|v| f64::from(*v).powi(2)).sum();
    Ok((squares / values.len().max(1) as f64).sqrt())
}
