//! The unit on disk and in training: a block of S x S samples at one level, made of patches.
//!
//! A block holds m x m patches of side p = S / m, row by row. Each patch has its own pair of directions and
//! its own corner: sample (i, j) of a patch lies at u = corner + ((j + 0.5) 2^level / W, (i + 0.5) 2^level /
//! H), wrapped to \[0, 1). Patches shrink with the level (a patch never laps the tile), blocks do not, so
//! every level has many pairs of directions and a batch of blocks is a rectangle. Neighbouring samples of one
//! patch are neighbours on the surface; across a patch border nothing is continuous.

use crate::{
    error::{Error, Result},
    query::QueryBuffer,
};
use half::{f16, slice::HalfFloatSliceExt};

/// Largest side of a block, samples.
pub const MAX_SIDE: usize = 8192;
/// Largest level: a tile of 8192 texels seen in one sample.
pub const MAX_LEVEL: f32 = 13.0;

/// One patch: where it starts and its pair of directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Corner of the first sample's cell, in \[0, 1)^2.
    pub corner: [f32; 2],
    /// Light direction (x, y).
    pub wi: [f32; 2],
    /// View direction (x, y).
    pub wo: [f32; 2],
}

/// What is asked in a block: everything but the answers.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    side: usize,
    patch: usize,
    level: f32,
    patches: Vec<Patch>,
}

impl Layout {
    /// A layout of `side` x `side` samples in patches of side `patch` at one level.
    ///
    /// # Errors
    /// `Config` if a size, the level, a corner or a direction is out of range.
    pub fn new(side: usize, patch: usize, level: f32, patches: Vec<Patch>) -> Result<Self> {
        if !(1..=MAX_SIDE).contains(&side) {
            return Err(Error::config("block.side", format!("{side} is outside 1 to {MAX_SIDE}")));
        }
        if patch == 0 || !side.is_multiple_of(patch) {
            return Err(Error::config("block.patch", format!("{patch} does not divide the side {side}")));
        }
        let expected = (side / patch) * (side / patch);
        if patches.len() != expected {
            return Err(Error::config(
                "block.patches",
                format!("has {} entries where {expected} patches fill the block", patches.len()),
            ));
        }
        if !(0.0..=MAX_LEVEL).contains(&level) {
            return Err(Error::config("block.level", format!("{level} is outside 0 to {MAX_LEVEL}")));
        }
        for (k, Patch { corner, wi, wo }) in patches.iter().enumerate() {
            if !corner.iter().all(|c| (0.0..1.0).contains(c)) {
                return Err(Error::config(format!("block.corner[{k}]"), "is outside [0, 1)"));
            }
            // Stored directions below the horizon have a length of up to 2.
            if !wi.iter().chain(wo).all(|c| c.abs() <= 2.0) {
                return Err(Error::config(format!("block.directions[{k}]"), "is not a stored direction"));
            }
        }
        Ok(Self { side, patch, level, patches })
    }

    /// Samples along a side.
    pub fn side(&self) -> usize {
        self.side
    }

    /// Samples along a side of each patch.
    pub fn patch(&self) -> usize {
        self.patch
    }

    /// The level of all samples.
    pub fn level(&self) -> f32 {
        self.level
    }

    /// The patches, row by row.
    pub fn patches(&self) -> &[Patch] {
        &self.patches
    }

    /// All samples as queries on a tile of \[H, W\] texels: a `side` x `side` grid.
    pub fn queries(&self, resolution: [usize; 2]) -> QueryBuffer {
        stack((0..self.side).map(|row| (self, row)), self.side, resolution)
    }

    /// All samples as rows of the components of u, wi and wo, of `side * side` values each.
    ///
    /// # Panics
    /// If a row has another length.
    pub fn rows(&self, resolution: [usize; 2], rows: [&mut [f32]; 6]) {
        let [ux, uy, wix, wiy, wox, woy] = rows;
        let (side, patch) = (self.side, self.patch);
        let step = f64::from(self.level).exp2();
        let at = |corner: f32, index: usize, texels: usize| {
            wrap(f64::from(corner) + (index as f64 + 0.5) * step / texels as f64)
        };
        for (k, of_patch) in self.patches.iter().enumerate() {
            let first = (k / (side / patch) * side + k % (side / patch)) * patch;
            for column in 0..patch {
                ux[first + column] = at(of_patch.corner[0], column, resolution[1]);
            }
            for row in 0..patch {
                let line = first + row * side..first + row * side + patch;
                ux.copy_within(first..first + patch, line.start);
                uy[line.clone()].fill(at(of_patch.corner[1], row, resolution[0]));
                wix[line.clone()].fill(of_patch.wi[0]);
                wiy[line.clone()].fill(of_patch.wi[1]);
                wox[line.clone()].fill(of_patch.wo[0]);
                woy[line].fill(of_patch.wo[1]);
            }
        }
    }

    /// Checks that pieces of side `side` tile the block without cutting a patch unevenly.
    ///
    /// # Errors
    /// `Config` if they do not.
    pub fn check_cut(&self, side: usize) -> Result<()> {
        let even = |a: usize, b: usize| a.is_multiple_of(b) || b.is_multiple_of(a);
        if side == 0 || !self.side.is_multiple_of(side) || !even(self.patch, side) {
            return Err(Error::config(
                "train.piece",
                format!(
                    "{side} does not cut blocks of side {0} with patches of side {1} into whole pieces; {0} does",
                    self.side, self.patch
                ),
            ));
        }
        Ok(())
    }

    /// The piece of side `side` at (row, column) of the block's grid of pieces; `check_cut` must have passed.
    fn piece(&self, side: usize, row: usize, column: usize, resolution: [usize; 2]) -> Self {
        let patch = self.patch.min(side);
        let (per_piece, per_block) = (side / patch, self.side / self.patch);
        let step = f64::from(self.level).exp2();
        let patches = (0..per_piece * per_piece)
            .map(|k| {
                let y = row * side + k / per_piece * patch;
                let x = column * side + k % per_piece * patch;
                let whole = self.patches[y / self.patch * per_block + x / self.patch];
                let moved = |corner: f32, offset: usize, texels: usize| {
                    wrap(f64::from(corner) + offset as f64 * step / texels as f64)
                };
                let corner = [
                    moved(whole.corner[0], x % self.patch, resolution[1]),
                    moved(whole.corner[1], y % self.patch, resolution[0]),
                ];
                Patch { corner, ..whole }
            })
            .collect();
        Self { side, patch, level: self.level, patches }
    }
}

/// Rows of layouts of one side, one under the other, as one query buffer.
pub(crate) fn stack<'a>(
    rows: impl ExactSizeIterator<Item = (&'a Layout, usize)>,
    side: usize,
    resolution: [usize; 2],
) -> QueryBuffer {
    let mut queries = QueryBuffer::slice(rows.len(), side, [0.0; 2], [0.0; 2], 0.0);
    let mut start = 0;
    for (layout, row) in rows {
        let (side, patch) = (layout.side, layout.patch);
        let step = f64::from(layout.level).exp2();
        let at = |corner: f32, index: usize, texels: usize| {
            wrap(f64::from(corner) + (index as f64 + 0.5) * step / texels as f64)
        };
        let first = row / patch * (side / patch);
        for of_patch in &layout.patches[first..first + side / patch] {
            let line = start..start + patch;
            let y = at(of_patch.corner[1], row % patch, resolution[0]);
            for (column, u) in queries.u[line.clone()].iter_mut().enumerate() {
                *u = [at(of_patch.corner[0], column, resolution[1]), y];
            }
            queries.wi[line.clone()].fill(of_patch.wi);
            queries.wo[line.clone()].fill(of_patch.wo);
            queries.level[line].fill(layout.level);
            start += patch;
        }
    }
    queries
}

/// A block with its answers.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    layout: Layout,
    rgb: Vec<[f16; 3]>,
    noise: f32,
    spp: Option<u32>,
}

impl Block {
    /// A block from its layout, `side * side` answers row by row, and their mean variance.
    ///
    /// # Errors
    /// `Config` if the number of answers is wrong or a value is not finite.
    pub fn new(layout: Layout, rgb: Vec<[f16; 3]>, noise: f32) -> Result<Self> {
        let expected = layout.side * layout.side;
        if rgb.len() != expected {
            return Err(Error::config("block.rgb", format!("has {} of {expected} samples", rgb.len())));
        }
        if let Some(k) = rgb.as_flattened().iter().position(|v| !v.is_finite()) {
            return Err(Error::config(format!("block.rgb[{}]", k / 3), "is not finite"));
        }
        if !(noise.is_finite() && noise >= 0.0) {
            return Err(Error::config("block.noise", format!("{noise} is not a variance")));
        }
        Ok(Self { layout, rgb, noise, spp: None })
    }

    /// The same with the number of sub-samples behind each answer, where that differs between blocks.
    pub fn with_spp(self, spp: u32) -> Self {
        Self { spp: Some(spp), ..self }
    }

    /// What is asked.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Samples along a side.
    pub fn side(&self) -> usize {
        self.layout.side
    }

    /// Samples along a side of each patch.
    pub fn patch(&self) -> usize {
        self.layout.patch
    }

    /// The level of all samples.
    pub fn level(&self) -> f32 {
        self.layout.level
    }

    /// The patches, row by row.
    pub fn patches(&self) -> &[Patch] {
        &self.layout.patches
    }

    /// The answers, row by row.
    pub fn rgb(&self) -> &[[f16; 3]] {
        &self.rgb
    }

    /// Mean variance of the answers.
    pub fn noise(&self) -> f32 {
        self.noise
    }

    /// Sub-samples behind each answer, where the block has its own number.
    pub fn spp(&self) -> Option<u32> {
        self.spp
    }

    /// All samples as queries on a tile of \[H, W\] texels: a `side` x `side` grid.
    pub fn queries(&self, resolution: [usize; 2]) -> QueryBuffer {
        self.layout.queries(resolution)
    }

    /// The answers in single precision, row by row.
    pub fn target(&self) -> Vec<[f32; 3]> {
        let mut out = vec![[0.0; 3]; self.rgb.len()];
        self.rgb.as_flattened().convert_to_f32_slice(out.as_flattened_mut());
        out
    }

    /// All pieces of side `side`, row by row; a patch larger than that is cut and its corner moves with it.
    ///
    /// # Errors
    /// `Config` if pieces of that side do not fill the block.
    pub fn cut(&self, side: usize, resolution: [usize; 2]) -> Result<Vec<Self>> {
        self.layout.check_cut(side)?;
        let per_block = self.side() / side;
        Ok((0..per_block * per_block).map(|k| self.piece(side, k, resolution)).collect())
    }

    /// The `index`-th piece of [`Block::cut`]; `check_cut` must have passed.
    pub(crate) fn piece(&self, side: usize, index: usize, resolution: [usize; 2]) -> Self {
        let per_block = self.side() / side;
        let (row, column) = (index / per_block, index % per_block);
        let mut rgb = Vec::with_capacity(side * side);
        for y in row * side..(row + 1) * side {
            let start = y * self.side() + column * side;
            rgb.extend_from_slice(&self.rgb[start..start + side]);
        }
        Self {
            layout: self.layout.piece(side, row, column, resolution),
            rgb,
            noise: self.noise,
            spp: self.spp,
        }
    }
}

/// x modulo 1; the value that rounds up to 1 is 0.
pub(crate) fn wrap(x: f64) -> f32 {
    let fraction = (x - x.floor()) as f32;
    if fraction < 1.0 { fraction } else { 0.0 }
}
