//! What the program reads: two textures and the block of weights, under numbers that a user can change.

use super::texture::Texture;
use super::writer::{Type::Half, Writer};
use super::{Language, Material, Mode};
use crate::weights::Layout;

/// Largest block of constants that every WebGPU and Direct3D has, and all WebGL 2 that is in use (its promise is a quarter).
pub const MOST_CONSTANT_BYTES: usize = 1 << 16;
/// Vectors in a row of the texture of weights.
pub const WEIGHTS_WIDTH: usize = 1024;

/// Where the weights are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Storage {
    /// A uniform or constant buffer, which processors read fastest.
    Constants,
    /// A storage or structured buffer.
    Buffer,
    /// A texture: what GLSL ES 3.00 has beyond a uniform block.
    Texture,
    /// In the source, as numbers.
    Source,
}

impl Storage {
    /// Where a block of `values` goes.
    pub fn of(language: Language, mode: Mode, values: usize, written: bool) -> Self {
        match language {
            _ if written => Self::Source,
            // An array of 16-bit vectors may not be a uniform.
            Language::Wgsl if mode == Mode::Fast => Self::Buffer,
            _ if 4 * values <= MOST_CONSTANT_BYTES => Self::Constants,
            Language::GlslEs => Self::Texture,
            _ => Self::Buffer,
        }
    }
}

/// The declarations.
pub fn declare(w: &mut Writer, material: &Material, layout: &Layout) {
    let vectors = layout.values / 4;
    let textures: &[Texture] = match material.architecture.offset_channels() {
        Some(_) => &[Texture::Pyramid, Texture::Offset],
        None => &[Texture::Pyramid],
    };
    match w.language {
        Language::GlslEs => glsl_es(w, textures, vectors),
        Language::Glsl => glsl(w, textures, vectors),
        Language::Wgsl => wgsl(w, textures, vectors),
        Language::Hlsl => hlsl(w, textures, vectors),
    }
    w.line("");
}

fn glsl_es(w: &mut Writer, textures: &[Texture], vectors: usize) {
    for of in ["float", "int", "sampler2D", "sampler2DArray"] {
        w.line(format!("precision highp {of};"));
    }
    textures.iter().for_each(|t| w.line(format!("uniform sampler2DArray {};", t.name())));
    match w.storage {
        Storage::Texture => w.line("uniform sampler2D neumip_weights;"),
        Storage::Source => (),
        _ => w.line(format!(
            "layout(std140) uniform NeumipWeights {{ {} neumip_weights[{vectors}]; }};",
            w.name(Half(4))
        )),
    }
}

fn glsl(w: &mut Writer, textures: &[Texture], vectors: usize) {
    let names = ["TEXTURE", "OFFSET", "WEIGHTS", "SAMPLER"];
    w.line("#ifndef NEUMIP_TEXTURE_BINDING");
    for (number, name) in names.iter().enumerate() {
        w.line(format!("#define NEUMIP_{name}_BINDING {number}"));
    }
    w.line("#endif");
    if w.is_exact() {
        w.comment("Define it as nothing for a compiler that does not know the word.");
        w.line("#ifndef NEUMIP_PRECISE");
        w.line("#define NEUMIP_PRECISE precise");
        w.line("#endif");
    }
    w.comment("Define it where textures and samplers are bound apart.");
    w.line("#ifdef NEUMIP_SEPARATE_SAMPLER");
    w.line("layout(binding = NEUMIP_SAMPLER_BINDING) uniform sampler neumip_sampler;");
    let upper = |t: &Texture| t.name().to_uppercase();
    for t in textures {
        w.line(format!("layout(binding = {}_BINDING) uniform texture2DArray {};", upper(t), t.name()));
        w.line(format!("#define {} sampler2DArray({}, neumip_sampler)", upper(t), t.name()));
    }
    w.line("#else");
    for t in textures {
        w.line(format!("layout(binding = {}_BINDING) uniform sampler2DArray {};", upper(t), t.name()));
        w.line(format!("#define {} {}", upper(t), t.name()));
    }
    w.line("#endif");
    let block = match w.storage {
        Storage::Source => return,
        Storage::Buffer => "std430, binding = NEUMIP_WEIGHTS_BINDING) readonly buffer",
        _ => "std140, binding = NEUMIP_WEIGHTS_BINDING) uniform",
    };
    w.line(format!("layout({block} NeumipWeights {{ vec4 neumip_weights[{vectors}]; }};"));
}

fn wgsl(w: &mut Writer, textures: &[Texture], vectors: usize) {
    if !w.is_exact() {
        w.comment("For 16-bit arithmetic say f16 here, put `enable f16;` first in the module and bind weights-f16.bin.");
        w.line("alias NeumipHalf = f32;");
        for n in 2..=4 {
            w.line(format!("alias NeumipHalf{n} = vec{n}<NeumipHalf>;"));
        }
    }
    for t in textures {
        let binding = usize::from(*t == Texture::Offset);
        w.line(format!("@group(0) @binding({binding}) var {}: texture_2d_array<f32>;", t.name()));
    }
    let space = match w.storage {
        Storage::Source => None,
        Storage::Buffer => Some("storage, read"),
        _ => Some("uniform"),
    };
    if let Some(space) = space {
        let of = w.name(Half(4));
        w.line(format!("@group(0) @binding(2) var<{space}> neumip_weights: array<{of}, {vectors}>;"));
    }
    if !w.is_exact() {
        w.line("@group(0) @binding(3) var neumip_sampler: sampler;");
    }
}

fn hlsl(w: &mut Writer, textures: &[Texture], vectors: usize) {
    let constants = w.storage == Storage::Constants;
    w.line("#ifndef NEUMIP_TEXTURE_REGISTER");
    // No number twice: compilers for Vulkan make one row of all kinds.
    let weights = if constants { "b2" } else { "t2" };
    for (name, register) in [("TEXTURE", "t0"), ("OFFSET", "t1"), ("WEIGHTS", weights), ("SAMPLER", "s3")] {
        w.line(format!("#define NEUMIP_{name}_REGISTER {register}"));
    }
    w.line("#endif");
    if !w.is_exact() {
        w.comment("At least 16 bits, or exactly 16 where NEUMIP_HALF is defined (-enable-16bit-types) and in Slang.");
        w.line("#if defined(NEUMIP_HALF) || defined(__SLANG__)");
        for (otherwise, name) in [(false, "half"), (true, "min16float")] {
            if otherwise {
                w.line("#else");
            }
            for n in ["", "2", "3", "4"] {
                w.line(format!("#define NeumipHalf{n} {name}{n}"));
            }
        }
        w.line("#endif");
    }
    for t in textures {
        let register = t.name().to_uppercase();
        w.line(format!("Texture2DArray<float4> {} : register({register}_REGISTER);", t.name()));
    }
    if !w.is_exact() {
        w.line("SamplerState neumip_sampler : register(NEUMIP_SAMPLER_REGISTER);");
    }
    match w.storage {
        Storage::Source => (),
        Storage::Constants => w.line(format!(
            "cbuffer NeumipWeights : register(NEUMIP_WEIGHTS_REGISTER) {{ float4 neumip_weights[{vectors}]; }};"
        )),
        _ => w.line("StructuredBuffer<float4> neumip_weights : register(NEUMIP_WEIGHTS_REGISTER);"),
    }
}
