//! The part of a model's configuration that is needed to answer a query, and the shapes that follow from it.
//!
//! The same structs are a preset's `model` object, the checkpoint's `model` object and what the command line overrides.

mod inception;

pub use inception::{Convolution, DECODER, InceptionConfig};

use crate::domain::Domain;
use crate::error::{Error, Result};
use crate::precision::Storage;
use serde::{Deserialize, Serialize};

/// Widest network, most channels and most bands that a configuration may ask for: bounds what a header can allocate.
pub const MAX_WIDTH: usize = 256;
/// Deepest network.
pub const MAX_LAYERS: usize = 16;
/// Most texture channels.
pub const MAX_CHANNELS: usize = 64;
/// Most octaves of an encoding: 2^23 periods a tile is where f32 positions end.
pub const MAX_BANDS: usize = 24;
/// Largest tile side in texels.
pub const MAX_RESOLUTION: usize = 8192;

/// A NeuMIP-like model: texture pyramid, parallax, input encoding, decoder, output.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelConfig {
    /// The neural texture pyramid.
    pub texture: TextureConfig,
    /// How a lookup position follows the surface's depth.
    pub parallax: ParallaxConfig,
    /// What the decoder sees of u, wi and wo.
    pub encoding: EncodingConfig,
    /// The network that turns features into outputs.
    pub decoder: DecoderConfig,
    /// How outputs become RGB.
    pub output: OutputConfig,
}

/// Neural texture pyramid: independent levels, each half the size of the one before.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextureConfig {
    /// Channels of every level.
    pub channels: usize,
    /// Finest level that is stored: queries of finer levels read it, and the offset texture has its size. A tile that is
    /// never seen from near does not need more.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub finest: usize,
    /// Number of stored levels; absent: log2 of the smaller side of the finest one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub levels: Option<usize>,
    /// Standard deviation of the initial values.
    pub init_std: f32,
}

/// Parallax module.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum ParallaxConfig {
    /// The lookup position is u.
    None {},
    /// NeuMIP's neural offset.
    Offset(OffsetConfig),
}

/// Neural offset: u' = u + 0.5 r wo.xy / max(wo.z, min_z), r = scale * MLP(texture(u), wo.xy).
/// The factor 0.5 turns the method's \[-1, 1\] positions into tile units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OffsetConfig {
    /// Channels of the offset texture, which is as large as the pyramid's finest level.
    pub channels: usize,
    /// Widths of the hidden layers, ReLU after each.
    pub hidden: Vec<usize>,
    /// Factor on the network's output.
    pub scale: f32,
    /// Least wo.z that divides.
    pub min_z: f32,
}

/// Input encoding gamma of u, wi and wo (improved NeuMIP, section 3.1).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EncodingConfig {
    /// Frequencies are 2^k pi (the paper) or 2^k (the authors' code).
    pub pi: bool,
    /// Directions enter with 2 components (x, y) or 3 (x, y, z).
    pub components: usize,
    /// Encoding of the query's position, as p = 2 u - 1.
    pub u: PositionEncoding,
    /// Encoding of the light direction.
    pub wi: DirectionEncoding,
    /// Encoding of the view direction.
    pub wo: DirectionEncoding,
}

/// Encoding of u.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PositionEncoding {
    /// Octaves; 0 leaves the encoding out.
    pub bands: usize,
    /// Use at most log2(resolution) + 1 octaves: finer ones alias between texel centres.
    pub limit_to_resolution: bool,
    /// Attenuate band k by exp(-(2^k pi s)^2 / 2) where s is the standard deviation of the footprint.
    pub attenuate: bool,
    /// Append p itself (discontinuous at the tile's border).
    pub raw: bool,
}

/// Encoding of a direction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DirectionEncoding {
    /// Octaves; 0 leaves the encoding out.
    pub bands: usize,
    /// Append the direction itself.
    pub raw: bool,
    /// Factor on the sines and cosines.
    pub amplitude: f32,
}

/// The decoder network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum DecoderConfig {
    /// Fully connected, ReLU between layers, linear output.
    Mlp {
        /// Widths of the hidden layers.
        hidden: Vec<usize>,
    },
    /// Convolutions over images of queries.
    Inception(InceptionConfig),
}

/// How outputs become RGB. The result is clamped at 0 outside training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OutputConfig {
    /// What the first three outputs are.
    pub space: OutputSpace,
    /// Applied to RGB after the change of space.
    pub transform: OutputTransform,
    /// Three more outputs x multiply the colour as 0.1 + sigmoid(x).
    pub mask: bool,
}

/// Colour space of the network's outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OutputSpace {
    /// Linear RGB.
    Rgb,
    /// Y, U, V: R = Y + 1.13983 V, G = Y - 0.39465 U - 0.5806 V, B = Y + 2.03211 U.
    Yuv,
}

/// Transform after the change of space.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OutputTransform {
    /// x.
    Identity,
    /// exp(x) - 1.
    ExpMinusOne,
}

/// Rows of the YUV to RGB matrix: rgb\[r\] = sum_c YUV_TO_RGB\[r\]\[c\] yuv\[c\].
pub const YUV_TO_RGB: [[f32; 3]; 3] = [[1.0, 0.0, 1.13983], [1.0, -0.39465, -0.5806], [1.0, 2.03211, 0.0]];

/// A configuration on a tile of a given size: everything that shapes follow from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Architecture {
    /// The configuration.
    pub model: ModelConfig,
    /// Texels of the tile, \[height, width\]; of the window, where a domain has one.
    pub resolution: [usize; 2],
    /// What the material was fitted for; absent: everything.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub domain: Option<Domain>,
}

/// Size of one pyramid level and where its rows start in the flattened table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LevelSize {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Texels of all finer levels together.
    pub base: usize,
}

impl Architecture {
    /// Checks every bound and returns the architecture.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn new(model: ModelConfig, resolution: [usize; 2]) -> Result<Self> {
        let this = Self { model, resolution, domain: None };
        this.validate()?;
        Ok(this)
    }

    /// Checks every bound.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn validate(&self) -> Result<()> {
        let within = |field: &str, value: usize, low: usize, high: usize| {
            if (low..=high).contains(&value) {
                Ok(())
            } else {
                Err(Error::config(field, format!("{value} is outside {low} to {high}")))
            }
        };
        let positive = |field: &str, value: f32| {
            if value.is_finite() && value > 0.0 {
                Ok(())
            } else {
                Err(Error::config(field, format!("{value} must be a positive number")))
            }
        };
        let model = &self.model;
        within("resolution[0]", self.resolution[0], 2, MAX_RESOLUTION)?;
        within("resolution[1]", self.resolution[1], 2, MAX_RESOLUTION)?;
        within("texture.channels", model.texture.channels, 1, MAX_CHANNELS)?;
        let most = self.full_levels();
        within("texture.finest", model.texture.finest, 0, most - 1)?;
        within("texture.levels", self.levels(), 1, most + 1 - model.texture.finest)?;
        positive("texture.init_std", model.texture.init_std)?;
        if let ParallaxConfig::Offset(offset) = &model.parallax {
            within("parallax.channels", offset.channels, 1, MAX_CHANNELS)?;
            check_hidden("parallax.hidden", &offset.hidden)?;
            positive("parallax.scale", offset.scale)?;
            positive("parallax.min_z", offset.min_z)?;
        }
        let encoding = &model.encoding;
        within("encoding.components", encoding.components, 2, 3)?;
        within("encoding.u.bands", encoding.u.bands, 0, MAX_BANDS)?;
        for (name, direction) in [("wi", &encoding.wi), ("wo", &encoding.wo)] {
            within(&format!("encoding.{name}.bands"), direction.bands, 0, MAX_BANDS)?;
            positive(&format!("encoding.{name}.amplitude"), direction.amplitude)?;
            if direction.bands == 0 && !direction.raw {
                return Err(Error::config(
                    format!("encoding.{name}"),
                    "the decoder would not see the direction: give it bands or raw",
                ));
            }
        }
        match &model.decoder {
            DecoderConfig::Mlp { hidden } => check_hidden("decoder.hidden", hidden)?,
            DecoderConfig::Inception(inception) => inception.validate()?,
        }
        match &self.domain {
            Some(_) if self.neighbourhood().is_some() => {
                let problem = "an inception decoder answers images of the whole tile, not queries that are led elsewhere";
                Err(Error::config("domain", problem))
            }
            Some(domain) => domain.validate(self.resolution, self.coarsest()),
            None => Ok(()),
        }
    }

    fn full_levels(&self) -> usize {
        let side = self.resolution[0].min(self.resolution[1]);
        (side.ilog2() as usize).max(1)
    }

    /// Number of stored pyramid levels.
    pub fn levels(&self) -> usize {
        let all = self.full_levels().saturating_sub(self.model.texture.finest);
        self.model.texture.levels.unwrap_or(all)
    }

    /// The coarsest level that a query may have; coarser ones are clamped to it.
    pub fn coarsest(&self) -> usize {
        self.model.texture.finest + self.levels() - 1
    }

    /// \[height, width\] of the finest stored level and of the offset texture.
    pub fn finest_size(&self) -> [usize; 2] {
        self.resolution.map(|side| (side >> self.model.texture.finest).max(1))
    }

    /// Sizes of all stored levels, finest first; each side is max(1, side >> (finest + index)).
    pub fn level_sizes(&self) -> Vec<LevelSize> {
        let mut base = 0;
        let [height, width] = self.finest_size();
        (0..self.levels())
            .map(|index| {
                let size =
                    LevelSize { height: (height >> index).max(1), width: (width >> index).max(1), base };
                base += size.height * size.width;
                size
            })
            .collect()
    }

    /// Texels of all levels together.
    pub fn pyramid_texels(&self) -> usize {
        self.level_sizes().iter().map(|s| s.height * s.width).sum()
    }

    /// Octaves of gamma(u) that are in force.
    pub fn u_bands(&self) -> usize {
        let u = &self.model.encoding.u;
        if u.limit_to_resolution {
            let side = self.resolution[0].max(self.resolution[1]);
            u.bands.min(side.ilog2() as usize + 1)
        } else {
            u.bands
        }
    }

    /// Decoder inputs that depend on u alone (and on the level, where attenuated).
    pub fn u_inputs(&self) -> usize {
        4 * self.u_bands() + if self.model.encoding.u.raw { 2 } else { 0 }
    }

    /// Decoder inputs made from one direction.
    pub fn direction_inputs(&self, direction: &DirectionEncoding) -> usize {
        let components = self.model.encoding.components;
        2 * components * direction.bands + if direction.raw { components } else { 0 }
    }

    /// Decoder inputs that are not features: u, then wi, then wo.
    pub fn encoding_inputs(&self) -> usize {
        let encoding = &self.model.encoding;
        self.u_inputs() + self.direction_inputs(&encoding.wi) + self.direction_inputs(&encoding.wo)
    }

    /// Decoder inputs: features first, then the encoding.
    pub fn decoder_inputs(&self) -> usize {
        self.model.texture.channels + self.encoding_inputs()
    }

    /// Decoder outputs: 3, or 6 with the mask.
    pub fn decoder_outputs(&self) -> usize {
        if self.model.output.mask { 6 } else { 3 }
    }

    /// Layer widths of the decoder, inputs and outputs included, where it is fully connected.
    pub fn decoder_widths(&self) -> Option<Vec<usize>> {
        match &self.model.decoder {
            DecoderConfig::Mlp { hidden } => {
                Some(widths(self.decoder_inputs(), hidden, self.decoder_outputs()))
            }
            DecoderConfig::Inception(_) => None,
        }
    }

    /// The decoder's convolutions, where it has some.
    pub fn convolutions(&self) -> Vec<Convolution> {
        match &self.model.decoder {
            DecoderConfig::Mlp { .. } => Vec::new(),
            DecoderConfig::Inception(inception) => {
                inception.convolutions(self.decoder_inputs(), self.decoder_outputs())
            }
        }
    }

    /// How far away a query may lie that an answer depends on, in samples of the grid; nothing where each answer depends on
    /// its own query alone.
    pub fn neighbourhood(&self) -> Option<usize> {
        match &self.model.decoder {
            DecoderConfig::Mlp { .. } => None,
            DecoderConfig::Inception(inception) => Some(inception.radius()),
        }
    }

    /// Channels of the offset texture, where there is one.
    pub fn offset_channels(&self) -> Option<usize> {
        match &self.model.parallax {
            ParallaxConfig::None {} => None,
            ParallaxConfig::Offset(offset) => Some(offset.channels),
        }
    }

    /// Layer widths of the offset network, where there is one.
    pub fn offset_widths(&self) -> Option<Vec<usize>> {
        match &self.model.parallax {
            ParallaxConfig::None {} => None,
            ParallaxConfig::Offset(offset) => Some(widths(offset.channels + 2, &offset.hidden, 1)),
        }
    }

    /// Names and shapes of all tensors, in the order in which they are initialised:
    /// textures \[height, width, channels\], weights \[out, in\] (of convolutions \[out, in, side, side\]), biases \[out\].
    pub fn tensors(&self) -> Vec<(String, Vec<usize>)> {
        let mut out = Vec::new();
        for (level, size) in self.level_sizes().iter().enumerate() {
            out.push((texture_name(level), vec![size.height, size.width, self.model.texture.channels]));
        }
        if let ParallaxConfig::Offset(offset) = &self.model.parallax {
            let [height, width] = self.finest_size();
            out.push((OFFSET_TEXTURE.into(), vec![height, width, offset.channels]));
        }
        for (prefix, widths) in [(OFFSET_MLP, self.offset_widths()), (DECODER_MLP, self.decoder_widths())] {
            for (layer, pair) in widths.unwrap_or_default().windows(2).enumerate() {
                out.push((weight_name(prefix, layer), vec![pair[1], pair[0]]));
                out.push((bias_name(prefix, layer), vec![pair[1]]));
            }
        }
        out.extend(self.convolutions().iter().flat_map(Convolution::tensors));
        out
    }

    /// Weights and biases of the networks (textures not counted).
    pub fn network_weights(&self) -> usize {
        let tensors = self.tensors();
        tensors.iter().filter(|(_, shape)| shape.len() != 3).map(|(_, s)| s.iter().product::<usize>()).sum()
    }

    /// Texels times channels of all textures.
    pub fn texture_values(&self) -> usize {
        self.tensors()
            .iter()
            .filter(|(_, shape)| shape.len() == 3)
            .map(|(_, shape)| shape.iter().product::<usize>())
            .sum()
    }

    /// Bytes of all weights and textures as f32.
    pub fn bytes(&self) -> usize {
        self.bytes_as(Storage::SINGLE)
    }

    /// Bytes of all weights and textures as they are stored.
    pub fn bytes_as(&self, storage: Storage) -> usize {
        storage.weights.bytes() * self.network_weights() + storage.textures.bytes() * self.texture_values()
    }

    /// Multiply-adds of the networks times 2, a query.
    pub fn flops_per_query(&self) -> usize {
        let count = |w: Vec<usize>| w.windows(2).map(|p| p[0] * p[1]).sum::<usize>();
        let connected = [self.decoder_widths(), self.offset_widths()].into_iter().flatten().map(count);
        let convolved = self.convolutions().iter().map(Convolution::products).sum::<usize>();
        2 * (connected.sum::<usize>() + convolved)
    }
}

/// Name of the offset texture.
pub const OFFSET_TEXTURE: &str = "offset.texture";
/// Prefix of the offset network's layers.
pub const OFFSET_MLP: &str = "offset.mlp";
/// Prefix of the decoder's layers.
pub const DECODER_MLP: &str = "decoder.mlp";

fn is_zero(n: &usize) -> bool {
    *n == 0
}

/// Name of one stored pyramid level, counted from the finest one.
pub fn texture_name(level: usize) -> String {
    format!("texture.level{level}")
}

/// Name of one layer's weight.
pub fn weight_name(prefix: &str, layer: usize) -> String {
    format!("{prefix}.{layer}.weight")
}

/// Name of one layer's bias.
pub fn bias_name(prefix: &str, layer: usize) -> String {
    format!("{prefix}.{layer}.bias")
}

fn widths(inputs: usize, hidden: &[usize], outputs: usize) -> Vec<usize> {
    let mut all = vec![inputs];
    all.extend_from_slice(hidden);
    all.push(outputs);
    all
}

fn check_hidden(field: &str, hidden: &[usize]) -> Result<()> {
    if hidden.is_empty() || hidden.len() > MAX_LAYERS {
        return Err(Error::config(field, format!("{} hidden layers; 1 to {MAX_LAYERS} work", hidden.len())));
    }
    match hidden.iter().find(|w| !(1..=MAX_WIDTH).contains(*w)) {
        Some(w) => Err(Error::config(field, format!("width {w} is outside 1 to {MAX_WIDTH}"))),
        None => Ok(()),
    }
}
