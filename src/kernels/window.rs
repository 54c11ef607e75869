//! Positions on a tile as positions in a window of it.

use super::simd::{Isa, Simd, Work, dispatch};

/// A window of a tile; pairs are along x and y.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    /// Its corner, in tiles.
    pub corner: [f32; 2],
    /// Windows in a tile.
    pub scale: [f32; 2],
    /// Whether it is a part of the tile.
    pub part: [bool; 2],
    /// The level of everything outside of it.
    pub outside: f32,
}

/// Replaces rows of positions, any finite ones, by those in the window, wrapped, and the level of those outside of it.
///
/// # Panics
/// If the rows are not of one length that is a multiple of 16.
pub fn lead(isa: Isa, window: &Window, u: [&mut [f32]; 2], level: &mut [f32]) {
    assert!(u[0].len() == level.len() && u[1].len() == level.len() && level.len().is_multiple_of(16));
    dispatch(isa, Lead { window, u, level });
}

struct Lead<'a> {
    window: &'a Window,
    u: [&'a mut [f32]; 2],
    level: &'a mut [f32],
}

impl Work for Lead<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Window { corner, scale, part, outside } = *self.window;
        for (c, row) in self.u.into_iter().enumerate() {
            let (corner, scale) = (s.splat(corner[c]), s.splat(scale[c]));
            let levels = self.level.chunks_exact_mut(S::LANES);
            for (u, level) in row.chunks_exact_mut(S::LANES).zip(levels) {
                let moved = s.sub(s.load(u), corner);
                let local = s.mul(s.sub(moved, s.floor(moved)), scale);
                let windows = s.floor(local);
                s.store(u, s.sub(local, windows));
                if part[c] {
                    let beyond = s.greater(windows, s.splat(0.0));
                    let here = s.load(level);
                    s.store(level, s.select(beyond, s.splat(outside), here));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_move_into_the_window_on_every_instruction_set() {
        let window = Window { corner: [0.75, 0.5], scale: [2.0, 1.0], part: [true, false], outside: 3.0 };
        for isa in Isa::all() {
            let (mut x, mut y, mut level) = ([0.8125f32; 16], [0.75f32; 16], [1.0f32; 16]);
            (x[1], x[2], y[3]) = (0.5, -9.0, 0.25);
            lead(isa, &window, [&mut x, &mut y], &mut level);
            assert_eq!((x[0], y[0], level[0]), (0.125, 0.25, 1.0), "{isa:?}");
            assert_eq!((x[1], level[1]), (0.5, 3.0), "{isa:?}");
            assert_eq!((x[2], level[2]), (0.5, 1.0), "{isa:?}");
            assert_eq!((y[3], level[3]), (0.75, 1.0), "{isa:?}");
        }
    }
}
