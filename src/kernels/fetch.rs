//! Wrapped bilinear and trilinear lookups of tiles of samples, with the slopes along u, and the scatter of their gradients.
//!
//! Positions are computed with lanes as samples, texels are mixed with lanes as channels, and the result is transposed.

use super::simd::{Isa, Simd, TEXEL, Work, dispatch};
use half::f16;

/// Samples of a tile come in multiples of this.
const GROUP: usize = 16;

/// Channels rounded up to whole texel vectors: floats a texel of gradient tables and half-precision textures.
pub fn padded(channels: usize) -> usize {
    channels.next_multiple_of(TEXEL)
}

/// Textures of which each is half the size of the one before: level l has max(1, side >> l) rows and columns.
#[derive(Clone, Debug)]
pub struct Pyramid<'a> {
    /// The levels, finest first.
    pub levels: Vec<Texels<'a>>,
    /// Rows of the finest.
    pub height: usize,
    /// Columns of the finest.
    pub width: usize,
}

/// Values of a texture, row by row.
#[derive(Clone, Copy, Debug)]
pub enum Texels<'a> {
    /// Single precision, `channels` values a texel.
    Single(&'a [f32]),
    /// Half precision, [`padded`] values a texel.
    Half(&'a [f16]),
}

/// Where a lookup read in one level: texels of the gradient table, and their weights.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Taps([f32; TEXEL]);

impl Taps {
    /// Texels (row 0, column 0), (0, 1), (1, 0), (1, 1); the levels follow one another in the table.
    #[inline(always)]
    pub fn index(&self) -> [u32; 4] {
        [0, 1, 2, 3].map(|k| self.0[k].to_bits())
    }

    /// Their weights.
    #[inline(always)]
    pub fn weight(&self) -> [f32; 4] {
        [4, 5, 6, 7].map(|k| self.0[k])
    }
}

/// Rows \[stride\] that say where a tile looks.
#[derive(Clone, Copy, Debug)]
pub struct Places<'a> {
    /// First component of the position.
    pub x: &'a [f32],
    /// Second component.
    pub y: &'a [f32],
    /// Level of each sample, clamped to what there is; what is no number counts as 0.
    pub level: &'a [f32],
}

/// What a lookup writes.
#[derive(Debug)]
pub struct Found<'a> {
    /// Features \[channels\]\[stride\].
    pub features: &'a mut [f32],
    /// Their slopes along x and y \[2\]\[channels\]\[stride\]; empty if they are not wanted.
    pub slopes: &'a mut [f32],
    /// Taps of the finer and the coarser level \[2\]\[stride\], or of one texture \[stride\]; empty if they are not wanted.
    pub taps: &'a mut [Taps],
}

/// Which texels the samples of a tile read: found by [`aim`], read by [`read`]. What is done between the two hides the
/// time that texels take to arrive.
#[derive(Clone, Debug, Default)]
pub struct Aim(Vec<[Corners; 2]>);

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

/// Reads what was aimed at.
///
/// # Panics
/// If a slice is too short.
pub fn read(isa: Isa, stride: usize, channels: usize, pyramid: &Pyramid, aim: &Aim, found: Found) {
    assert!(stride == GROUP * aim.0.len() && found.features.len() >= channels * stride);
    assert!(found.slopes.is_empty() || found.slopes.len() >= 2 * channels * stride);
    dispatch(isa, Read { stride, channels, pyramid, groups: &aim.0, found });
}

struct FindAim<'a> {
    channels: usize,
    pyramid: &'a Pyramid<'a>,
    at: Places<'a>,
    groups: &'a mut [[Corners; 2]],
}

struct Read<'a> {
    stride: usize,
    channels: usize,
    pyramid: &'a Pyramid<'a>,
    groups: &'a [[Corners; 2]],
    found: Found<'a>,
}

/// Corners of 16 samples in one level.
#[derive(Clone, Copy, Debug)]
struct Corners {
    /// Rows and columns of the four texels, as texel numbers.
    index: [[u32; GROUP]; 4],
    fraction: [[f32; GROUP]; 2],
    size: [[f32; GROUP]; 2],
    level: [u32; GROUP],
    /// Weight of the level.
    mix: [f32; GROUP],
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
                    for (c, end) in [(0, 0), (1, 1), (2, 0), (3, 1)] {
                        let texel = corners.index[c][i] as usize;
                        match self.pyramid.levels.get(corners.level[i] as usize) {
                            Some(Texels::Single(all)) => {
                                s.prefetch(all, texel * self.channels + end * (self.channels - 1));
                            }
                            Some(Texels::Half(all)) => s.prefetch(all, texel * padded(self.channels)),
                            None => {}
                        }
                    }
                }
            }
        }
    }
}

impl Work for Read<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) {
        let mut bases = [0u32; 32];
        let (mut base, mut sides) = (0, (self.pyramid.height, self.pyramid.width));
        for to in bases.iter_mut().take(self.pyramid.levels.len()) {
            *to = base as u32;
            base += sides.0 * sides.1;
            sides = ((sides.0 / 2).max(1), (sides.1 / 2).max(1));
        }
        let halves = matches!(self.pyramid.levels[0], Texels::Half(_));
        let slopes = !self.found.slopes.is_empty();
        for (number, levels) in self.groups.iter().enumerate() {
            let start = number * GROUP;
            for at in (0..GROUP).step_by(TEXEL) {
                // Most samples of training lie on a level: the other one then weighs nothing.
                let both = levels[1].mix[at..at + TEXEL].iter().any(|m| *m != 0.0);
                let used = if both { &levels[..] } else { &levels[..1] };
                for channel in (0..self.channels).step_by(TEXEL) {
                    match (halves, slopes) {
                        (false, false) => self.mix::<S, false, false>(s, start, at, channel, used),
                        (false, true) => self.mix::<S, false, true>(s, start, at, channel, used),
                        (true, false) => self.mix::<S, true, false>(s, start, at, channel, used),
                        (true, true) => self.mix::<S, true, true>(s, start, at, channel, used),
                    }
                }
                let parts = self.found.taps.chunks_mut(self.stride);
                for (corners, taps) in levels.iter().zip(parts) {
                    remember(s, corners, &bases, at, &mut taps[start + at..]);
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
fn place<S: Simd>(
    s: S,
    places: Places,
    start: usize,
    at: usize,
    sizes: [S::F; 2],
    corners: &mut Corners,
) {
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

impl Read<'_> {
    /// Eight samples' features (and slopes) in eight channels.
    #[inline(always)]
    fn mix<S: Simd, const HALF: bool, const SLOPES: bool>(
        &mut self,
        s: S,
        start: usize,
        at: usize,
        channel: usize,
        levels: &[Corners],
    ) {
        let zero = s.texel_splat(0.0);
        let (mut values, mut along_x, mut along_y) = ([zero; TEXEL], [zero; TEXEL], [zero; TEXEL]);
        let wide = if HALF { padded(self.channels) } else { self.channels };
        for k in 0..TEXEL {
            let i = at + k;
            for corners in levels {
                let mut texels = [zero; 4];
                match self.pyramid.levels.get(corners.level[i] as usize) {
                    Some(Texels::Single(all)) if !HALF => {
                        for c in 0..4 {
                            let first = corners.index[c][i] as usize * wide + channel;
                            texels[c] = match all.get(first..first + TEXEL) {
                                Some(eight) => s.texel_load(eight.as_chunks().0.first().unwrap_or(&[0.0; 8])),
                                None => s.texel_load(&end_of(all, first)),
                            };
                        }
                    }
                    Some(Texels::Half(all)) if HALF => {
                        for c in 0..4 {
                            let first = corners.index[c][i] as usize * wide + channel;
                            if let Some(eight) = all.get(first..first + TEXEL) {
                                texels[c] =
                                    s.texel_load_half(eight.as_chunks().0.first().unwrap_or(&[f16::ZERO; 8]));
                            }
                        }
                    }
                    _ => {}
                }
                let [a, b, c, d] = texels;
                let (fx, fy) =
                    (s.texel_splat(corners.fraction[0][i]), s.texel_splat(corners.fraction[1][i]));
                let mix = s.texel_splat(corners.mix[i]);
                let (upper, lower) = (s.texel_sub(b, a), s.texel_sub(d, c));
                let (top, bottom) = (s.texel_fma(upper, fx, a), s.texel_fma(lower, fx, c));
                let down = s.texel_sub(bottom, top);
                values[k] = s.texel_fma(s.texel_fma(down, fy, top), mix, values[k]);
                if SLOPES {
                    let across = s.texel_fma(s.texel_sub(lower, upper), fy, upper);
                    let per_x = s.texel_splat(corners.mix[i] * corners.size[0][i]);
                    let per_y = s.texel_splat(corners.mix[i] * corners.size[1][i]);
                    along_x[k] = s.texel_fma(across, per_x, along_x[k]);
                    along_y[k] = s.texel_fma(down, per_y, along_y[k]);
                }
            }
        }
        let place = start + at;
        let channels = self.channels;
        write(s, values, channels - channel, self.stride, &mut self.found.features[channel * self.stride + place..]);
        if SLOPES {
            for (part, along) in [along_x, along_y].into_iter().enumerate() {
                let row = part * channels + channel;
                let out = &mut self.found.slopes[row * self.stride + place..];
                write(s, along, channels - channel, self.stride, out);
            }
        }
    }
}

/// Eight values from `first` on, zeros beyond the end.
#[cold]
#[inline(never)]
fn end_of(all: &[f32], first: usize) -> [f32; TEXEL] {
    let mut eight = [0.0; TEXEL];
    for (to, from) in eight.iter_mut().zip(all.get(first..).unwrap_or(&[])) {
        *to = *from;
    }
    eight
}

/// Writes eight samples of up to eight channels to the rows that begin at `out`.
#[inline(always)]
fn write<S: Simd>(s: S, samples: [S::T; TEXEL], channels: usize, stride: usize, out: &mut [f32]) {
    let columns = s.transpose(samples);
    for c in 0..TEXEL {
        if c < channels
            && let Some(eight) = out.get_mut(c * stride..).and_then(|row| row.first_chunk_mut())
        {
            s.texel_store(eight, columns[c]);
        }
    }
}

/// Taps of eight samples.
#[inline(always)]
fn remember<S: Simd>(s: S, corners: &Corners, bases: &[u32; 32], at: usize, out: &mut [Taps]) {
    let mut rows = [[0.0f32; TEXEL]; TEXEL];
    for k in 0..TEXEL {
        let i = at + k;
        let base = bases[corners.level[i] as usize % 32];
        for c in 0..4 {
            rows[c][k] = f32::from_bits(corners.index[c][i] + base);
        }
        let (fx, fy, mix) = (corners.fraction[0][i], corners.fraction[1][i], corners.mix[i]);
        let (upper, lower) = (mix * (1.0 - fy), mix * fy);
        rows[4][k] = upper * (1.0 - fx);
        rows[5][k] = upper * fx;
        rows[6][k] = lower * (1.0 - fx);
        rows[7][k] = lower * fx;
    }
    let mut vectors = [s.texel_splat(0.0); TEXEL];
    for c in 0..TEXEL {
        vectors[c] = s.texel_load(&rows[c]);
    }
    let samples = s.transpose(vectors);
    for (tap, sample) in out.iter_mut().zip(samples) {
        s.texel_store(&mut tap.0, sample);
    }
}

/// Samples between asking for a texel's line and adding to it.
const AHEAD: usize = 8;

/// Texels of a block of a gradient table: blocks go to owners in turn, and each owner adds to its own alone.
pub const OWNED: usize = 512;

/// The blocks of a gradient table that one owner adds to: those whose number is `number` modulo `owners`, a power of two.
#[derive(Debug)]
pub struct Owned<'a> {
    number: usize,
    owners: usize,
    stride: usize,
    blocks: Vec<&'a mut [f32]>,
}

impl<'a> Owned<'a> {
    /// Splits a table of texels of `stride` floats, a multiple of 8, among owners: as many, or up to the next power of two.
    pub fn split(table: &'a mut [f32], stride: usize, owners: usize) -> Vec<Self> {
        let owners = owners.max(1).next_power_of_two();
        let mut all: Vec<Self> =
            (0..owners).map(|number| Self { number, owners, stride, blocks: Vec::new() }).collect();
        for (k, block) in table.chunks_mut(OWNED * stride).enumerate() {
            all[k % owners].blocks.push(block);
        }
        all
    }

    /// Adds the gradients of samples' features to the texels that this owner has. `gradients` holds `stride` floats a
    /// sample. Called for samples in one order, every texel has one sum, whoever owns it.
    pub fn scatter(&mut self, isa: Isa, taps: &[Taps], gradients: &[f32]) {
        dispatch(isa, Scatter { owned: self, taps, gradients });
    }
}

struct Scatter<'a, 'b> {
    owned: &'a mut Owned<'b>,
    taps: &'a [Taps],
    gradients: &'a [f32],
}

impl Work for Scatter<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Owned { number, owners, stride, blocks } = self.owned;
        // A division by a number that is not known here would cost as much as the sum.
        let (mask, shift) = (*owners - 1, owners.trailing_zeros());
        for (k, (taps, gradient)) in self.taps.iter().zip(self.gradients.chunks_exact(*stride)).enumerate() {
            if let Some(taps) = self.taps.get(k + AHEAD) {
                for index in taps.index() {
                    let (block, texel) = (index as usize / OWNED, index as usize % OWNED);
                    if block & mask == *number
                        && let Some(block) = blocks.get(block >> shift)
                    {
                        s.prefetch(block, texel * *stride);
                    }
                }
            }
            if taps.weight() == [0.0; 4] {
                continue;
            }
            for (index, weight) in taps.index().into_iter().zip(taps.weight()) {
                let (block, texel) = (index as usize / OWNED, index as usize % OWNED);
                if block & mask != *number {
                    continue;
                }
                let Some(block) = blocks.get_mut(block >> shift) else { continue };
                let Some(texel) = block.get_mut(texel * *stride..(texel + 1) * *stride) else { continue };
                for (sum, part) in
                    texel.as_chunks_mut::<TEXEL>().0.iter_mut().zip(gradient.as_chunks::<TEXEL>().0)
                {
                    let value = s.texel_fma(s.texel_load(part), s.texel_splat(weight), s.texel_load(sum));
                    s.texel_store(sum, value);
                }
            }
        }
    }
}

/// Rows \[channels\]\[stride\] as \[samples\]\[padded channels\], zeros in the padding.
pub fn by_sample(isa: Isa, stride: usize, channels: usize, rows: &[f32], out: &mut [f32]) {
    dispatch(isa, BySample { stride, channels, rows, out });
}

struct BySample<'a> {
    stride: usize,
    channels: usize,
    rows: &'a [f32],
    out: &'a mut [f32],
}

impl Work for BySample<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let wide = padded(self.channels);
        for channel in (0..self.channels).step_by(TEXEL) {
            for at in (0..self.stride).step_by(TEXEL) {
                let mut rows = [s.texel_splat(0.0); TEXEL];
                for (c, row) in rows.iter_mut().enumerate().take(self.channels - channel) {
                    let first = (channel + c) * self.stride + at;
                    if let Some(eight) = self.rows[first..].first_chunk() {
                        *row = s.texel_load(eight);
                    }
                }
                for (k, sample) in s.transpose(rows).into_iter().enumerate() {
                    if let Some(eight) = self.out[(at + k) * wide + channel..].first_chunk_mut() {
                        s.texel_store(eight, sample);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
#[path = "fetch_tests.rs"]
mod tests;
