//! neumip_prepare and neumip_evaluate: a query in two halves, divided by what depends on wi.

use super::network::{Part, joined, output_widths, rest};
use super::texture::{self, Texture};
use super::writer::{Type, Type::Float, Type::Half, Type::Struct, Writer, number};
use super::{Material, encoding};
use crate::config::{
    Architecture, DECODER_MLP, OFFSET_MLP, OutputSpace, OutputTransform, ParallaxConfig, YUV_TO_RGB,
};
use crate::weights::{Layer, Layout};

/// Everything but the sampler.
pub fn functions(w: &mut Writer, material: &Material, layout: &Layout) {
    let offset: Vec<&Layer> = layout.network(OFFSET_MLP).collect();
    let decoder: Vec<&Layer> = layout.network(DECODER_MLP).collect();
    let [before, after] = halves(material, decoder[0]);
    offset.iter().for_each(|layer| Part::whole(layer).functions(w));
    before.functions(w);
    after.functions(w);
    decoder[1..].iter().for_each(|layer| Part::whole(layer).functions(w));
    prepared(w, material, decoder[0]);
    prepare(w, material, &offset, &before);
    evaluate(w, material, &decoder, &after);
}

/// The first layer of the decoder on what does not depend on wi, and on what does.
fn halves<'a>(material: &Material, first: &'a Layer) -> [Part<'a>; 2] {
    let architecture = material.architecture;
    let start = architecture.model.texture.channels + architecture.u_inputs();
    let end = start + architecture.direction_inputs(&architecture.model.encoding.wi);
    [
        Part::of(first, "", (0..start).chain(end..first.inputs), true),
        Part::of(first, "_wi", start..end, false),
    ]
}

fn prepared(w: &mut Writer, material: &Material, first: &Layer) {
    let mut fields: Vec<(Type, String)> = Vec::new();
    let widths = output_widths(first);
    fields.extend(widths.iter().enumerate().map(|(k, width)| (Half(*width), format!("sum{k}"))));
    fields.push((Float(1), "above".into()));
    if let Some(sampler) = material.sampler {
        fields.push((Float(2), "wo".into()));
        fields.extend((0..sampler.features.div_ceil(4)).map(|k| (Float(4), format!("features{k}"))));
    }
    w.comment("What of a query does not depend on wi: the sums of the decoder's first layer, and 1 where wo is above the horizon.");
    w.structure("NeumipPrepared", &fields);
}

fn prepare(w: &mut Writer, material: &Material, offset: &[&Layer], before: &Part) {
    let architecture = material.architecture;
    let model = &architecture.model;
    w.comment("u: position in tiles. level: log2 of the footprint in texels of the finest level. wo: x and y of the unit vector to the viewer.");
    let parameters = [(Float(2), "u".into()), (Float(1), "level".into()), (Float(2), "wo".into())];
    w.function(Struct("NeumipPrepared"), "neumip_prepare", &parameters, |w| {
        place(w, architecture);
        square(w, "wo");
        root(w, "wo");
        let at = match &model.parallax {
            ParallaxConfig::None {} => "tile",
            ParallaxConfig::Offset(config) => {
                let mut inputs = texture::lookup(w, architecture, Texture::Offset, "tile", "0.0", "o");
                inputs.extend(["wo.x".into(), "wo.y".into()]);
                let first = Part::whole(offset[0]);
                let inputs = first.gather(w, "q", &inputs);
                let hidden = first.call(w, "r0_", &inputs, None, true);
                let depth = rest(w, &offset[1..], hidden, ['r', 'd']);
                let depth = w.float(1, &depth[0]);
                let shift = format!(
                    "tile + {} * {depth} / max(wo_z, {}) * wo",
                    number(0.5 * config.scale),
                    number(config.min_z)
                );
                w.declare(Float(2), "shifted", &shift);
                "shifted"
            }
        };
        let stored = match model.texture.finest {
            0 => "level_".to_string(),
            finest => {
                w.declare(Float(1), "stored", &format!("max(level_ - {}, 0.0)", number(finest as f32)));
                "stored".into()
            }
        };
        let mut inputs = texture::lookup(w, architecture, Texture::Pyramid, at, &stored, "t");
        if architecture.u_inputs() > 0 {
            w.declare_precise(Float(2), "p", "2.0 * tile - 1.0");
            inputs.extend(encoding::position(w, architecture));
        }
        inputs.extend(encoding::direction(w, architecture, "wo", &model.encoding.wo));
        let inputs = before.gather(w, "x", &inputs);
        let sums = before.call(w, "s", &inputs, None, false);
        w.variable(Struct("NeumipPrepared"), "prepared");
        sums.iter().enumerate().for_each(|(k, sum)| w.line(format!("prepared.sum{k} = {sum};")));
        let above = w.choose("wo_square < 1.0", "1.0", "0.0");
        w.line(format!("prepared.above = {above};"));
        if let Some(sampler) = material.sampler {
            w.line("prepared.wo = wo;");
            for k in 0..sampler.features.div_ceil(4) {
                w.line(format!("prepared.features{k} = t{k};"));
            }
        }
        w.line("return prepared;");
    });
}

/// The position and the level that answer: `tile` and `level_`.
fn place(w: &mut Writer, architecture: &Architecture) {
    let Some(guide) = architecture.guide() else {
        w.declare_precise(Float(2), "tile", "u - floor(u)");
        let coarsest = number(architecture.coarsest() as f32);
        return w.declare(Float(1), "level_", &format!("clamp(level, 0.0, {coarsest})"));
    };
    let clamped = format!("clamp(level, {}, {})", number(guide.levels[0]), number(guide.levels[1]));
    if !guide.is_window() {
        w.declare_precise(Float(2), "tile", "u - floor(u)");
        return w.declare(Float(1), "level_", &clamped);
    }
    w.comment("In windows from the window's corner. Outside, the coarsest level answers.");
    let [corner, scale] =
        [guide.corner, guide.scale].map(|pair| w.make(Float(2), &pair.map(number).join(", ")));
    w.declare_precise(Float(2), "from_corner", &format!("u - {corner}"));
    w.declare_precise(Float(2), "windows", &format!("(from_corner - floor(from_corner)) * {scale}"));
    w.declare_precise(Float(2), "tile", "windows - floor(windows)");
    let inside = [("windows.x", guide.part[0]), ("windows.y", guide.part[1])];
    let inside = inside.iter().filter(|(_, part)| *part).map(|(axis, _)| format!("{axis} < 1.0"));
    let level = w.choose(&inside.collect::<Vec<_>>().join(" && "), &clamped, &number(guide.outside));
    w.declare(Float(1), "level_", &level);
}

fn evaluate(w: &mut Writer, material: &Material, decoder: &[&Layer], after: &Part) {
    let architecture = material.architecture;
    let model = &architecture.model;
    w.comment("wi: x and y of the unit vector to the light. Linear RGB; 0 where wi or wo is on or below the horizon.");
    let parameters = [(Struct("NeumipPrepared"), "prepared".into()), (Float(2), "wi".into())];
    w.function(Float(3), "neumip_evaluate", &parameters, |w| {
        square(w, "wi");
        if model.encoding.components == 3 {
            root(w, "wi");
        }
        let inputs = encoding::direction(w, architecture, "wi", &model.encoding.wi);
        let inputs = after.gather(w, "x", &inputs);
        let hidden = after.call(w, "h0_", &inputs, Some("prepared.sum"), true);
        let outputs = rest(w, &decoder[1..], hidden, ['h', 'y']);
        let three = |w: &mut Writer, values: &[String]| {
            let parts = joined(values);
            match parts.as_slice() {
                [one] => w.float(3, one),
                parts => {
                    let parts: Vec<String> = parts
                        .iter()
                        .map(|part| w.float(part.rsplit_once('.').map_or(1, |p| p.1.len()), part))
                        .collect();
                    w.make(Float(3), &parts.join(", "))
                }
            }
        };
        let colour = three(w, &outputs[..3]);
        w.declare(Float(3), "colour", &colour);
        let mut rgb = "colour".to_string();
        if model.output.space == OutputSpace::Yuv {
            let rows = YUV_TO_RGB.map(|row| {
                let row = w.make(Float(3), &row.map(number).join(", "));
                format!("dot({row}, colour)")
            });
            let value = w.make(Float(3), &rows.join(", "));
            w.declare(Float(3), "rgb", &value);
            rgb = "rgb".into();
        }
        if model.output.transform == OutputTransform::ExpMinusOne {
            w.declare(Float(3), "bright", &format!("neumip_exp_minus_one({rgb})"));
            rgb = "bright".into();
        }
        if model.output.mask {
            let mask = three(w, &outputs[3..6]);
            w.declare(Float(3), "mask", &mask);
            w.declare(Float(3), "masked", &format!("{rgb} * (0.1 + 1.0 / (1.0 + exp(-mask)))"));
            rgb = "masked".into();
        }
        let zero = w.splat(Float(3), "0.0");
        let answer =
            w.choose("wi_square < 1.0 && prepared.above > 0.5", &format!("max({rgb}, {zero})"), &zero);
        w.line(format!("return {answer};"));
    });
}

/// x^2 + y^2 of a direction.
fn square(w: &mut Writer, name: &str) {
    w.declare_precise(
        Float(1),
        &format!("{name}_square"),
        &format!("{name}.x * {name}.x + {name}.y * {name}.y"),
    );
}

/// z of a direction.
fn root(w: &mut Writer, name: &str) {
    w.declare(Float(1), &format!("{name}_z"), &format!("sqrt(max(0.0, 1.0 - {name}_square))"));
}
