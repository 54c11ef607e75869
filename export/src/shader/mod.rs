//! Shader source of a material: functions for a renderer's own shaders, generated for the material's exact shape.
//!
//! One generator makes all languages, so they cannot drift apart. Weights and textures are bound, not written into the
//! source: it changes with the architecture only, unless weights are
//! asked for.

mod bindings;
mod encoding;
mod header;
mod lobes;
mod material;
mod math;
mod network;
mod texture;
mod writer;

use crate::checkpoint::{Checkpoint, Measure};
use crate::config::{Architecture, OutputTransform};
use crate::error::{Error, Result};
use crate::sampler::{Sampler, SamplerConfig};
use crate::weights::Layout;
use serde::{Deserialize, Serialize};

/// Most weights that are written into a source: a megabyte of text.
pub const MOST_LITERALS: usize = 1 << 16;

/// The language of a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Language {
    /// GLSL ES 3.00, of WebGL 2.
    GlslEs,
    /// GLSL 4.50, of OpenGL and Vulkan.
    Glsl,
    /// WGSL, of WebGPU.
    Wgsl,
    /// HLSL, of Direct3D; Slang reads it too.
    Hlsl,
}

/// What a source is made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// Golden answers within their tolerance: 32-bit floats, texels mixed by the shader, sines of known error.
    Exact,
    /// Speed: hardware filtering, half floats, the processor's sines.
    Fast,
}

impl Language {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::GlslEs, Self::Glsl, Self::Wgsl, Self::Hlsl];
}

impl Mode {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Exact, Self::Fast];
}

/// What a source is generated from.
#[derive(Clone, Copy, Debug)]
pub struct Material<'a> {
    /// Its name, for the head of the source.
    pub name: &'a str,
    /// What its values are.
    pub measure: Measure,
    /// Its shape.
    pub architecture: &'a Architecture,
    /// The shape of its sampler; without one there are no functions that draw directions.
    pub sampler: Option<&'a SamplerConfig>,
    /// The block of weights ([`Layout::fill`]), to be written into the source as numbers; without it they are bound.
    pub weights: Option<&'a [f32]>,
}

impl<'a> Material<'a> {
    /// Of a checkpoint.
    pub fn new(checkpoint: &'a Checkpoint, sampler: Option<&'a SamplerConfig>) -> Self {
        let header = &checkpoint.header;
        Self {
            name: &header.material,
            measure: header.measure,
            architecture: &header.architecture,
            sampler,
            weights: None,
        }
    }
}

/// The file of a source in a bundle.
pub fn file_name(language: Language, mode: Mode) -> &'static str {
    match (mode, language) {
        (Mode::Exact, Language::GlslEs) => "exact.es.glsl",
        (Mode::Exact, Language::Glsl) => "exact.glsl",
        (Mode::Exact, Language::Wgsl) => "exact.wgsl",
        (Mode::Exact, Language::Hlsl) => "exact.hlsl",
        (Mode::Fast, Language::GlslEs) => "fast.es.glsl",
        (Mode::Fast, Language::Glsl) => "fast.glsl",
        (Mode::Fast, Language::Wgsl) => "fast.wgsl",
        (Mode::Fast, Language::Hlsl) => "fast.hlsl",
    }
}

/// The sources of a bundle: all languages in both modes, by file name. Those for WebGL have the weights in them: on a software
/// rasteriser that is five times as fast as a uniform block, whose reads are checked one by one, and nothing bounds the size of
/// the networks. The others read the block of weights.
///
/// # Errors
/// As [`source`], and `Config`, naming a tensor that is missing.
pub fn files(checkpoint: &Checkpoint, sampler: Option<&Sampler>) -> Result<Vec<(&'static str, String)>> {
    let config = sampler.map(|sampler| &sampler.header.config);
    let material = Material::new(checkpoint, config);
    check(&material)?;
    let block = Layout::new(material.architecture, config).fill(checkpoint, sampler)?;
    let mut files = Vec::new();
    for language in Language::ALL {
        let written = language == Language::GlslEs && block.len() <= MOST_LITERALS;
        let material = Material { weights: written.then_some(&block), ..material };
        for mode in Mode::ALL {
            files.push((file_name(language, mode), source(&material, language, mode)?));
        }
    }
    Ok(files)
}

/// Operations of the networks in neumip_prepare and neumip_evaluate together.
pub fn operations(architecture: &Architecture) -> usize {
    architecture.flops_per_query()
}

/// The functions neumip_prepare and neumip_evaluate, and neumip_lobes, neumip_sample and neumip_pdf where there is a sampler;
/// the head of the text says how to call them and what to bind.
///
/// # Errors
/// `Config`, naming the field: of an invalid architecture or sampler, of a sampler that reads more channels than there are,
/// and of a decoder that reads neighbours, which no function of one query can answer.
pub fn source(material: &Material, language: Language, mode: Mode) -> Result<String> {
    check(material)?;
    let architecture = material.architecture;
    let layout = Layout::new(architecture, material.sampler);
    let storage = bindings::Storage::of(language, mode, layout.values, material.weights.is_some());
    let mut w = writer::Writer::new(language, mode, storage, material.weights);
    header::comment(&mut w, material, &layout);
    bindings::declare(&mut w, material, &layout);
    let mut widths = encoding::sine_widths(architecture);
    if !architecture.model.encoding.pi {
        widths.iter().for_each(|width| math::half_turns(&mut w, *width));
    }
    widths.extend(material.sampler.map(|_| 1));
    widths.iter().for_each(|width| math::sines(&mut w, *width));
    if architecture.model.output.transform == OutputTransform::ExpMinusOne {
        math::exp_minus_one(&mut w);
    }
    texture::functions(&mut w, architecture);
    material::functions(&mut w, material, &layout);
    if let Some(sampler) = material.sampler {
        lobes::functions(&mut w, sampler, &layout);
    }
    Ok(w.finish())
}

/// Whether there is a source of this shape.
fn check(material: &Material) -> Result<()> {
    let architecture = material.architecture;
    architecture.validate()?;
    if architecture.neighbourhood().is_some() {
        let problem =
            "an inception decoder reads neighbours, which a shader of one query cannot; use the ONNX graphs";
        return Err(Error::config("decoder.kind", problem));
    }
    if let Some(sampler) = material.sampler {
        sampler.validate()?;
        let channels = architecture.model.texture.channels;
        if sampler.features > channels {
            let problem = format!("{} of a texture with {channels} channels", sampler.features);
            return Err(Error::config("sampler.features", problem));
        }
    }
    let values = Layout::new(architecture, material.sampler).values;
    match material.weights {
        Some(block) if block.len() != values => {
            Err(Error::config("weights", format!("{} values where the layout has {values}", block.len())))
        }
        Some(block) if block.iter().any(|v| !v.is_finite()) => {
            Err(Error::config("weights", "have a value that is not a number"))
        }
        _ => Ok(()),
    }
}
