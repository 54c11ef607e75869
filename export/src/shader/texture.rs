//! Texture lookup: by texels, wrapped and mixed here in 32-bit floats, or by the hardware.

use super::writer::{Type, Type::Float, Type::Int, Type::Struct, Writer};
use super::{Language, Mode};
use crate::config::Architecture;

/// What is looked up.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Texture {
    Pyramid,
    Offset,
}

impl Texture {
    pub fn name(self) -> &'static str {
        match self {
            Self::Pyramid => "neumip_texture",
            Self::Offset => "neumip_offset",
        }
    }
}

/// The functions that lookups call.
pub fn functions(w: &mut Writer, architecture: &Architecture) {
    if w.mode == Mode::Fast {
        return;
    }
    let int = |name: &str| (Int(1), name.to_string());
    w.comment("The four texels around a position in [0, 1]: first and last column and row, and how far it is to the last ones.");
    w.structure("NeumipTaps", &[(Int(4), "texels".into()), (Float(2), "part".into())]);
    w.function(
        Struct("NeumipTaps"),
        "neumip_taps",
        &[(Float(2), "u".into()), (Float(2), "size".into())],
        |w| {
            w.declare(Float(2), "x", "u * size - 0.5");
            w.declare(Float(2), "corner", "floor(x)");
            let before = w.splat(Float(2), "-0.5");
            w.declare(Float(2), "low", &format!("corner + size * step(corner, {before})"));
            w.declare(Float(2), "high", "low + 1.0 - size * step(size, low + 1.0)");
            w.variable(Struct("NeumipTaps"), "taps");
            let four = w.make(Float(4), "low, high");
            w.line(format!("taps.texels = {};", w.make(Int(4), &four)));
            w.line("taps.part = x - corner;");
            w.line("return taps;");
        },
    );
    let textures: &[Texture] = match architecture.offset_channels() {
        Some(_) => &[Texture::Pyramid, Texture::Offset],
        None => &[Texture::Pyramid],
    };
    for texture in textures {
        let parameters = [(Struct("NeumipTaps"), "taps".into()), int("layer"), int("mip")];
        let name = format!("{}_texels", texture.name());
        w.function(Float(4), &name, &parameters, |w| {
            let mix = w.mix();
            let [a, b, c, d] = ["x y", "z y", "x w", "z w"].map(|texel| {
                let (column, row) = texel.split_once(' ').unwrap_or_default();
                fetch(w, *texture, &format!("taps.texels.{column}"), &format!("taps.texels.{row}"))
            });
            w.declare(Float(4), "top", &format!("{mix}({a}, {b}, taps.part.x)"));
            w.declare(Float(4), "bottom", &format!("{mix}({c}, {d}, taps.part.x)"));
            w.line(format!("return {mix}(top, bottom, taps.part.y);"));
        });
    }
}

/// Declares `prefix`0, `prefix`1, ...: four channels each of the texture at the position `at`; the names of the channels.
/// `level` counts from the finest stored one.
pub fn lookup(
    w: &mut Writer,
    architecture: &Architecture,
    texture: Texture,
    at: &str,
    level: &str,
    prefix: &str,
) -> Vec<String> {
    let [height, width] = architecture.finest_size();
    let (channels, levels) = match texture {
        Texture::Pyramid => (architecture.model.texture.channels, architecture.levels()),
        Texture::Offset => (architecture.offset_channels().unwrap_or(0), 1),
    };
    let layers = channels.div_ceil(4);
    let name = |suffix: &str| format!("{prefix}_{suffix}");
    if w.mode == Mode::Fast {
        for layer in 0..layers {
            let level = if levels == 1 { "0.0" } else { level };
            let value = sampled(w, texture, at, layer, level);
            w.declare(Float(4), &format!("{prefix}{layer}"), &value);
        }
    } else {
        w.declare(Float(2), &name("at"), &format!("{at} - floor({at})"));
        let taps = |w: &mut Writer, suffix: &str, mip: &str| {
            let (columns, rows) = match levels {
                1 => (format!("{width}"), format!("{height}")),
                _ => (w.halved(width, mip), w.halved(height, mip)),
            };
            let size = match levels {
                1 => w.make(Float(2), &format!("{columns}.0, {rows}.0")),
                _ => {
                    let integers = w.make(Int(2), &format!("{columns}, {rows}"));
                    w.make(Float(2), &integers)
                }
            };
            let of: Type = Struct("NeumipTaps");
            w.declare(of, &name(suffix), &format!("neumip_taps({}, {size})", name("at")));
        };
        let texels = format!("{}_texels", texture.name());
        if levels == 1 {
            taps(w, "taps", "0");
            for layer in 0..layers {
                w.declare(
                    Float(4),
                    &format!("{prefix}{layer}"),
                    &format!("{texels}({}, {layer}, 0)", name("taps")),
                );
            }
        } else {
            let (fine, coarse) = (name("fine"), name("coarse"));
            let integer = w.make(Int(1), &format!("floor({level})"));
            w.declare(Int(1), &fine, &integer);
            w.declare(Int(1), &coarse, &format!("min({fine} + 1, {})", levels - 1));
            let part = format!("{level} - {}", w.make(Float(1), &fine));
            w.declare(Float(1), &name("part"), &part);
            taps(w, "fine_taps", &fine);
            taps(w, "coarse_taps", &coarse);
            let mix = w.mix();
            for layer in 0..layers {
                let at_fine = format!("{texels}({}, {layer}, {fine})", name("fine_taps"));
                let at_coarse = format!("{texels}({}, {layer}, {coarse})", name("coarse_taps"));
                let value = format!("{mix}({at_fine}, {at_coarse}, {})", name("part"));
                w.declare(Float(4), &format!("{prefix}{layer}"), &value);
            }
        }
    }
    (0..channels).map(|c| format!("{prefix}{}.{}", c / 4, super::writer::letter(c))).collect()
}

fn fetch(w: &Writer, texture: Texture, column: &str, row: &str) -> String {
    let name = texture.name();
    match w.language {
        Language::GlslEs => format!("texelFetch({name}, ivec3({column}, {row}, layer), mip)"),
        Language::Glsl => {
            format!("texelFetch({}, ivec3({column}, {row}, layer), mip)", name.to_uppercase())
        }
        Language::Wgsl => format!("textureLoad({name}, vec2<i32>({column}, {row}), layer, mip)"),
        Language::Hlsl => format!("{name}.Load(int4({column}, {row}, layer, mip))"),
    }
}

fn sampled(w: &Writer, texture: Texture, at: &str, layer: usize, level: &str) -> String {
    let name = texture.name();
    match w.language {
        Language::GlslEs => format!("textureLod({name}, vec3({at}, {layer}.0), {level})"),
        Language::Glsl => format!("textureLod({}, vec3({at}, {layer}.0), {level})", name.to_uppercase()),
        Language::Wgsl => format!("textureSampleLevel({name}, neumip_sampler, {at}, {layer}, {level})"),
        Language::Hlsl => format!("{name}.SampleLevel(neumip_sampler, float3({at}, {layer}.0), {level})"),
    }
}
