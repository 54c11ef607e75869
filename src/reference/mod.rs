//! Ground truth: a tileable displaced surface with a distant light, cast shadows and optional indirect light.
//!
//! u names where the view ray crosses the plane z = 0; the surface lies above and below it, so parallax goes both ways.
//!
//! [`maps`] and [`builtin`] make a [`Material`]; [`heightfield`] and [`raycast`] answer rays, [`shading`] the
//! reflectance of a point; [`integrator`] joins them along paths; [`footprint`] averages over a query's box.

pub mod builtin;
pub mod footprint;
pub mod heightfield;
pub mod integrator;
pub mod map_file;
pub mod maps;
pub mod material;
pub mod raycast;
pub mod resample;
pub mod shading;
pub mod texture;

pub use heightfield::{HeightMap, Heightfield};
pub use integrator::Surface;
pub use material::Material;
pub use shading::Brdf;
pub use texture::Texture;

use crate::error::{Error, Result};
use crate::query::{QueryBuffer, Reflectance, RgbImage, above_horizon};
use crate::random::{Random, Stream};
use footprint::{Footprint, Strata, mean_and_variance};
use rayon::prelude::*;
use std::path::Path;

/// Most sub-samples a query may ask for.
pub const MAX_SPP: usize = 1 << 20;

/// Most bounces of indirect light.
pub const MAX_BOUNCES: usize = 64;

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
    /// Sub-samples a query and seed where queries come through [`Reflectance`].
    pub sampling: Sampling,
}

impl Default for ReferenceOptions {
    fn default() -> Self {
        Self {
            resolution: None,
            bounces: 0,
            field_side: 512,
            material_seed: 0,
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
}

/// A surface that answers queries.
#[derive(Clone, Debug)]
pub struct Reference {
    surface: Surface,
    resolution: [usize; 2],
    bounces: usize,
    sampling: Sampling,
}

impl Reference {
    /// A built-in material by name, a `material.json`, or a folder that holds one.
    ///
    /// # Errors
    /// `Usage` for a name that is neither, listing the built-in ones; otherwise as [`maps::read`] and [`Reference::new`].
    pub fn open(spec: &str, options: &ReferenceOptions) -> Result<Self> {
        let path = Path::new(spec);
        let material = if builtin::NAMES.contains(&spec) {
            builtin::make(spec, options.field_side, options.material_seed)?
        } else if path.is_dir() {
            maps::read(&path.join("material.json"))?
        } else if path.exists() {
            maps::read(path)?
        } else {
            let names = builtin::NAMES.join(", ");
            return Err(Error::usage(format!(
                "{spec}: no such file, and no built-in material of that name; built in are {names}"
            )));
        };
        Self::new(material, options)
    }

    /// A reference over a material.
    ///
    /// # Errors
    /// `Config`, naming the option that is out of bounds; and as [`Heightfield::new`].
    pub fn new(material: Material, options: &ReferenceOptions) -> Result<Self> {
        let field = Heightfield::new(&material.height)?;
        let resolution = options.resolution.unwrap_or([material.height.height, material.height.width]);
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
        Ok(Self {
            surface: Surface { field, material },
            resolution,
            bounces: options.bounces,
            sampling: options.sampling,
        })
    }

    /// What was done to the material's maps, a line each.
    pub fn notes(&self) -> &[String] {
        &self.surface.material.notes
    }

    /// The material's name.
    pub fn name(&self) -> &str {
        &self.surface.material.name
    }

    /// Texels \[H, W\] of level 0.
    pub fn resolution(&self) -> [usize; 2] {
        self.resolution
    }

    /// The surface behind the answers.
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// Least and greatest height over the reference plane, in tile widths.
    pub fn height_range(&self) -> [f32; 2] {
        self.surface.field.range()
    }

    /// Heights over the reference plane at the field's own resolution.
    pub fn height_map(&self) -> HeightMap {
        self.surface.field.height_map()
    }

    /// Answers every query with its noise. The bytes depend on the queries and `sampling` alone.
    ///
    /// # Errors
    /// `Config` if `spp` is 0 or more than [`MAX_SPP`].
    pub fn measure(&self, queries: &QueryBuffer, sampling: &Sampling) -> Result<Measured> {
        check_spp(sampling.spp)?;
        let strata = Strata::new(sampling.spp);
        let mut answers = vec![([0.0; 3], 0.0); queries.len()];
        answers.par_iter_mut().enumerate().with_min_len(16).for_each_init(
            || Vec::with_capacity(sampling.spp),
            |samples, (k, answer)| {
                *answer = self.answer(queries, k, sampling, &strata, samples);
            },
        );
        let (pixels, variance) = answers.into_iter().unzip();
        let rgb = RgbImage { height: queries.height(), width: queries.width(), pixels };
        Ok(Measured { rgb, variance })
    }

    fn answer(
        &self,
        queries: &QueryBuffer,
        k: usize,
        sampling: &Sampling,
        strata: &Strata,
        samples: &mut Vec<[f32; 3]>,
    ) -> ([f32; 3], f32) {
        if !above_horizon(queries.wi[k]) || !above_horizon(queries.wo[k]) {
            return ([0.0; 3], 0.0);
        }
        let (wi, wo) = (unit(queries.wi[k]), unit(queries.wo[k]));
        let footprint = Footprint::new(queries.u[k], queries.level[k], self.resolution);
        let mut random = Random::new(sampling.seed, Stream::Reference, sampling.first.wrapping_add(k as u64));
        samples.clear();
        for stratum in 0..strata.len() {
            let jitter = [random.uniform(), random.uniform()].map(f64::from);
            let p = footprint.point(strata.point(stratum, jitter));
            samples.push(self.surface.radiance(p, wi, wo, self.bounces, &mut random));
        }
        mean_and_variance(samples)
    }
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
