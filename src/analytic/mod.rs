//! The maps themselves, marched and shaded analytically: what a renderer has without a neural material.
//!
//! ```text
//! maps ─ pyramids baked from a solid layer: heights; reflectance, slopes and how far they spread (sources)
//!   │
//! march ─ the view ray down to the surface, the shadow on it      shade ─ GGX and diffuse of the texels there
//! ```
//!
//! One ray a query: the pyramid's level stands for the footprint. What is averaged away is left to the shading: slopes
//! within a footprint widen the lobe and soften the diffuse part (after LEAN mapping, Olano and Baker 2010, and LEADR
//! mapping, Dupuy et al. 2013), and shadows have soft borders. Light that has bounced off the material is a map as well,
//! baked from the reference: a colour that knows neither viewer nor light but for the light's elevation.
//!
//! Arrays of vectors are indexed by number on purpose: iterators over them leave the registers now and then.
#![allow(clippy::needless_range_loop, clippy::manual_memcpy)]

mod indirect;
mod maps;
mod march;
mod shade;
mod sources;
#[cfg(test)]
mod tests;

use crate::error::{Error, Result};
use crate::kernels::fetch::{self, Aim};
use crate::kernels::simd::{Isa, dispatch};
use crate::query::{QueryBuffer, Reflectance, RgbImage, above_horizon};
use crate::reference::heightfield::SIDES;
use crate::reference::{MAX_BOUNCES, MAX_SPP, Material, Part};
use maps::{CHANNELS, Maps};
use rayon::prelude::*;

/// Most steps of a march; more than the texels that the steepest rays cross in the largest tile.
pub const MAX_STEPS: usize = 4096;
/// Most rays along a side of the footprint.
pub const MAX_RAYS: usize = 64;
/// Queries of a tile: their rows stay in the first-level cache.
const TILE: usize = 64;
/// Queries that a core answers at a time.
const CHUNK: usize = 16 * TILE;

/// Floating-point operations of a step down, of one towards the light, and of a shading: counted in the source.
const VIEW_STEP: usize = 28;
const SHADOW_STEP: usize = 34;
const SHADING: usize = 560;

/// How maps are baked and marched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapsConfig {
    /// Heights that are read on the way down to the surface, evenly spaced in height, at least 2.
    pub view_steps: usize,
    /// Heights that are read on the way to the light; 0 casts no shadows.
    pub shadow_steps: usize,
    /// Rays along a side of the footprint: rays x rays are marched through it, on maps that much finer.
    pub rays: usize,
    /// Texels \[H, W\] of the finest maps; None takes those of level 0.
    pub resolution: Option<[usize; 2]>,
    /// Bounces of indirect light that are baked, 0 for none.
    pub bounces: usize,
    /// Paths a texel from which indirect light is baked.
    pub paths: usize,
    /// Seed of those paths.
    pub seed: u64,
}

impl Default for MapsConfig {
    fn default() -> Self {
        Self { view_steps: 16, shadow_steps: 16, rays: 1, resolution: None, bounces: 1, paths: 32, seed: 0 }
    }
}

impl MapsConfig {
    fn check(&self) -> Result<()> {
        check("view_steps", self.view_steps, 2, MAX_STEPS)?;
        check("shadow_steps", self.shadow_steps, 0, MAX_STEPS)?;
        check("rays", self.rays, 1, MAX_RAYS)?;
        check("bounces", self.bounces, 0, MAX_BOUNCES)?;
        check("paths", self.paths, 1, MAX_SPP)
    }
}

/// A material's maps that answer queries.
#[derive(Clone, Debug)]
pub struct AnalyticMaps {
    config: MapsConfig,
    maps: Maps,
    isa: Isa,
}

impl AnalyticMaps {
    /// Bakes a material of one solid layer; level 0 has `resolution` = \[H, W\] texels.
    ///
    /// # Errors
    /// `Config` for a material that is not one solid layer, for maps with values that are not finite, and for an option
    /// that is out of bounds; `Usage` for an instruction set that this machine has not.
    pub fn new(material: &Material, resolution: [usize; 2], config: &MapsConfig) -> Result<Self> {
        Self::with_isa(material, resolution, config, Isa::chosen()?)
    }

    /// [`AnalyticMaps::new`] for an instruction set.
    ///
    /// # Errors
    /// As [`AnalyticMaps::new`].
    pub fn with_isa(
        material: &Material,
        resolution: [usize; 2],
        config: &MapsConfig,
        isa: Isa,
    ) -> Result<Self> {
        config.check()?;
        let finest = config.resolution.unwrap_or(resolution);
        for side in resolution.into_iter().chain(finest) {
            check("resolution", side, *SIDES.start(), *SIDES.end())?;
        }
        let [Part::Solid(layer)] = material.parts.as_slice() else {
            let problem = format!("{} is not one solid layer, so it has no maps to march", material.name);
            return Err(Error::config("material", problem));
        };
        let bounced = indirect::bake(material, layer, finest, config)?;
        Ok(Self { config: *config, maps: Maps::new(layer, resolution, finest, &bounced)?, isa })
    }

    /// `maps-8` for 8 steps on either way, `maps-8-4` for 8 of the view ray and 4 of the shadow; with what differs from the
    /// default: `-256x128` for maps of 256 rows, `-rays-4` for 4 rays a query, `-direct` without bounced light.
    pub fn name(&self) -> String {
        let MapsConfig { view_steps, shadow_steps, rays, resolution, bounces, .. } = self.config;
        let mut name = format!("maps-{view_steps}");
        if shadow_steps != view_steps {
            name += &format!("-{shadow_steps}");
        }
        if let Some([rows, columns]) = resolution {
            name += &format!("-{rows}x{columns}");
        }
        if rays > 1 {
            name += &format!("-rays-{}", rays * rays);
        }
        if bounces == 0 {
            name += "-direct";
        }
        name
    }

    /// The same maps, marched otherwise.
    ///
    /// # Errors
    /// `Config` for a number that is out of bounds.
    pub fn marched(&self, view_steps: usize, shadow_steps: usize, rays: usize) -> Result<Self> {
        let config = MapsConfig { view_steps, shadow_steps, rays, ..self.config };
        config.check()?;
        Ok(Self { config, ..self.clone() })
    }

    /// How it was made.
    pub fn config(&self) -> &MapsConfig {
        &self.config
    }

    /// The instruction set that answers.
    pub fn isa(&self) -> Isa {
        self.isa
    }

    /// Bytes of all maps as they are stored.
    pub fn bytes(&self) -> usize {
        self.maps.bytes()
    }

    /// Floating-point operations of a query, about: those of every height that is read and of one shading of trilinear texels.
    pub fn flops(&self) -> usize {
        let MapsConfig { view_steps, shadow_steps, rays, .. } = self.config;
        rays * rays * (view_steps * VIEW_STEP + shadow_steps * SHADOW_STEP + SHADING)
    }

    fn tile(&self, rows: &mut Rows, queries: &QueryBuffer, at: usize, out: &mut [[f32; 3]]) {
        rows.load(queries, at, out.len());
        let Self { maps, config, isa } = self;
        let pyramid = maps.texels();
        let share = 1.0 / (config.rays * config.rays) as f32;
        rows.rgb = [[0.0; TILE]; 3];
        for ray in 0..config.rays * config.rays {
            let place = [ray % config.rays, ray / config.rays];
            let place = place.map(|k| (k as f32 + 0.5) / config.rays as f32 - 0.5);
            dispatch(*isa, march::View { maps, config, rows, place });
            let places = fetch::Places { x: &rows.x, y: &rows.y, level: &rows.shade_level };
            fetch::aim(*isa, TILE, CHANNELS, &pyramid, places, &mut rows.aim);
            dispatch(*isa, march::Shadow { maps, config, rows });
            let features: &mut [f32] = rows.texels.as_flattened_mut();
            let found = fetch::Found { features, slopes: &mut [], taps: &mut [] };
            fetch::read(*isa, TILE, CHANNELS, &pyramid, &rows.aim, found);
            dispatch(*isa, shade::Shade { rows, share });
        }
        for (k, pixel) in out.iter_mut().enumerate() {
            if above_horizon(queries.wi[at + k]) && above_horizon(queries.wo[at + k]) {
                *pixel = std::array::from_fn(|c| rows.rgb[c][k]);
            }
        }
    }
}

/// A tile of queries and all that is found out about them.
#[derive(Debug)]
struct Rows {
    u: [Row; 2],
    wi: [Row; 2],
    wo: [Row; 2],
    level: Row,
    /// Where the view ray meets the surface.
    x: Row,
    y: Row,
    z: Row,
    /// Level of the shading maps.
    shade_level: Row,
    /// Share of the light that arrives.
    lit: Row,
    aim: Aim,
    texels: [Row; CHANNELS],
    rgb: [Row; 3],
}

type Row = [f32; TILE];

impl Default for Rows {
    fn default() -> Self {
        let row = [0.0; TILE];
        Self {
            u: [row; 2],
            wi: [row; 2],
            wo: [row; 2],
            level: row,
            x: row,
            y: row,
            z: row,
            shade_level: row,
            lit: row,
            aim: Aim::default(),
            texels: [row; CHANNELS],
            rgb: [row; 3],
        }
    }
}

impl Rows {
    /// Fills in `count` queries from `at` on; what lies behind them repeats older ones, or zeros.
    fn load(&mut self, queries: &QueryBuffer, at: usize, count: usize) {
        let pairs = [(&mut self.u, &queries.u), (&mut self.wi, &queries.wi), (&mut self.wo, &queries.wo)];
        for ([x, y], from) in pairs {
            for ((x, y), from) in x.iter_mut().zip(y).zip(&from[at..at + count]) {
                [*x, *y] = *from;
            }
        }
        self.level[..count].copy_from_slice(&queries.level[at..at + count]);
    }
}

impl Reflectance for AnalyticMaps {
    fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage> {
        let mut pixels = vec![[0.0f32; 3]; queries.len()];
        pixels.par_chunks_mut(CHUNK).enumerate().for_each_init(Rows::default, |rows, (chunk, out)| {
            for (part, out) in out.chunks_mut(TILE).enumerate() {
                self.tile(rows, queries, chunk * CHUNK + part * TILE, out);
            }
        });
        Ok(RgbImage { height: queries.height(), width: queries.width(), pixels })
    }
}

fn check(field: &str, value: usize, least: usize, most: usize) -> Result<()> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    Err(Error::config(format!("maps.{field}"), format!("{value} is outside {least} to {most}")))
}
