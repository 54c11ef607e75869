//! What a fit starts from: the full model, the scene around it, and who knows the answers.

use crate::checkpoint::RunFolder;
use crate::cli::console::Console;
use crate::cli::train::train;
use crate::config::{Budget, Config};
use crate::dataset::Dataset;
use crate::engine::FusedMaterial;
use crate::error::{Error, Result};
use crate::fit::truth::Truth;
use crate::inference::answerer;
use crate::reference::{Reference, ReferenceOptions, builtin};
use crate::render::builtin::scene as named;
use crate::render::format::{DEFAULT_MATERIAL, MaterialSpec, SceneFile};
use crate::render::material::load;
use crate::render::{Model, OpenOptions, Scene, directions_of};
use crate::trainer::{Progress, Trainer};
use candle_core::Device;
use neumip_export::Precision;
use neumip_export::checkpoint::Checkpoint;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Preset of a full model that is trained here.
const PRESET: &str = "improved";
/// Memory for its training data.
const MEMORY: usize = 2 << 30;

/// A full model.
pub struct Full {
    /// The model.
    pub checkpoint: Checkpoint,
    /// How it was trained.
    pub config: Config,
    /// Samples presented to it and seconds of that, where it says so.
    pub trained: Option<(u64, f64)>,
    /// Where it is.
    pub path: PathBuf,
}

/// The full model of `path`, or one that is trained in `out` for so many samples.
///
/// # Errors
/// What reading or training meets.
pub fn full(
    path: Option<&Path>,
    data: &Dataset,
    out: &Path,
    (samples, seed): (u64, u64),
    console: &Console,
) -> Result<Full> {
    let path = match path {
        Some(path) => path.to_path_buf(),
        None => {
            trained(data, out, samples, seed, console)?;
            out.to_path_buf()
        }
    };
    let checkpoint = load(&path)?;
    let record = RunFolder::open(&path).ok().map(|(_, record)| record.config);
    let config = match record {
        Some(config) => config,
        None => Config { model: checkpoint.header.architecture.model.clone(), ..Config::preset(PRESET)? },
    };
    let history = std::fs::read(path.join("history.json")).ok();
    let progress: Option<Progress> = history.and_then(|bytes| serde_json::from_slice(&bytes).ok());
    let trained = progress.map(|progress| (progress.samples, progress.seconds));
    let architecture = &checkpoint.header.architecture;
    if architecture.domain.is_some() {
        return Err(Error::file(&path, "is fitted to a scene already: fit the full model that it came from"));
    }
    if architecture.resolution != data.resolution() {
        let ([height, width], [rows, columns]) = (architecture.resolution, data.resolution());
        let problem = format!(
            "has a tile of {width} x {height} texels, {} has {columns} x {rows}",
            data.root().display()
        );
        return Err(Error::file(&path, problem));
    }
    Ok(Full { checkpoint, config, trained, path })
}

fn trained(data: &Dataset, out: &Path, samples: u64, seed: u64, console: &Console) -> Result<()> {
    let mut config = Config::preset(PRESET)?;
    let side = data.resolution()[0].min(data.resolution()[1]);
    config.train.seed = seed;
    config.train.piece = config.train.piece.min(side);
    config.train.budget = Budget::Steps((samples / config.train.batch as u64).max(1));
    let begun = out.is_dir().then(|| RunFolder::open(out).ok()).flatten();
    let device = Device::Cpu;
    let mut trainer = match begun {
        Some((_, record)) if record.config == config => Trainer::resume(out, data, &device)?,
        _ => Trainer::new(config, data, out, out.exists(), MEMORY, &device)?,
    };
    if trainer.progress().fraction < 1.0 {
        train(&mut trainer, "train the full model", console)?;
    }
    Ok(())
}

/// A scene whose materials of these names are full models; the name of objects without a material is `default`.
///
/// # Errors
/// As [`Scene::open`]; `Usage` for a material that the scene has not.
pub fn scene(spec: &str, models: &BTreeMap<String, PathBuf>, seed: u64) -> Result<Scene> {
    let (mut file, path) = named(spec)?;
    let mut default_material = None;
    for (name, model) in models {
        let model = std::path::absolute(model).map_err(|e| Error::file(model, e))?;
        if name == DEFAULT_MATERIAL {
            default_material = Some(MaterialSpec::model(&model));
        } else if file.objects.iter().any(|object| object.material == *name) {
            file.materials.insert(name.clone(), MaterialSpec::model(&model));
        } else {
            let problem =
                format!("no object of {} has the material {name}; {}", path.display(), names(&file));
            return Err(Error::usage(problem));
        }
    }
    let engine = |checkpoint: &Checkpoint, path: &Path| {
        let answers = answerer(checkpoint, None, Precision::Single, &Device::Cpu)?.material;
        let (directions, sampler) = directions_of(checkpoint, path)?;
        Ok(Model { answers, directions, identity: format!("fused {sampler}") })
    };
    Scene::open(file, &path, &OpenOptions { default_material, seed, engine: &engine })
}

/// The materials of a scene's objects, in words.
pub fn names(file: &SceneFile) -> String {
    let mut names: Vec<&str> = file.objects.iter().map(|object| object.material.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    format!("its objects have {}", names.join(", "))
}

/// Who knows the answers: the surface of `surface`, that of the data where it is built in, else the full model.
///
/// # Errors
/// What opening the surface meets; `Usage` for a surface that the data was not rendered from.
pub fn truth(
    surface: Option<&str>,
    (field_side, material_seed): (usize, u64),
    data: &Dataset,
    full: &Full,
    console: &Console,
) -> Result<Truth> {
    let source = &data.manifest().source;
    let name = source.get("name").and_then(|name| name.as_str()).unwrap_or_default();
    let rendered = source.get("kind").and_then(|kind| kind.as_str()) == Some("reference");
    let chosen = match surface {
        Some("none") => None,
        Some(surface) => Some(surface),
        None => (rendered && builtin::NAMES.contains(&name)).then_some(name),
    };
    let Some(chosen) = chosen else {
        console.say(
            "note: the data has no surface that can be opened, so the full model is taken for the truth",
        );
        return Ok(Truth::Model(Box::new(FusedMaterial::from_checkpoint(&full.checkpoint)?)));
    };
    let [height, width] = data.resolution();
    let options = ReferenceOptions {
        resolution: Some([height, width]),
        bounces: source.get("bounces").and_then(|v| v.as_u64()).map_or(1, |bounces| bounces as usize),
        field_side,
        material_seed,
        ..ReferenceOptions::default()
    };
    let reference = Reference::open(chosen, &options)?;
    let known = source.get("fingerprint").and_then(|v| v.as_str().map(String::from));
    let found = serde_json::to_value(reference.fingerprint()).ok();
    if rendered && known.is_some() && found.as_ref().and_then(|v| v.as_str()) != known.as_deref() {
        let problem = format!(
            "{} was rendered from another {name}: say the --field-side and --material-seed that it was generated with, name its \
             surface with --surface material.json, or take the full model for the truth with --surface none",
            data.root().display()
        );
        return Err(Error::usage(problem));
    }
    Ok(Truth::Surface(Box::new(reference)))
}
