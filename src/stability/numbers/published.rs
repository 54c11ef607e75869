//! The model read one query at a time, as a reader of the papers would write it, with the habits that go wrong.

use crate::error::{Error, Result};
use crate::kernels::encoding::{attenuation, footprint_sigma};
use crate::query::{QueryBuffer, Reflectance, RgbImage, above_horizon};
use neumip_export::Checkpoint;
use neumip_export::config::{
    Architecture, DECODER_MLP, DirectionEncoding, OFFSET_MLP, OFFSET_TEXTURE, OutputSpace, OutputTransform,
    ParallaxConfig, YUV_TO_RGB, bias_name, texture_name, weight_name,
};
use rayon::prelude::*;

/// Queries that a core takes at a time.
const CHUNK: usize = 1024;

/// How sin(2^k pi p) is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gamma {
    /// In double precision.
    Exact,
    /// As the formula reads, in f32: 2^k pi p is rounded before the sine is taken.
    Plain,
    /// From the first octave by double angles, through all octaves.
    Doubled,
}

/// What a reader of the papers may do.
#[derive(Clone, Copy, Debug)]
pub struct Habits {
    /// Sines and cosines.
    pub gamma: Gamma,
    /// False: positions go into the encoding as they come, z is sqrt(1 - x^2 - y^2) of any x and y, the level is log2 of a
    /// radius, and nothing is clamped.
    pub guarded: bool,
    /// The nearest level alone.
    pub nearest_level: bool,
    /// What every value is rounded to.
    pub round: fn(f32) -> f32,
}

impl Habits {
    /// None of them.
    pub const GOOD: Self =
        Self { gamma: Gamma::Exact, guarded: true, nearest_level: false, round: |value| value };
}

/// A checkpoint in scalar arithmetic.
pub struct Published<'a> {
    architecture: &'a Architecture,
    levels: Vec<&'a [f32]>,
    offset_texture: &'a [f32],
    offset: Vec<Layer<'a>>,
    decoder: Vec<Layer<'a>>,
    habits: Habits,
}

type Layer<'a> = (&'a [f32], &'a [f32]);

impl<'a> Published<'a> {
    /// The model of a checkpoint whose decoder is fully connected.
    ///
    /// # Errors
    /// `Config` if a tensor is missing, or the decoder is of another kind.
    pub fn new(checkpoint: &'a Checkpoint, habits: Habits) -> Result<Self> {
        let architecture = &checkpoint.header.architecture;
        let values = |name: &str| -> Result<&'a [f32]> { Ok(&checkpoint.tensor(name)?.data) };
        let layers = |prefix: &str, widths: Option<Vec<usize>>| -> Result<Vec<Layer<'a>>> {
            let count = widths.map_or(0, |widths| widths.len() - 1);
            (0..count)
                .map(|i| Ok((values(&weight_name(prefix, i))?, values(&bias_name(prefix, i))?)))
                .collect()
        };
        let decoder = layers(DECODER_MLP, architecture.decoder_widths())?;
        if decoder.is_empty() {
            return Err(Error::config("decoder.kind", "scalar arithmetic has fully connected decoders only"));
        }
        let levels = (0..architecture.levels()).map(|l| values(&texture_name(l))).collect::<Result<_>>()?;
        let offset_texture =
            if architecture.offset_channels().is_some() { values(OFFSET_TEXTURE)? } else { &[] };
        let offset = layers(OFFSET_MLP, architecture.offset_widths())?;
        Ok(Self { architecture, levels, offset_texture, offset, decoder, habits })
    }

    /// The answers to queries, whatever they are.
    pub fn answers(&self, queries: &QueryBuffer) -> Vec<[f32; 3]> {
        let mut pixels = vec![[0.0; 3]; queries.len()];
        pixels.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, out)| {
            for (k, pixel) in out.iter_mut().enumerate() {
                let at = chunk * CHUNK + k;
                *pixel = self.answer(queries.u[at], queries.wi[at], queries.wo[at], queries.level[at]);
            }
        });
        pixels
    }

    fn answer(&self, u: [f32; 2], wi: [f32; 2], wo: [f32; 2], level: f32) -> [f32; 3] {
        let Habits { guarded, round, .. } = self.habits;
        if guarded && !(above_horizon(wi) && above_horizon(wo)) {
            return [0.0; 3];
        }
        let model = &self.architecture.model;
        let u = u.map(|x| if guarded { round(round(x) - round(x).floor()) } else { round(x) });
        let (wi, wo) = (wi.map(round), wo.map(round));
        let level = round(match guarded {
            true => level.clamp(0.0, self.architecture.coarsest() as f32),
            // A renderer has a radius: 0 without a footprint, and as large as it likes.
            false => level.exp2().log2(),
        });
        let mut at = u;
        if let ParallaxConfig::Offset(offset) = &model.parallax {
            let mut input = vec![0.0; offset.channels];
            self.look_up(self.offset_texture, 0, u, 1.0, &mut input);
            input.extend(wo);
            let depth = self.network(&self.offset, input)[0];
            let square = 1.0 - wo[0] * wo[0] - wo[1] * wo[1];
            let z = round((if guarded { square.max(0.0) } else { square }).sqrt());
            // Not `max`, which would hide what is no number.
            let z = if z < offset.min_z { offset.min_z } else { z };
            for axis in 0..2 {
                at[axis] = round(at[axis] + round(offset.scale * 0.5 * wo[axis] / z) * depth);
            }
        }
        let mut input = vec![0.0; model.texture.channels];
        let level_of = |level: f32| (level - model.texture.finest as f32).max(0.0);
        let stored = if guarded { level_of(level) } else { level - model.texture.finest as f32 };
        let stored = if self.habits.nearest_level { stored.round() } else { stored };
        let share = stored - stored.floor();
        let finer = (stored.floor().max(0.0) as usize).min(self.levels.len() - 1);
        let coarser = (finer + 1).min(self.levels.len() - 1);
        for (index, weight) in [(finer, 1.0 - share), (coarser, share)] {
            self.look_up(self.levels[index], index, at, round(weight), &mut input);
        }
        self.encode(u, level, wi, wo, &mut input);
        let raw = self.network(&self.decoder, input);
        self.rgb(&raw)
    }

    /// Adds a texture's value at a place, bilinear, times a weight.
    fn look_up(&self, texture: &[f32], index: usize, u: [f32; 2], weight: f32, out: &mut [f32]) {
        let round = self.habits.round;
        let [height, width] = self.architecture.finest_size().map(|side| (side >> index).max(1));
        let axis = |u: f32, size: usize| {
            let x = round(u * size as f32 - 0.5);
            let low = x.floor();
            let first = (low as i64).rem_euclid(size as i64) as usize;
            ([first, (first + 1) % size], round(x - low))
        };
        let ((columns, fx), (rows, fy)) = (axis(u[0], width), axis(u[1], height));
        let channels = out.len();
        for (row, wy) in [(rows[0], 1.0 - fy), (rows[1], fy)] {
            for (column, wx) in [(columns[0], 1.0 - fx), (columns[1], fx)] {
                let texel = &texture[(row * width + column) * channels..][..channels];
                let share = round(round(wx * wy) * weight);
                for (to, value) in out.iter_mut().zip(texel) {
                    *to = round(*to + round(share * round(*value)));
                }
            }
        }
    }

    fn encode(&self, u: [f32; 2], level: f32, wi: [f32; 2], wo: [f32; 2], out: &mut Vec<f32>) {
        let round = self.habits.round;
        let config = &self.architecture.model.encoding;
        let p = u.map(|x| round(2.0 * x - 1.0));
        let [height, width] = self.architecture.resolution;
        let sigma = [width, height].map(|texels| footprint_sigma(level, texels));
        let damped = |band: usize, axis: usize| match config.u.attenuate {
            true => attenuation(band, config.pi, sigma[axis]),
            false => 1.0,
        };
        self.waves(&p, self.architecture.u_bands(), &damped, out);
        if config.u.raw {
            out.extend(p);
        }
        for (w, encoding) in [(wi, &config.wi), (wo, &config.wo)] {
            let DirectionEncoding { bands, raw, amplitude } = *encoding;
            let square = 1.0 - w[0] * w[0] - w[1] * w[1];
            let z = (if self.habits.guarded { square.max(0.0) } else { square }).sqrt();
            let full = [w[0], w[1], round(z)];
            let full = &full[..config.components];
            self.waves(full, bands, &|_, _| amplitude, out);
            if raw {
                out.extend(full);
            }
        }
    }

    fn waves(&self, p: &[f32], bands: usize, factor: &dyn Fn(usize, usize) -> f32, out: &mut Vec<f32>) {
        let Habits { round, gamma, .. } = self.habits;
        let pi = self.architecture.model.encoding.pi;
        let mut known = [(0.0f32, 1.0f32); 3];
        for band in 0..bands {
            let octave = (1u32 << band) as f32;
            for (known, p) in known.iter_mut().zip(p) {
                *known = match gamma {
                    Gamma::Exact => {
                        let angle =
                            f64::from(octave) * f64::from(*p) * if pi { std::f64::consts::PI } else { 1.0 };
                        (angle.sin() as f32, angle.cos() as f32)
                    }
                    Gamma::Doubled if band > 0 => {
                        let (sin, cos) = *known;
                        (2.0 * sin * cos, 1.0 - 2.0 * sin * sin)
                    }
                    _ => (round(octave * if pi { std::f32::consts::PI } else { 1.0 } * p)).sin_cos(),
                };
            }
            let known = &known[..p.len()];
            out.extend(known.iter().enumerate().map(|(d, (sin, _))| round(sin * factor(band, d))));
            out.extend(known.iter().enumerate().map(|(d, (_, cos))| round(cos * factor(band, d))));
        }
    }

    fn network(&self, layers: &[Layer], mut x: Vec<f32>) -> Vec<f32> {
        let round = self.habits.round;
        for (i, (weight, bias)) in layers.iter().enumerate() {
            let rows = weight.chunks_exact(x.len()).zip(*bias);
            let last = i + 1 == layers.len();
            let neuron = |(row, bias): (&[f32], &f32)| {
                let products = row.iter().zip(&x).map(|(w, x)| round(round(*w) * x));
                let sum = products.fold(round(*bias), |sum, product| round(sum + product));
                if sum < 0.0 && !last { 0.0 } else { sum }
            };
            x = rows.map(neuron).collect();
        }
        x
    }

    fn rgb(&self, raw: &[f32]) -> [f32; 3] {
        let output = &self.architecture.model.output;
        std::array::from_fn(|c| {
            let mut x = match output.space {
                OutputSpace::Rgb => raw[c],
                OutputSpace::Yuv => (0..3).map(|k| YUV_TO_RGB[c][k] * raw[k]).sum(),
            };
            if output.transform == OutputTransform::ExpMinusOne {
                x = x.exp() - 1.0;
            }
            if output.mask {
                x *= 0.1 + 1.0 / (1.0 + (-raw[3 + c]).exp());
            }
            (self.habits.round)(if x < 0.0 { 0.0 } else { x })
        })
    }
}

impl Reflectance for Published<'_> {
    fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage> {
        let pixels = self.answers(queries);
        Ok(RgbImage { height: queries.height(), width: queries.width(), pixels })
    }
}
