//! ONNX graphs of a checkpoint: `decoder.onnx` (the caller looks the textures up) and `material.onnx`
//! (everything).
//!
//! Opset 17 and IR version 8: the widest target, and the same nodes are valid from opset 13 on. The batch N
//! is dynamic; a decoder that reads neighbours takes N images of H x W queries, all three dynamic. Every input is read even where the answer does not depend on it, so that callers can always
//! feed all of them.

mod builder;
mod encoding;
mod inception;
mod network;
#[allow(missing_docs)] // The fields are those of onnx.proto.
mod proto;
mod query;
mod texture;

use crate::checkpoint::Checkpoint;
use crate::config::{Architecture, ParallaxConfig, texture_name};
use crate::error::{Error, Result};
use crate::precision::Precision;
use builder::{Builder, Value};
use prost::Message;
use query::Direction;

/// Operator set of the graphs.
pub const OPSET: i64 = 17;
/// Version of the ONNX file format.
pub const IR_VERSION: i64 = 8;
/// Largest message that protobuf readers accept.
const MAX_BYTES: usize = i32::MAX as usize;

/// How queries are laid out in the inputs of a graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// N queries, each on its own.
    Queries,
    /// N periodic images of H x W queries.
    Images,
}

impl Layout {
    /// The layout of a model.
    pub fn of(architecture: &Architecture) -> Self {
        if architecture.neighbourhood().is_some() { Self::Images } else { Self::Queries }
    }

    /// Names of the first extents.
    pub fn extents(self) -> &'static [&'static str] {
        match self {
            Self::Queries => &["N"],
            Self::Images => &["N", "H", "W"],
        }
    }
}

/// An input or output \[N, columns...\] or \[N, H, W, columns...\] of 32-bit floats.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// Name.
    pub name: &'static str,
    /// Its first extents.
    pub layout: Layout,
    /// Extents after those.
    pub columns: Vec<usize>,
    /// What it is.
    pub meaning: &'static str,
}

/// Inputs of `material.onnx`, in order.
pub fn material_inputs(layout: Layout) -> Vec<Port> {
    let port = |name, columns: &[usize], meaning| Port { name, layout, columns: columns.into(), meaning };
    vec![
        port("u", &[2], "position in tiles, wrapped by the graph"),
        port("wi", &[2], "x and y of the unit vector to the light"),
        port("wo", &[2], "x and y of the unit vector to the viewer"),
        port("level", &[], "log2 of the footprint in texels of the finest level, clamped by the graph"),
    ]
}

/// Inputs of `decoder.onnx`, in order: features with `channels` columns, then those of `material.onnx`.
pub fn decoder_inputs(layout: Layout, channels: usize) -> Vec<Port> {
    let meaning = "texture pyramid at the position after parallax, trilinear";
    let mut inputs = vec![Port { name: "features", layout, columns: vec![channels], meaning }];
    inputs.extend(material_inputs(layout));
    inputs
}

/// The output of both graphs.
pub fn output(layout: Layout) -> Port {
    Port { name: "rgb", layout, columns: vec![3], meaning: "linear RGB, 0 on and below the horizon" }
}

/// `decoder.onnx`: features, u, wi, wo, level -> rgb.
///
/// # Errors
/// `Config`, naming the tensor or field of an invalid checkpoint.
pub fn decoder_graph(checkpoint: &Checkpoint) -> Result<Vec<u8>> {
    checkpoint.validate()?;
    let mut b = Builder::new("decoder", "neural material: decoder and its input encoding");
    let architecture = &checkpoint.header.architecture;
    let ports = decoder_inputs(Layout::of(architecture), architecture.model.texture.channels);
    let (inputs, shape) = declare(&mut b, &ports);
    let [features, u, wi, wo, level] = inputs.as_slice() else { unreachable!("five ports are declared") };
    let wi = Direction::new(&mut b, "wi", wi.clone());
    let wo = Direction::new(&mut b, "wo", wo.clone());
    let (u, level) = (query::wrapped(&mut b, u), column(&mut b, checkpoint, level));
    let query = Query { u, level, wi, wo, shape };
    let u_is_read = checkpoint.header.architecture.u_inputs() > 0;
    answer(b, checkpoint, &query, features, (u_is_read, false))
}

/// `material.onnx`: u, wi, wo, level -> rgb, textures as 32-bit floats.
///
/// # Errors
/// `Config`, naming the tensor or field of an invalid checkpoint, or saying that the textures exceed the
/// 2 GiB that an ONNX file can hold.
pub fn material_graph(checkpoint: &Checkpoint) -> Result<Vec<u8>> {
    material_graph_as(checkpoint, Precision::Single)
}

/// As [`material_graph`], with textures of a precision that holds every value of them ([`Precision::round`]).
///
/// # Errors
/// As [`material_graph`], and `Config`, naming the texture that is not rounded.
pub fn material_graph_as(checkpoint: &Checkpoint, textures: Precision) -> Result<Vec<u8>> {
    checkpoint.validate()?;
    textures.check(checkpoint)?;
    let architecture = &checkpoint.header.architecture;
    let bytes = architecture.bytes_as(textures);
    if bytes > MAX_BYTES {
        return Err(too_large(bytes));
    }
    let mut b = Builder::new("material", "neural material: parallax, texture pyramid and decoder");
    let (inputs, shape) = declare(&mut b, &material_inputs(Layout::of(architecture)));
    let [u, wi, wo, level] = inputs.as_slice() else { unreachable!("four ports are declared") };
    let wi = Direction::new(&mut b, "wi", wi.clone());
    let wo = Direction::new(&mut b, "wo", wo.clone());
    let (u, level) = (query::wrapped(&mut b, u), column(&mut b, checkpoint, level));
    let query = Query { u, level, wi, wo, shape };
    let shifted = match &architecture.model.parallax {
        ParallaxConfig::None {} => query.u.clone(),
        ParallaxConfig::Offset(offset) => {
            network::parallax(&mut b, checkpoint, textures, offset, &query.u, &query.wo)?
        }
    };
    b.scope("texture");
    let sizes = architecture.level_sizes();
    let mut texels = Vec::with_capacity(architecture.pyramid_texels() * architecture.model.texture.channels);
    for level in 0..sizes.len() {
        texels.extend_from_slice(&checkpoint.tensor(&texture_name(level))?.data);
    }
    let shape = [architecture.pyramid_texels(), architecture.model.texture.channels];
    let table = texture::Table::new(&mut b, "texture.pyramid", shape, &texels, textures);
    drop(texels);
    let level = query::stored(&mut b, &query.level, architecture.model.texture.finest);
    let features = texture::lookup(&mut b, &shifted, &level, &table, &sizes);
    answer(b, checkpoint, &query, &features, (true, sizes.len() > 1))
}

/// The inputs that both graphs share, ready for use.
struct Query {
    u: Value,
    level: Value,
    wi: Direction,
    wo: Direction,
    /// \[N, H, W\], where the queries are images.
    shape: Option<Value>,
}

/// Declares inputs and gives them with one row a query, and the shape that they had before where they were images.
fn declare(b: &mut Builder, ports: &[Port]) -> (Vec<Value>, Option<Value>) {
    let inputs: Vec<Value> = ports.iter().map(|port| b.input(port)).collect();
    let mut shape = None;
    b.scope("images");
    let rows = ports.iter().zip(inputs).map(|(port, input)| {
        if port.layout == Layout::Queries {
            return input;
        }
        if port.columns.is_empty() {
            shape = Some(b.node("Shape", "shape", &[&input], &[]));
        }
        let rows: Vec<i64> = [-1].into_iter().chain(port.columns.iter().map(|c| *c as i64)).collect();
        let rows = b.axes(&rows);
        b.node("Reshape", &format!("{}.rows", port.name), &[&input, &rows], &[])
    });
    (rows.collect(), shape)
}

fn column(b: &mut Builder, checkpoint: &Checkpoint, level: &Value) -> Value {
    query::clamped(b, level, checkpoint.header.architecture.coarsest())
}

/// From features to the model's bytes; `read` says whether u and the level were read on the way to here.
fn answer(
    mut b: Builder,
    checkpoint: &Checkpoint,
    query: &Query,
    features: &Value,
    read: (bool, bool),
) -> Result<Vec<u8>> {
    let architecture = &checkpoint.header.architecture;
    let channels = architecture.model.texture.channels;
    let encoded = encoding::encode(&mut b, architecture, &query.u, &query.wi, &query.wo, &query.level);
    let mut columns: Vec<encoding::Column> = (0..channels).map(|c| Some((c, 1.0))).collect();
    columns.extend(encoded.columns.iter().map(|c| c.map(|(input, f)| (channels + input, f))));
    let parts: Vec<&Value> = std::iter::once(features).chain(&encoded.parts).collect();
    let mut outputs = network::decode(&mut b, checkpoint, &parts, &columns, query.shape.as_ref())?;
    for (name, value, is_read) in
        [("u", &query.u, read.0), ("level", &query.level, read.1 || encoded.uses_level)]
    {
        if !is_read {
            let nothing = query::nothing_of(&mut b, name, value);
            outputs = b.add(&format!("{name}.read"), &outputs, &nothing);
        }
    }
    let mut shown = network::rgb(&mut b, checkpoint, outputs, &query.wi, &query.wo);
    if let Some(shape) = &query.shape {
        let channels = b.axes(&[3]);
        let images = b.node("Concat", "images.shape", &[shape, &channels], &[("axis", 0)]);
        shown = b.node("Reshape", "images", &[&shown, &images], &[]);
    }
    b.output(&output(Layout::of(architecture)), &shown);
    finish(b, checkpoint)
}

fn finish(b: Builder, checkpoint: &Checkpoint) -> Result<Vec<u8>> {
    let header = &checkpoint.header;
    let json = |value: serde_json::Result<String>| value.map_err(|e| Error::config("header", e));
    let radius = header.architecture.neighbourhood();
    let properties = [
        ("neumip.format", header.format.to_string()),
        ("neumip.material", header.material.clone()),
        ("neumip.measure", json(serde_json::to_string(&header.measure))?),
        ("neumip.height_range", json(serde_json::to_string(&header.height_range))?),
        ("neumip.architecture", json(serde_json::to_string(&header.architecture))?),
    ];
    let radius = radius.map(|radius| ("neumip.neighbourhood", radius.to_string()));
    let model = proto::Model {
        ir_version: IR_VERSION,
        producer_name: "neumip".into(),
        producer_version: env!("CARGO_PKG_VERSION").into(),
        graph: Some(b.finish()),
        opset_import: vec![proto::OperatorSet { domain: String::new(), version: OPSET }],
        metadata_props: properties
            .into_iter()
            .chain(radius)
            .map(|(key, value)| proto::Property { key: key.into(), value })
            .collect(),
    };
    match model.encoded_len() {
        bytes if bytes > MAX_BYTES => Err(too_large(bytes)),
        _ => Ok(model.encode_to_vec()),
    }
}

fn too_large(bytes: usize) -> Error {
    Error::config("resolution", format!("a graph of {bytes} bytes; an ONNX file holds {MAX_BYTES}"))
}
