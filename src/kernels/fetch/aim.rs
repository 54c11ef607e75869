//! Where samples look: levels, texels, fractions; and the request for those texels.

use super::{GROUP, Places, Pyramid, Texels, padded};
use crate::kernels::simd::{Isa, Simd, Work, dispatch};

/// Which texels the samples of a tile read: found by [`aim()`], read by [`super::read()`]. What is done between the two hides the
/// time that texels take to arrive.
#[derive(Clone, Debug, Default)]
pub struct Aim(pub(super) Vec<[Corners; 2]>);

/// Finds where a tile looks in a pyramid, trilinearly; in one texture, bilinearly.
///
/// # Panics
/// If `stride` is no multiple of 16, there is no level, or a slice is too short.
pub fn aim(isa: Isa, stride: usize, channels: usize, pyramid: &Pyramid, at: Places, out: &mut Aim) {
    assert!(stride.is_multiple_of(GROUP) && !pyramid.levels.is_empty());
    assert!(at.x.len() >= stride && at.y.len() >= stride && at.level.len() >= stride);
    out.0.resize(stride / GROUP, [Corners::NONE; 2]);
    dispatch(isa, FindAim { channels, pyramid, at, groups: &mut out.0 });
}

struct FindAim<'a> {
    channels: usize,
    pyramid: &'a Pyramid<'a>,
    at: Places<'a>,
    groups: &'a mut [[Corners; 2]],
}

/// Corners of 16 samples in one level.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corners {
    /// Rows and columns of the four texels, as texel numbers.
    pub index: [[u32; GROUP]; 4],
    pub fraction: [[f32; GROUP]; 2],
    pub size: [[f32; GROUP]; 2],
    pub level: [u32; GROUP],
    /// Weight of the level.
    pub mix: [f32; GROUP],
}

impl Corners {
    const NONE: Self = Self {
        index: [[0; GROUP]; 4],
        fraction: [[0.0; GROUP]; 2],
        size: [[0.0; GROUP]; 2],
        level: [0; GROUP],
        mix: [0.0; GROUP],
    };
}

impl Work for FindAim<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        for (number, levels) in self.groups.iter_mut().enumerate() {
            for at in (0..GROUP).step_by(S::LANES) {
                choose(s, self.pyramid, self.at, number * GROUP, at, levels);
            }
            for corners in levels {
                for i in 0..GROUP {
                    if corners.mix[i] == 0.0 {
                        continue;
                    }
                    // The two texels of a row mostly lie side by side, on one line or on two.
                    let texel = |c: usize| corners.index[c][i] as usize;
                    match self.pyramid.levels.get(corners.level[i] as usize) {
                        Some(Texels::Single(all)) => {
                            for c in [0, 2] {
                                s.prefetch(all, texel(c) * self.channels);
                                s.prefetch(all, (texel(c + 1) + 1) * self.channels - 1);
                            }
                        }
                        Some(Texels::Half(all)) => {
                            for c in 0..4 {
                                s.prefetch(all, texel(c) * padded(self.channels));
                            }
                        }
                        None => {}
                    }
                }
            }
        }
    }
}

/// The two levels of a vector of samples, and where they are in them.
#[inline(always)]
fn choose<S: Simd>(
    s: S,
    pyramid: &Pyramid,
    places: Places,
    start: usize,
    at: usize,
    levels: &mut [Corners; 2],
) {
    let last = s.splat((pyramid.levels.len() - 1) as f32);
    let level = s.min(s.max(s.load(&places.level[start + at..]), s.splat(0.0)), last);
    let finer = s.floor(level);
    let share = s.sub(level, finer);
    let coarser = s.min(s.add(finer, s.splat(1.0)), last);
    let sides = [pyramid.width as f32, pyramid.height as f32];
    let parts = [(finer, s.sub(s.splat(1.0), share)), (coarser, share)];
    for (corners, (number, mix)) in levels.iter_mut().zip(parts) {
        let number = s.truncate(number);
        s.int_store(&mut corners.level[at..], number);
        s.store(&mut corners.mix[at..], mix);
        // 2^-level, made of its exponent.
        let exponent = s.int_add(s.int(127), s.int_mul(number, s.int(-1)));
        let scale = s.as_float(s.int_up::<23>(exponent));
        let mut sizes = [s.splat(1.0); 2];
        for axis in 0..2 {
            sizes[axis] = s.max(s.floor(s.mul(s.splat(sides[axis]), scale)), s.splat(1.0));
            s.store(&mut corners.size[axis][at..], sizes[axis]);
        }
        place(s, places, start, at, sizes, corners);
    }
}

/// Texels and fractions of a vector of samples in levels of these sizes.
#[inline(always)]
fn place<S: Simd>(s: S, places: Places, start: usize, at: usize, sizes: [S::F; 2], corners: &mut Corners) {
    let mut cells = [[s.int(0); 2]; 2];
    for (axis, u) in [places.x, places.y].into_iter().enumerate() {
        let size = sizes[axis];
        let x = s.sub(s.mul(s.load(&u[start + at..]), size), s.splat(0.5));
        let low = s.floor(x);
        s.store(&mut corners.fraction[axis][at..], s.sub(x, low));
        let turns = s.floor(s.div(low, size));
        let wrapped = s.sub(low, s.mul(turns, size));
        // Far away, where neighbouring floats are further apart than texels, and for what is no number.
        let first = s.min(s.max(wrapped, s.splat(0.0)), s.sub(size, s.splat(1.0)));
        let next = s.add(first, s.splat(1.0));
        let second = s.select(s.greater(size, next), next, s.splat(0.0));
        cells[axis] = [s.truncate(first), s.truncate(second)];
    }
    let width = s.truncate(sizes[0]);
    for (row, y) in cells[1].into_iter().enumerate() {
        let line = s.int_mul(y, width);
        for (column, x) in cells[0].into_iter().enumerate() {
            s.int_store(&mut corners.index[2 * row + column][at..], s.int_add(line, x));
        }
    }
}
