//! What computes a step: one trait, candle's graph or the fused kernels behind it. Both leave the parameters to candle
//! variables and hand out gradients by name.

use super::candle_engine::CandleEngine;
use super::fused_engine::FusedEngine;
use crate::config::{EngineKind, Term};
use crate::dataset::{Block, Layout};
use crate::error::{Error, Result};
use crate::kernels::simd::Isa;
use crate::loss::{Means, Patches};
use crate::model::Variables;
use crate::model::texture::Sigmas;
use candle_core::{Device, Tensor};
use neumip_export::config::Architecture;

/// What a step is asked.
#[derive(Clone, Copy, Debug)]
pub struct Step<'a> {
    /// Pieces of one side.
    pub pieces: &'a [Block],
    /// Terms of the loss.
    pub terms: &'a [Term],
    /// Targets are clamped to this range.
    pub target_range: [f32; 2],
    /// Pieces of a higher level have weight 0.
    pub highest_level: Option<u32>,
    /// Whether the offset texture learns.
    pub offset_texture: bool,
}

impl Step<'_> {
    /// Counts that the sums over the step are divided by.
    pub(super) fn means(&self, architecture: &Architecture) -> Means {
        let side = self.pieces.first().map_or(1, |p| p.side());
        Means::of(side, self.pieces.iter().map(|p| patches(p.layout(), architecture)))
    }
}

/// The patches of a piece, of which a decoder that reads neighbours answers the border otherwise than on the whole tile.
pub(super) fn patches(layout: &Layout, architecture: &Architecture) -> Patches {
    let radius = architecture.neighbourhood();
    let margin = radius.map_or(0, |radius| layout.margin(radius, architecture.resolution));
    Patches { side: layout.patch(), margin }
}

/// A gradient of one variable.
#[derive(Debug)]
pub enum Gradient<'a> {
    /// On the variables' device.
    Tensor(Tensor),
    /// In host memory.
    Dense(&'a [f32]),
    /// In host memory, `stride` floats a texel of which the first `channels` count; cleared by whoever takes it.
    Padded {
        /// The table.
        table: &'a mut [f32],
        /// Floats a texel.
        stride: usize,
        /// Channels of the texture.
        channels: usize,
    },
}

/// Takes the gradient of a variable by name.
pub type Take<'a> = dyn FnMut(&str, Gradient) -> Result<()> + 'a;

/// Computes losses and gradients.
pub trait Engine: Send {
    /// Reads the textures anew, smoothed by these sigmas.
    ///
    /// # Errors
    /// Whatever candle refuses.
    fn read(&mut self, variables: &Variables, sigmas: &Sigmas) -> Result<()>;

    /// The loss of a step, not finite if any sample's gradient is not. Gradients by weights replace the last step's, those
    /// by texels are added to them.
    ///
    /// # Errors
    /// Whatever candle refuses.
    fn step(&mut self, variables: &Variables, step: &Step) -> Result<f64>;

    /// Hands out the gradients of the networks' weights and biases.
    ///
    /// # Errors
    /// What `take` reports.
    fn networks(&mut self, take: &mut Take) -> Result<()>;

    /// Hands out the gradients of the textures that were read with these sigmas, and begins their sums anew.
    ///
    /// # Errors
    /// What `take` reports.
    fn textures(&mut self, sigmas: &Sigmas, take: &mut Take) -> Result<()>;
}

/// The engine of a kind on a device.
///
/// # Errors
/// `Config` for the fused engine on a device that is not the CPU, `Usage` for an instruction set that this machine has not.
pub fn engine(
    kind: Option<EngineKind>,
    architecture: &Architecture,
    variables: &Variables,
    device: &Device,
) -> Result<Box<dyn Engine>> {
    match (kind, device.is_cpu()) {
        (None | Some(EngineKind::Fused), true) => {
            Ok(Box::new(FusedEngine::new(architecture, Isa::chosen()?)))
        }
        (None | Some(EngineKind::Candle), _) => {
            Ok(Box::new(CandleEngine::new(architecture, variables, device)?))
        }
        (Some(EngineKind::Fused), false) => Err(Error::config(
            "train.engine",
            "the fused engine runs on the CPU; use candle on other devices",
        )),
    }
}
