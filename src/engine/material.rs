//! A trained model that answers query buffers through the fused kernels.

use super::images::Canvas;
use super::networks::Networks;
use super::plan::{Order, Plan};
use super::textures::{Table, Textures};
use super::tile::{Queries, Tile, stride_of};
use crate::error::{Error, Result};
use crate::kernels::rows;
use crate::kernels::simd::Isa;
use crate::kernels::window::{self, Window};
use crate::query::grid::{self, Mosaic};
use crate::query::{QueryBuffer, Reflectance, RgbImage, Support, above_horizon};
use neumip_export::checkpoint::Checkpoint;
use neumip_export::config::{Architecture, OFFSET_TEXTURE, texture_name};
use neumip_export::domain::Guide;
use neumip_export::{Precision, Tensor};
use rayon::prelude::*;
use std::cell::RefCell;
use std::collections::BTreeMap;

/// Samples of a tile: the decoder's input and one layer's outputs stay in the first-level cache.
const TILE: usize = 64;
/// Queries that a core answers at a time.
const CHUNK: usize = 16 * TILE;

/// A neural material in fused kernels.
#[derive(Clone, Debug)]
pub struct FusedMaterial {
    plan: Plan,
    networks: Networks,
    levels: Vec<Table>,
    offset: Option<Table>,
}

/// Queries without their light: partial sums of the decoder's first layer.
#[derive(Clone, Debug)]
pub struct Prepared {
    /// Tiles of \[outputs of the first layer\]\[[`TILE`]\].
    sums: Vec<f32>,
    /// Outputs of the first layer.
    outputs: usize,
    /// Whether each query's wo is above the horizon.
    visible: Vec<bool>,
}

impl Prepared {
    /// Number of queries.
    pub fn len(&self) -> usize {
        self.visible.len()
    }

    /// True if nothing was asked.
    pub fn is_empty(&self) -> bool {
        self.visible.is_empty()
    }
}

impl FusedMaterial {
    /// The material of a checkpoint, on the instruction set in use.
    ///
    /// # Errors
    /// `Config` if a tensor is missing or does not fit, `Usage` for an instruction set that this machine has not.
    pub fn from_checkpoint(checkpoint: &Checkpoint) -> Result<Self> {
        let architecture = &checkpoint.header.architecture;
        Self::new(architecture, &checkpoint.tensors, Precision::Single, Isa::chosen()?)
    }

    /// The material of stored tensors.
    ///
    /// # Errors
    /// `Config` if a tensor is missing or does not fit.
    pub fn new(
        architecture: &Architecture,
        tensors: &BTreeMap<String, Tensor>,
        precision: Precision,
        isa: Isa,
    ) -> Result<Self> {
        for (name, shape) in architecture.tensors() {
            match tensors.get(&name) {
                Some(t) if t.shape == shape && t.data.len() == shape.iter().product::<usize>() => {}
                Some(t) => {
                    return Err(Error::config(name, format!("has shape {:?}, not {shape:?}", t.shape)));
                }
                None => return Err(Error::config(name, "this tensor is missing")),
            }
        }
        let values = |name: &str| match tensors.get(name) {
            Some(t) => Ok(t.data.clone()),
            None => Err(Error::config(name, "this tensor is missing")),
        };
        let order = match architecture.neighbourhood() {
            Some(_) => Order::Stored,
            None => Order::LightLast,
        };
        let plan = Plan::new(architecture, isa, order);
        let table = |name: &str, channels: usize| -> Result<Table> {
            Ok(match precision {
                Precision::Single => Table::Single(values(name)?),
                Precision::Half => Table::half(&values(name)?, channels),
                Precision::Byte => {
                    return Err(Error::config("precision", "the fused engine has textures of f32 and f16"));
                }
            })
        };
        let levels = (0..architecture.levels())
            .map(|level| table(&texture_name(level), plan.channels()))
            .collect::<Result<_>>()?;
        let offset = plan.offset.map(|(channels, _)| table(OFFSET_TEXTURE, channels)).transpose()?;
        Ok(Self { networks: Networks::answering(&plan, &values)?, plan, levels, offset })
    }

    /// What the material is.
    pub fn architecture(&self) -> &Architecture {
        &self.plan.architecture
    }

    /// The instruction set that answers.
    pub fn isa(&self) -> Isa {
        self.plan.isa
    }

    fn textures(&self) -> Textures<'_> {
        let levels: Vec<_> = self.levels.iter().map(Table::texels).collect();
        Textures::new(&self.plan, levels, self.offset.as_ref().map(Table::texels))
    }

    /// Does everything that does not depend on wi, for queries at positions `u` and `level`, seen from `wo`.
    ///
    /// # Errors
    /// `Config` if the slices differ in length or a value is not finite, or if the decoder reads neighbours.
    pub fn prepare(&self, u: &[[f32; 2]], level: &[f32], wo: &[[f32; 2]]) -> Result<Prepared> {
        let queries = self.viewed(u, level, wo)?;
        let textures = self.textures();
        let wide = TILE * self.networks.first_outputs();
        let mut sums = vec![0.0; u.len().div_ceil(TILE) * wide];
        let chunks = sums.par_chunks_mut(CHUNK / TILE * wide).enumerate();
        chunks.for_each_init(Tile::default, |tile, (chunk, out)| {
            for (part, out) in out.chunks_mut(wide).enumerate() {
                let at = chunk * CHUNK + part * TILE;
                self.load(tile, &queries, at, (at + TILE).min(u.len()));
                tile.prepare(&self.plan, &self.networks, &textures);
                out[..tile.partial.len()].copy_from_slice(&tile.partial);
            }
        });
        Ok(Prepared {
            sums,
            outputs: self.networks.first_outputs(),
            visible: wo.iter().map(|w| above_horizon(*w)).collect(),
        })
    }

    /// The features that the decoder reads for queries at positions `u` and `level`, seen from `wo`: the texture pyramid's
    /// channels at the positions after parallax, \[queries\]\[channels\].
    ///
    /// # Errors
    /// `Config` if the slices differ in length or a value is not finite, or if the decoder reads neighbours.
    pub fn features(&self, u: &[[f32; 2]], level: &[f32], wo: &[[f32; 2]]) -> Result<Vec<f32>> {
        let queries = self.viewed(u, level, wo)?;
        let textures = self.textures();
        let channels = self.plan.channels();
        let mut features = vec![0.0; u.len() * channels];
        let chunks = features.par_chunks_mut(CHUNK * channels).enumerate();
        chunks.for_each_init(Tile::default, |tile, (chunk, out)| {
            for (part, out) in out.chunks_mut(TILE * channels).enumerate() {
                let at = chunk * CHUNK + part * TILE;
                self.load(tile, &queries, at, at + out.len() / channels);
                tile.view(&self.plan, &self.networks, &textures, false);
                for (k, features) in out.chunks_exact_mut(channels).enumerate() {
                    for (to, row) in features.iter_mut().zip(tile.input.chunks(tile.stride)) {
                        *to = row[k];
                    }
                }
            }
        });
        Ok(features)
    }

    /// Queries without their light, for a decoder that answers them one by one.
    fn viewed(&self, u: &[[f32; 2]], level: &[f32], wo: &[[f32; 2]]) -> Result<QueryBuffer> {
        if self.networks.inception.is_some() {
            return Err(Error::config("decoder.kind", "inception answers images, not queries one by one"));
        }
        let light = vec![[0.0; 2]; u.len()];
        QueryBuffer::new(1, u.len(), u.to_vec(), light, wo.to_vec(), level.to_vec())
    }

    /// Answers prepared queries under one light each: RGB as [`Reflectance::evaluate`] gives it.
    ///
    /// # Errors
    /// `Config` if `wi` has another length, is not finite, or an answer is not, or if another model prepared the queries.
    pub fn light(&self, prepared: &Prepared, wi: &[[f32; 2]]) -> Result<Vec<[f32; 3]>> {
        if wi.len() != prepared.len() {
            let problem = format!("has {} entries where {} queries are prepared", wi.len(), prepared.len());
            return Err(Error::config("query.wi", problem));
        }
        if prepared.outputs != self.networks.first_outputs() {
            return Err(Error::config("queries", "were prepared by a model with another first layer"));
        }
        if let Some(i) = wi.iter().position(|w| !(w[0].is_finite() && w[1].is_finite())) {
            return Err(Error::config(format!("query.wi[{i}]"), "is not finite"));
        }
        let mut pixels = vec![[0.0f32; 3]; wi.len()];
        let wide = TILE * self.networks.first_outputs();
        pixels.par_chunks_mut(CHUNK).enumerate().for_each_init(Tile::default, |tile, (chunk, out)| {
            for (part, out) in out.chunks_mut(TILE).enumerate() {
                let at = chunk * CHUNK + part * TILE;
                tile.resize(&self.plan, &self.networks, stride_of(out.len()), false);
                let n = tile.partial.len();
                tile.partial.copy_from_slice(&prepared.sums[at / TILE * wide..][..n]);
                let Queries { wi: rows, .. } = &mut tile.queries;
                let (x, y) = rows.split_at_mut(tile.stride);
                rows::split(self.plan.isa, &wi[at..at + out.len()], false, x, y);
                tile.light(&self.plan, &self.networks);
                let lit = |k: usize| prepared.visible[at + k] && above_horizon(wi[at + k]);
                write(&tile.rgb, lit, out);
            }
        });
        finite(&pixels)?;
        Ok(pixels)
    }

    /// Answers images of queries, each taken as periodic.
    fn images(&self, canvas: &mut Canvas, queries: &QueryBuffer, mosaic: Mosaic) -> Result<Vec<[f32; 3]>> {
        canvas.queries.resize(stride_of(queries.len()));
        self.fill(&mut canvas.queries, queries, 0, queries.len());
        canvas.forward(&self.plan, &self.networks, &self.textures(), mosaic, false)?;
        let lit = |k: usize| above_horizon(queries.wi[k]) && above_horizon(queries.wo[k]);
        let mut pixels = vec![[0.0; 3]; queries.len()];
        write(&canvas.rgb, lit, &mut pixels);
        Ok(pixels)
    }

    /// Fills a tile with the queries `start..end`.
    fn load(&self, tile: &mut Tile, queries: &QueryBuffer, start: usize, end: usize) {
        tile.resize(&self.plan, &self.networks, stride_of(end - start), false);
        self.fill(&mut tile.queries, queries, start, end);
    }

    /// Fills rows with the queries `start..end`.
    fn fill(&self, rows: &mut Queries, queries: &QueryBuffer, start: usize, end: usize) {
        let isa = self.plan.isa;
        let stride = rows.level.len();
        let guide = self.plan.architecture.guide();
        let window = guide.filter(Guide::is_window);
        let Queries { u, level, wi, wo } = rows;
        let pairs =
            [(&mut *u, &queries.u, window.is_none()), (wi, &queries.wi, false), (wo, &queries.wo, false)];
        for (rows, pairs, wrap) in pairs {
            let (x, y) = rows.split_at_mut(stride);
            rows::split(isa, &pairs[start..end], wrap, x, y);
        }
        let whole = [0.0, self.plan.architecture.coarsest() as f32];
        let [finest, coarsest] = guide.map_or(whole, |guide| guide.levels);
        for (to, from) in level.iter_mut().zip(&queries.level[start..end]) {
            *to = from.clamp(finest, coarsest);
        }
        if let Some(Guide { corner, scale, part, outside, .. }) = window {
            let (x, y) = u.split_at_mut(stride);
            window::lead(isa, &Window { corner, scale, part, outside }, [x, y], level);
        }
        level[end - start..].fill(0.0);
    }
}

/// The answers in rows \[3\]\[stride\]: not below 0, and 0 where `lit` is false.
fn write(rgb: &[f32], lit: impl Fn(usize) -> bool, out: &mut [[f32; 3]]) {
    let (red, rest) = rgb.split_at(rgb.len() / 3);
    let (green, blue) = rest.split_at(rgb.len() / 3);
    for (k, (pixel, ((red, green), blue))) in out.iter_mut().zip(red.iter().zip(green).zip(blue)).enumerate()
    {
        if lit(k) {
            // f32::max would hide a NaN behind 0.
            *pixel = [*red, *green, *blue].map(|value| if value < 0.0 { 0.0 } else { value });
        }
    }
}

fn finite(pixels: &[[f32; 3]]) -> Result<()> {
    match pixels.iter().position(|p| !p.iter().all(|v| v.is_finite())) {
        Some(k) => Err(Error::config(format!("query[{k}]"), "the model's answer is not finite")),
        None => Ok(()),
    }
}

impl Reflectance for FusedMaterial {
    fn support(&self) -> Support {
        Support::of(self.plan.architecture.neighbourhood(), self.plan.architecture.resolution)
    }

    fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage> {
        let (height, width) = (queries.height(), queries.width());
        if let Support::Neighbourhood { radius, resolution } = self.support() {
            let canvas = RefCell::new(Canvas::default());
            let images = |q: &QueryBuffer, mosaic| self.images(&mut canvas.borrow_mut(), q, mosaic);
            let pixels = grid::answer(queries, radius, resolution, &images)?;
            finite(&pixels)?;
            return Ok(RgbImage { height, width, pixels });
        }
        let mut pixels = vec![[0.0f32; 3]; queries.len()];
        let textures = self.textures();
        pixels.par_chunks_mut(CHUNK).enumerate().for_each_init(Tile::default, |tile, (chunk, out)| {
            for (part, out) in out.chunks_mut(TILE).enumerate() {
                let at = chunk * CHUNK + part * TILE;
                self.load(tile, queries, at, at + out.len());
                tile.forward(&self.plan, &self.networks, &textures);
                let lit = |k: usize| above_horizon(queries.wi[at + k]) && above_horizon(queries.wo[at + k]);
                write(&tile.rgb, lit, out);
            }
        });
        finite(&pixels)?;
        Ok(RgbImage { height, width, pixels })
    }
}
