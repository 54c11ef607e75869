//! Materials with random weights over the configurations that matter, and queries that reach every corner.

use neumip_export::checkpoint::{Checkpoint, FORMAT, Header, Measure};
use neumip_export::config::*;
use neumip_export::{Cone, Domain, Golden, Tensor};
use std::collections::BTreeMap;
use std::f32::consts::TAU;

/// A small generator: tests need repeatable numbers, not good ones.
pub struct Numbers(u64);

impl Numbers {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x5851_f42d_4c95_7f2d)
    }

    pub fn uniform(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let mixed = (self.0 ^ (self.0 >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (mixed >> 40) as f32 / 16_777_216.0
    }

    pub fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.uniform()
    }

    pub fn normal(&mut self) -> f32 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (TAU * self.uniform()).cos()
    }

    /// A direction whose squared length is in the range.
    pub fn direction(&mut self, low: f32, high: f32) -> [f32; 2] {
        let (radius, angle) = (self.between(low, high).sqrt(), TAU * self.uniform());
        [radius * angle.cos(), radius * angle.sin()]
    }
}

fn direction(bands: usize, raw: bool, amplitude: f32) -> DirectionEncoding {
    DirectionEncoding { bands, raw, amplitude }
}

fn position(bands: usize, limit_to_resolution: bool, attenuate: bool, raw: bool) -> PositionEncoding {
    PositionEncoding { bands, limit_to_resolution, attenuate, raw }
}

fn offset() -> ParallaxConfig {
    ParallaxConfig::Offset(OffsetConfig { channels: 7, hidden: vec![25, 25, 25], scale: 0.1, min_z: 0.6 })
}

/// NeuMIP's own structure, which the cases vary.
fn baseline() -> ModelConfig {
    ModelConfig {
        texture: TextureConfig { channels: 7, finest: 0, levels: None, init_std: 0.1 },
        parallax: offset(),
        encoding: EncodingConfig {
            pi: true,
            components: 2,
            u: position(0, false, false, false),
            wi: direction(0, true, 1.0),
            wo: direction(0, true, 1.0),
        },
        decoder: DecoderConfig::Mlp { hidden: vec![25, 25, 25] },
        output: OutputConfig { space: OutputSpace::Rgb, transform: OutputTransform::Identity, mask: false },
    }
}

/// Name, configuration and resolution of every case.
pub fn cases() -> Vec<(&'static str, ModelConfig, [usize; 2])> {
    let case = |change: fn(&mut ModelConfig)| {
        let mut model = baseline();
        change(&mut model);
        model
    };
    vec![
        ("baseline", case(|_| ()), [32, 32]),
        (
            "paper",
            case(|m| {
                m.encoding.u.bands = 10;
                m.encoding.wi = direction(4, false, 1.0);
                m.encoding.wo = direction(4, false, 1.0);
            }),
            [64, 64],
        ),
        (
            "three components, raw, no pi",
            case(|m| {
                m.encoding.pi = false;
                m.encoding.components = 3;
                m.encoding.u = position(10, false, false, true);
                m.encoding.wi = direction(4, true, 1.0);
                m.encoding.wo = direction(4, true, 1.0);
            }),
            [16, 16],
        ),
        (
            "attenuated, not square",
            case(|m| {
                m.encoding.u = position(10, true, true, false);
                m.encoding.wi = direction(4, true, 0.25);
                m.encoding.wo = direction(4, true, 0.25);
            }),
            [12, 20],
        ),
        (
            "mask and yuv, odd",
            case(|m| {
                m.output.mask = true;
                m.output.space = OutputSpace::Yuv;
                m.output.transform = OutputTransform::ExpMinusOne;
            }),
            [7, 9],
        ),
        (
            "no parallax, two levels",
            case(|m| {
                m.parallax = ParallaxConfig::None {};
                m.texture.levels = Some(2);
                m.encoding.u.bands = 3;
            }),
            [64, 16],
        ),
        (
            "one level, u unencoded",
            case(|m| {
                m.parallax = ParallaxConfig::None {};
                m.texture = TextureConfig { channels: 3, finest: 0, levels: Some(1), init_std: 0.1 };
                m.decoder = DecoderConfig::Mlp { hidden: vec![8] };
            }),
            [9, 5],
        ),
        (
            "uneven bands, attenuated without pi",
            case(|m| {
                m.encoding.pi = false;
                m.encoding.components = 3;
                m.encoding.u = position(5, false, true, true);
                m.encoding.wi = direction(1, false, 0.5);
                m.encoding.wo = direction(6, false, 2.0);
                m.texture.levels = Some(4);
            }),
            [8, 8],
        ),
        (
            "two finest levels left out",
            case(|m| {
                m.encoding.u = position(6, true, true, false);
                m.texture.finest = 2;
            }),
            [48, 33],
        ),
        (
            "one level, attenuated",
            case(|m| {
                m.encoding.u = position(2, true, true, false);
                m.texture.levels = Some(1);
                m.output.mask = true;
            }),
            [2, 3],
        ),
    ]
}

/// Materials that were fitted for a scene: a window that laps the tile's border, a band of it, and the whole tile with some
/// of its levels.
pub fn fitted() -> Vec<(&'static str, Checkpoint)> {
    let up = |cosine| Cone { axis: [0.0, 0.0, 1.0], cosine };
    let mut attenuated = baseline();
    attenuated.encoding.u = position(4, true, true, true);
    let places = [
        ("a window over the border", baseline(), [16, 24], [32, 32], [25, 20], [0.0, 1.25]),
        ("a band of rows", attenuated, [12, 20], [20, 20], [5, 0], [0.25, 1.0]),
        ("the whole tile", baseline(), [16, 16], [16, 16], [0, 0], [0.75, 2.0]),
    ];
    let checkpoints = places.into_iter().map(|(name, model, resolution, tile, corner, levels)| {
        let mut checkpoint = checkpoint(&model, resolution, 31);
        let (wi, wo) = (up(0.2), up(0.5));
        let domain = Domain { scene: "near".into(), tile, corner, levels, wi, wo, floor: 0.1 };
        checkpoint.header.architecture.domain = Some(domain);
        checkpoint.header.architecture.validate().unwrap();
        (name, checkpoint)
    });
    checkpoints.collect()
}

/// Moves the window of a fitted material by a texel, or its finest level where the window is the whole tile.
pub fn misplace(checkpoint: &mut Checkpoint) {
    let Architecture { domain, resolution, .. } = &mut checkpoint.header.architecture;
    let domain = domain.as_mut().unwrap();
    match domain.tile == *resolution {
        true => domain.levels[0] += 0.25,
        false => domain.corner[0] = (domain.corner[0] + 1) % domain.tile[0],
    }
}

/// As [`cases`], with decoders that read neighbours.
pub fn image_cases() -> Vec<(&'static str, ModelConfig, [usize; 2])> {
    let case = |modules, paths: [usize; 4], reduce, change: fn(&mut ModelConfig)| {
        let mut model = baseline();
        let width = paths.iter().sum();
        model.decoder = DecoderConfig::Inception(InceptionConfig { width, modules, paths, reduce });
        change(&mut model);
        model
    };
    vec![
        (
            "two modules, attenuated",
            case(2, [4, 5, 3, 2], [4, 2], |m| {
                m.encoding.u = position(4, true, true, false);
                m.encoding.wi = direction(2, true, 0.5);
            }),
            [16, 16],
        ),
        (
            "one module, masked, without parallax",
            case(1, [3, 2, 2, 3], [4, 4], |m| {
                m.parallax = ParallaxConfig::None {};
                m.output.mask = true;
                m.output.space = OutputSpace::Yuv;
            }),
            [8, 12],
        ),
        ("images smaller than the margin", case(2, [2, 2, 2, 2], [3, 3], |_| ()), [4, 2]),
    ]
}

/// Queries as images of an odd size, with everything that [`queries`] has: a graph takes any.
pub fn images(architecture: &Architecture, [count, height, width]: [usize; 3], seed: u64) -> Golden {
    let images = Some([count, height, width]);
    Golden { images, ..queries(architecture, count * height * width, seed) }
}

/// A checkpoint with textures N(0, 0.3) and weights uniform in +-sqrt(6 / inputs), which keeps the variance
/// through ReLU layers: with less, the answer would hardly depend on the query.
pub fn checkpoint(model: &ModelConfig, resolution: [usize; 2], seed: u64) -> Checkpoint {
    let architecture = Architecture::new(model.clone(), resolution).unwrap();
    let mut numbers = Numbers::new(seed);
    let mut tensors = BTreeMap::<String, Tensor>::new();
    let mut inputs = 1;
    for (name, shape) in architecture.tensors() {
        let count = shape.iter().product();
        inputs = if matches!(shape.len(), 2 | 4) { shape[1..].iter().product() } else { inputs };
        let bound = (6.0 / inputs as f32).sqrt();
        let mut draw =
            || if shape.len() == 3 { 0.3 * numbers.normal() } else { numbers.between(-bound, bound) };
        let data = (0..count).map(|_| draw()).collect();
        tensors.insert(name, Tensor { shape, data });
    }
    // Most colours above 0, where the clamp would hide a difference.
    let last = match architecture.decoder_widths() {
        Some(widths) => bias_name(DECODER_MLP, widths.len() - 2),
        None => format!("{DECODER}.out.bias"),
    };
    let bias = tensors.get_mut(&last).unwrap();
    bias.data[..3].iter_mut().for_each(|b| *b += 1.0);
    let header = Header {
        format: FORMAT,
        architecture,
        height_range: [-0.05, 0.125],
        measure: Measure::RadianceCosine,
        material: "metal rings".into(),
        provenance: serde_json::json!({"seed": seed, "steps": [1, 2.5, 0.1 + 0.2], "data": "rings"}),
        errors: serde_json::json!({"test": {"mse": 0.0123, "psnr": 31.7}}),
    };
    Checkpoint { header, tensors }
}

/// Within this many tiles of a window's border nothing is asked.
const NEAR: f32 = 1e-3;

/// Queries: ordinary ones, texel edges, far tiles, levels outside the pyramid, grazing and below the horizon.
/// The answers are left empty.
pub fn queries(architecture: &Architecture, count: usize, seed: u64) -> Golden {
    let mut numbers = Numbers::new(seed);
    let [height, width] = architecture.tile();
    let levels = architecture.coarsest() as f32 + 1.0;
    let empty = || (vec![], vec![], vec![], vec![], vec![]);
    let (u, wi, wo, level, rgb) = empty();
    let mut out = Golden { tolerance: 1e-4, u, wi, wo, level, rgb, images: None };
    for i in 0..count {
        let mut place = |texels: usize| match i % 5 {
            0 | 1 => numbers.uniform(),
            2 => numbers.between(-3.0, 3.0),
            3 => (numbers.between(-2.0, 2.0) * texels as f32).floor() / texels as f32,
            _ => numbers.between(-1e3, 1e3),
        };
        out.u.push([place(width), place(height)]);
        out.level.push(match i % 4 {
            0 => numbers.between(-1.0, levels + 1.0).floor(),
            1 => numbers.between(-2.0, levels + 2.0),
            _ => numbers.between(0.0, levels - 1.0),
        });
        let (low, high) = match i % 16 {
            14 => (0.99, 0.9999),
            15 => (1.0, 4.0),
            _ => (0.0, 0.99),
        };
        out.wi.push(numbers.direction(low, high));
        let (low, high) = if i % 29 == 28 { (1.0, 4.0) } else { (0.0, 0.999) };
        out.wo.push(numbers.direction(low, high));
    }
    // Exactly on the horizon, straight up, and a position whose wrap rounds up to 1.
    out.wi[0] = [1.0, 0.0];
    out.wi[1] = [0.0, 0.0];
    out.wo[1] = [0.0, 0.0];
    out.u[2] = [-1e-9, 1.0];
    if let Some(guide) = architecture.guide() {
        // A reader may round the border of a window otherwise.
        out.u.iter_mut().filter(|u| guide.border(**u) < NEAR).for_each(|u| *u = u.map(|v| v + 2.0 * NEAR));
    }
    out
}
