//! A fitted model that answers: its tensors in a precision, behind its domain.

use super::need::Need;
use crate::engine::FusedMaterial;
use crate::error::Result;
use crate::kernels::simd::Isa;
use neumip_export::checkpoint::{Checkpoint, Header};
use neumip_export::config::Architecture;
use neumip_export::{Precision, Storage, Tensor};
use std::collections::BTreeMap;

/// The checkpoint of a window's tensors: what `full` is of, at another size, with its domain.
///
/// # Errors
/// `Config` if the tensors do not fit.
pub fn checkpoint(
    full: &Checkpoint,
    architecture: &Architecture,
    tensors: BTreeMap<String, Tensor>,
    need: &Need,
    (scene, floor): (&str, f64),
) -> Result<Checkpoint> {
    let domain = Some(need.domain(scene, floor as f32));
    let architecture = Architecture { domain, ..architecture.clone() };
    let header = Header { architecture, ..full.header.clone() };
    let checkpoint = Checkpoint { header, tensors };
    checkpoint.validate()?;
    Ok(checkpoint)
}

/// What answers for a checkpoint whose numbers are those of a storage. Bytes are read as half floats: each is one exactly times
/// its channel's factor, to within a thousandth.
///
/// # Errors
/// `Config` for tensors that do not fit.
pub fn material(checkpoint: &Checkpoint, storage: Storage) -> Result<FusedMaterial> {
    let precision = match storage.textures {
        Precision::Single => Precision::Single,
        Precision::Half | Precision::Byte => Precision::Half,
    };
    FusedMaterial::new(&checkpoint.header.architecture, &checkpoint.tensors, precision, Isa::chosen()?)
}
