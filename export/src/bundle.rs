//! The bundle: one folder with everything that another renderer needs, each file with its checksum.

use crate::checkpoint::Checkpoint;
use crate::error::{Error, Result};
use crate::golden::Golden;
use crate::onnx;
use crate::precision::{Precision, TexturePrecision};
use crate::sidecar::Sidecar;
use crate::textures::texture_files;
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
/// The golden answers.
pub const GOLDEN: &str = "golden.json";
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
}

/// Writes a bundle as the folder `out`, whole or not at all, and returns its files (`material.json` last).
///
/// With `force` an older bundle at `out` is replaced once the new one is complete; any other folder is left
/// alone.
///
/// # Errors
/// `Config`, naming the tensor or field at fault; `File`, naming the path that exists or cannot be written.
pub fn write_bundle(
    checkpoint: &Checkpoint,
    golden: &Golden,
    out: &Path,
    force: bool,
) -> Result<Vec<BundleFile>> {
    write_bundle_as(checkpoint, golden, None, out, force)
}

/// As [`write_bundle`], of a checkpoint whose textures were rounded by [`Precision::round`]; `golden` is what the
/// rounded checkpoint answers, and `textures` how far that is from the answers before.
///
/// # Errors
/// As [`write_bundle`], and `Config`, naming the texture that is not rounded.
pub fn write_bundle_as(
    checkpoint: &Checkpoint,
    golden: &Golden,
    textures: Option<TexturePrecision>,
    out: &Path,
    force: bool,
) -> Result<Vec<BundleFile>> {
    checkpoint.validate()?;
    golden.validate()?;
    let storage = textures.map_or(Precision::Single, |p| p.storage);
    storage.check(checkpoint)?;
    if let Some(precision) = &textures {
        precision.validate()?;
    }
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
    add(MODEL, &checkpoint.to_bytes()?)?;
    add(DECODER, &onnx::decoder_graph(checkpoint)?)?;
    add(MATERIAL, &onnx::material_graph_as(checkpoint, storage)?)?;
    let mut planes = Vec::new();
    for (texture, bytes) in texture_files(checkpoint)? {
        add(&texture.file, &bytes)?;
        planes.push(texture);
    }
    let json = |value: serde_json::Result<Vec<u8>>| value.map_err(|e| Error::config("bundle", e));
    add(GOLDEN, &json(serde_json::to_vec(golden))?)?;
    add(README, readme(checkpoint, textures.as_ref(), planes.len()).as_bytes())?;
    let sidecar = Sidecar::new(checkpoint, textures, planes, files.clone());
    let bytes = json(serde_json::to_vec_pretty(&sidecar))?;
    write_whole(&folder.path().join(SIDECAR), &bytes)?;
    files.push(BundleFile { name: SIDECAR.into(), bytes: bytes.len() as u64, sha256: digest(&bytes) });

    put_in_place(folder, out, replaces)?;
    Ok(files)
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
    let file = path.join(GOLDEN);
    let golden: Golden = serde_json::from_slice(&read_small(&file)?).map_err(|e| Error::file(&file, e))?;
    golden.validate().map_err(|e| Error::file(&file, e))?;
    Ok(Bundle { sidecar, checkpoint, golden })
}

/// True if `out` is a bundle to be replaced, false if nothing is there.
fn may_replace(out: &Path, force: bool) -> Result<bool> {
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

fn readme(checkpoint: &Checkpoint, rounded: Option<&TexturePrecision>, planes: usize) -> String {
    let architecture = &checkpoint.header.architecture;
    let [height, width] = architecture.resolution;
    let rounding = match rounded.filter(|p| p.storage == Precision::Half) {
        None => "The textures were rounded to half floats in the EXR files only.".to_string(),
        Some(TexturePrecision { largest_difference: largest, mean_difference: mean, .. }) => format!(
            "The textures were rounded to half floats in every file. That moved the golden answers by at most\n\
             {largest:.1e} (1 + |value|), {mean:.1e} (1 + |value|) in the mean."
        ),
    };
    let (extents, images) = match architecture.neighbourhood() {
        None => ("N", String::new()),
        Some(radius) => (
            "N, H, W",
            format!(
                "\n\
                 The decoder is a convolutional network: an answer depends on all queries within {radius} samples. The graphs\n\
                 take images of regular grids (one pair of directions and one whole level an image, samples at the centres of\n\
                 that level's texels) and take each as periodic: give a whole tile, or a part of it with {radius} samples more\n\
                 on each side, which are cut off the answer. golden.json has such images, one after another.\n"
            ),
        ),
    };
    format!(
        "{name}: a neural material ({height} x {width} texels, {levels} levels)\n\
         \n\
         {MATERIAL}       the whole material: u, wi, wo [{extents}, 2] and level [{extents}] in, rgb [{extents}, 3] out\n\
         {DECODER}        the network alone, for renderers that look the textures up themselves:\n\
         \x20                   features [{extents}, {channels}] first, then the same inputs\n\
         *.exr               {planes} files of neural textures: half floats, four channels, mip levels\n\
         {MODEL}   all weights and textures as 32-bit floats\n\
         {SIDECAR}       conventions, interfaces, costs, errors, checksums, how to evaluate step by step\n\
         {GOLDEN}         queries and answers: a reader is right if it reproduces rgb within `tolerance`,\n\
         \x20                   |difference| <= tolerance (1 + |rgb|)\n\
         \n\
         In short: wi points to the light and wo to the viewer, both away from the surface, as x and y of\n\
         unit vectors in the local frame (z along the normal). u is the position on the tile and repeats with\n\
         period 1. level is log2 of the footprint in texels. rgb is linear; {measure}.\n\
         {rounding}\n\
         {images}\
         \n\
         To check this bundle with Python (numpy and onnxruntime): python neumip_onnx.py FOLDER --check\n\
         The script is export/consumers/python/neumip_onnx.py in the neumip repository.\n",
        name = checkpoint.header.material,
        levels = architecture.levels(),
        channels = architecture.model.texture.channels,
        measure = match checkpoint.header.measure {
            crate::Measure::RadianceCosine => "the cosine of the light is in it",
            crate::Measure::Reflectance => "the cosine of the light is not in it",
        },
    )
}
