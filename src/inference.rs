//! A checkpoint as something that answers queries: through the fused engine or through candle.

use crate::config::EngineKind;
use crate::engine::FusedMaterial;
use crate::error::{Error, Result};
use crate::kernels::simd::Isa;
use crate::model::NeuralMaterial;
use crate::query::Reflectance;
use candle_core::Device;
use neumip_export::Precision;
use neumip_export::checkpoint::{Checkpoint, Header};

/// A material and what answers for it.
pub struct Answerer {
    /// The material.
    pub material: Box<dyn Reflectance>,
    /// The engine in words: `fused avx512`, `fused avx512, f16 textures`, `candle`.
    pub engine: String,
}

/// The material of a checkpoint: by default fused on the CPU, candle on other devices.
///
/// # Errors
/// `Config` if a tensor does not fit, or the choice does not go with the device.
pub fn answerer(
    checkpoint: &Checkpoint,
    kind: Option<EngineKind>,
    precision: Precision,
    device: &Device,
) -> Result<Answerer> {
    let Header { architecture, .. } = &checkpoint.header;
    match (kind, device.is_cpu()) {
        (None | Some(EngineKind::Fused), true) => {
            let isa = Isa::chosen()?;
            let material = FusedMaterial::new(architecture, &checkpoint.tensors, precision, isa)?;
            let textures = if precision == Precision::Half { ", f16 textures" } else { "" };
            Ok(Answerer { material: Box::new(material), engine: format!("fused {}{textures}", isa.name()) })
        }
        (Some(EngineKind::Fused), false) => {
            Err(Error::usage("--engine fused: it runs on the CPU; use candle on other devices"))
        }
        (None | Some(EngineKind::Candle), _) if precision == Precision::Half => {
            Err(Error::usage("--half-textures: only the fused engine has them"))
        }
        (None | Some(EngineKind::Candle), _) => Ok(Answerer {
            material: Box::new(NeuralMaterial::from_checkpoint(checkpoint, device)?),
            engine: "candle".into(),
        }),
    }
}
