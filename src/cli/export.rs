//! `neumip export`.

use super::console::Console;
use crate::artefacts::{self, Artefact};
use crate::error::{Error, Result};
use crate::onnx_material::{OnnxMaterial, largest_difference};
use crate::query::QueryBuffer;
use crate::sampler::{self, Options, fit};
use crate::{checkpoint, golden};
use clap::Args;
use neumip_export::bundle::{MATERIAL, SIDECAR, may_replace};
use neumip_export::onnx::{self, Opset};
use neumip_export::{
    BundleFile, Checkpoint, Contents, Golden, Rounding, Sampler, SamplerGolden, Storage, read_bundle,
};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Write what another renderer needs: ONNX graphs, textures, weights, conventions, golden answers.
#[derive(Debug, Args)]
#[command(after_help = "Examples: neumip export runs/metal --out bundles/metal --check\n          \
                        neumip export bundles/metal --check")]
pub struct Export {
    /// A run's folder or a checkpoint; with --check and without --out, a bundle.
    run: PathBuf,
    /// The bundle's folder.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Round textures and weights to half floats before anything is written, store them so in the graphs, and say what
    /// that changes of the answers.
    #[arg(long, conflicts_with_all = ["half_textures", "int8"])]
    half: bool,
    /// As --half, of the textures alone.
    #[arg(long, conflicts_with = "int8")]
    half_textures: bool,
    /// Round textures to 8-bit integers with a factor for each channel, and weights to half floats; refused where that
    /// moves the answers too far.
    #[arg(long)]
    int8: bool,
    /// Operator set of the ONNX graphs: 13, 17 or 21.
    #[arg(long, default_value_t = 17)]
    opset: i64,
    /// Put this importance sampler of `neumip sampler` into the bundle; without it, one is fitted.
    #[arg(long)]
    sampler: Option<PathBuf>,
    /// Steps of the fit.
    #[arg(long, default_value_t = Options::default().steps, conflicts_with = "sampler")]
    sampler_steps: u64,
    /// Leave importance sampling out: renderers then sample the cosine.
    #[arg(long, conflicts_with_all = ["sampler", "sampler_steps"])]
    no_sampler: bool,
    /// Run the golden answers through everything in the bundle that can be run here.
    #[arg(long)]
    check: bool,
    /// Replace an existing bundle.
    #[arg(long)]
    force: bool,
    /// Write the list of files and what the check found here.
    #[arg(long)]
    json: Option<PathBuf>,
}

/// Largest mean difference / (1 + |value|) that `--int8` may cost. Measured: 0.7e-4 to 2.9e-4 on trained materials; a bundle
/// beyond it would be mostly rounding.
const MOST_OF_BYTES: f64 = 1e-3;

impl Export {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        super::check_json(self.json.as_deref())?;
        let Some(out) = &self.out else {
            return self.check_bundle(console);
        };
        let opset = Opset::try_from(self.opset).map_err(|e| Error::usage(format!("--opset: {e}")))?;
        let checkpoint = checkpoint::load(&self.run)?;
        let sampling = match &self.sampler {
            _ if self.no_sampler => Sampling::None,
            Some(file) => Sampling::File(file.clone()),
            // A decoder that reads neighbours answers no single direction.
            None if checkpoint.header.architecture.neighbourhood().is_some() => Sampling::None,
            None => Sampling::Fit(self.sampler_steps),
        };
        let choices = Choices { storage: self.storage(), opset, sampling };
        let mut bundle = bundle_as(&checkpoint, &choices, out, self.force, console)?;
        for file in &bundle.files {
            console.say(format!("{:>10}  {}", file.bytes, out.join(&file.name).display()));
        }
        console.say(format!(
            "material.onnx answers within {:.1e} (1 + |value|) of the model",
            bundle.difference
        ));
        if let Some(cost) = &bundle.rounding {
            console.say(format!(
                "{} move the answers by at most {:.1e} (1 + |value|), {:.1e} in the mean",
                named(cost.storage),
                cost.largest_difference,
                cost.mean_difference
            ));
        }
        if let Some(sampling) = &bundle.sampling {
            console.say(sampling);
        }
        if self.check {
            bundle.artefacts = checked(out, console)?;
        }
        super::save_json(self.json.as_deref(), &bundle)?;
        verdict(&bundle.artefacts, out)
    }

    fn storage(&self) -> Storage {
        match (self.half, self.half_textures, self.int8) {
            (true, ..) => Storage::HALF,
            (_, true, _) => Storage::HALF_TEXTURES,
            (.., true) => Storage::BYTE,
            _ => Storage::SINGLE,
        }
    }

    fn check_bundle(&self, console: &Console) -> Result<()> {
        let used = [
            (self.half, "--half"),
            (self.half_textures, "--half-textures"),
            (self.int8, "--int8"),
            (self.sampler.is_some(), "--sampler"),
            (self.no_sampler, "--no-sampler"),
            (self.force, "--force"),
        ];
        if let Some((_, flag)) = used.iter().find(|(used, _)| *used) {
            return Err(Error::usage(format!("{flag}: needs --out, the bundle to write")));
        }
        if !self.check {
            return Err(Error::usage("--out: name the bundle's folder, or --check an existing one"));
        }
        if !self.run.join(SIDECAR).is_file() {
            let problem = format!("is no bundle to check (it has no {SIDECAR}); with --out one is written");
            return Err(Error::file(&self.run, problem));
        }
        let artefacts = checked(&self.run, console)?;
        super::save_json(self.json.as_deref(), &artefacts)?;
        verdict(&artefacts, &self.run)
    }
}

/// Runs what can be run of a bundle and says how it went.
fn checked(folder: &Path, console: &Console) -> Result<Vec<Artefact>> {
    let bundle = read_bundle(folder)?;
    let artefacts = artefacts::check(folder, &bundle)?;
    for Artefact { files, by, difference, bound } in &artefacts {
        console.say(format!("{files:<30} {by:<36} off by {difference:.1e}, at most {bound:.0e} is right"));
    }
    if !bundle.sidecar.shaders.is_empty() {
        console
            .say(format!("{:<30} not run here; neumip view makes a page that runs them", "exact.*, fast.*"));
    }
    Ok(artefacts)
}

/// An error that names the first artefact that is wrong.
fn verdict(artefacts: &[Artefact], folder: &Path) -> Result<()> {
    match artefacts.iter().find(|artefact| !artefact.is_right()) {
        None => Ok(()),
        Some(Artefact { files, by, difference, bound }) => {
            let problem = format!("{files} ({by}) is off by {difference:.1e} where {bound:.0e} is allowed");
            Err(Error::file(folder, problem))
        }
    }
}

fn named(storage: Storage) -> &'static str {
    match storage {
        Storage::HALF_TEXTURES => "half textures",
        Storage::HALF => "half textures and weights",
        Storage::BYTE => "byte textures and half weights",
        _ => "rounded numbers",
    }
}

/// A bundle that was written and checked.
#[derive(Clone, Debug, Serialize)]
pub struct Written {
    /// Its files.
    pub files: Vec<BundleFile>,
    /// Largest |difference| / (1 + |value|) of its graph's golden answers.
    pub difference: f64,
    /// What rounding cost, where numbers were rounded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rounding: Option<Rounding>,
    /// What `--check` found.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub artefacts: Vec<Artefact>,
    /// What its importance sampler gains, in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sampling: Option<String>,
}

/// Where the importance sampler comes from.
#[derive(Clone, Debug)]
pub enum Sampling {
    /// There is none.
    None,
    /// A file.
    File(PathBuf),
    /// A fit of so many steps.
    Fit(u64),
}

/// How a bundle is made.
#[derive(Clone, Debug)]
pub struct Choices {
    /// How numbers are stored.
    pub storage: Storage,
    /// Operator set of the graphs.
    pub opset: Opset,
    /// Where the importance sampler comes from.
    pub sampling: Sampling,
}

impl Default for Choices {
    fn default() -> Self {
        Self { storage: Storage::SINGLE, opset: Opset::default(), sampling: Sampling::None }
    }
}

/// Writes the bundle of a checkpoint with its golden answers, once an engine that is not ours gives the same from its graph.
pub fn bundle(checkpoint: &Checkpoint, out: &Path, force: bool, console: &Console) -> Result<Written> {
    bundle_as(checkpoint, &Choices::default(), out, force, console)
}

/// As [`bundle`], as it is asked for.
pub fn bundle_as(
    checkpoint: &Checkpoint,
    choices: &Choices,
    out: &Path,
    force: bool,
    console: &Console,
) -> Result<Written> {
    // Fitting takes longer than anything after it: what cannot be written is refused before.
    may_replace(out, force)?;
    let mut contents = checkpoint.clone();
    let (answers, rounding) = if choices.storage == Storage::SINGLE {
        (golden::answers(checkpoint, golden::QUERIES)?, None)
    } else {
        let rounded = golden::rounded(checkpoint, choices.storage, golden::QUERIES)?;
        contents = rounded.checkpoint;
        (rounded.golden, Some(rounded.cost))
    };
    if let Some(Rounding { mean_difference: mean, .. }) = rounding.filter(|r| r.storage == Storage::BYTE)
        && mean.is_nan() | (mean > MOST_OF_BYTES)
    {
        let problem =
            format!("would move the answers by {mean:.1e} in the mean, more than {MOST_OF_BYTES:.0e}");
        return Err(Error::config("--int8", format!("{problem}; use --half")));
    }
    let sampler = sampler(&contents, &choices.sampling, console)?;
    let sampling = sampler.as_ref().map(|(sampler, _)| gained(sampler));
    let sampler = sampler.as_ref().map(|(sampler, golden)| (sampler, golden));
    let contents =
        Contents { checkpoint: &contents, golden: &answers, rounding, sampler, opset: choices.opset };
    let difference = difference(&contents, &out.join(MATERIAL))?;
    let files = contents.write(out, force)?;
    Ok(Written { files, difference, rounding, artefacts: Vec::new(), sampling })
}

/// The sampler of a checkpoint and its golden samples.
fn sampler(
    checkpoint: &Checkpoint,
    sampling: &Sampling,
    console: &Console,
) -> Result<Option<(Sampler, SamplerGolden)>> {
    let sampler = match sampling {
        Sampling::None => return Ok(None),
        Sampling::File(file) => Sampler::read(file)?,
        Sampling::Fit(steps) => {
            let options = Options { steps: *steps, ..Options::default() };
            let mut meter = console.meter("importance sampler", *steps, "steps");
            let fitted = fit(checkpoint, &options, &mut |step, loss| {
                meter.update(step, &format!("loss {loss:.3}"));
                console.flow()
            });
            meter.finish(*steps);
            fitted?
        }
    };
    let golden = sampler::golden::golden(checkpoint, &sampler, golden::QUERIES, 1)?;
    Ok(Some((sampler, golden)))
}

/// What the gains of a sampler's provenance say.
fn gained(sampler: &Sampler) -> String {
    let provenance = &sampler.header.provenance;
    let of = |gain: &serde_json::Value| Some((gain["ratio"].as_f64()?, gain["light"].as_str()?.to_string()));
    let gains = provenance["gains"].as_array().into_iter().flatten().filter_map(of);
    let gains: Vec<String> = gains.map(|(ratio, light)| format!("{ratio:.2} under {light}")).collect();
    format!("importance sampling: variance over that of cosine sampling {}", gains.join(", "))
}

/// Runs the graph that is about to be written as `path`.
fn difference(contents: &Contents, path: &Path) -> Result<f64> {
    let options = onnx::Options { storage: contents.storage(), opset: contents.opset };
    let graph = OnnxMaterial::from_bytes(path, onnx::material_graph(contents.checkpoint, options)?)?;
    let Golden { u, wi, wo, level, rgb, tolerance, images } = contents.golden.clone();
    let queries = QueryBuffer::new(1, level.len(), u, wi, wo, level)?;
    let difference = largest_difference(&graph.answers(&queries, images)?, &rgb);
    if difference.is_nan() || difference > tolerance {
        let problem = format!("would answer {difference:.1e} (1 + |value|) off, more than {tolerance:.0e}");
        return Err(Error::file(path, problem));
    }
    Ok(difference)
}
