//! A bundle put to the test: its golden answers through every artefact that can be run here.

use crate::config::EngineKind;
use crate::engine::FusedMaterial;
use crate::error::{Error, Result};
use crate::inference::answerer;
use crate::onnx_material::{Feed, OnnxGraph, OnnxMaterial, feeds, largest_difference, with};
use crate::query::{QueryBuffer, Reflectance};
use candle_core::Device;
use exr::prelude::{AnyChannels, FlatSamples, Image, Layer, Levels, ReadChannels, ReadLayers, f16, read};
use neumip_export::bundle::{Bundle, DECODER, EVALUATE, MATERIAL, MODEL, PDF, PREPARE, SAMPLE};
use neumip_export::config::texture_name;
use neumip_export::onnx::LOBE_COLUMNS;
use neumip_export::textures::TextureFile;
use neumip_export::{Checkpoint, Golden, Precision, Sampler, SamplerGolden, weights};
use serde::Serialize;
use std::path::Path;

/// One artefact and how it answered.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Artefact {
    /// Its files.
    pub files: String,
    /// What ran or read them.
    pub by: String,
    /// Largest |difference| / (1 + |value|) from the golden answers, or of stored numbers from what they should be.
    pub difference: f64,
    /// The largest that is right.
    pub bound: f64,
}

impl Artefact {
    /// Whether it is right; a NaN is not.
    pub fn is_right(&self) -> bool {
        self.difference <= self.bound
    }
}

/// Runs everything of a bundle in a folder that can be run here.
///
/// # Errors
/// `File` or `Config`, naming what cannot be run at all.
pub fn check(folder: &Path, bundle: &Bundle) -> Result<Vec<Artefact>> {
    let Golden { tolerance, u, wi, wo, level, rgb, images } = bundle.golden.clone();
    let queries = QueryBuffer::new(1, rgb.len(), u, wi, wo, level)?;
    let mut artefacts = Vec::new();
    let mut answered = |files: &str, by: &str, answers: &[[f32; 3]]| {
        let difference = largest_difference(answers, &rgb);
        artefacts.push(Artefact { files: files.into(), by: by.into(), difference, bound: tolerance });
    };
    let checkpoint = &bundle.checkpoint;
    for engine in [EngineKind::Candle, EngineKind::Fused] {
        let answerer = answerer(checkpoint, Some(engine), Precision::Single, &Device::Cpu)?;
        let answers = match images {
            None => answerer.material.evaluate(&queries)?.pixels,
            Some(images) => by_images(&*answerer.material, &queries, images)?,
        };
        answered(MODEL, &answerer.engine, &answers);
    }
    let material = OnnxMaterial::open(&folder.join(MATERIAL))?;
    answered(MATERIAL, "rten", &material.answers(&queries, images)?);
    if images.is_none() {
        answered(DECODER, "rten, features of the fused engine", &by_decoder(folder, checkpoint, &queries)?);
        let prepare = OnnxGraph::open(&folder.join(PREPARE))?;
        let rgb = in_steps(folder, &prepare, &queries, checkpoint)?;
        answered(&format!("{PREPARE}, {EVALUATE}"), "rten", &rgb);
        if let Some((sampler, golden)) = &bundle.sampler {
            artefacts.extend(sampled(folder, &prepare, sampler, golden)?);
        }
    }
    for texture in &bundle.sidecar.textures {
        let difference = stored_texture(folder, texture, checkpoint)?;
        // The nearest half float of every value, exactly.
        artefacts.push(Artefact {
            files: texture.file.clone(),
            by: "read back".into(),
            difference,
            bound: 0.0,
        });
    }
    artefacts.extend(stored_weights(folder, bundle)?);
    Ok(artefacts)
}

/// Images of a grid, one at a time, from an answerer that takes only such.
fn by_images(
    material: &dyn Reflectance,
    queries: &QueryBuffer,
    [count, height, width]: [usize; 3],
) -> Result<Vec<[f32; 3]>> {
    let mut answers = Vec::with_capacity(queries.len());
    for image in 0..count {
        let part = queries.range(image * height * width, (image + 1) * height * width);
        let part = QueryBuffer::new(height, width, part.u, part.wi, part.wo, part.level)?;
        answers.extend(material.evaluate(&part)?.pixels);
    }
    Ok(answers)
}

/// The decoder alone: whoever looks its features up has led their positions and levels too.
fn by_decoder(folder: &Path, checkpoint: &Checkpoint, queries: &QueryBuffer) -> Result<Vec<[f32; 3]>> {
    let fused = FusedMaterial::from_checkpoint(checkpoint)?;
    let features = fused.features(&queries.u, &queries.level, &queries.wo)?;
    let channels = checkpoint.header.architecture.model.texture.channels;
    let mut inputs: Vec<Feed> = vec![("features", vec![queries.len(), channels], &features)];
    let mut led = queries.clone();
    for (u, level) in led.u.iter_mut().zip(&mut led.level) {
        (*u, *level) = checkpoint.header.architecture.fitted(*u, *level);
    }
    inputs.extend(feeds(&led, None));
    let graph = OnnxGraph::open(&folder.join(DECODER))?;
    let rgb = graph.run(&inputs, &[("rgb", with(queries, None, 3))])?;
    Ok(rgb.concat().as_chunks::<3>().0.to_vec())
}

fn in_steps(
    folder: &Path,
    prepare: &OnnxGraph,
    queries: &QueryBuffer,
    checkpoint: &Checkpoint,
) -> Result<Vec<[f32; 3]>> {
    let n = queries.len();
    let widths = checkpoint.header.architecture.decoder_widths().unwrap_or_default();
    let partial = vec![n, widths.get(1).copied().unwrap_or(0)];
    let inputs: Vec<Feed> = feeds(queries, None).into_iter().filter(|(name, ..)| *name != "wi").collect();
    let prepared = prepare.run(&inputs, &[("partial", partial.clone()), ("visible", vec![n])])?;
    let graph = OnnxGraph::open(&folder.join(EVALUATE))?;
    let inputs: [Feed; 3] = [
        ("partial", partial, &prepared[0]),
        ("visible", vec![n], &prepared[1]),
        ("wi", vec![n, 2], queries.wi.as_flattened()),
    ];
    let rgb = graph.run(&inputs, &[("rgb", vec![n, 3])])?;
    Ok(rgb.concat().as_chunks::<3>().0.to_vec())
}

/// Directions and densities of a sampler, as graphs give them.
fn sampled(
    folder: &Path,
    prepare: &OnnxGraph,
    sampler: &Sampler,
    golden: &SamplerGolden,
) -> Result<[Artefact; 2]> {
    let n = golden.u.len();
    let shape = vec![n, sampler.header.config.lobes.len() + 1, LOBE_COLUMNS];
    let inputs: [Feed; 3] = [
        ("u", vec![n, 2], golden.u.as_flattened()),
        ("wo", vec![n, 2], golden.wo.as_flattened()),
        ("level", vec![n], &golden.level),
    ];
    let lobes = prepare.run(&inputs, &[("lobes", shape.clone())])?.concat();
    let feed: Feed = ("lobes", shape, &lobes);
    let xi: Feed = ("xi", vec![n, 2], golden.xi.as_flattened());
    let outputs = [("wi", vec![n, 3]), ("pdf", vec![n])];
    let answers = OnnxGraph::open(&folder.join(SAMPLE))?.run(&[feed.clone(), xi], &outputs)?;
    let wi = answers[0].as_chunks::<3>().0;
    let apart = |(a, e): (&f32, &f32)| f64::from((a - e).abs());
    let pairs = wi.as_flattened().iter().zip(golden.wi.as_flattened());
    let direction = pairs.map(apart).max_by(f64::total_cmp).unwrap_or(0.0);
    let given: Feed = ("wi", vec![n, 3], golden.wi.as_flattened());
    let density = OnnxGraph::open(&folder.join(PDF))?.run(&[feed, given], &[("pdf", vec![n])])?.concat();
    let relative = |(a, e): (&f32, &f32)| f64::from((a - e).abs()) / f64::from(e.abs());
    let density = density.iter().zip(&golden.pdf).map(relative).max_by(f64::total_cmp).unwrap_or(0.0);
    let row = |file: &str, difference, bound| Artefact {
        files: format!("{PREPARE}, {file}"),
        by: "rten".into(),
        difference,
        bound,
    };
    Ok([row(SAMPLE, direction, golden.tolerance), row(PDF, density, golden.pdf_tolerance)])
}

/// Largest difference of an EXR file's levels from the nearest half floats of the model's.
fn stored_texture(folder: &Path, file: &TextureFile, checkpoint: &Checkpoint) -> Result<f64> {
    let path = folder.join(&file.file);
    let image: Image<Layer<AnyChannels<Levels<FlatSamples>>>> = read()
        .no_deep_data()
        .all_resolution_levels()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(&path)
        .map_err(|e| Error::file(&path, format!("cannot be read: {e}")))?;
    let mut largest = 0.0f64;
    for (lane, name) in ["R", "G", "B", "A"].iter().take(file.channels).enumerate() {
        let channel = image.layer_data.channel_data.list.iter().find(|c| c.name.eq(name));
        let Some(Levels::Mip { level_data, .. }) = channel.map(|c| &c.sample_data) else {
            return Err(Error::file(&path, format!("has no channel {name} with mip levels")));
        };
        for level in 0..file.levels {
            let name = if file.texture == "texture" { texture_name(level) } else { file.texture.clone() };
            let tensor = checkpoint.tensor(&name)?;
            let channels = tensor.shape.last().copied().unwrap_or(1);
            let values = tensor.data.iter().skip(file.first_channel + lane).step_by(channels);
            let stored = level_data.get(level).map(|data| data.values_as_f32().collect::<Vec<_>>());
            let stored = stored.filter(|stored| stored.len() * channels == tensor.data.len());
            let Some(stored) = stored else {
                return Err(Error::file(&path, format!("its mip level {level} is not as large as {name}")));
            };
            for (value, stored) in values.zip(stored) {
                let nearest = f16::from_f32(*value).to_f32();
                largest = largest.max(f64::from((nearest - stored).abs()));
            }
        }
    }
    Ok(largest)
}

/// Whether the blocks of weights are those of the model.
fn stored_weights(folder: &Path, bundle: &Bundle) -> Result<Vec<Artefact>> {
    let Some(files) = &bundle.sidecar.weights else { return Ok(Vec::new()) };
    let sampler = bundle.sampler.as_ref().map(|(sampler, _)| sampler);
    let block = files.layout.fill(&bundle.checkpoint, sampler)?;
    let both = [(&files.single, weights::single_bytes(&block)), (&files.half, weights::half_bytes(&block))];
    let mut artefacts = Vec::new();
    for (name, expected) in both {
        let path = folder.join(name);
        let bytes = std::fs::read(&path).map_err(|e| Error::file(&path, format!("cannot be read: {e}")))?;
        let wrong = bytes.iter().zip(&expected).filter(|(a, b)| a != b).count();
        let wrong = wrong + bytes.len().abs_diff(expected.len());
        let difference = wrong as f64;
        artefacts.push(Artefact { files: name.clone(), by: "read back".into(), difference, bound: 0.0 });
    }
    Ok(artefacts)
}
