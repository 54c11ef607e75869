//! The material in the steps of a renderer: `prepare.onnx` once a hit, `evaluate.onnx` once a light.

use super::builder::Builder;
use super::encoding::{self, Inputs};
use super::network::{self, decoder};
use super::query::{self, Direction};
use super::{Layout, Options, Port, check, features, finish, lobes, properties, with_features};
use crate::checkpoint::Checkpoint;
use crate::config::Architecture;
use crate::error::{Error, Result};
use crate::sampler::{Sampler, SamplerConfig};

/// Inputs and outputs of `prepare.onnx`; the last output is there where the material has a sampler.
///
/// # Errors
/// `Config`, for a decoder that reads neighbours.
pub fn prepare_ports(
    architecture: &Architecture,
    sampler: Option<&SamplerConfig>,
) -> Result<(Vec<Port>, Vec<Port>)> {
    let inputs = vec![
        port("u", &[2], "position in tiles, wrapped by the graph"),
        port("wo", &[2], "x and y of the unit vector to the viewer"),
        port("level", &[], "log2 of the footprint in texels of the finest level, clamped by the graph"),
    ];
    let mut outputs = vec![
        port(
            "partial",
            &[first_outputs(architecture)?],
            "sums of the decoder's first layer without the light",
        ),
        port("visible", &[], "1 where the viewer is above the horizon, else 0"),
    ];
    outputs.extend(sampler.map(lobes::lobes_port));
    Ok((inputs, outputs))
}

/// Inputs and the output of `evaluate.onnx`.
///
/// # Errors
/// `Config`, for a decoder that reads neighbours.
pub fn evaluate_ports(architecture: &Architecture) -> Result<(Vec<Port>, Vec<Port>)> {
    let inputs = vec![
        port("partial", &[first_outputs(architecture)?], "from prepare.onnx"),
        port("visible", &[], "from prepare.onnx"),
        port("wi", &[2], "x and y of the unit vector to the light"),
    ];
    Ok((inputs, vec![super::output(Layout::Queries)]))
}

/// `prepare.onnx`: u, wo, level -> partial, visible and, with a sampler, lobes.
///
/// # Errors
/// As [`super::material_graph`], and `Config` for a decoder that reads neighbours or a sampler of other features.
pub fn prepare_graph(
    checkpoint: &Checkpoint,
    sampler: Option<&Sampler>,
    options: Options,
) -> Result<Vec<u8>> {
    check(checkpoint, options)?;
    let architecture = &checkpoint.header.architecture;
    let (inputs, outputs) = prepare_ports(architecture, sampler.map(|s| &s.header.config))?;
    let mut b = Builder::new("prepare", "neural material: everything that does not depend on wi");
    let inputs: Vec<_> = inputs.iter().map(|port| b.input(port)).collect();
    let [u, wo, level] = inputs.as_slice() else { unreachable!("three ports are declared") };
    let wo = Direction::new(&mut b, "wo", wo.clone());
    let (u, level) = query::led(&mut b, architecture, u, level);
    let features = features(&mut b, checkpoint, options, &u, &wo, &level)?;

    let encoded =
        encoding::encode(&mut b, architecture, &Inputs { u: Some((&u, &level)), wi: None, wo: Some(&wo) });
    let columns = with_features(architecture, &encoded);
    b.scope("decoder");
    let parts: Vec<_> = std::iter::once(&features).chain(&encoded.parts).collect();
    let input = b.concat("input", &parts, 1);
    let mut partial =
        decoder(checkpoint, options.storage.weights).first(&mut b, &input, Some(&columns), None)?;
    if architecture.levels() == 1 && !encoded.uses_level {
        let nothing = query::nothing_of(&mut b, "level", &level);
        partial = b.add("level.read", &partial, &nothing);
    }
    b.output(&outputs[0], &partial);
    b.scope("visible");
    let above = wo.above(&mut b, "wo");
    let above = b.float_of("above", &above);
    let visible = b.squeeze("visible", &above, &[1]);
    b.output(&outputs[1], &visible);
    if let Some(sampler) = sampler {
        let lobes = lobes::lobes(&mut b, sampler, &features, &wo)?;
        b.output(&outputs[2], &lobes);
    }
    finish(b, &properties(&checkpoint.header)?, options.opset)
}

/// `evaluate.onnx`: partial, visible, wi -> rgb.
///
/// # Errors
/// As [`super::decoder_graph`], and `Config` for a decoder that reads neighbours.
pub fn evaluate_graph(checkpoint: &Checkpoint, options: Options) -> Result<Vec<u8>> {
    checkpoint.validate()?;
    options.storage.check(checkpoint)?;
    let architecture = &checkpoint.header.architecture;
    let (inputs, outputs) = evaluate_ports(architecture)?;
    let mut b = Builder::new("evaluate", "neural material: from what prepare gave and wi to rgb");
    let inputs: Vec<_> = inputs.iter().map(|port| b.input(port)).collect();
    let [partial, visible, wi] = inputs.as_slice() else { unreachable!("three ports are declared") };
    let wi = Direction::new(&mut b, "wi", wi.clone());
    let encoded = encoding::encode(&mut b, architecture, &Inputs { wi: Some(&wi), ..Inputs::default() });
    let channels = architecture.model.texture.channels;
    let columns: Vec<_> = encoded.columns.iter().map(|c| c.map(|(input, f)| (channels + input, f))).collect();
    b.scope("decoder");
    let input = b.concat("input", &encoded.parts.iter().collect::<Vec<_>>(), 1);
    let network = decoder(checkpoint, options.storage.weights);
    let sums = network.first(&mut b, &input, Some(&columns), Some(partial))?;
    let decoded = network.rest(&mut b, sums)?;
    b.scope("output");
    let lit = wi.above(&mut b, "wi");
    let visible = b.unsqueeze("visible.column", visible, &[1]);
    let half = b.scalar(0.5);
    let seen = b.node("Greater", "wo.above", &[&visible, &half], &[]);
    let rgb = network::rgb(&mut b, checkpoint, decoded, &lit, &seen);
    b.output(&outputs[0], &rgb);
    finish(b, &properties(&checkpoint.header)?, options.opset)
}

fn port(name: &'static str, columns: &[usize], meaning: &'static str) -> Port {
    Port { name, layout: Layout::Queries, columns: columns.into(), meaning }
}

fn first_outputs(architecture: &Architecture) -> Result<usize> {
    architecture.decoder_widths().map(|widths| widths[1]).ok_or_else(|| {
        let problem =
            "its answers depend on their neighbours: they cannot be split into prepare and evaluate";
        Error::config("decoder", problem)
    })
}
