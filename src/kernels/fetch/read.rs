//! Mixing the texels that were aimed at.

use super::aim::{Aim, Corners};
use super::{Found, GROUP, Pyramid, Taps, Texels, padded};
use crate::kernels::simd::{Isa, Simd, TEXEL, Work, dispatch};
use half::f16;

/// Reads what was aimed at.
///
/// # Panics
/// If a slice is too short.
pub fn read(isa: Isa, stride: usize, channels: usize, pyramid: &Pyramid, aim: &Aim, found: Found) {
    assert!(stride == GROUP * aim.0.len() && found.features.len() >= channels * stride);
    assert!(found.slopes.is_empty() || found.slopes.len() >= 2 * channels * stride);
    dispatch(isa, Read { stride, channels, pyramid, groups: &aim.0, found });
}

struct Read<'a> {
    stride: usize,
    channels: usize,
    pyramid: &'a Pyramid<'a>,
    groups: &'a [[Corners; 2]],
    found: Found<'a>,
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
                let (fx, fy) = (s.texel_splat(corners.fraction[0][i]), s.texel_splat(corners.fraction[1][i]));
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
        write(
            s,
            values,
            channels - channel,
            self.stride,
            &mut self.found.features[channel * self.stride + place..],
        );
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
