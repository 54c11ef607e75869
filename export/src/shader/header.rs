//! The comment at the head of a source: for the person who puts it into a renderer.

use super::bindings::{Storage, WEIGHTS_WIDTH};
use super::writer::Writer;
use super::{Language, Material, Mode, operations};
use crate::Measure;
use crate::weights::{Layout, SINGLE};

/// The tolerance of golden answers. Measured: 1e-6 at most.
const EXACT: f64 = 2e-5;
/// The hardware places a sample on 1/256 of a texel, and texels are half floats. Measured: 2e-4 at most on five materials.
const FAST: f64 = 1e-3;
/// As [`FAST`], with every number of the networks and every sum of theirs rounded to 11 bits. Emulated: 4e-3 at most.
const HALF: f64 = 1e-2;

/// The comment.
pub fn comment(w: &mut Writer, material: &Material, layout: &Layout) {
    let architecture = material.architecture;
    let [height, width] = architecture.finest_size();
    let levels = architecture.levels();
    let layers = architecture.model.texture.channels.div_ceil(4);
    // A name comes from a file: nothing of it may end the comment, in WGSL not even these two.
    let ends = |c: char| c.is_control() || ['\u{2028}', '\u{2029}'].contains(&c);
    let name = material.name.replace(ends, " ");
    let language = match w.language {
        Language::GlslEs => "GLSL ES 3.00",
        Language::Glsl => "GLSL 4.50",
        Language::Wgsl => "WGSL",
        Language::Hlsl => "HLSL (shader model 5 and later, Slang)",
    };
    let measure = match material.measure {
        Measure::RadianceCosine => {
            "RGB is linear and has the cosine of the light in it: do not multiply by it again."
        }
        Measure::Reflectance => "RGB is linear and does not have the cosine of the light in it.",
    };
    let fitted = match &architecture.domain {
        None => "",
        Some(_) => {
            "It was fitted for one scene; other levels are clamped and other places blurred: see README.txt.\n"
        }
    };
    let text = format!(
        "neumip: the neural material \"{name}\", {language}, {mode}.\n\
         Golden answers within {error}.\n\
         \n\
         NeumipPrepared q = neumip_prepare(u, level, wo);   once a point: all that does not depend on the light\n\
         vec3 rgb = neumip_evaluate(q, wi);                 once a light\n{sampler}\
         \n\
         Local frame: x along u, y along v, z along the normal. wi points to the light, wo to the viewer, both away from\n\
         the surface; x and y of unit vectors are given, so give them only where z > 0 (the answer is 0 elsewhere). u is\n\
         the position in tiles and repeats. level is log2 of the footprint's size in texels of the finest level ({finest}).\n\
         {measure}\n\
         {fitted}\
         \n\
         {bindings}\n\
         {operations} operations a query in the networks (neumip_prepare and neumip_evaluate; 2 a weight).",
        mode = match w.mode {
            Mode::Exact => "exact: 32-bit floats, own filtering and sines",
            Mode::Fast => "fast: hardware filtering and sines, networks in half precision where there is one",
        },
        error = match w.mode {
            Mode::Exact => format!("{EXACT:.0e} (1 + |value|)"),
            Mode::Fast => {
                format!("{FAST:.0e} (1 + |value|) in 32-bit arithmetic, {HALF:.0e} (1 + |value|) in 16-bit")
            }
        },
        sampler = match material.sampler {
            None => "",
            Some(_) =>
                "NeumipLobes lobes = neumip_lobes(q);               where directions are to be drawn\n\
                 vec4 drawn = neumip_sample(lobes, xi);             wi (x, y, z) and its density; xi: two uniform numbers\n\
                 float pdf = neumip_pdf(lobes, wi);                 of any unit vector wi (x, y, z)\n",
        },
        finest = format_args!("{} x {}", architecture.tile()[0], architecture.tile()[1]),
        bindings = bindings(w, material, layout, [height, width, levels, layers]),
        operations = operations(architecture),
    );
    w.comment(text);
    w.line("");
}

fn bindings(
    w: &Writer,
    material: &Material,
    layout: &Layout,
    [height, width, levels, layers]: [usize; 4],
) -> String {
    let filter = match (w.mode, w.language) {
        (Mode::Exact, Language::GlslEs | Language::Glsl) => "32-bit floats, nearest filtering",
        (Mode::Exact, _) => "32-bit floats",
        (Mode::Fast, _) => "half floats, repeating, linear within and between mip levels",
    };
    let mut text = format!(
        "neumip_texture: 2D array texture, {width} x {height}, {layers} layers of RGBA, {levels} mip levels ({filter}):\n\
         \x20   layer j of mip k holds the channels 4 j to 4 j + 3 of texture.levelk, 0 where there are no more.\n"
    );
    if let Some(channels) = material.architecture.offset_channels() {
        text += &format!(
            "neumip_offset: likewise of offset.texture, {} layers, 1 mip level.\n",
            channels.div_ceil(4)
        );
    }
    let (vectors, bytes) = (layout.values / 4, 4 * layout.values);
    let place = match w.storage {
        Storage::Constants => "uniform block",
        Storage::Buffer => "read-only buffer",
        Storage::Texture => "texture of 32-bit floats",
        Storage::Source => return text + "The weights are in the source.",
    };
    text += &format!("neumip_weights: {place}, the {bytes} bytes of {SINGLE} as {vectors} vectors");
    text += &match w.storage {
        Storage::Texture => format!(", {WEIGHTS_WIDTH} in a row: more than a uniform block holds."),
        _ => ".".into(),
    };
    text
}
