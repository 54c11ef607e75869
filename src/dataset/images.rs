//! Blocks as images, for decoders that read the queries around each one.

use super::block::{Layout, Patch};
use crate::{
    error::{Error, Result},
    query::grid::Mosaic,
};

/// Least side of a patch that is no whole tile, in radii: at least 9/16 of its samples are as far as a radius from its border.
const LEAST_RADII: usize = 8;
/// Distance of a corner from that of a texel, in texels of its level: rounding of f32 positions is far below.
const OFF_GRID: f64 = 1.0 / 64.0;

impl Layout {
    /// The patches as images.
    pub fn mosaic(&self) -> Mosaic {
        let across = self.side() / self.patch();
        Mosaic { down: across, across, height: self.patch(), width: self.patch() }
    }

    /// True if every patch is a whole tile of \[H, W\] texels.
    pub fn is_whole(&self, resolution: [usize; 2]) -> bool {
        let covered = self.patch() as f64 * f64::from(self.level()).exp2();
        resolution.iter().all(|side| covered == *side as f64)
    }

    /// How far from a patch's border a sample has to be for a decoder of this radius to answer it as on the whole tile.
    pub fn margin(&self, radius: usize, resolution: [usize; 2]) -> usize {
        if self.is_whole(resolution) { 0 } else { radius }
    }

    /// Checks that a decoder of this radius learns from pieces of side `piece`: regular grids at whole levels, whole tiles or
    /// large parts of one.
    ///
    /// # Errors
    /// `Config`, saying what data it needs.
    pub(crate) fn check_images(&self, radius: usize, piece: usize, resolution: [usize; 2]) -> Result<()> {
        let needs = |problem: String| {
            let advice = "generate it with --regime slices";
            let problem = format!(
                "this decoder learns from whole images, since it reads all queries within {radius} samples; {problem}: {advice}"
            );
            Err(Error::config("decoder.kind", problem))
        };
        let level = self.level();
        if level.fract() != 0.0 {
            return needs(format!("the data has level {level} between two whole ones"));
        }
        let on_grid = |Patch { corner, .. }: &Patch| {
            corner.iter().zip([resolution[1], resolution[0]]).all(|(corner, side)| {
                let texels = f64::from(*corner) * side as f64 / f64::from(level).exp2();
                (texels - texels.round()).abs() < OFF_GRID
            })
        };
        if !self.patches().iter().all(on_grid) {
            return needs("the data has patches between the texels".into());
        }
        let whole = self.is_whole(resolution) && self.patch() <= piece;
        if whole || self.patch().min(piece) >= LEAST_RADII * radius {
            return Ok(());
        }
        if self.patch() > piece {
            let problem = format!(
                "{piece} cuts images into parts that are too small for a decoder that reads all queries within {radius} \
                 samples; use {} or more",
                (LEAST_RADII * radius).next_power_of_two().min(self.patch())
            );
            return Err(Error::config("train.piece", problem));
        }
        needs(format!("the data has patches of {0} x {0} samples", self.patch()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RESOLUTION: [usize; 2] = [256, 256];

    fn layout(side: usize, patch: usize, level: f32, corner: [f32; 2]) -> Layout {
        let across = side / patch;
        let patches = vec![Patch { corner, wi: [0.1; 2], wo: [0.2; 2] }; across * across];
        Layout::new(side, patch, level, patches).unwrap()
    }

    #[test]
    fn whole_tiles_and_large_parts_of_one_are_learned_from_and_nothing_else() {
        let whole = layout(256, 64, 2.0, [0.0; 2]);
        assert_eq!(whole.mosaic(), Mosaic { down: 4, across: 4, height: 64, width: 64 });
        assert_eq!((whole.margin(12, RESOLUTION), whole.margin(12, [512, 512])), (0, 12));
        for (layout, piece) in
            [(whole, 256), (layout(256, 256, 0.0, [0.0; 2]), 128), (layout(128, 128, 0.0, [0.25, 0.5]), 128)]
        {
            layout.check_images(12, piece, RESOLUTION).unwrap();
        }
        for (layout, piece, cause) in [
            (layout(256, 256, 0.0, [0.0; 2]), 64, "train.piece: 64"),
            (layout(32, 32, 0.0, [0.0; 2]), 32, "--regime slices"),
            (layout(128, 128, 0.0, [0.251, 0.0]), 128, "between the texels"),
            (layout(128, 128, 0.5, [0.0; 2]), 128, "level 0.5"),
        ] {
            let problem = layout.check_images(12, piece, RESOLUTION).unwrap_err().to_string();
            assert!(problem.contains(cause) && problem.contains("within 12 samples"), "{problem}");
        }
        // A smaller radius is content with smaller parts.
        layout(32, 32, 0.0, [0.0; 2]).check_images(4, 32, RESOLUTION).unwrap();
    }
}
