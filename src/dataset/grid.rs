//! Many blocks in one frame: ceil(sqrt(n)) to a row, unused cells black.

use super::{
    block::Block,
    frame::{Plane, read_frame, write_frame},
    table::Row,
};
use crate::error::{Error, Result};
use half::f16;
use std::path::Path;

/// Where the cells of a frame of `blocks` blocks are.
struct Grid {
    side: usize,
    columns: usize,
    rows: usize,
}

impl Grid {
    fn new(side: usize, blocks: usize) -> Self {
        let root = blocks.isqrt().max(1);
        let columns = if root * root < blocks { root + 1 } else { root };
        Self { side, columns, rows: blocks.div_ceil(columns) }
    }

    /// \[height, width\] of the frame.
    fn size(&self) -> [usize; 2] {
        [self.rows * self.side, self.columns * self.side]
    }

    /// Pixels of one row of a block.
    fn line(&self, block: usize, row: usize) -> std::ops::Range<usize> {
        let y = block / self.columns * self.side + row;
        let start = (y * self.columns + block % self.columns) * self.side;
        start..start + self.side
    }
}

/// Writes blocks of one side; returns the bytes written.
pub(crate) fn write_grid(path: &Path, side: usize, blocks: &[Block]) -> Result<u64> {
    let grid = Grid::new(side, blocks.len());
    let [height, width] = grid.size();
    let plane = |c: usize| {
        let mut values = vec![f16::ZERO; height * width];
        for (b, block) in blocks.iter().enumerate() {
            for (row, rgb) in block.rgb().chunks_exact(side).enumerate() {
                let line = &mut values[grid.line(b, row)];
                line.iter_mut().zip(rgb).for_each(|(value, rgb)| *value = rgb[c]);
            }
        }
        Plane::Half(values)
    };
    write_frame(path, [height, width], vec![("R", plane(0)), ("G", plane(1)), ("B", plane(2))])
}

/// Reads the answers of the blocks that the rows of their table describe.
///
/// # Errors
/// `File` if it is no frame of half floats of the size that follows, or a value is not finite.
pub(crate) fn read_grid(path: &Path, side: usize, rows: Vec<Row>) -> Result<Vec<Block>> {
    let grid = Grid::new(side, rows.len());
    let (_, planes) = read_frame(path, Some(grid.size()), &["R", "G", "B"])?;
    let [Plane::Half(r), Plane::Half(g), Plane::Half(b)] = planes.as_slice() else {
        return Err(Error::file(path, "does not hold half floats"));
    };
    let blocks = rows.into_iter().enumerate().map(|(index, Row { layout, noise, spp })| {
        let mut rgb: Vec<[f16; 3]> = Vec::with_capacity(side * side);
        for row in 0..side {
            let line = grid.line(index, row);
            let pixels = r[line.clone()].iter().zip(&g[line.clone()]).zip(&b[line]);
            rgb.extend(pixels.map(|((r, g), b)| [*r, *g, *b]));
        }
        let block =
            Block::new(layout, rgb, noise).map_err(|e| Error::file(path, format!("block {index}: {e}")))?;
        Ok(match spp {
            Some(spp) => block.with_spp(spp),
            None => block,
        })
    });
    blocks.collect()
}
