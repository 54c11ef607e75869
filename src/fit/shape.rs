//! What a fitted model may be: its size as few numbers, and which sizes are worth a trial.

use super::need::Need;
use crate::error::Result;
use neumip_export::config::{Architecture, DecoderConfig, ModelConfig, OffsetConfig, ParallaxConfig};
use serde::{Deserialize, Serialize};
use std::fmt;

/// A model's size.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shape {
    /// Finest stored level.
    pub finest: usize,
    /// Texture channels.
    pub channels: usize,
    /// Widths of the decoder's hidden layers.
    pub hidden: Vec<usize>,
    /// Channels of the offset texture and widths of its network's hidden layers; none without an offset.
    pub offset: Option<(usize, Vec<usize>)>,
    /// Octaves of the position.
    pub bands: usize,
}

impl fmt::Display for Shape {
    /// As in `f1 c4 16-16 offset 4:8 u0`.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let list = |widths: &[usize]| widths.iter().map(ToString::to_string).collect::<Vec<_>>().join("-");
        write!(f, "f{} c{} {}", self.finest, self.channels, list(&self.hidden))?;
        if let Some((channels, hidden)) = &self.offset {
            write!(f, " offset {channels}:{}", list(hidden))?;
        }
        write!(f, " u{}", self.bands)
    }
}

impl Shape {
    /// The size of a model; None for a decoder that is not fully connected.
    pub fn of(model: &ModelConfig) -> Option<Self> {
        let DecoderConfig::Mlp { hidden } = &model.decoder else { return None };
        let offset = match &model.parallax {
            ParallaxConfig::None {} => None,
            ParallaxConfig::Offset(offset) => Some((offset.channels, offset.hidden.clone())),
        };
        Some(Self {
            finest: model.texture.finest,
            channels: model.texture.channels,
            hidden: hidden.clone(),
            offset,
            bands: model.encoding.u.bands,
        })
    }

    /// A model of this size with everything else as in `full`, on the window of `need`.
    ///
    /// # Errors
    /// `Config` if it cannot be.
    pub fn model(&self, full: &ModelConfig, need: &Need) -> Result<Architecture> {
        let mut model = self.sized(full);
        model.texture.levels = Some(need.levels_from(self.finest));
        Ok(Architecture::new(model, need.size)?)
    }

    /// A model of this size with everything else as in `full`, on a whole tile of \[H, W\] texels with all levels.
    ///
    /// # Errors
    /// `Config` if it cannot be.
    pub fn of_tile(&self, full: &ModelConfig, resolution: [usize; 2]) -> Result<Architecture> {
        Ok(Architecture::new(self.sized(full), resolution)?)
    }

    fn sized(&self, full: &ModelConfig) -> ModelConfig {
        let mut model = full.clone();
        model.texture.finest = self.finest;
        model.texture.levels = None;
        model.texture.channels = self.channels;
        model.decoder = DecoderConfig::Mlp { hidden: self.hidden.clone() };
        model.encoding.u.bands = self.bands;
        model.parallax = match (&self.offset, &full.parallax) {
            (Some((channels, hidden)), ParallaxConfig::Offset(offset)) => {
                ParallaxConfig::Offset(OffsetConfig {
                    channels: *channels,
                    hidden: hidden.clone(),
                    ..offset.clone()
                })
            }
            _ => ParallaxConfig::None {},
        };
        model
    }
}
