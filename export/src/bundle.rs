//! The bundle: one folder with everything that another renderer needs, each file with its checksum.

use crate::checkpoint::Checkpoint;
use crate::error::{Error, Result};
use crate::golden::{Golden, SamplerGolden};
use crate::onnx::{self, Opset, Port};
use crate::precision::{Rounding, Storage};
use crate::readme;
use crate::sampler::Sampler;
use crate::shader;
use crate::sidecar::{GraphFile, GraphPort, Sidecar};
use crate::textures::texture_files;
use crate::weights::{self, Layout};
use crate::whole_file::{parent_of, sibling_folder, sync_folder, write_whole};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// The checkpoint's name in a bundle.
pub const MODEL: &str = "model.safetensors";
/// The graph of the decoder.
pub const DECODER: &str = "decoder.onnx";
/// The graph of the whole material.
pub const MATERIAL: &str = "material.onnx";
/// The graph of what does not depend on the light.
pub const PREPARE: &str = "prepare.onnx";
/// The graph of the rest.
pub const EVALUATE: &str = "evaluate.onnx";
/// The graph that samples a light direction.
pub const SAMPLE: &str = "sample.onnx";
/// The graph of that sampling's density.
pub const PDF: &str = "pdf.onnx";
/// The golden answers.
pub const GOLDEN: &str = "golden.json";
/// The importance sampler.
pub const SAMPLER: &str = "sampler.safetensors";
/// Its golden answers.
pub const SAMPLER_GOLDEN: &str = "sampler-golden.json";
/// The description.
pub const SIDECAR: &str = "material.json";
/// The page for people.
pub const README: &str = "README.txt";
/// Largest JSON file that is read.
const MAX_JSON: u64 = 256 << 20;

/// One file of a bundle.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BundleFile {
    /// Name in the folder.
    pub name: String,
    /// Length.
    pub bytes: u64,
    /// SHA-256 of the content, in hexadecimal.
    pub sha256: String,
}

/// A bundle that was read and verified.
#[derive(Clone, Debug, PartialEq)]
pub struct Bundle {
    /// `material.json`.
    pub sidecar: Sidecar,
    /// `model.safetensors`.
    pub checkpoint: Checkpoint,
    /// `golden.json`.
    pub golden: Golden,
    /// `sampler.safetensors` and `sampler-golden.json`, where there are such.
    pub sampler: Option<(Sampler, SamplerGolden)>,
}

/// What a bundle is made of.
#[derive(Clone, Copy, Debug)]
pub struct Contents<'a> {
    /// The model; where `rounding` is given, rounded by [`Storage::round`].
    pub checkpoint: &'a Checkpoint,
    /// What it answers.
    pub golden: &'a Golden,
    /// How numbers are stored, and how far that is from the answers before.
    pub rounding: Option<Rounding>,
    /// Its importance sampler, and what that gives.
    pub sampler: Option<(&'a Sampler, &'a SamplerGolden)>,
    /// Operator set of the graphs.
    pub opset: Opset,
}

impl<'a> Contents<'a> {
    /// A model and its answers, as they are.
    pub fn new(checkpoint: &'a Checkpoint, golden: &'a Golden) -> Self {
        Self { checkpoint, golden, rounding: None, sampler: None, opset: Opset::default() }
    }

    /// How numbers are stored.
    pub fn storage(&self) -> Storage {
        self.rounding.map_or(Storage::SINGLE, |rounding| rounding.storage)
    }

    /// Writes a bundle as the folder `out`, whole or not at all, and returns its files (`material.json` last).
    ///
    /// With `force` an older bundle at `out` is replaced once the new one is complete; any other folder is left
    /// alone.
    ///
    /// # Errors
    /// `Config`, naming the tensor or field at fault; `File`, naming the path that exists or cannot be written.
    pub fn write(&self, out: &Path, force: bool) -> Result<Vec<BundleFile>> {
        self.validate()?;
        let replaces = may_replace(out, force)?;
        let parent = parent_of(out);
        std::fs::create_dir_all(&parent)
            .map_err(|e| Error::file(out, format!("cannot be written: {}: {e}", parent.display())))?;
        let folder = sibling_folder(out)?;
        let mut files = Vec::new();
        let mut add = |name: &str, bytes: &[u8]| {
            write_whole(&folder.path().join(name), bytes)?;
            files.push(BundleFile { name: name.into(), bytes: bytes.len() as u64, sha256: digest(bytes) });
            Ok::<(), Error>(())
        };
        add(MODEL, &self.checkpoint.to_bytes()?)?;
        let mut graphs = Vec::new();
        for (graph, bytes) in self.graphs()? {
            add(&graph.file, &bytes)?;
            graphs.push(graph);
        }
        let mut planes = Vec::new();
        for (texture, bytes) in texture_files(self.checkpoint)? {
            add(&texture.file, &bytes)?;
            planes.push(texture);
        }
        let json = |value: serde_json::Result<Vec<u8>>| value.map_err(|e| Error::config("bundle", e));
        add(GOLDEN, &json(serde_json::to_vec(self.golden))?)?;
        let sampler = self.sampler.map(|(sampler, _)| sampler);
        let architecture = &self.checkpoint.header.architecture;
        if architecture.neighbourhood().is_none() {
            let layout = Layout::new(architecture, sampler.map(|s| &s.header.config));
            let block = layout.fill(self.checkpoint, sampler)?;
            add(weights::SINGLE, &weights::single_bytes(&block))?;
            add(weights::HALF, &weights::half_bytes(&block))?;
            for (name, text) in shader::files(self.checkpoint, sampler)? {
                add(name, text.as_bytes())?;
            }
        }
        if let Some((sampler, golden)) = self.sampler {
            add(SAMPLER, &sampler.to_bytes()?)?;
            add(SAMPLER_GOLDEN, &json(serde_json::to_vec(golden))?)?;
        }
        let mut sidecar = Sidecar::new(self, graphs, planes, Vec::new());
        add(README, readme::page(&sidecar).as_bytes())?;
        sidecar.files = files.clone();
        let bytes = json(serde_json::to_vec_pretty(&sidecar))?;
        write_whole(&folder.path().join(SIDECAR), &bytes)?;
        files.push(BundleFile { name: SIDECAR.into(), bytes: bytes.len() as u64, sha256: digest(&bytes) });

        put_in_place(folder, out, replaces)?;
        Ok(files)
    }

    fn validate(&self) -> Result<()> {
        self.checkpoint.validate()?;
        self.golden.validate()?;
        self.storage().check(self.checkpoint)?;
        if let Some(rounding) = &self.rounding {
            rounding.validate()?;
        }
        if let Some((sampler, golden)) = self.sampler {
            check_sampler(sampler, self.checkpoint)?;
            golden.validate()?;
        }
        Ok(())
    }

    /// The ONNX graphs.
    fn graphs(&self) -> Result<Vec<(GraphFile, Vec<u8>)>> {
        let Self { checkpoint, opset, .. } = *self;
        let options = onnx::Options { storage: self.storage(), opset };
        let architecture = &checkpoint.header.architecture;
        let layout = onnx::Layout::of(architecture);
        let file = |file: &str, (inputs, outputs): (Vec<Port>, Vec<Port>)| GraphFile {
            file: file.into(),
            opset,
            inputs: inputs.into_iter().map(GraphPort::from).collect(),
            outputs: outputs.into_iter().map(GraphPort::from).collect(),
        };
        let rgb = || vec![onnx::output(layout)];
        let inputs = onnx::decoder_inputs(architecture);
        let mut graphs = vec![
            (file(DECODER, (inputs, rgb())), onnx::decoder_graph(checkpoint, options)?),
            (
                file(MATERIAL, (onnx::material_inputs(layout), rgb())),
                onnx::material_graph(checkpoint, options)?,
            ),
        ];
        if architecture.neighbourhood().is_none() {
            let sampler = self.sampler.map(|(sampler, _)| sampler);
            let ports = onnx::prepare_ports(architecture, sampler.map(|s| &s.header.config))?;
            graphs.push((file(PREPARE, ports), onnx::prepare_graph(checkpoint, sampler, options)?));
            let ports = onnx::evaluate_ports(architecture)?;
            graphs.push((file(EVALUATE, ports), onnx::evaluate_graph(checkpoint, options)?));
        }
        if let Some((sampler, _)) = self.sampler {
            let config = &sampler.header.config;
            graphs.push((file(SAMPLE, onnx::sample_ports(config)), onnx::sample_graph(sampler, opset)?));
            graphs.push((file(PDF, onnx::pdf_ports(config)), onnx::pdf_graph(sampler, opset)?));
        }
        Ok(graphs)
    }
}

/// Checks that a sampler reads what a model gives.
fn check_sampler(sampler: &Sampler, checkpoint: &Checkpoint) -> Result<()> {
    sampler.validate()?;
    let architecture = &checkpoint.header.architecture;
    if architecture.neighbourhood().is_some() {
        return Err(Error::config("sampler", "a decoder that reads neighbours has none"));
    }
    match (sampler.header.config.features, architecture.model.texture.channels) {
        (reads, has) if reads != has => {
            Err(Error::config("sampler.features", format!("reads {reads} where the model has {has}")))
        }
        _ => Ok(()),
    }
}

/// Reads a bundle: versions, the presence and checksum of every file, checkpoint and golden answers.
///
/// # Errors
/// `File`, naming the file that is missing, altered or invalid.
pub fn read_bundle(path: &Path) -> Result<Bundle> {
    let file = path.join(SIDECAR);
    let sidecar = Sidecar::from_json(&read_small(&file)?).map_err(|e| Error::file(&file, e))?;
    for name in [MODEL, DECODER, MATERIAL, GOLDEN] {
        if !sidecar.files.iter().any(|f| f.name == name) {
            return Err(Error::file(&file, format!("does not list {name}")));
        }
    }
    for entry in &sidecar.files {
        verify(&path.join(&entry.name), entry)?;
    }
    let checkpoint = Checkpoint::read(&path.join(MODEL))?;
    if checkpoint.header.architecture != sidecar.architecture {
        return Err(Error::file(&file, format!("describes another architecture than {MODEL}")));
    }
    sidecar.storage().check(&checkpoint).map_err(|e| Error::file(path.join(MODEL), e))?;
    let golden: Golden = read_json(&path.join(GOLDEN))?;
    golden.validate().map_err(|e| Error::file(path.join(GOLDEN), e))?;
    let sampler = match &sidecar.sampler {
        None => None,
        Some(described) => {
            let file = path.join(&described.file);
            let sampler = Sampler::read(&file)?;
            check_sampler(&sampler, &checkpoint).map_err(|e| Error::file(&file, e))?;
            if sampler.header.config != described.config {
                return Err(Error::file(&file, format!("is another sampler than {SIDECAR} describes")));
            }
            let file = path.join(&described.golden);
            let golden: SamplerGolden = read_json(&file)?;
            golden.validate().map_err(|e| Error::file(&file, e))?;
            Some((sampler, golden))
        }
    };
    Ok(Bundle { sidecar, checkpoint, golden, sampler })
}

fn read_json<T: serde::de::DeserializeOwned>(file: &Path) -> Result<T> {
    serde_json::from_slice(&read_small(file)?).map_err(|e| Error::file(file, e))
}

/// True if `out` is a bundle to be replaced, false if nothing is there.
///
/// # Errors
/// `File`, naming the folder that is left alone, and why.
pub fn may_replace(out: &Path, force: bool) -> Result<bool> {
    if out.file_name().is_none() {
        return Err(Error::file(out, "is not the name of a folder to write"));
    }
    match std::fs::symlink_metadata(out) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(false),
        Err(e) => Err(Error::file(out, format!("cannot be written: {e}"))),
        Ok(_) if !force => Err(Error::file(out, "exists: choose another folder, or force to replace it")),
        Ok(about) if about.is_dir() => match foreign_part(out)? {
            None => Ok(true),
            Some(problem) => Err(Error::file(out, format!("is left alone: {problem}"))),
        },
        Ok(_) => Err(Error::file(out, "is left alone: it is a file, not a bundle")),
    }
}

/// What of a folder is not a bundle's. The description alone proves nothing: textures that people download come with a
/// material.json too.
fn foreign_part(folder: &Path) -> Result<Option<String>> {
    #[derive(Deserialize)]
    struct Listing {
        files: Vec<BundleFile>,
    }
    let no_bundle = || Ok(Some(format!("it is not a bundle (it has no {SIDECAR} of one)")));
    let Ok(json) = read_small(&folder.join(SIDECAR)) else { return no_bundle() };
    let Ok(listing) = serde_json::from_slice::<Listing>(&json) else { return no_bundle() };
    let failed = |e: std::io::Error| Error::file(folder, format!("cannot be listed: {e}"));
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let name = entry.map_err(failed)?.file_name();
        if name != SIDECAR && !listing.files.iter().any(|file| name == file.name.as_str()) {
            return Ok(Some(format!("{} is not of the bundle; move it away", name.display())));
        }
    }
    Ok(None)
}

/// Renames the finished folder to `out`; an older one is moved aside first and comes back if that fails.
fn put_in_place(folder: tempfile::TempDir, out: &Path, replaces: bool) -> Result<()> {
    let failed = |e: std::io::Error| Error::file(out, format!("cannot be written: {e}"));
    sync_folder(folder.path());
    if replaces {
        let aside = sibling_folder(out)?;
        let old: PathBuf = aside.path().join("replaced");
        std::fs::rename(out, &old).map_err(failed)?;
        if let Err(e) = std::fs::rename(folder.path(), out) {
            if std::fs::rename(&old, out).is_err() {
                let kept = aside.keep();
                return Err(Error::file(
                    out,
                    format!("cannot be written: {e}; the old bundle is in {}", kept.display()),
                ));
            }
            return Err(failed(e));
        }
    } else {
        std::fs::rename(folder.path(), out).map_err(failed)?;
    }
    // It is at its place now: nothing is left to remove.
    let _ = folder.keep();
    sync_folder(&parent_of(out));
    Ok(())
}

fn verify(path: &Path, entry: &BundleFile) -> Result<()> {
    let failed = |e: std::io::Error| match e.kind() {
        std::io::ErrorKind::NotFound => Error::file(path, "is missing from the bundle"),
        _ => Error::file(path, format!("cannot be read: {e}")),
    };
    let about = std::fs::metadata(path).map_err(failed)?;
    if !about.is_file() || about.len() != entry.bytes {
        return Err(Error::file(path, format!("was altered: it is not a file of {} bytes", entry.bytes)));
    }
    let mut file = File::open(path).map_err(failed)?;
    let mut hasher = Sha256::new();
    let mut chunk = vec![0; 1 << 16];
    loop {
        match file.read(&mut chunk).map_err(failed)? {
            0 => break,
            n => hasher.update(&chunk[..n]),
        }
    }
    if hex(&hasher.finalize()) != entry.sha256 {
        return Err(Error::file(path, "was altered: its checksum is not the one of material.json"));
    }
    Ok(())
}

fn read_small(path: &Path) -> Result<Vec<u8>> {
    let failed = |e: std::io::Error| Error::file(path, format!("cannot be read: {e}"));
    let about = std::fs::metadata(path).map_err(failed)?;
    if !about.is_file() || about.len() > MAX_JSON {
        return Err(Error::file(path, format!("is not a file of at most {MAX_JSON} bytes")));
    }
    std::fs::read(path).map_err(failed)
}

fn digest(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}
