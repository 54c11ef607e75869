//! The fused engine answers and differentiates as plain float64 does, for every instruction set, shape and thread count.

use crate::{materials, plain};
use half::f16;
use neumip::dataset::{Block, Layout, Patch};
use neumip::engine::{Batch, FusedMaterial, Loss, Networks, Order, Plan, Sums, Textures};
use neumip::kernels::fetch::{Texels, padded};
use neumip::kernels::loss::{Kind, Remap, Term};
use neumip::kernels::simd::Isa;
use neumip::query::{QueryBuffer, Reflectance};
use neumip::random::{Random, Stream};
use neumip_export::config::*;
use neumip_export::{Checkpoint, Precision};
use rayon::ThreadPoolBuilder;

/// |difference| / (1 + |value|) of f32 kernels against float64: the exporter's tolerance, for the same reasons.
const ANSWER_TOLERANCE: f64 = 2e-5;
/// The same for widths and depths that no preset has: sums of a hundred products, eight layers deep.
const SHAPE_TOLERANCE: f64 = 2e-4;
/// Gradients relative to their tensor's largest: f32 back-propagation, and differences over a step that a ReLU or a texel's
/// edge may fall into.
const GRADIENT_TOLERANCE: f64 = 2e-3;
/// The same for deep and narrow shapes, through which hardly any gradient passes: what is left is a difference of large sums.
const SHAPE_GRADIENT_TOLERANCE: f64 = 1e-2;
/// Step of the central differences: float64 has digits to spare, and hardly a ReLU bends within it.
const STEP: f32 = 1e-6;
/// f16 keeps 11 bits: textures of size 0.3 are off by 1e-4, and the networks of these tests grow that.
const HALF_TOLERANCE: f64 = 2e-2;

fn material(checkpoint: &Checkpoint, precision: Precision, isa: Isa) -> FusedMaterial {
    FusedMaterial::new(&checkpoint.header.architecture, &checkpoint.tensors, precision, isa).unwrap()
}

fn buffer(checkpoint: &Checkpoint, n: usize, seed: u64) -> QueryBuffer {
    let golden = materials::queries(&checkpoint.header.architecture, n, seed);
    QueryBuffer::new(1, n, golden.u, golden.wi, golden.wo, golden.level).unwrap()
}

fn answers64(checkpoint: &Checkpoint, q: &QueryBuffer) -> Vec<[f64; 3]> {
    (0..q.len())
        .map(|k| {
            let features = plain::features(checkpoint, q.u[k], q.wo[k], q.level[k]);
            plain::decode(checkpoint, &features, q.u[k], q.wi[k], q.wo[k], q.level[k])
        })
        .collect()
}

/// Largest |difference| / (1 + |value|).
fn worst(given: &[[f32; 3]], exact: &[[f64; 3]]) -> f64 {
    assert_eq!(given.len(), exact.len());
    given
        .as_flattened()
        .iter()
        .zip(exact.as_flattened())
        .map(|(g, e)| (f64::from(*g) - e).abs() / (1.0 + e.abs()))
        .max_by(f64::total_cmp)
        .unwrap()
}

#[test]
fn fused_answers_follow_float64_and_a_changed_weight_is_noticed() {
    for (name, model, resolution) in materials::cases() {
        let checkpoint = materials::checkpoint(&model, resolution, 3);
        let q = buffer(&checkpoint, 1001, 4);
        let exact = answers64(&checkpoint, &q);
        for isa in Isa::all() {
            let answer = |c: &Checkpoint, p| material(c, p, isa).evaluate(&q).unwrap().pixels;
            let error = worst(&answer(&checkpoint, Precision::Single), &exact);
            assert!(error < ANSWER_TOLERANCE, "{name} {}: {error:e}", isa.name());
            let half = worst(&answer(&checkpoint, Precision::Half), &exact);
            assert!(half < HALF_TOLERANCE && half > ANSWER_TOLERANCE, "{name} {}: {half:e}", isa.name());
            let mut changed = checkpoint.clone();
            changed.tensors.get_mut("decoder.mlp.1.weight").unwrap().data[7] += 1e-2;
            let error = worst(&answer(&changed, Precision::Single), &exact);
            assert!(error > ANSWER_TOLERANCE, "{name} {}", isa.name());
        }
    }
}

/// Shapes over the whole range that the engine promises: widths 4 to 128, 1 to 8 layers, 1 to 16 channels, any bands.
fn shapes() -> Vec<(ModelConfig, [usize; 2])> {
    let (_, base, _) = materials::cases().remove(1);
    let one = |channels, offset: (usize, Vec<usize>), hidden: Vec<usize>, bands: [usize; 3], side| {
        let mut model = base.clone();
        model.texture.channels = channels;
        model.parallax = ParallaxConfig::Offset(OffsetConfig {
            channels: offset.0,
            hidden: offset.1,
            scale: 0.05,
            min_z: 0.6,
        });
        model.decoder = DecoderConfig::Mlp { hidden };
        model.encoding.u.bands = bands[0];
        (model.encoding.wi.bands, model.encoding.wi.raw) = (bands[1], bands[1] == 0);
        (model.encoding.wo.bands, model.encoding.wo.raw) = (bands[2], true);
        (model, side)
    };
    vec![
        one(1, (1, vec![4]), vec![4], [0, 0, 0], [16, 16]),
        one(16, (16, vec![128]), vec![128, 128], [7, 3, 1], [8, 32]),
        one(12, (3, vec![8, 8, 8, 8]), vec![17, 33, 65], [12, 0, 5], [10, 6]),
        one(5, (9, vec![31, 5]), vec![40, 13, 26, 4, 64, 7, 12, 25], [1, 4, 0], [33, 17]),
    ]
}

#[test]
fn any_shape_is_answered_and_a_changed_weight_is_noticed() {
    for (model, resolution) in shapes() {
        let mut checkpoint = materials::checkpoint(&model, resolution, 15);
        let q = buffer(&checkpoint, 300, 16);
        let exact = answers64(&checkpoint, &q);
        for isa in Isa::all() {
            let error =
                worst(&material(&checkpoint, Precision::Single, isa).evaluate(&q).unwrap().pixels, &exact);
            assert!(error < SHAPE_TOLERANCE, "{model:?} {}: {error:e}", isa.name());
        }
        checkpoint.tensors.get_mut("decoder.mlp.0.weight").unwrap().data[3] += 0.5;
        let isa = Isa::chosen().unwrap();
        let error =
            worst(&material(&checkpoint, Precision::Single, isa).evaluate(&q).unwrap().pixels, &exact);
        assert!(error > SHAPE_TOLERANCE);
    }
}

#[test]
fn prepared_queries_answer_as_whole_ones_under_every_light() {
    for (name, model, resolution) in materials::cases() {
        let checkpoint = materials::checkpoint(&model, resolution, 17);
        for isa in Isa::all() {
            let material = material(&checkpoint, Precision::Single, isa);
            // Longer than a chunk, and no multiple of a tile.
            let mut q = buffer(&checkpoint, 1500, 18);
            let prepared = material.prepare(&q.u, &q.level, &q.wo).unwrap();
            assert_eq!(prepared.len(), q.len());
            for turn in [0, 7, 100] {
                q.wi.rotate_left(turn);
                let whole = material.evaluate(&q).unwrap().pixels;
                let exact: Vec<[f64; 3]> = whole.iter().map(|p| p.map(f64::from)).collect();
                let lit = material.light(&prepared, &q.wi).unwrap();
                assert!(worst(&lit, &exact) < ANSWER_TOLERANCE, "{name} {}", isa.name());
                q.wi.rotate_left(1);
                assert!(worst(&material.light(&prepared, &q.wi).unwrap(), &exact) > ANSWER_TOLERANCE);
                q.wi.rotate_right(1);
            }
            assert!(material.light(&prepared, &q.wi[1..]).is_err());
            assert!(material.prepare(&q.u, &q.level[1..], &q.wo).is_err());
            assert!(material.prepare(&[[f32::NAN; 2]], &[0.0], &[[0.0; 2]]).is_err());
            let (other, side) = shapes().remove(1);
            let other = materials::checkpoint(&other, side, 1);
            let other =
                FusedMaterial::new(&other.header.architecture, &other.tensors, Precision::Single, isa);
            assert!(other.unwrap().light(&prepared, &q.wi).is_err());
        }
    }
}

#[test]
fn an_answer_is_the_same_bytes_in_any_buffer_and_on_any_number_of_threads() {
    let (_, model, resolution) = materials::cases().remove(1);
    let checkpoint = materials::checkpoint(&model, resolution, 13);
    let q = buffer(&checkpoint, 3000, 14);
    for isa in Isa::all() {
        let material = material(&checkpoint, Precision::Single, isa);
        let whole = material.evaluate(&q).unwrap().pixels;
        for (start, end) in [(0, 1), (1000, 1031), (2990, 3000), (63, 64), (5, 70)] {
            assert_eq!(material.evaluate(&q.range(start, end)).unwrap().pixels, whole[start..end]);
        }
        for threads in [1, 2, 4] {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert_eq!(pool.install(|| material.evaluate(&q)).unwrap().pixels, whole);
        }
        assert!(material.evaluate(&QueryBuffer::default()).unwrap().pixels.is_empty());
    }
}

#[test]
fn poison_is_answered_or_named_and_never_a_panic() {
    for (name, model, resolution) in materials::cases() {
        let checkpoint = materials::checkpoint(&model, resolution, 19);
        for isa in Isa::all() {
            let material = material(&checkpoint, Precision::Single, isa);
            for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e-42, 1.0, -0.0, 3e38, 1e-7] {
                for place in 0..4 {
                    let mut q = buffer(&checkpoint, 65, 20);
                    for w in q.wi.iter_mut().chain(&mut q.wo) {
                        *w = [0.3, -0.2];
                    }
                    match place {
                        0 => q.u[40] = [value, 0.5],
                        1 => q.wi[40] = [value, 0.0],
                        2 => q.wo[40] = [0.0, value],
                        _ => q.level[40] = value,
                    }
                    let clean = {
                        let mut q = q.clone();
                        (q.u[40], q.level[40], q.wi[40], q.wo[40]) = ([0.1; 2], 0.0, [0.3; 2], [0.2; 2]);
                        material.evaluate(&q).unwrap().pixels
                    };
                    match material.evaluate(&q) {
                        Ok(answer) => {
                            assert!(answer.pixels.as_flattened().iter().all(|v| v.is_finite()));
                            assert_eq!(answer.pixels[..40], clean[..40], "{name}");
                            assert_eq!(answer.pixels[41..], clean[41..], "{name}");
                        }
                        Err(error) => assert!(error.to_string().contains("query[40]"), "{name}: {error}"),
                    }
                }
            }
            // On the horizon and below it.
            let mut q = buffer(&checkpoint, 3, 21);
            (q.wi[0], q.wo[0]) = ([1.0, 0.0], [0.0; 2]);
            (q.wi[1], q.wo[1]) = ([0.0; 2], [0.0, 1.5]);
            assert_eq!(material.evaluate(&q).unwrap().pixels[..2], [[0.0; 3]; 2]);
        }
        let mut poisoned = checkpoint.clone();
        poisoned.tensors.get_mut("texture.level0").unwrap().data.fill(f32::NAN);
        let q = buffer(&checkpoint, 64, 22);
        let isa = Isa::chosen().unwrap();
        assert!(material(&poisoned, Precision::Single, isa).evaluate(&q).is_err(), "{name}");
        poisoned.tensors.remove("decoder.mlp.0.bias");
        let error =
            FusedMaterial::new(&poisoned.header.architecture, &poisoned.tensors, Precision::Half, isa);
        assert!(error.unwrap_err().to_string().contains("decoder.mlp.0.bias"));
    }
}

/// Pieces of patches at whole and fractional levels.
fn pieces(side: usize, patch: usize, count: u64) -> Vec<Block> {
    let piece = |k: u64| {
        let mut random = Random::new(21, Stream::Probe, k);
        let patches = (0..(side / patch).pow(2))
            .map(|_| Patch {
                corner: [random.uniform(), random.uniform()],
                wi: random.disc(0.9),
                wo: random.disc(0.9),
            })
            .collect();
        let layout = Layout::new(side, patch, (k % 4) as f32 * 0.75, patches).unwrap();
        let rgb = (0..side * side).map(|_| [0; 3].map(|_| f16::from_f32(random.uniform()))).collect();
        Block::new(layout, rgb, 0.0).unwrap()
    };
    (0..count).map(piece).collect()
}

/// Loss and gradients of the fused engine.
fn gradients(checkpoint: &Checkpoint, isa: Isa, pieces: &[Block], loss: &Loss) -> (f64, Sums) {
    let architecture = &checkpoint.header.architecture;
    let plan = Plan::new(architecture, isa, Order::Stored);
    let values = |name: &str| Ok(checkpoint.tensors[name].data.clone());
    let networks = Networks::training(&plan, &values).unwrap();
    let single = |name: String| Texels::Single(&checkpoint.tensors[&name].data);
    let levels: Vec<Texels> = (0..architecture.levels()).map(|l| single(texture_name(l))).collect();
    let offset = architecture.offset_channels().map(|_| single(OFFSET_TEXTURE.into()));
    let textures = Textures::new(&plan, levels, offset);
    let mut batch = Batch::new(plan);
    let mut sums = batch.zeros();
    let value = batch.gradients(&networks, &textures, pieces, loss, &mut sums).unwrap();
    (value, sums)
}

/// The gradients by tensor.
fn by_tensor(architecture: &Architecture, sums: &Sums) -> Vec<(String, Vec<f64>)> {
    let compact = |table: &[f32], channels: usize| -> Vec<f64> {
        let texels = table.chunks(padded(channels));
        texels.flat_map(|t| t[..channels].iter().map(|v| f64::from(*v))).collect()
    };
    let channels = architecture.model.texture.channels;
    let pyramid = compact(&sums.pyramid, channels);
    let sizes = architecture.level_sizes();
    let mut rest = &sums.networks[..];
    let mut all = Vec::new();
    for (name, shape) in architecture.tensors() {
        let n: usize = shape.iter().product();
        if name == OFFSET_TEXTURE {
            all.push((name, compact(&sums.offset, shape[2])));
        } else if let Some(level) = name.strip_prefix("texture.level") {
            let base = sizes[level.parse::<usize>().unwrap()].base * channels;
            all.push((name, pyramid[base..base + n].to_vec()));
        } else {
            let (part, others) = rest.split_at(n);
            rest = others;
            all.push((name, part.iter().map(|v| f64::from(*v)).collect()));
        }
    }
    all
}

/// Squared differences in float64, times `scale`.
fn loss64(checkpoint: &Checkpoint, pieces: &[Block], scale: f64) -> f64 {
    let mut sum = 0.0;
    for piece in pieces {
        let q = piece.queries(checkpoint.header.architecture.resolution);
        for (k, target) in piece.target().iter().enumerate() {
            let features = plain::features(checkpoint, q.u[k], q.wo[k], q.level[k]);
            let rgb = plain::colour(checkpoint, &features, q.u[k], q.wi[k], q.wo[k], q.level[k]);
            sum += (0..3).map(|c| (rgb[c] - f64::from(target[c])).powi(2)).sum::<f64>();
        }
    }
    scale * sum
}

#[test]
fn fused_gradients_follow_float64_and_a_changed_one_does_not() {
    const ENTRIES: usize = 3;
    let scale = 0.125f32;
    let terms = [Term { kind: Kind::L2, remap: Remap::Linear, scale }];
    let loss = Loss { terms: &terms, range: [0.0, 1.0], highest_level: None, offset_texture: true };
    let cases =
        materials::cases().into_iter().map(|(name, m, side)| (name.to_string(), m, side, GRADIENT_TOLERANCE));
    let shape = |(k, (m, side))| (format!("shape {k}"), m, side, SHAPE_GRADIENT_TOLERANCE);
    for (name, model, resolution, tolerance) in cases.chain(shapes().into_iter().enumerate().map(shape)) {
        let checkpoint = materials::checkpoint(&model, resolution, 5);
        // Tiles of one piece, of several, and with a tail.
        for (side, patch, count) in [(4, 2, 5), (1, 1, 3)] {
            let pieces = pieces(side, patch, count);
            for isa in Isa::all() {
                let (value, sums) = gradients(&checkpoint, isa, &pieces, &loss);
                let exact = loss64(&checkpoint, &pieces, f64::from(scale));
                assert!((value - exact).abs() < tolerance * exact, "{name}: {value} {exact}");
                for (tensor, gradient) in by_tensor(&checkpoint.header.architecture, &sums) {
                    let largest = gradient.iter().fold(0.0f64, |m, g| m.max(g.abs()));
                    if largest == 0.0 {
                        continue;
                    }
                    let mut order: Vec<usize> = (0..gradient.len()).collect();
                    order.sort_by(|a, b| gradient[*b].abs().total_cmp(&gradient[*a].abs()));
                    for &entry in order.iter().take(ENTRIES) {
                        let mut moved = checkpoint.clone();
                        let at = checkpoint.tensors[&tensor].data[entry];
                        let mut loss_at = |to: f32| {
                            moved.tensors.get_mut(&tensor).unwrap().data[entry] = to;
                            loss64(&moved, &pieces, f64::from(scale))
                        };
                        let (up, down) = (at + STEP, at - STEP);
                        let slope = (loss_at(up) - loss_at(down)) / (f64::from(up) - f64::from(down));
                        let error = |g: f64| (g - slope).abs() / largest;
                        let found = gradient[entry];
                        let where_from = format!("{name} {tensor}[{entry}] {}: {found} {slope}", isa.name());
                        assert!(error(found) < tolerance, "{where_from}");
                        if found.abs() == largest {
                            assert!(error((1.0 + 5.0 * tolerance) * found) > tolerance, "{where_from}");
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn pieces_larger_than_a_tile_give_what_small_ones_do() {
    /// Sums of 8,192 terms in two orders.
    const ROUNDING: f64 = 1e-4;
    let (_, model, resolution) = materials::cases().remove(1);
    let checkpoint = materials::checkpoint(&model, resolution, 6);
    let terms = [Term { kind: Kind::L1, remap: Remap::Log, scale: 1e-3 }];
    let loss = Loss { terms: &terms, range: [0.0, 1.0], highest_level: None, offset_texture: true };
    let large = pieces(64, 8, 2);
    let small: Vec<Block> = large.iter().flat_map(|p| p.cut(8, resolution).unwrap()).collect();
    let isa = Isa::chosen().unwrap();
    let (whole, a) = gradients(&checkpoint, isa, &large, &loss);
    let (parts, b) = gradients(&checkpoint, isa, &small, &loss);
    assert!((whole - parts).abs() < ROUNDING * whole, "{whole} {parts}");
    let (a, b) =
        (by_tensor(&checkpoint.header.architecture, &a), by_tensor(&checkpoint.header.architecture, &b));
    let mut checked = 0;
    for ((name, a), (_, b)) in a.iter().zip(&b) {
        let largest = b.iter().fold(0.0f64, |m, g| m.max(g.abs()));
        let off = |scale: f64| a.iter().zip(b).map(|(a, b)| (a * scale - b).abs()).fold(0.0, f64::max);
        assert!(off(1.0) <= ROUNDING * largest, "{name}");
        assert!(largest == 0.0 || off(1.001) > ROUNDING * largest, "{name}");
        checked += usize::from(largest > 0.0);
    }
    assert!(checked > 10);
}

#[test]
fn gradients_are_the_same_bytes_on_any_number_of_threads() {
    let (_, model, resolution) = materials::cases().remove(1);
    let checkpoint = materials::checkpoint(&model, resolution, 6);
    let terms = [
        Term { kind: Kind::L2, remap: Remap::Root4Signed(1e-3), scale: 1.0 },
        Term { kind: Kind::Gradient, remap: Remap::Root4Signed(1e-3), scale: 0.03 },
    ];
    let pieces = pieces(16, 8, 40);
    for isa in Isa::all() {
        let loss = Loss { terms: &terms, range: [0.0, 1.0], highest_level: Some(2), offset_texture: true };
        let mut results = [1, 2, 4].map(|threads| {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let (value, sums) = pool.install(|| gradients(&checkpoint, isa, &pieces, &loss));
            (value.to_bits(), sums.networks, sums.pyramid, sums.offset)
        });
        assert!(results[0] == results[1] && results[0] == results[2], "{}", isa.name());
        results[0].1[0] = -results[0].1[0];
        assert!(results[0] != results[1]);
    }
}
