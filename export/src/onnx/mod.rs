//! ONNX graphs of a checkpoint: `decoder.onnx` (the caller looks the textures up), `material.onnx` (everything), and the
//! same in the steps of a renderer: `prepare.onnx` (what does not depend on wi), `evaluate.onnx` (the rest), `sample.onnx`
//! and `pdf.onnx` (importance sampling of wi).
//!
//! Opset 17 and IR version 8 by default: the widest target; the same nodes are valid from opset 13 to 21. The batch N
//! is dynamic; a decoder that reads neighbours takes N images of H x W queries, all three dynamic. Every input is read even
//! where the answer does not depend on it, so that callers can always feed all of them.

mod builder;
mod encoding;
mod inception;
mod lobes;
mod network;
#[allow(missing_docs)] // The fields are those of onnx.proto.
mod proto;
mod query;
mod split;
mod texture;

pub use lobes::{LOBE_COLUMNS, pdf_graph, pdf_ports, sample_graph, sample_ports};
pub use split::{evaluate_graph, evaluate_ports, prepare_graph, prepare_ports};

use crate::checkpoint::{Checkpoint, Header};
use crate::config::{Architecture, ParallaxConfig, texture_name};
use crate::error::{Error, Result};
use crate::precision::Storage;
use builder::{Builder, Value};
use prost::Message;
use query::Direction;
use serde::{Deserialize, Serialize};

/// Operator set of a graph, with the version of the file format that came with it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "i64", into = "i64")]
pub enum Opset {
    /// 13, IR version 7.
    V13,
    /// 17, IR version 8.
    #[default]
    V17,
    /// 21, IR version 10.
    V21,
}

impl Opset {
    /// The version of the ONNX file format.
    pub fn ir_version(self) -> i64 {
        match self {
            Self::V13 => 7,
            Self::V17 => 8,
            Self::V21 => 10,
        }
    }
}

impl From<Opset> for i64 {
    fn from(opset: Opset) -> Self {
        match opset {
            Opset::V13 => 13,
            Opset::V17 => 17,
            Opset::V21 => 21,
        }
    }
}

impl TryFrom<i64> for Opset {
    type Error = String;

    fn try_from(version: i64) -> std::result::Result<Self, String> {
        match version {
            13 => Ok(Self::V13),
            17 => Ok(Self::V17),
            21 => Ok(Self::V21),
            _ => Err(format!("opset {version}: 13, 17 and 21 are written")),
        }
    }
}

/// How graphs are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// How numbers are stored; the checkpoint is rounded to it.
    pub storage: Storage,
    /// The operator set.
    pub opset: Opset,
}

impl Default for Options {
    fn default() -> Self {
        Self { storage: Storage::SINGLE, opset: Opset::default() }
    }
}

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

/// Inputs of `decoder.onnx`, in order: features, then those of `material.onnx`. The caller looks features up, so it has led
/// the position and level of a fitted material before.
pub fn decoder_inputs(architecture: &Architecture) -> Vec<Port> {
    let layout = Layout::of(architecture);
    let meaning = "texture pyramid at the position after parallax, trilinear";
    let columns = vec![architecture.model.texture.channels];
    let mut inputs = vec![Port { name: "features", layout, columns, meaning }];
    inputs.extend(material_inputs(layout));
    if architecture.domain.is_some() {
        for port in &mut inputs {
            port.meaning = match port.name {
                "u" => "position that the first step of material.json gives, in windows",
                "level" => "level that the first step of material.json gives",
                _ => port.meaning,
            };
        }
    }
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
pub fn decoder_graph(checkpoint: &Checkpoint, options: Options) -> Result<Vec<u8>> {
    checkpoint.validate()?;
    options.storage.check(checkpoint)?;
    let mut b = Builder::new("decoder", "neural material: decoder and its input encoding");
    let architecture = &checkpoint.header.architecture;
    let ports = decoder_inputs(architecture);
    let (inputs, shape) = declare(&mut b, &ports);
    let [features, u, wi, wo, level] = inputs.as_slice() else { unreachable!("five ports are declared") };
    let wi = Direction::new(&mut b, "wi", wi.clone());
    let wo = Direction::new(&mut b, "wo", wo.clone());
    let (u, level) = (query::wrapped(&mut b, u), query::clamped(&mut b, level, architecture.coarsest()));
    let query = Query { u, level, wi, wo, shape };
    let u_is_read = checkpoint.header.architecture.u_inputs() > 0;
    answer(b, checkpoint, options, &query, features, (u_is_read, false))
}

/// `material.onnx`: u, wi, wo, level -> rgb.
///
/// # Errors
/// `Config`, naming the tensor or field of an invalid checkpoint, or the tensor that is not rounded as `options` say, or
/// saying that the textures exceed the 2 GiB that an ONNX file can hold.
pub fn material_graph(checkpoint: &Checkpoint, options: Options) -> Result<Vec<u8>> {
    check(checkpoint, options)?;
    let architecture = &checkpoint.header.architecture;
    let mut b = Builder::new("material", "neural material: parallax, texture pyramid and decoder");
    let (inputs, shape) = declare(&mut b, &material_inputs(Layout::of(architecture)));
    let [u, wi, wo, level] = inputs.as_slice() else { unreachable!("four ports are declared") };
    let wi = Direction::new(&mut b, "wi", wi.clone());
    let wo = Direction::new(&mut b, "wo", wo.clone());
    let (u, level) = query::led(&mut b, architecture, u, level);
    let query = Query { u, level, wi, wo, shape };
    let features = features(&mut b, checkpoint, options, &query.u, &query.wo, &query.level)?;
    answer(b, checkpoint, options, &query, &features, (true, architecture.levels() > 1))
}

/// Checks a checkpoint with all its textures for a graph.
fn check(checkpoint: &Checkpoint, options: Options) -> Result<()> {
    checkpoint.validate()?;
    options.storage.check(checkpoint)?;
    match checkpoint.header.architecture.bytes_as(options.storage) {
        bytes if bytes > MAX_BYTES => Err(too_large(bytes)),
        _ => Ok(()),
    }
}

/// The pyramid \[N, C\] at the position after parallax.
fn features(
    b: &mut Builder,
    checkpoint: &Checkpoint,
    options: Options,
    u: &Value,
    wo: &Direction,
    level: &Value,
) -> Result<Value> {
    let architecture = &checkpoint.header.architecture;
    let shifted = match &architecture.model.parallax {
        ParallaxConfig::None {} => u.clone(),
        ParallaxConfig::Offset(offset) => network::parallax(b, checkpoint, options.storage, offset, u, wo)?,
    };
    b.scope("texture");
    let sizes = architecture.level_sizes();
    let names: Vec<String> = (0..sizes.len()).map(texture_name).collect();
    let precision = options.storage.textures;
    let table = texture::Table::new(b, "texture.pyramid", checkpoint, &names, precision)?;
    let level = query::stored(b, level, architecture.model.texture.finest);
    Ok(texture::lookup(b, &shifted, &level, &table, &sizes))
}

/// The inputs that both whole graphs share, ready for use.
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

/// From features to the model's bytes; `read` says whether u and the level were read on the way to here.
fn answer(
    mut b: Builder,
    checkpoint: &Checkpoint,
    options: Options,
    query: &Query,
    features: &Value,
    read: (bool, bool),
) -> Result<Vec<u8>> {
    let Header { architecture, .. } = &checkpoint.header;
    let Query { u, level, wi, wo, shape } = query;
    let inputs = encoding::Inputs { u: Some((u, level)), wi: Some(wi), wo: Some(wo) };
    let encoded = encoding::encode(&mut b, architecture, &inputs);
    let columns = with_features(architecture, &encoded);
    let parts: Vec<&Value> = std::iter::once(features).chain(&encoded.parts).collect();
    let weights = options.storage.weights;
    let mut outputs = network::decode(&mut b, checkpoint, weights, &parts, &columns, shape.as_ref())?;
    for (name, value, is_read) in [("u", u, read.0), ("level", level, read.1 || encoded.uses_level)] {
        if !is_read {
            let nothing = query::nothing_of(&mut b, name, value);
            outputs = b.add(&format!("{name}.read"), &outputs, &nothing);
        }
    }
    b.scope("output");
    let (lit, seen) = (wi.above(&mut b, "wi"), wo.above(&mut b, "wo"));
    let mut shown = network::rgb(&mut b, checkpoint, outputs, &lit, &seen);
    if let Some(shape) = shape {
        let channels = b.axes(&[3]);
        let images = b.node("Concat", "images.shape", &[shape, &channels], &[("axis", 0)]);
        shown = b.node("Reshape", "images", &[&shown, &images], &[]);
    }
    b.output(&output(Layout::of(architecture)), &shown);
    finish(b, &properties(&checkpoint.header)?, options.opset)
}

/// What the decoder's columns are where features come before an encoding.
fn with_features(architecture: &Architecture, encoded: &encoding::Encoded) -> Vec<encoding::Column> {
    let channels = architecture.model.texture.channels;
    let mut columns: Vec<encoding::Column> = (0..channels).map(|c| Some((c, 1.0))).collect();
    columns.extend(encoded.columns.iter().map(|c| c.map(|(input, f)| (channels + input, f))));
    columns
}

/// What a graph says of its material.
fn properties(header: &Header) -> Result<Vec<(&'static str, String)>> {
    let json = |value: serde_json::Result<String>| value.map_err(|e| Error::config("header", e));
    let mut properties = vec![
        ("neumip.format", header.format.to_string()),
        ("neumip.material", header.material.clone()),
        ("neumip.measure", json(serde_json::to_string(&header.measure))?),
        ("neumip.height_range", json(serde_json::to_string(&header.height_range))?),
        ("neumip.architecture", json(serde_json::to_string(&header.architecture))?),
    ];
    let radius = header.architecture.neighbourhood();
    properties.extend(radius.map(|radius| ("neumip.neighbourhood", radius.to_string())));
    Ok(properties)
}

fn finish(b: Builder, properties: &[(&str, String)], opset: Opset) -> Result<Vec<u8>> {
    let property =
        |(key, value): &(&str, String)| proto::Property { key: (*key).into(), value: value.clone() };
    let model = proto::Model {
        ir_version: opset.ir_version(),
        producer_name: "neumip".into(),
        producer_version: env!("CARGO_PKG_VERSION").into(),
        graph: Some(b.finish()),
        opset_import: vec![proto::OperatorSet { domain: String::new(), version: opset.into() }],
        metadata_props: properties.iter().map(property).collect(),
    };
    match model.encoded_len() {
        bytes if bytes > MAX_BYTES => Err(too_large(bytes)),
        _ => Ok(model.encode_to_vec()),
    }
}

fn too_large(bytes: usize) -> Error {
    Error::config("resolution", format!("a graph of {bytes} bytes; an ONNX file holds {MAX_BYTES}"))
}
