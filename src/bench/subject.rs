//! What is timed on: a model with initial weights, training pieces and queries like those of training and rendering.

use crate::config::{AdamConfig, Config, Remap, Term, TermKind};
use crate::dataset::{Block, Layout, Patch};
use crate::error::{Error, Result};
use crate::model::{self, Variables};
use crate::query::QueryBuffer;
use crate::random::{Random, Stream};
use half::f16;
use neumip_export::checkpoint::{Checkpoint, FORMAT, Header, Measure};
use neumip_export::config::{
    Architecture, DecoderConfig, DirectionEncoding, EncodingConfig, ModelConfig, OffsetConfig, OutputConfig,
    OutputSpace, OutputTransform, ParallaxConfig, PositionEncoding, TextureConfig,
};

/// Side of a training piece: one pair of directions and one level.
pub const PIECE: usize = 16;
/// Name of the model that is timed where no preset is asked for.
pub const DEFAULT: &str = "default";

const SEED: u64 = 1;
/// Directions: squared radius in the projected disc.
const DISC: f32 = 0.99;
/// Levels are drawn from 0 to this.
const LEVELS: f32 = 3.0;
/// Queries lie on a grid of this spacing in tiles, one texel of the default model, ...
const SPACING: f32 = 1.0 / 512.0;
/// ... that does not begin at the tile's corner.
const CORNER: f32 = 0.13;
/// Samples of all batches that take turns: more than the caches keep, so that a small batch meets textures as in training.
const SAMPLES_IN_TURN: usize = 1 << 17;

/// A model and its losses.
#[derive(Clone, Debug)]
pub struct Subject {
    /// [`DEFAULT`], or the preset.
    pub name: String,
    /// The model.
    pub architecture: Architecture,
    /// Terms of the loss.
    pub terms: Vec<Term>,
    /// Targets are clamped to this range.
    pub target_range: [f32; 2],
    /// Adam's constants.
    pub adam: AdamConfig,
}

impl Subject {
    /// The default model on a square tile: NeuMIP's networks with the paper's encodings (40 + 16 + 16 inputs), all levels
    /// down to one texel, L1 plus the paper's gradient loss on guarded 4th roots.
    ///
    /// # Errors
    /// `Config` for a resolution that is out of range.
    pub fn standard(resolution: usize) -> Result<Self> {
        let levels = resolution.checked_ilog2().map(|l| l as usize + 1);
        let hidden = vec![25; 3];
        let direction = DirectionEncoding { bands: 4, raw: false, amplitude: 1.0 };
        let model = ModelConfig {
            texture: TextureConfig { channels: 7, finest: 0, levels, init_std: 0.1 },
            parallax: ParallaxConfig::Offset(OffsetConfig {
                channels: 7,
                hidden: hidden.clone(),
                scale: 0.1,
                min_z: 0.6,
            }),
            encoding: EncodingConfig {
                pi: true,
                components: 2,
                u: PositionEncoding { bands: 10, limit_to_resolution: false, attenuate: false, raw: false },
                wi: direction.clone(),
                wo: direction,
            },
            decoder: DecoderConfig::Mlp { hidden },
            output: OutputConfig {
                space: OutputSpace::Rgb,
                transform: OutputTransform::Identity,
                mask: false,
            },
        };
        let term = |kind, remap| Term { kind, remap, weight: 1.0 };
        Ok(Self {
            name: DEFAULT.into(),
            architecture: Architecture::new(model, [resolution; 2])?,
            terms: vec![term(TermKind::L1, Remap::Linear), term(TermKind::Gradient, Remap::Root4Guarded)],
            target_range: [0.0, 1000.0],
            adam: AdamConfig { beta1: 0.9, beta2: 0.999, epsilon: 1e-8 },
        })
    }

    /// The model of a preset on a square tile, with the losses of its longest stage.
    ///
    /// # Errors
    /// `Config`, naming the field that is out of range.
    pub fn preset(name: &str, config: Config, resolution: usize) -> Result<Self> {
        config.train.validate()?;
        let stages = config.train.stages.resolve()?;
        let longest = stages.into_iter().max_by(|a, b| a.share.total_cmp(&b.share));
        let architecture = Architecture::new(config.model, [resolution; 2])?;
        if architecture.neighbourhood().is_some() {
            return Err(Error::usage(format!(
                "--preset {name}: its decoder sees its neighbours and takes no single queries; the example `inception` \
                 times its kernels"
            )));
        }
        Ok(Self {
            name: name.into(),
            architecture,
            terms: longest.ok_or_else(|| Error::config("train.stages", "is empty"))?.terms,
            target_range: config.train.target_range,
            adam: config.train.adam,
        })
    }

    /// The model with initial weights.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn checkpoint(&self) -> Result<Checkpoint> {
        let variables = Variables::initial(&self.architecture, SEED, &model::device("cpu")?)?;
        let header = Header {
            format: FORMAT,
            architecture: self.architecture.clone(),
            height_range: [0.0; 2],
            measure: Measure::RadianceCosine,
            material: format!("bench {}", self.name),
            provenance: serde_json::json!({ "seed": SEED }),
            errors: serde_json::Value::Null,
        };
        Ok(Checkpoint { header, tensors: variables.to_stored()? })
    }

    /// Batches of `batch` samples that take turns: pieces of side [`PIECE`] at random places, each with one random pair of
    /// directions, one level and random targets.
    ///
    /// # Errors
    /// None in practice: what is drawn is in range.
    pub fn batches(&self, batch: usize) -> Result<Vec<Vec<Block>>> {
        let pieces = batch / (PIECE * PIECE);
        let count = (SAMPLES_IN_TURN / batch.max(1)).max(2);
        (0..count).map(|k| (k * pieces..(k + 1) * pieces).map(piece).collect()).collect()
    }

    /// Queries as a renderer asks them: a jittered grid of positions a texel apart, every one with its own directions and
    /// level.
    ///
    /// # Errors
    /// None in practice: what is drawn is in range.
    pub fn queries(&self, n: usize) -> Result<QueryBuffer> {
        let width = n.isqrt().max(1);
        let mut queries = QueryBuffer::slice(1, n, [0.0; 2], [0.0; 2], 0.0);
        for k in 0..n {
            let mut random = Random::sub_stream(SEED, Stream::Probe, 1, k as u64);
            queries.u[k] =
                [k % width, k / width].map(|at| ((at as f32 + random.uniform()) * SPACING + CORNER).fract());
            queries.wi[k] = random.disc(DISC);
            queries.wo[k] = random.disc(DISC);
            queries.level[k] = LEVELS * random.uniform();
        }
        Ok(queries)
    }

    /// Directions of `count` lights for each of `n` queries.
    pub fn lights(&self, n: usize, count: usize) -> Vec<Vec<[f32; 2]>> {
        let mut random = Random::sub_stream(SEED, Stream::Probe, 2, 0);
        (0..count).map(|_| (0..n).map(|_| random.disc(DISC)).collect()).collect()
    }

    /// Multiply-adds of the networks times 2 for a query, and how many of them do not depend on wi.
    pub(super) fn operations(&self) -> (f64, f64) {
        let architecture = &self.architecture;
        let decoder = architecture.decoder_widths().unwrap_or_default();
        let of_decoder: usize = decoder.windows(2).map(|w| 2 * w[0] * w[1]).sum();
        let of_wi = architecture.direction_inputs(&architecture.model.encoding.wi);
        let all = architecture.flops_per_query();
        let of_first = match &decoder[..] {
            [inputs, outputs, ..] => 2 * (inputs - of_wi) * outputs,
            _ => 0,
        };
        (all as f64, (all - of_decoder + of_first) as f64)
    }
}

/// The `index`-th training piece.
fn piece(index: usize) -> Result<Block> {
    let mut random = Random::sub_stream(SEED, Stream::Probe, 0, index as u64);
    let patch =
        Patch { corner: [random.uniform(), random.uniform()], wi: random.disc(DISC), wo: random.disc(DISC) };
    let layout = Layout::new(PIECE, PIECE, LEVELS * random.uniform(), vec![patch])?;
    let rgb = (0..PIECE * PIECE).map(|_| [(); 3].map(|()| f16::from_f32(random.uniform()))).collect();
    Block::new(layout, rgb, 0.0)
}
