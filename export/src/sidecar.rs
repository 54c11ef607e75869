//! `material.json`: what a bundle holds and how to evaluate it, in words and numbers.

use crate::bundle::{BundleFile, Contents, SAMPLER, SAMPLER_GOLDEN};
use crate::checkpoint::{Header, Measure};
use crate::config::{
    Architecture, DecoderConfig, DirectionEncoding, InceptionConfig, OFFSET_TEXTURE, OutputSpace,
    OutputTransform, ParallaxConfig,
};
use crate::domain::Domain;
use crate::error::{Error, Result};
use crate::onnx::{Opset, Port};
use crate::precision::{Precision, Rounding, Storage};
use crate::sampler::{CENTRES, Frame, LOG_SCALES, LOGITS, SHEARS, SamplerConfig};
use crate::shader::{Language, Mode, file_name};
use crate::textures::TextureFile;
use crate::weights::{self, Layout};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::{Component, Path};

/// Version of the bundle format.
pub const FORMAT: u32 = 1;

/// The content of `material.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sidecar {
    /// Version of the bundle format: [`FORMAT`].
    pub format: u32,
    /// The material's name.
    pub material: String,
    /// What RGB is.
    pub measure: Measure,
    /// Lowest and highest height of the surface around the plane z = 0, in tile widths.
    pub height_range: [f32; 2],
    /// Texels of the tile, \[height, width\]: those that a footprint's level counts.
    pub resolution: [usize; 2],
    /// Number of stored levels; queries are clamped to 0 .. finest + levels - 1.
    pub levels: usize,
    /// What the material was fitted for; absent: everything.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub domain: Option<DomainEntry>,
    /// What the material costs.
    pub cost: Cost,
    /// How numbers are stored and what that costs; absent: as 32-bit floats, which costs nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rounding: Option<Rounding>,
    /// How far away a query may lie that an answer depends on, in samples of a regular grid; absent: each answer depends on
    /// its own query alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub neighbourhood: Option<usize>,
    /// The error table, of the model before rounding.
    pub errors: serde_json::Value,
    /// The conventions, in words.
    pub conventions: Vec<String>,
    /// How a query is answered, step by step.
    pub evaluate: Vec<String>,
    /// The ONNX graphs.
    pub graphs: Vec<GraphFile>,
    /// The texture files.
    pub textures: Vec<TextureFile>,
    /// The networks' weights without a container; absent where the decoder is convolutional.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weights: Option<WeightFiles>,
    /// Functions for a renderer's own shaders; none where the decoder is convolutional.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shaders: Vec<ShaderFile>,
    /// Importance sampling of wi; absent: sample the cosine.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sampler: Option<SamplerFiles>,
    /// The model's configuration and resolution.
    pub architecture: Architecture,
    /// Every other file of the bundle.
    pub files: Vec<BundleFile>,
}

/// What a material was fitted for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DomainEntry {
    /// In words.
    pub meaning: Vec<String>,
    /// Texels \[height, width\] of the textures' finest level, before any was left out.
    pub window: [usize; 2],
    /// In numbers.
    pub bounds: Domain,
}

/// Size and work of a material.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cost {
    /// Floating-point operations of the networks, a query.
    pub flops_per_query: usize,
    /// Weights and biases of the networks.
    pub network_weights: usize,
    /// Texels times channels of all textures.
    pub texture_values: usize,
    /// Bytes of both as they are stored.
    pub bytes: usize,
}

/// The block of the networks' weights ([`crate::weights`]).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WeightFiles {
    /// The file of 32-bit floats.
    pub single: String,
    /// The file of 16-bit floats.
    pub half: String,
    /// How both are laid out.
    pub order: String,
    /// Where everything is.
    pub layout: Layout,
}

/// Shader source ([`crate::shader`]); its head says what to bind.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShaderFile {
    /// File name.
    pub file: String,
    /// The language.
    pub language: Language,
    /// What it is made for.
    pub mode: Mode,
}

/// The files of the importance sampler ([`crate::sampler`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SamplerFiles {
    /// Its network.
    pub file: String,
    /// Its golden answers.
    pub golden: String,
    /// The mixture.
    pub config: SamplerConfig,
    /// How it was fitted and what it gains.
    pub provenance: serde_json::Value,
    /// How a direction is sampled, step by step.
    pub evaluate: Vec<String>,
}

/// An ONNX graph's interface.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraphFile {
    /// File name.
    pub file: String,
    /// Operator set.
    pub opset: Opset,
    /// Inputs, in order.
    pub inputs: Vec<GraphPort>,
    /// Outputs.
    pub outputs: Vec<GraphPort>,
}

/// An input or output of 32-bit floats.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraphPort {
    /// Name.
    pub name: String,
    /// Extents; `N` is the batch, `H` and `W` the rows and columns of its images.
    pub shape: Vec<String>,
    /// What it is.
    pub meaning: String,
}

impl From<Port> for GraphPort {
    fn from(port: Port) -> Self {
        let named = port.layout.extents().iter().map(|name| name.to_string());
        let shape = named.chain(port.columns.iter().map(usize::to_string)).collect();
        Self { name: port.name.into(), shape, meaning: port.meaning.into() }
    }
}

impl Sidecar {
    /// Describes what a bundle is made of and the files that were made from it.
    pub fn new(
        contents: &Contents,
        graphs: Vec<GraphFile>,
        textures: Vec<TextureFile>,
        files: Vec<BundleFile>,
    ) -> Self {
        let Header { architecture, material, measure, height_range, errors, .. } =
            &contents.checkpoint.header;
        let storage = contents.storage();
        let sampler = contents.sampler.map(|(sampler, _)| &sampler.header);
        let weights = architecture.decoder_widths().map(|_| WeightFiles {
            single: weights::SINGLE.into(),
            half: weights::HALF.into(),
            order: format!(
                "Little-endian, layer after layer: weight row-major [padded_outputs][padded_inputs], then bias \
                 [padded_outputs]; both sides padded with zeros to multiples of {}. Places are in values.",
                weights::PAD
            ),
            layout: Layout::new(architecture, sampler.map(|s| &s.config)),
        });
        Self {
            format: FORMAT,
            material: material.clone(),
            measure: *measure,
            height_range: *height_range,
            resolution: architecture.tile(),
            levels: architecture.levels(),
            domain: architecture.domain.as_ref().map(|domain| DomainEntry {
                meaning: domain.explained(architecture.resolution, architecture.coarsest()),
                window: architecture.resolution,
                bounds: domain.clone(),
            }),
            cost: Cost {
                flops_per_query: architecture.flops_per_query(),
                network_weights: architecture.network_weights(),
                texture_values: architecture.texture_values(),
                bytes: architecture.bytes_as(storage),
            },
            rounding: contents.rounding,
            neighbourhood: architecture.neighbourhood(),
            errors: errors.clone(),
            conventions: conventions(*measure, storage, architecture.neighbourhood()),
            evaluate: steps(architecture),
            graphs,
            textures,
            shaders: if weights.is_some() { shaders() } else { Vec::new() },
            weights,
            sampler: sampler.map(|header| SamplerFiles {
                file: SAMPLER.into(),
                golden: SAMPLER_GOLDEN.into(),
                config: header.config.clone(),
                provenance: header.provenance.clone(),
                evaluate: sampler_steps(&header.config),
            }),
            architecture: architecture.clone(),
            files,
        }
    }

    /// How numbers are stored.
    pub fn storage(&self) -> Storage {
        self.rounding.map_or(Storage::SINGLE, |rounding| rounding.storage)
    }

    /// Parses `material.json`, checks its version and that every file is named once, plainly.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn from_json(json: &[u8]) -> Result<Self> {
        #[derive(Deserialize)]
        struct Version {
            format: u32,
        }
        let broken = |e: serde_json::Error| Error::config("bundle", e);
        let Version { format } = serde_json::from_slice(json).map_err(broken)?;
        if format != FORMAT {
            return Err(Error::config("format", format!("version {format}; this program reads {FORMAT}")));
        }
        let sidecar: Self = serde_json::from_slice(json).map_err(broken)?;
        sidecar.architecture.validate()?;
        if let Some(rounding) = &sidecar.rounding {
            rounding.validate()?;
        }
        if let Some(sampler) = &sidecar.sampler {
            sampler.config.validate()?;
        }
        let mut names = BTreeSet::new();
        for BundleFile { name, .. } in &sidecar.files {
            let mut parts = Path::new(name).components();
            let plain = matches!(parts.next(), Some(Component::Normal(_))) && parts.next().is_none();
            if !plain || !names.insert(name.as_str()) {
                return Err(Error::config(
                    "files",
                    format!("{name:?} is not the name of one file of the bundle"),
                ));
            }
        }
        let graphs = sidecar.graphs.iter().map(|g| &g.file);
        let weights = sidecar.weights.iter().flat_map(|w| [&w.single, &w.half]);
        let sampler = sidecar.sampler.iter().flat_map(|s| [&s.file, &s.golden]);
        let textures = sidecar.textures.iter().map(|t| &t.file);
        let shaders = sidecar.shaders.iter().map(|s| &s.file);
        for name in graphs.chain(textures).chain(weights).chain(shaders).chain(sampler) {
            if !names.contains(name.as_str()) {
                return Err(Error::config("files", format!("{name:?} is described and not listed")));
            }
        }
        Ok(sidecar)
    }
}

/// All sources of a bundle.
fn shaders() -> Vec<ShaderFile> {
    let modes = |language| {
        Mode::ALL.map(|mode| ShaderFile { file: file_name(language, mode).into(), language, mode })
    };
    Language::ALL.into_iter().flat_map(modes).collect()
}

/// The conventions of the project, for a reader who has nothing else.
fn conventions(measure: Measure, storage: Storage, neighbourhood: Option<usize>) -> Vec<String> {
    let rgb = match measure {
        Measure::RadianceCosine => {
            "RGB is linear and is f cos(theta_i) averaged over the footprint: the radiance under a distant light \
             that gives irradiance 1 on a plane facing it. Do not multiply by the cosine again."
        }
        Measure::Reflectance => {
            "RGB is linear and is the bare f averaged over the footprint. Multiply by cos(theta_i) = wi.z \
             for radiance."
        }
    };
    let conventions = vec![
        "Local frame: x along u, y along v, z along the normal. wi points to the light, wo to the viewer, both \
         away from the surface, unit length; they are given as (x, y), with z = sqrt(1 - x^2 - y^2).",
        "x^2 + y^2 >= 1 means on or below the horizon: the answer is 0.",
        "u is where the view ray meets the plane z = 0. The tile is [0, 1) x [0, 1) and repeats; texel (row i, \
         column j) has its centre at ((j + 0.5) / width, (i + 0.5) / height).",
        "level is log2 of the footprint's size in texels of the finest level; levels are continuous.",
        rgb,
    ];
    let mut conventions: Vec<String> = conventions.into_iter().map(String::from).collect();
    let stored = |precision: Precision| match precision {
        Precision::Single => "32-bit floats",
        Precision::Half => "16-bit floats",
        Precision::Byte => "8-bit integers times a factor for each channel",
    };
    if storage != Storage::SINGLE {
        conventions.push(format!(
            "Texture values are {} and weights are {} in the graphs; every other file has the same rounded numbers, and all \
             arithmetic is in 32-bit floats. errors is the table of the model before rounding.",
            stored(storage.textures),
            stored(storage.weights)
        ));
    }
    conventions.extend(neighbourhood.map(|radius| {
        format!(
            "An answer depends on all queries within {radius} samples, so the graphs take images [N, H, W] of regular grids: \
             one pair of directions and one whole level l an image, samples 2^l texels apart at the centres of that level's \
             texels. The graphs take every image as periodic: give a whole tile, or a part with {radius} samples more on \
             each side, which are cut off the answer."
        )
    }));
    conventions
}

/// How a query is answered, with this material's numbers.
fn steps(architecture: &Architecture) -> Vec<String> {
    let model = &architecture.model;
    let [height, width] = architecture.finest_size();
    let mut steps = vec![
        architecture.place_step(),
        match &model.parallax {
            ParallaxConfig::None {} => "No parallax: u' = u.".into(),
            ParallaxConfig::Offset(offset) => format!(
                "Parallax: u' = u + 0.5 r wo.xy / max(wo.z, {}), r = {} MLP({OFFSET_TEXTURE} at u, wo.x, wo.y); \
                 the texture [{height}, {width}, {}] is looked up bilinearly with repetition.",
                offset.min_z, offset.scale, offset.channels
            ),
        },
        format!(
            "Features: the {} channels of texture.level0, texture.level1, ... at u', bilinear with repetition in \
             the two levels around `level` (level l has max(1, {height} >> l) rows and max(1, {width} >> l) \
             columns), mixed linearly by the fraction.",
            model.texture.channels
        ),
    ];
    if let finest @ 1.. = model.texture.finest {
        steps.push(format!(
            "The tile's {finest} finest levels are not stored: texture.level0 is level {finest}, so that the lookup \
             takes max(level - {finest}, 0) in the place of level. The encoding takes level."
        ));
    }
    steps.push(encoding_step(architecture));
    steps.push(format!(
        "Decoder: input [features, u encoding, wi encoding, wo encoding] ({} values), {}",
        architecture.decoder_inputs(),
        match &model.decoder {
            DecoderConfig::Mlp { .. } =>
                "layers relu(W x + b), the last one linear. Networks in order of layers: decoder.mlp.0.weight [out, in], \
                 decoder.mlp.0.bias [out], ..."
                    .into(),
            DecoderConfig::Inception(inception) => decoder_step(inception),
        }
    ));
    let mut output = String::from("Output: the first three values y.");
    if model.output.space == OutputSpace::Yuv {
        output += " They are Y, U, V: R = Y + 1.13983 V, G = Y - 0.39465 U - 0.5806 V, B = Y + 2.03211 U.";
    }
    if model.output.transform == OutputTransform::ExpMinusOne {
        output += " Then exp(x) - 1.";
    }
    if model.output.mask {
        output += " Then times 0.1 + 1 / (1 + exp(-x)) of the last three values.";
    }
    output += " Then max(x, 0); 0 where wi or wo is on or below the horizon.";
    steps.push(output);
    steps
}

fn decoder_step(inception: &InceptionConfig) -> String {
    let InceptionConfig { width, modules, paths: [one, three, five, most], reduce: [to_three, to_five] } =
        inception;
    format!(
        "convolved over periodic images. decoder.in.weight [{width}, in, 1, 1] and bias; then {modules} modules whose four \
         paths are joined: path1 is 1x1 to {one} channels; path2.reduce is 1x1 to {to_three} and path2 3x3 to {three}; \
         path3.reduce is 1x1 to {to_five} and path3 5x5 to {five}; path4 is 1x1 to {most} of the largest of 3x3; then \
         decoder.out, 1x1. relu after every convolution but the last. Tensors: decoder.module0.path2.reduce.weight \
         [out, in, side, side], ..."
    )
}

/// How a direction is sampled, with this sampler's numbers.
fn sampler_steps(config: &SamplerConfig) -> Vec<String> {
    let frames: Vec<String> = config
        .lobes
        .iter()
        .enumerate()
        .map(|(k, frame)| match frame {
            Frame::Surface => format!("lobe {k} is around the normal: A = L, b = c"),
            Frame::Mirror => format!("lobe {k} is around the mirror direction: A = T L, b = m + T c"),
        })
        .collect();
    vec![
        format!(
            "Network: sampler.mlp of [features, wo.x, wo.y], ReLU between layers, features as the decoder gets them; {} values \
             a lobe: logit in {LOGITS:?}, c.x and c.y in {CENTRES:?}, p in {LOG_SCALES:?}, r in {SHEARS:?}, q in \
             {LOG_SCALES:?}, clamped.",
            crate::sampler::OUTPUTS_PER_LOBE
        ),
        format!(
            "Lobes: L = [[e^p, 0], [r e^p, e^q]]; m = -wo.xy / max(wo.z, {}), T = I + m m^T; \
             {}. Before them comes the cosine: A = I, b = 0.",
            config.min_z,
            frames.join("; ")
        ),
        format!(
            "Weights: softmax of (0, logits...) times {}, and {} more for the cosine.",
            1.0 - config.cosine_floor,
            config.cosine_floor
        ),
        "Sample: xi.x chooses a lobe, rest = xi.x less the weights before it, and the angle phi = 2 pi min(rest / weight, 1); \
         t = sqrt(xi.y / (1 - xi.y)) (cos phi, sin phi), xi.y at most 1 - 2^-24; s = A t + b; wi = normalize(s.x, s.y, 1)."
            .into(),
        "Density: the sum over lobes of weight z / (pi |det A| (z^2 + |v|^2)^2), v = A^-1 (wi.xy - b z), z = wi.z; 0 on and \
         below the horizon."
            .into(),
    ]
}

fn encoding_step(architecture: &Architecture) -> String {
    let encoding = &architecture.model.encoding;
    let place =
        if architecture.domain.is_some() { "the u of the first step" } else { "the wrapped u of the query" };
    let frequency = if encoding.pi { "2^k pi" } else { "2^k" };
    let mut step = format!(
        "Encoding: p = 2 u - 1 with {place}, not u'. For k = 0, 1, ...: the sines of all \
         components times {frequency}, then the cosines. u: {} bands",
        architecture.u_bands()
    );
    if encoding.u.attenuate {
        let pi = if encoding.pi { "pi " } else { "" };
        step += &format!(
            ", band k of component c times exp(-(2^k {pi}s_c)^2 / 2), s_c = 2^level (2 / N_c) / sqrt(12), \
             N = (width, height)"
        );
    }
    if encoding.u.raw {
        step += ", then p";
    }
    for (name, direction) in [("wi", &encoding.wi), ("wo", &encoding.wo)] {
        let DirectionEncoding { bands, raw, amplitude } = direction;
        step += &format!("; {name}: {bands} bands times {amplitude}");
        if *raw {
            step += ", then the direction";
        }
    }
    step + &format!(
        ". Directions have the components {}.",
        if encoding.components == 3 { "x, y, z" } else { "x, y" }
    )
}
