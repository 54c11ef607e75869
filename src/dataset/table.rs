//! The safetensors file beside each frame: where the samples of its blocks lie and which way they look.
//!
//! Per block (n of them) `level` f32, `patch` u32 (side of its patches), `noise` f32 (mean variance), `first`
//! u32 (row of its first patch in the tables below), and where it was chosen by the block `spp` u32 (sub-samples); per patch (k of them) `wi`, `wo`, `corner` f32 \[k, 2\].

use super::{
    block::{Block, Layout, MAX_SIDE, Patch},
    folder::{check_bytes, write_whole},
};
use crate::error::{Error, Result};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use std::path::Path;

/// Room for the header, far above the eight entries that it has.
const HEADER_BYTES: u64 = 4096;

/// What a table says of a block.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Row {
    pub(crate) layout: Layout,
    /// Mean variance of its samples.
    pub(crate) noise: f32,
    /// Sub-samples of each sample, where the block has its own number.
    pub(crate) spp: Option<u32>,
}

/// Writes the table of blocks; returns the bytes written.
pub(crate) fn write_table(path: &Path, blocks: &[Block]) -> Result<u64> {
    let mut level = Vec::new();
    let mut side = Vec::new();
    let mut first = Vec::new();
    let mut vectors: [Vec<u8>; 3] = Default::default();
    let mut patches = 0u32;
    for layout in blocks.iter().map(Block::layout) {
        level.extend(layout.level().to_le_bytes());
        side.extend((layout.patch() as u32).to_le_bytes());
        first.extend(patches.to_le_bytes());
        patches += layout.patches().len() as u32;
        for Patch { corner, wi, wo } in layout.patches() {
            for (bytes, vector) in vectors.iter_mut().zip([wi, wo, corner]) {
                bytes.extend(vector[0].to_le_bytes());
                bytes.extend(vector[1].to_le_bytes());
            }
        }
    }
    let noise: Vec<u8> = blocks.iter().flat_map(|block| block.noise().to_le_bytes()).collect();
    let spp = blocks.iter().map(|block| block.spp().map(u32::to_le_bytes)).collect::<Option<Vec<_>>>();
    let spp = spp.map(|spp| spp.into_flattened());
    let (n, k) = (vec![blocks.len()], vec![patches as usize, 2]);
    let failed = |e: &dyn std::fmt::Display| Error::file(path, format!("cannot be written: {e}"));
    let tensors = [
        ("level", Dtype::F32, &n, &level),
        ("patch", Dtype::U32, &n, &side),
        ("noise", Dtype::F32, &n, &noise),
        ("first", Dtype::U32, &n, &first),
        ("wi", Dtype::F32, &k, &vectors[0]),
        ("wo", Dtype::F32, &k, &vectors[1]),
        ("corner", Dtype::F32, &k, &vectors[2]),
    ]
    .into_iter()
    .chain(spp.as_ref().map(|spp| ("spp", Dtype::U32, &n, spp)))
    .map(|(name, dtype, shape, data)| Ok((name, TensorView::new(dtype, shape.clone(), data)?)))
    .collect::<std::result::Result<Vec<_>, safetensors::SafeTensorError>>()
    .map_err(|e| failed(&e))?;
    let bytes = safetensors::serialize(tensors, None).map_err(|e| failed(&e))?;
    write_whole(path, &bytes)
}

/// Reads the rows of `blocks` blocks of side `side` with `patches` patches in all.
///
/// # Errors
/// `File` if the file is not `bytes` long or is not that table.
pub(crate) fn read_table(
    path: &Path,
    bytes: u64,
    side: usize,
    blocks: usize,
    patches: usize,
) -> Result<Vec<Row>> {
    let wrong = |problem: &dyn std::fmt::Display| Error::file(path, problem);
    check_bytes(path, bytes)?;
    if bytes > 20 * blocks as u64 + 24 * patches as u64 + HEADER_BYTES {
        return Err(wrong(&format!("is too long for {blocks} blocks with {patches} patches")));
    }
    let data = std::fs::read(path).map_err(|e| wrong(&format!("cannot be read: {e}")))?;
    let tensors =
        SafeTensors::deserialize(&data).map_err(|e| wrong(&format!("is not a safetensors file: {e}")))?;
    let words = |name: &str, dtype: Dtype, shape: &[usize]| -> Result<Vec<[u8; 4]>> {
        let view = tensors.tensor(name).map_err(|_| wrong(&format!("has no tensor {name}")))?;
        if view.dtype() != dtype || view.shape() != shape {
            return Err(wrong(&format!(
                "{name} is {:?} {:?}, not {dtype:?} {shape:?}",
                view.dtype(),
                view.shape()
            )));
        }
        Ok(view.data().as_chunks::<4>().0.to_vec())
    };
    let vectors = |name: &str| -> Result<Vec<[f32; 2]>> {
        let flat = words(name, Dtype::F32, &[patches, 2])?;
        Ok(flat
            .as_chunks::<2>()
            .0
            .iter()
            .map(|[x, y]| [f32::from_le_bytes(*x), f32::from_le_bytes(*y)])
            .collect())
    };
    let level = words("level", Dtype::F32, &[blocks])?;
    let patch = words("patch", Dtype::U32, &[blocks])?;
    let noise = words("noise", Dtype::F32, &[blocks])?;
    let first = words("first", Dtype::U32, &[blocks])?;
    let (wi, wo, corner) = (vectors("wi")?, vectors("wo")?, vectors("corner")?);
    let spp = if tensors.tensor("spp").is_ok() { Some(words("spp", Dtype::U32, &[blocks])?) } else { None };

    let mut start = 0;
    let mut out = Vec::with_capacity(blocks);
    for b in 0..blocks {
        let patch = u32::from_le_bytes(patch[b]) as usize;
        if patch == 0 || patch > MAX_SIDE || !side.is_multiple_of(patch) {
            return Err(wrong(&format!(
                "patch[{b}] is {patch}, which does not divide the block's side {side}"
            )));
        }
        let end = start + (side / patch) * (side / patch);
        if u32::from_le_bytes(first[b]) as usize != start || end > patches {
            return Err(wrong(&format!("first[{b}] is not where the patches of block {b} start")));
        }
        let of_block = (start..end).map(|k| Patch { corner: corner[k], wi: wi[k], wo: wo[k] }).collect();
        let layout = Layout::new(side, patch, f32::from_le_bytes(level[b]), of_block)
            .map_err(|e| wrong(&format!("block {b}: {e}")))?;
        let noise = f32::from_le_bytes(noise[b]);
        if !(noise.is_finite() && noise >= 0.0) {
            return Err(wrong(&format!("noise[{b}] is {noise}, not a variance")));
        }
        let spp = spp.as_ref().map(|spp| u32::from_le_bytes(spp[b]));
        out.push(Row { layout, noise, spp });
        start = end;
    }
    if start != patches {
        return Err(wrong(&format!("has {patches} patches where its blocks hold {start}")));
    }
    Ok(out)
}
