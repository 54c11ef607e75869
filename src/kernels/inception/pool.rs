//! 3x3 max-pool of stride 1 of a line. Its inputs are outputs of a ReLU, so zeros outside an image are as good as nothing.

use super::super::simd::{Isa, Simd, Work, dispatch};
use super::grid::{Grid, HALO, Source};

/// Side of the window.
const SIDE: usize = 3;

type Rows<'a> = [Option<&'a [f32]>; SIDE];

fn around<'a>(grid: &Grid, source: Source<'a>, line: usize, channels: usize) -> Rows<'a> {
    std::array::from_fn(|ky| source.neighbour(grid, line, ky as isize - 1, channels))
}

/// The largest of each window, rows \[channel\]\[stride\].
pub fn largest(isa: Isa, grid: &Grid, source: Source, line: usize, out: &mut [f32]) {
    let rows = around(grid, source, line, out.len() / grid.stride);
    dispatch(isa, Largest { grid, rows, middle: &mut vec![0.0; grid.stride], out });
}

struct Largest<'a> {
    grid: &'a Grid,
    rows: Rows<'a>,
    /// The largest of each column of three.
    middle: &'a mut [f32],
    out: &'a mut [f32],
}

impl Work for Largest<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let stride = self.grid.stride;
        let channels = self.out.len() / stride;
        let nothing = vec![0.0; stride];
        for c in 0..channels {
            let row = |ky: usize| self.rows[ky].map_or(&nothing[..], |r| &r[c * stride..(c + 1) * stride]);
            let (above, own, below) = (row(0), row(1), row(2));
            let rows = above.chunks_exact(S::LANES).zip(own.chunks_exact(S::LANES));
            let rows = rows.zip(below.chunks_exact(S::LANES)).zip(self.middle.chunks_exact_mut(S::LANES));
            for (((above, own), below), middle) in rows {
                s.store(middle, s.max(s.max(s.load(above), s.load(own)), s.load(below)));
            }
            let out = &mut self.out[c * stride + HALO..(c + 1) * stride];
            for at in (0..self.grid.computed).step_by(S::LANES) {
                let near = &self.middle[HALO - 1 + at..HALO + 1 + at + S::LANES];
                let sides = s.max(s.load(near), s.load(&near[2..]));
                s.store(&mut out[at..], s.max(sides, s.load(&near[1..])));
            }
        }
    }
}

/// The largest of each window and the place in the window, 0 to 8 in scan order, of the first that is as large.
pub fn winners(isa: Isa, grid: &Grid, source: Source, line: usize, out: &mut [f32], places: &mut [f32]) {
    let rows = around(grid, source, line, out.len() / grid.stride);
    dispatch(isa, Winners { grid, rows, out, places });
}

struct Winners<'a> {
    grid: &'a Grid,
    rows: Rows<'a>,
    out: &'a mut [f32],
    places: &'a mut [f32],
}

impl Work for Winners<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let stride = self.grid.stride;
        for c in 0..self.out.len() / stride {
            for at in (0..self.grid.computed).step_by(S::LANES) {
                let place = c * stride + HALO + at;
                // Below any output of a ReLU.
                let (mut best, mut winner) = (s.splat(-1.0), s.splat(0.0));
                for (ky, rows) in self.rows.iter().enumerate() {
                    let Some(rows) = rows else { continue };
                    for kx in 0..SIDE {
                        let value = s.load(&rows[place + kx - 1..]);
                        let larger = s.greater(value, best);
                        best = s.select(larger, value, best);
                        winner = s.select(larger, s.splat((ky * SIDE + kx) as f32), winner);
                    }
                }
                s.store(&mut self.out[place..], best);
                s.store(&mut self.places[place..], winner);
            }
        }
    }
}

/// Gradients of the inputs of a line, rows \[channel\]\[stride\]: each takes those of the windows that it won.
pub fn back(isa: Isa, grid: &Grid, gradient: Source, places: Source, line: usize, out: &mut [f32]) {
    let channels = out.len() / grid.stride;
    let (gradient, places) = (around(grid, gradient, line, channels), around(grid, places, line, channels));
    dispatch(isa, Back { grid, gradient, places, out });
}

struct Back<'a> {
    grid: &'a Grid,
    gradient: Rows<'a>,
    places: Rows<'a>,
    out: &'a mut [f32],
}

impl Work for Back<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let stride = self.grid.stride;
        for c in 0..self.out.len() / stride {
            for at in (0..self.grid.computed).step_by(S::LANES) {
                let place = c * stride + HALO + at;
                let mut sum = s.splat(0.0);
                for (ky, both) in self.gradient.iter().zip(&self.places).enumerate() {
                    let (Some(gradient), Some(places)) = both else { continue };
                    for kx in 0..SIDE {
                        // Seen from a window above, this pixel is below.
                        let own = ((SIDE - 1 - ky) * SIDE + SIDE - 1 - kx) as f32;
                        let winner = s.load(&places[place + kx - 1..]);
                        let won = s.both(
                            s.greater(winner, s.splat(own - 0.5)),
                            s.greater(s.splat(own + 0.5), winner),
                        );
                        let part = s.load(&gradient[place + kx - 1..]);
                        sum = s.add(sum, s.select(won, part, s.splat(0.0)));
                    }
                }
                s.store(&mut self.out[place..], sum);
            }
        }
    }
}
