//! Ground truth: a tileable surface with a distant light, cast shadows and indirect light.
//!
//! u names where the view ray crosses the plane z = 0; the surface lies above and below it, so parallax goes both ways.
//!
//! ```text
//! builtin, cloth, maps, mesh_file ── what there is to see
//!      │
//! material ─ parts: solid layers, sheets with holes, meshes, fibres; their maps
//!      │
//! heightfield + raycast, primitives ─ rays   shading, fibre_shading ─ the reflectance of a point
//!      │                                        │
//! geometry ─ the nearest part, its frame ───────┘
//!      │
//! integrator ─ direct and indirect light along paths        footprint ─ the box of a query and its strata
//! ```

pub mod builtin;

pub mod cloth;
pub mod fibre_shading;
pub mod footprint;
pub mod frame;
pub mod geometry;
pub mod heightfield;
pub mod integrator;
pub mod map_file;
pub mod maps;
pub mod material;
pub mod mesh_file;
pub mod packet;
pub mod primitives;
pub mod raycast;
pub mod resample;
pub mod shading;
pub mod texture;
pub mod tiling;

pub use fibre_shading::FibreLook;
pub use geometry::Geometry;
pub use heightfield::{HeightMap, Heightfield};
pub use integrator::{Paths, View};
pub use material::{Layer, Material, Paint, Part};
pub use shading::Brdf;
pub use texture::Texture;

use crate::error::{Error, Result};
use crate::query::{QueryBuffer, Reflectance, RgbImage, above_horizon};
use crate::random::{self, Random, Stream};
use footprint::{Footprint, Strata, mean_and_variance};
use maps::ReadOptions;
use rayon::prelude::*;
use std::path::Path;

/// Most sub-samples a query may ask for.
pub const MAX_SPP: usize = 1 << 20;

/// Most bounces of indirect light.
pub const MAX_BOUNCES: usize = 64;

/// Queries that one thread answers at a time.
const CHUNK: usize = 64;

/// Queries along a side, and sub-samples of each, by which a material is told from others.
const FINGERPRINT_SIDE: usize = 16;
const FINGERPRINT_SPP: usize = 2;

/// How a reference is set up.
#[derive(Clone, Debug)]
pub struct ReferenceOptions {
    /// Texels \[H, W\] of level 0: what a footprint of level 0 is. None takes the sides of the height map.
    pub resolution: Option<[usize; 2]>,
    /// Indirect bounces after the direct light.
    pub bounces: usize,
    /// Side of a built-in material's field in samples.
    pub field_side: usize,
    /// Seed of a built-in material's random choices; not the seed of the sampling, so that a name stays a material.
    pub material_seed: u64,
    /// Crop and cross-fade maps that do not tile.
    pub make_tileable: bool,
    /// Sub-samples a query and seed where queries come through [`Reflectance`].
    pub sampling: Sampling,
}

impl Default for ReferenceOptions {
    fn default() -> Self {
        Self {
            resolution: None,
            bounces: 1,
            field_side: 512,
            material_seed: 0,
            make_tileable: false,
            sampling: Sampling { spp: 64, seed: 0, first: 0 },
        }
    }
}

/// How queries are sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sampling {
    /// Stratified sub-samples a query, at least 1.
    pub spp: usize,
    /// Seed.
    pub seed: u64,
    /// Index of the buffer's first query in the stream of random numbers: query k draws from (seed, first + k).
    pub first: u64,
}

/// Answers with their noise.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// The answers, in the buffer's shape.
    pub rgb: RgbImage,
    /// Variance of each answer (of the mean over its sub-samples), averaged over RGB; see
    /// [`footprint::mean_and_variance`]. 0 where one sub-sample was taken: unknown.
    pub variance: Vec<f32>,
    /// Rays that were cast.
    pub rays: u64,
}

/// A material that answers queries.
#[derive(Debug)]
pub struct Reference {
    name: String,
    notes: Vec<String>,
    geometry: Geometry,
    height_range: [f32; 2],
    resolution: [usize; 2],
    bounces: usize,
    sampling: Sampling,
}

impl Reference {
    /// A reference over the material of a name ([`Reference::material`]).
    ///
    /// # Errors
    /// As [`Reference::material`] and [`Reference::new`].
    pub fn open(spec: &str, options: &ReferenceOptions) -> Result<Self> {
        Self::new(Self::material(spec, options)?, options)
    }

    /// A built-in material by name, a `material.json`, or a folder that holds one.
    ///
    /// # Errors
    /// `Usage` for a name that is neither, listing the built-in ones; otherwise as [`ReadOptions::read`].
    pub fn material(spec: &str, options: &ReferenceOptions) -> Result<Material> {
        let path = Path::new(spec);
        let maps = ReadOptions { make_tileable: options.make_tileable };
        if builtin::NAMES.contains(&spec) {
            builtin::make(spec, options.field_side, options.material_seed)
        } else if path.is_dir() {
            maps.read(&path.join("material.json"))
        } else if path.exists() {
            maps.read(path)
        } else {
            let names = builtin::NAMES.join(", ");
            Err(Error::usage(format!(
                "{spec}: no such file, and no built-in material of that name; built in are {names}"
            )))
        }
    }

    /// A reference over a material.
    ///
    /// # Errors
    /// `Config`, naming the option that is out of bounds; for a material whose stated range its surface leaves; and as
    /// [`Geometry::new`].
    pub fn new(mut material: Material, options: &ReferenceOptions) -> Result<Self> {
        let (name, notes) = (std::mem::take(&mut material.name), std::mem::take(&mut material.notes));
        let stated = material.height_range;
        let geometry = Geometry::new(material)?;
        let resolution = options.resolution.unwrap_or(match geometry.height_map() {
            Some(map) => [map.height, map.width],
            None => [options.field_side; 2],
        });
        for (k, side) in resolution.iter().enumerate() {
            if !heightfield::SIDES.contains(side) {
                let (least, most) = (heightfield::SIDES.start(), heightfield::SIDES.end());
                return Err(Error::config(
                    format!("resolution[{k}]"),
                    format!("{side} is outside {least} to {most}"),
                ));
            }
        }
        if options.bounces > MAX_BOUNCES {
            return Err(Error::config("bounces", format!("{} is more than {MAX_BOUNCES}", options.bounces)));
        }
        check_spp(options.sampling.spp)?;
        let found = geometry.range().map(|z| z as f32);
        let height_range = stated.unwrap_or(found);
        if !(height_range[0] <= found[0] && found[1] <= height_range[1]) {
            return Err(Error::config(
                "height_range",
                format!(
                    "{} to {} is stated, but the surface spans {} to {}",
                    height_range[0], height_range[1], found[0], found[1]
                ),
            ));
        }
        let (bounces, sampling) = (options.bounces, options.sampling);
        Ok(Self { name, notes, geometry, height_range, resolution, bounces, sampling })
    }

    /// What was done to the material's files, a line each.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// The material's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Texels \[H, W\] of level 0.
    pub fn resolution(&self) -> [usize; 2] {
        self.resolution
    }

    /// Indirect bounces after the direct light.
    pub fn bounces(&self) -> usize {
        self.bounces
    }

    /// A number that tells this material under this light transport from others: a hash of its answers to a few fixed
    /// queries.
    pub fn fingerprint(&self) -> String {
        let strata = Strata::new(FINGERPRINT_SPP);
        let sampling = Sampling { spp: FINGERPRINT_SPP, seed: 0, first: 0 };
        let mut queries = QueryBuffer::slice(FINGERPRINT_SIDE, FINGERPRINT_SIDE, [0.0; 2], [0.0; 2], 0.0);
        for k in 0..queries.len() {
            let mut random = Random::new(0, Stream::Probe, k as u64);
            (queries.wi[k], queries.wo[k]) = (random.disc(0.99), random.disc(0.99));
        }
        let (mut scratch, mut hash) = (Scratch::default(), 0);
        for k in 0..queries.len() {
            let (rgb, _) = self.answer(&queries, k, &sampling, &strata, &mut scratch);
            hash = rgb.iter().fold(hash, |hash, v| random::hash(hash ^ u64::from(v.to_bits())));
        }
        format!("{hash:016x}")
    }

    /// The geometry behind the answers.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Least and greatest height over the reference plane, in tile widths.
    pub fn height_range(&self) -> [f32; 2] {
        self.height_range
    }

    /// Heights over the reference plane at the field's own resolution, where the material is one solid layer.
    pub fn height_map(&self) -> Option<HeightMap> {
        self.geometry.height_map()
    }

    /// Answers every query with its noise. The bytes depend on the queries and `sampling` alone.
    ///
    /// # Errors
    /// `Config` if `spp` is 0 or more than [`MAX_SPP`].
    pub fn measure(&self, queries: &QueryBuffer, sampling: &Sampling) -> Result<Measured> {
        check_spp(sampling.spp)?;
        let strata = Strata::new(sampling.spp);
        let mut answers = vec![([0.0; 3], 0.0); queries.len()];
        let chunks = answers.par_chunks_mut(CHUNK).enumerate().map(|(chunk, answers)| {
            let mut scratch = Scratch::default();
            for (k, answer) in answers.iter_mut().enumerate() {
                *answer = self.answer(queries, chunk * CHUNK + k, sampling, &strata, &mut scratch);
            }
            scratch.rays
        });
        let rays = chunks.sum();
        let (pixels, variance) = answers.into_iter().unzip();
        let rgb = RgbImage { height: queries.height(), width: queries.width(), pixels };
        Ok(Measured { rgb, variance, rays })
    }

    fn answer<'a>(
        &'a self,
        queries: &QueryBuffer,
        k: usize,
        sampling: &Sampling,
        strata: &Strata,
        scratch: &mut Scratch<'a>,
    ) -> ([f32; 3], f32) {
        if !above_horizon(queries.wi[k]) || !above_horizon(queries.wo[k]) {
            return ([0.0; 3], 0.0);
        }
        let view = View { wi: unit(queries.wi[k]), wo: unit(queries.wo[k]), bounces: self.bounces };
        let footprint = Footprint::new(queries.u[k], queries.level[k], self.resolution);
        let mut random = Random::new(sampling.seed, Stream::Reference, sampling.first.wrapping_add(k as u64));
        let Scratch { positions, paths, samples, rays } = scratch;
        positions.clear();
        positions.extend((0..strata.len()).map(|stratum| {
            let jitter = [random.uniform(), random.uniform()].map(f64::from);
            footprint.point(strata.point(stratum, jitter))
        }));
        *rays += self.geometry.radiances(positions, &view, &mut random, paths, samples);
        mean_and_variance(samples)
    }
}

/// What a thread keeps between answers.
#[derive(Default)]
struct Scratch<'a> {
    positions: Vec<[f64; 2]>,
    paths: Paths<'a>,
    samples: Vec<[f32; 3]>,
    rays: u64,
}

impl Reflectance for Reference {
    fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage> {
        Ok(self.measure(queries, &self.sampling)?.rgb)
    }
}

fn check_spp(spp: usize) -> Result<()> {
    if (1..=MAX_SPP).contains(&spp) {
        return Ok(());
    }
    Err(Error::config("spp", format!("{spp} is outside 1 to {MAX_SPP}")))
}

/// [`crate::query::unit`] in f64, for directions above the horizon: z is then never 0.
fn unit(w: [f32; 2]) -> [f64; 3] {
    let [x, y] = w.map(f64::from);
    [x, y, (1.0 - x * x - y * y).max(f64::from(f32::EPSILON) / 2.0).sqrt()]
}
