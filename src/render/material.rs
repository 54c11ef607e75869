//! Materials that were opened: what answers their queries.

use super::directions::{Cosine, Directions};
use super::format::{MaterialSpec, Source};
use crate::checkpoint;
use crate::error::{Error, Result};
use crate::outside::Count;
use crate::query::{QueryBuffer, Reflectance, RgbImage, Support, above_horizon, unit};
use crate::reference::{Reference, ReferenceOptions, Sampling, builtin};
use neumip_export::checkpoint::Checkpoint;
use neumip_export::config::Architecture;
use neumip_export::{Measure, read_bundle};
use sha2::{Digest, Sha256};
use std::f32::consts::FRAC_1_PI;
use std::path::Path;

/// Rays to a reference surface a query where nothing else is said.
const REFERENCE_SPP: usize = 16;
/// Texels along a side of a reference where nothing else is said: as `neumip generate` has it.
const REFERENCE_RESOLUTION: usize = 128;

/// A material of a scene.
pub struct Material {
    /// Its name in the scene.
    pub name: String,
    /// Texels \[H, W\] of level 0.
    pub resolution: [usize; 2],
    /// The coarsest level that it is asked at.
    pub coarsest: f32,
    /// What it is, for people.
    pub described: String,
    /// A number that tells what it answers from what others do.
    pub identity: String,
    /// What was done to its files, a line each.
    pub notes: Vec<String>,
    /// Which directions it asks for.
    pub directions: Box<dyn Directions>,
    /// What it was trained on, where it is a model.
    pub trained_on: Option<String>,
    /// Of a model that was fitted for a scene.
    fitted: Option<Architecture>,
    answers: Answers,
}

enum Answers {
    Pointwise(Box<dyn Reflectance>),
    Measured(Box<Reference>, usize),
}

/// Answers with their noise.
pub struct Answered {
    /// The answers.
    pub rgb: Vec<[f32; 3]>,
    /// The variance of each, where the material measures.
    pub variance: Option<Vec<f32>>,
}

/// What answers for a checkpoint.
pub struct Model {
    /// Answers its queries.
    pub answers: Box<dyn Reflectance>,
    /// Which directions it asks for: [`Cosine`], or a sampler that was fitted to it.
    pub directions: Box<dyn Directions>,
    /// A number that tells its answers and directions from others of the same checkpoint; may be empty.
    pub identity: String,
}

/// Makes a checkpoint answer; the path is that of the run, bundle or checkpoint that it comes from.
pub type Engine<'a> = dyn Fn(&Checkpoint, &Path) -> Result<Model> + 'a;

impl Material {
    /// The material of a checked spec; `base` is the folder of relative paths, and `engine` answers for checkpoints.
    ///
    /// # Errors
    /// `File` or `Usage`, naming what cannot be opened; `Config`, naming an option out of bounds, or a decoder that reads
    /// the queries around each one.
    pub fn open(name: &str, spec: &MaterialSpec, base: &Path, engine: &Engine) -> Result<Self> {
        let field = format!("materials.{name}");
        match spec.source().map_err(|problem| Error::config(&field, problem))? {
            Source::Model(path) => Self::model(name, &base.join(path), engine),
            Source::Reference(surface) => Self::reference(name, surface, spec, base),
            Source::Lambert(albedo) => Ok(Self::lambert(name, albedo)),
        }
    }

    fn model(name: &str, path: &Path, engine: &Engine) -> Result<Self> {
        let checkpoint = load(path)?;
        if checkpoint.header.measure != Measure::RadianceCosine {
            let problem = "its answers are the bare reflectance; pictures are made of f cos";
            return Err(Error::config(format!("materials.{name}"), problem));
        }
        let architecture = &checkpoint.header.architecture;
        let [height, width] = architecture.tile();
        let Model { answers, directions, identity } = engine(&checkpoint, path)?;
        if answers.support() != Support::Pointwise {
            let problem = "its Inception decoder answers images of the whole tile, not the points that rays meet; \
                           train a model with an MLP decoder";
            return Err(Error::config(format!("materials.{name}"), problem));
        }
        Ok(Self {
            name: name.into(),
            resolution: [height, width],
            // A fitted material clamps the levels itself, and is told which ones it was asked.
            coarsest: match &architecture.domain {
                Some(_) => full_levels([height, width]).max(architecture.coarsest() as f32),
                None => architecture.coarsest() as f32,
            },
            described: format!("{} at {width} x {height}", checkpoint.header.material),
            identity: format!("{} {identity}", content(&checkpoint)?),
            notes: Vec::new(),
            directions,
            trained_on: Some(checkpoint.header.material.clone()),
            fitted: architecture.domain.is_some().then(|| architecture.clone()),
            answers: Answers::Pointwise(answers),
        })
    }

    fn reference(name: &str, surface: &str, spec: &MaterialSpec, base: &Path) -> Result<Self> {
        let defaults = ReferenceOptions::default();
        let spp = spec.spp.unwrap_or(REFERENCE_SPP);
        let options = ReferenceOptions {
            resolution: Some([spec.resolution.unwrap_or(REFERENCE_RESOLUTION); 2]),
            bounces: spec.bounces.unwrap_or(defaults.bounces),
            field_side: spec.field_side.unwrap_or(defaults.field_side),
            material_seed: spec.material_seed.unwrap_or(defaults.material_seed),
            make_tileable: spec.make_tileable.unwrap_or(defaults.make_tileable),
            sampling: Sampling { spp, seed: 0, first: 0 },
        };
        let opened = if builtin::NAMES.contains(&surface) {
            Reference::open(surface, &options)
        } else {
            Reference::open(&base.join(surface).to_string_lossy(), &options)
        };
        let reference = opened.map_err(|error| match error {
            Error::Config { field, problem } => Error::config(format!("materials.{name}.{field}"), problem),
            other => other,
        })?;
        let [height, width] = reference.resolution();
        Ok(Self {
            name: name.into(),
            resolution: [height, width],
            coarsest: full_levels([height, width]),
            described: format!("reference {} at {width} x {height}, {spp} rays a query", reference.name()),
            identity: format!("reference {} {height} {width} {spp}", reference.fingerprint()),
            notes: reference.notes().iter().map(|note| format!("{}: {note}", reference.name())).collect(),
            directions: Box::new(Cosine),
            trained_on: None,
            fitted: None,
            answers: Answers::Measured(Box::new(reference), spp),
        })
    }

    /// A matt material.
    pub fn lambert(name: &str, albedo: [f32; 3]) -> Self {
        Self {
            name: name.into(),
            resolution: [1, 1],
            coarsest: 0.0,
            described: format!("matt {albedo:?}"),
            identity: format!("lambert {:?}", albedo.map(f32::to_bits)),
            notes: Vec::new(),
            directions: Box::new(Cosine),
            trained_on: None,
            fitted: None,
            answers: Answers::Pointwise(Box::new(Lambert(albedo))),
        }
    }

    /// True if its answers depend on where on the tile it is asked.
    pub fn needs_uv(&self) -> bool {
        self.resolution != [1, 1]
    }

    /// Rays of a measured answer; None if its answers have no noise.
    pub fn rays(&self) -> Option<usize> {
        match self.answers {
            Answers::Pointwise(_) => None,
            Answers::Measured(_, spp) => Some(spp),
        }
    }

    /// How many queries are outside of what it was fitted for; None if it was fitted for everything.
    pub fn outside(&self, queries: &QueryBuffer) -> Option<Count> {
        self.fitted.as_ref().map(|architecture| {
            let mut count = Count::default();
            count.add(architecture, queries);
            count
        })
    }

    /// Answers queries. `batch` numbers the buffers of a picture: no two draw the same random numbers.
    ///
    /// # Errors
    /// Whatever keeps the material from answering.
    pub fn answer(&self, queries: &QueryBuffer, seed: u64, batch: u64) -> Result<Answered> {
        match &self.answers {
            Answers::Pointwise(answers) => {
                Ok(Answered { rgb: answers.evaluate(queries)?.pixels, variance: None })
            }
            Answers::Measured(reference, spp) => {
                let sampling = Sampling { spp: *spp, seed, first: batch << 32 };
                let measured = reference.measure(queries, &sampling)?;
                Ok(Answered { rgb: measured.rgb.pixels, variance: Some(measured.variance) })
            }
        }
    }
}

/// The checkpoint that a path means: a bundle, which is verified, a run, or a checkpoint file.
///
/// # Errors
/// `File` if there is none, or it is damaged.
pub fn load(path: &Path) -> Result<Checkpoint> {
    if !path.exists() {
        return Err(Error::file(path, "no such run, bundle or checkpoint"));
    }
    let is_bundle = ["golden.json", "material.json", "model.safetensors"];
    if is_bundle.iter().any(|name| path.join(name).is_file()) {
        return Ok(read_bundle(path)?.checkpoint);
    }
    checkpoint::load(path)
}

/// The coarsest level of a full pyramid.
fn full_levels(resolution: [usize; 2]) -> f32 {
    resolution[0].min(resolution[1]).max(2).ilog2() as f32 - 1.0
}

/// A hash of all that a checkpoint holds.
fn content(checkpoint: &Checkpoint) -> Result<String> {
    let mut hash = Sha256::new();
    let header = serde_json::to_vec(&checkpoint.header).map_err(|e| Error::config("checkpoint", e))?;
    hash.update(header);
    for (name, tensor) in &checkpoint.tensors {
        hash.update(name.as_bytes());
        tensor.data.iter().for_each(|value| hash.update(value.to_le_bytes()));
    }
    Ok(format!("model {}", hex(&hash.finalize())))
}

/// Bytes as hexadecimal digits.
pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Reflects the same in all directions.
struct Lambert([f32; 3]);

impl Reflectance for Lambert {
    fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage> {
        let answer = |(wi, wo): (&[f32; 2], &[f32; 2])| {
            if !(above_horizon(*wi) && above_horizon(*wo)) {
                return [0.0; 3];
            }
            self.0.map(|albedo| albedo * FRAC_1_PI * unit(*wi)[2])
        };
        let pixels = queries.wi.iter().zip(&queries.wo).map(answer).collect();
        Ok(RgbImage { height: queries.height(), width: queries.width(), pixels })
    }
}
