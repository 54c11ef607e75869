//! The decoder that reads neighbours: its answers do not depend on how a grid is asked, what is no grid is refused, and it
//! learns from whole slices.

use crate::{materials, plain};
use candle_core::Device;
use half::f16;
use neumip::checkpoint;
use neumip::config::{AdamConfig, Budget, Config, EngineKind, Remap, Term, TermKind};
use neumip::dataset::{
    Answers, Block, Dataset, Existing, GenerateConfig, Layout, Patch, Regime, Source, SplitName, generate,
};
use neumip::error::Result;
use neumip::evaluate::{costs, error_table, refusal, view_table};
use neumip::inference::answerer;
use neumip::model::texture::Sigmas;
use neumip::model::{NeuralMaterial, Variables};
use neumip::onnx_material::largest_difference;
use neumip::query::grid::{self, Mosaic};
use neumip::query::{QueryBuffer, Reflectance, Support, unit};
use neumip::random::{Random, Stream};
use neumip::trainer::{Learner, Step, Trainer};
use neumip_export::config::{DecoderConfig, InceptionConfig};
use neumip_export::{Checkpoint, Precision};
use std::ops::ControlFlow;
use std::path::Path;

/// |difference| / (1 + |value|) of f32 networks whose sums are taken in another order, as the exporter's.
const TOLERANCE: f64 = 2e-5;
/// As many texels as the margins of a network of two modules on both sides, and some more.
const TILE: [usize; 2] = [32, 16];

fn small(modules: usize) -> Checkpoint {
    let (_, mut model, _) = materials::image_cases().remove(0);
    if let DecoderConfig::Inception(inception) = &mut model.decoder {
        inception.modules = modules;
    }
    materials::checkpoint(&model, TILE, 3)
}

fn material(checkpoint: &Checkpoint) -> NeuralMaterial {
    NeuralMaterial::from_checkpoint(checkpoint, &Device::Cpu).unwrap()
}

/// What answers by default and what does when candle is asked for.
fn answerers(checkpoint: &Checkpoint) -> Vec<(String, Box<dyn Reflectance>)> {
    let kinds = [None, Some(EngineKind::Candle)];
    let of = |kind| answerer(checkpoint, kind, Precision::Single, &Device::Cpu).unwrap();
    kinds.map(of).map(|answerer| (answerer.engine, answerer.material)).into()
}

/// Rows `rows` and columns `columns` of a buffer, and where they are in it.
fn window(whole: &QueryBuffer, rows: [usize; 2], columns: [usize; 2]) -> (QueryBuffer, Vec<usize>) {
    let at: Vec<usize> = (rows[0]..rows[1])
        .flat_map(|i| (columns[0]..columns[1]).map(move |j| i * whole.width() + j))
        .collect();
    let pick = |v: &[[f32; 2]]| at.iter().map(|k| v[*k]).collect();
    let level = at.iter().map(|k| whole.level[*k]).collect();
    let (height, width) = (rows[1] - rows[0], columns[1] - columns[0]);
    let part =
        QueryBuffer::new(height, width, pick(&whole.u), pick(&whole.wi), pick(&whole.wo), level).unwrap();
    (part, at)
}

#[test]
fn candle_follows_float64_and_a_changed_weight_is_noticed() {
    for (name, model, resolution) in materials::image_cases() {
        let checkpoint = materials::checkpoint(&model, resolution, 5);
        let images = [2, 7, 9];
        let asked = materials::images(&checkpoint.header.architecture, images, 6);
        let features = |k: usize| plain::features(&checkpoint, asked.u[k], asked.wo[k], asked.level[k]);
        let features: Vec<Vec<f64>> = (0..asked.u.len()).map(features).collect();
        let exact = plain::decode_images(&checkpoint, &features, &asked);
        let error = |changed: &Checkpoint| {
            let (u, wi, wo) = (asked.u.clone(), asked.wi.clone(), asked.wo.clone());
            let queries = QueryBuffer::new(14, 9, u, wi, wo, asked.level.clone()).unwrap();
            let mosaic = Mosaic { down: 2, across: 1, height: 7, width: 9 };
            let answers = material(changed).images(&queries, mosaic).unwrap();
            let pairs = answers.as_flattened().iter().zip(exact.as_flattened());
            pairs.map(|(a, e)| (f64::from(*a) - e).abs() / (1.0 + e.abs())).fold(0.0, f64::max)
        };
        assert!(error(&checkpoint) < TOLERANCE, "{name}: {:e}", error(&checkpoint));
        let mut changed = checkpoint.clone();
        let kernel = &mut changed.tensors.get_mut("decoder.module0.path3.weight").unwrap().data;
        kernel.iter_mut().for_each(|v| *v += 1e-2);
        assert!(error(&changed) > TOLERANCE, "{name}");
    }
}

#[test]
fn a_part_of_a_tile_is_answered_as_in_the_whole_one_and_not_with_a_smaller_radius() {
    let checkpoint = small(1);
    let (_, resolution) = (0, TILE);
    let whole = QueryBuffer::slice(TILE[0], TILE[1], [0.3, 0.1], [-0.2, 0.4], 0.0);
    let reference = material(&checkpoint);
    let mosaic = Mosaic { down: 1, across: 1, height: TILE[0], width: TILE[1] };
    let expected = reference.images(&whole, mosaic).unwrap();
    assert_eq!(reference.support(), Support::Neighbourhood { radius: 2, resolution });
    let difference = |answers: &[[f32; 3]], at: &[usize]| {
        let expected: Vec<[f32; 3]> = at.iter().map(|k| expected[*k]).collect();
        largest_difference(answers, &expected)
    };
    for (name, material) in answerers(&checkpoint) {
        for (rows, columns) in
            [([0, 32], [0, 16]), ([3, 12], [2, 9]), ([20, 21], [15, 16]), ([0, 32], [0, 5])]
        {
            let (part, at) = window(&whole, rows, columns);
            let answers = material.evaluate(&part).unwrap();
            assert_eq!((answers.height, answers.width), (part.height(), part.width()));
            let found = difference(&answers.pixels, &at);
            assert!(found < TOLERANCE, "{name} {rows:?} {columns:?}: {found:e}");
        }
    }
    let (part, at) = window(&whole, [3, 12], [2, 9]);
    for (radius, right) in [(2, true), (1, false)] {
        let answers = grid::answer(&part, radius, resolution, &|q, m| reference.images(q, m)).unwrap();
        assert_eq!(difference(&answers, &at) < TOLERANCE, right, "radius {radius}");
    }
}

#[test]
fn a_block_of_small_tiles_is_answered_tile_by_tile() {
    let checkpoint = small(2);
    let architecture = &checkpoint.header.architecture;
    // Level 2 of 32 x 16 texels: patches of 4 x 4 are half a tile high.
    let pair = |k: usize| Patch {
        corner: [0.0, 0.5 * (k % 2) as f32],
        wi: [0.1 * k as f32 - 0.7, 0.2],
        wo: [0.3, 0.05 * k as f32],
    };
    let block = Layout::new(16, 4, 2.0, (0..16).map(pair).collect()).unwrap();
    let queries = block.queries(architecture.resolution);
    for (name, material) in answerers(&checkpoint) {
        let together = material.evaluate(&queries).unwrap().pixels;
        for (row, column) in [(0, 0), (4, 8), (12, 12)] {
            let (part, at) = window(&queries, [row, row + 4], [column, column + 4]);
            let alone = material.evaluate(&part).unwrap().pixels;
            let expected: Vec<[f32; 3]> = at.iter().map(|k| together[*k]).collect();
            assert!(largest_difference(&alone, &expected) < TOLERANCE, "{name} {row} {column}");
            let other: Vec<[f32; 3]> = at.iter().map(|k| together[(*k + 8) % 256]).collect();
            assert!(largest_difference(&alone, &other) > TOLERANCE, "{name} {row} {column}");
        }
    }
}

#[test]
fn what_is_no_regular_grid_is_refused_in_one_line() {
    let checkpoint = small(2);
    for (name, material) in answerers(&checkpoint) {
        let mut queries = QueryBuffer::slice(8, 8, [0.1; 2], [0.2; 2], 1.5);
        for _ in 0..2 {
            let problem = material.evaluate(&queries).unwrap_err();
            let line = problem.to_string();
            assert!(line.contains("query[0]") && line.contains("within 4 samples"), "{name}: {line}");
            assert!(line.contains("regular grids") && !line.contains('\n'), "{name}: {line}");
            assert_eq!(problem.exit_code(), 2);
            queries.level.fill(0.0);
            queries.u.iter_mut().for_each(|u| u[0] += 0.011);
        }
    }
}

#[test]
fn below_the_horizon_is_black_and_bad_weights_are_reported() {
    let mut checkpoint = small(1);
    for (name, material) in answerers(&checkpoint) {
        let queries = QueryBuffer::slice(TILE[0], TILE[1], [0.9, 0.9], [0.2; 2], 0.0);
        assert!(material.evaluate(&queries).unwrap().pixels.iter().all(|p| *p == [0.0; 3]), "{name}");
    }
    checkpoint.tensors.get_mut("decoder.out.bias").unwrap().data[0] = f32::NAN;
    for (name, material) in answerers(&checkpoint) {
        let queries = QueryBuffer::slice(TILE[0], TILE[1], [0.1; 2], [0.2; 2], 0.0);
        let problem = material.evaluate(&queries).unwrap_err().to_string();
        assert!(problem.contains("not finite"), "{name}: {problem}");
    }
}

#[test]
fn a_checkpoint_comes_back_and_one_of_another_shape_does_not() {
    let checkpoint = small(2);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("inception.safetensors");
    checkpoint.write(&path).unwrap();
    assert_eq!(Checkpoint::read(&path).unwrap(), checkpoint);
    let architecture = &checkpoint.header.architecture;
    let kernel = &checkpoint.tensors["decoder.module1.path3.weight"];
    assert_eq!(kernel.shape, [3, 2, 5, 5]);
    let weights = checkpoint.tensors.iter().filter(|(name, _)| !neumip::model::variables::is_texture(name));
    assert_eq!(weights.map(|(_, t)| t.data.len()).sum::<usize>(), architecture.network_weights());
    let mut other = checkpoint.clone();
    other.tensors.get_mut("decoder.module1.path3.weight").unwrap().shape = vec![3, 50];
    let problem = other.write(&path).unwrap_err().to_string();
    assert!(problem.contains("decoder.module1.path3.weight"), "{problem}");

    let mut model = architecture.model.clone();
    let wrong = InceptionConfig { width: 10, modules: 1, paths: [4, 4, 1, 2], reduce: [1, 1] };
    model.decoder = DecoderConfig::Inception(wrong);
    let problem = neumip_export::Architecture::new(model, TILE).unwrap_err().to_string();
    assert!(problem.contains("decoder.paths") && problem.contains("11"), "{problem}");
}

/// A piece with patches at these corners of a tile.
fn piece(patch: usize, level: f32, corners: &[[f32; 2]], seed: u64) -> Block {
    let mut random = Random::new(seed, Stream::Probe, 0);
    let patches = corners
        .iter()
        .map(|corner| Patch { corner: *corner, wi: random.disc(0.9), wo: random.disc(0.9) })
        .collect();
    let layout = Layout::new(16, patch, level, patches).unwrap();
    let rgb = (0..256).map(|_| [0; 3].map(|_| f16::from_f32(random.uniform()))).collect();
    Block::new(layout, rgb, 0.0).unwrap()
}

/// Values by tensor.
type Named = (String, Vec<f32>);

/// The loss of a step and its gradients by every tensor.
fn gradients(checkpoint: &Checkpoint, engine: EngineKind, pieces: &[Block]) -> (f64, Vec<Named>) {
    // Without memory, and with an epsilon above any gradient, Adam's step is the gradient.
    const HUGE: f64 = 1e6;
    let adam = AdamConfig { beta1: 0.0, beta2: 0.0, epsilon: HUGE };
    let architecture = &checkpoint.header.architecture;
    let variables = Variables::from_stored(architecture, &checkpoint.tensors, &Device::Cpu).unwrap();
    let mut learner = Learner::new(architecture, variables, adam, Some(engine), &Device::Cpu).unwrap();
    let terms = [
        Term { kind: TermKind::L2, remap: Remap::Linear, weight: 30.0 },
        Term { kind: TermKind::Gradient, remap: Remap::Root4Signed(0.1), weight: 3.0 },
    ];
    let step = Step {
        pieces,
        terms: &terms,
        target_range: [0.0, 1000.0],
        highest_level: Some(2),
        offset_texture: true,
    };
    let loss = learner.step(&step, &Sigmas::none(architecture)).unwrap();
    learner.update_networks(HUGE, 1).unwrap();
    learner.update_textures(HUGE, 1, true).unwrap();
    let after = learner.variables().to_stored().unwrap();
    let difference = |(name, after): (String, neumip_export::Tensor)| {
        let before = &checkpoint.tensors[&name].data;
        let difference = before.iter().zip(&after.data).map(|(before, after)| before - after).collect();
        (name, difference)
    };
    (loss, after.into_iter().map(difference).collect())
}

#[test]
fn engines_agree_on_losses_and_gradients_of_whole_tiles_and_of_parts() {
    /// Largest difference over a tensor's largest gradient: f32 sums over a few hundred samples, and the values
    /// themselves, which the gradients are read from.
    const AGREEMENT: f32 = 2e-3;
    let (_, model, _) = materials::image_cases().remove(0);
    let checkpoint = materials::checkpoint(&model, [32, 32], 9);
    let quarters = [[0.0, 0.0], [0.5, 0.0], [0.0, 0.5], [0.25, 0.5]];
    let pieces = [
        // Part of a tile, whose margin of 4 does not count; whole tiles; one whose level is left out.
        piece(16, 0.0, &[[0.25, 0.5]], 1),
        piece(16, 1.0, &[[0.0, 0.0]], 2),
        piece(8, 2.0, &quarters, 3),
        piece(4, 3.0, &[[0.0; 2]; 16], 4),
    ];
    let worst = |a: &[Named], b: &[Named]| -> (f32, String) {
        let of = |((name, a), (_, b)): (&Named, &Named)| {
            let scale = a.iter().fold(0.0f32, |m, v| m.max(v.abs()));
            let difference = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            // The piece that reads the coarsest levels is left out.
            assert!(scale > 0.0 || ["texture.level3", "texture.level4"].contains(&&**name), "{name}");
            (difference / scale.max(1e-6), name.clone())
        };
        a.iter().zip(b).map(of).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
    };
    let (loss, candle) = gradients(&checkpoint, EngineKind::Candle, &pieces);
    let (other, fused) = gradients(&checkpoint, EngineKind::Fused, &pieces);
    assert!((loss - other).abs() < 1e-5 * loss, "{loss} {other}");
    let (difference, name) = worst(&candle, &fused);
    println!("engines differ by {difference:.1e} of the largest gradient of {name}");
    assert!(difference < AGREEMENT, "{name}: {difference:e}");
    let mut changed = checkpoint.clone();
    changed.tensors.get_mut("decoder.module1.path2.weight").unwrap().data[0] += 1e-2;
    assert!(worst(&candle, &gradients(&changed, EngineKind::Fused, &pieces).1).0 > AGREEMENT);
    // A sample of the margin teaches nothing, one inside does.
    for (at, counts) in [(0, false), (8 * 16 + 8, true)] {
        let mut moved = pieces[0].rgb().to_vec();
        moved[at] = [f16::from_f32(3.0); 3];
        let moved = Block::new(pieces[0].layout().clone(), moved, 0.0).unwrap();
        for engine in [EngineKind::Candle, EngineKind::Fused] {
            let before = gradients(&checkpoint, engine, &pieces[..1]).0;
            assert_eq!(gradients(&checkpoint, engine, std::slice::from_ref(&moved)).0 != before, counts);
        }
    }
}

/// Stripes that shift with the light.
struct Stripes;

impl Source for Stripes {
    fn name(&self) -> &str {
        "stripes"
    }

    fn height_range(&self) -> [f32; 2] {
        [0.0, 0.0]
    }

    fn height_map(&self) -> Option<(usize, usize, Vec<f32>)> {
        None
    }

    fn measure(&self, q: &QueryBuffer, _: usize, _: u64, _: u64) -> Result<Answers> {
        let answer = |k: usize| {
            let wave = (std::f32::consts::TAU * (q.u[k][0] + 0.1 * q.wi[k][0])).sin();
            [0, 1, 2]
                .map(|c| unit(q.wi[k])[2] * (0.3 + 0.1 * c as f32 + 0.2 * wave * (-0.3 * q.level[k]).exp2()))
        };
        Ok(Answers { rgb: (0..q.len()).map(answer).collect(), variance: vec![0.0; q.len()], rays: 0 })
    }

    fn description(&self) -> serde_json::Value {
        "stripes".into()
    }
}

fn data(folder: &Path, regime: Regime) -> Dataset {
    let mut config = GenerateConfig::new(16);
    config.regime = regime;
    config.samples = 40_000;
    config.validation_samples = 1024;
    (config.test_pairs, config.view_size, config.file_samples) = (4, 8, 16_384);
    let out = folder.join(format!("data-{regime}"));
    generate(&Stripes, &config, &out, Existing::Refuse, &mut |_| ControlFlow::Continue(())).unwrap();
    Dataset::open(&out).unwrap()
}

fn config(steps: u64, engine: Option<EngineKind>) -> Config {
    let mut config = Config::preset("inception-small").unwrap();
    // A radius of 2 leaves something of a tile of 16 x 16.
    config.set("model.decoder.modules=1").unwrap();
    config.train.budget = Budget::Steps(steps);
    (config.train.batch, config.train.piece) = (1024, 16);
    config.train.learning_rate.peak = 5e-3;
    (config.train.smoothing, config.train.validations) = (None, 2);
    config.train.engine = engine;
    config
}

fn train(config: Config, data: &Dataset, out: &Path) -> Result<()> {
    let mut trainer = Trainer::new(config, data, out, false, 1 << 30, &Device::Cpu)?;
    trainer.run(&mut |_| ControlFlow::Continue(()))
}

#[test]
fn it_learns_from_slices_and_is_evaluated_where_it_can_be() {
    /// Held-out PSNR, dB, between what the steps reach and what fresh weights have.
    const LEARNED: f64 = 18.0;
    let folder = tempfile::tempdir().unwrap();
    let data = data(folder.path(), Regime::Slices(24));
    for (engine, name) in [(None, "default"), (Some(EngineKind::Candle), "candle")] {
        for (steps, learned) in [(120, true), (1, false)] {
            let out = folder.path().join(format!("{name}-{steps}"));
            train(config(steps, engine), &data, &out).unwrap();
            let material = material(&checkpoint::load(&out).unwrap());
            let rows = error_table(&material, &data, &[SplitName::Test, SplitName::Offgrid], None).unwrap();
            let psnr = rows.iter().find(|r| r.level.is_none()).unwrap().psnr.unwrap();
            println!("{name}, {steps} steps: {psnr:.1} dB");
            assert_eq!(psnr > LEARNED, learned, "{name}, {steps} steps: {psnr} dB");
            assert!(rows.iter().all(|r| r.split == "test"));
            assert!(view_table(&material, &data, None).unwrap().is_empty());
            assert_eq!(refusal(&material, &data, SplitName::Test).unwrap(), None);
            let why = refusal(&material, &data, SplitName::Offgrid).unwrap().unwrap();
            assert!(why.starts_with("offgrid is left out: query["), "{why}");
            let cost = costs(&[&material], 4, 512, 1).unwrap();
            assert_eq!(cost[0].queries, 512);
        }
    }
}

#[test]
fn scattered_data_and_small_pieces_are_refused_before_a_run_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let scattered = data(folder.path(), Regime::Scattered);
    let slices = data(folder.path(), Regime::Slices(24));
    let out = folder.path().join("run");
    let mut cut = config(1, None);
    cut.train.piece = 8;
    for (config, data, causes) in [
        (config(1, None), &scattered, ["--regime slices", "within 2 samples"]),
        (cut, &slices, ["train.piece: 8", "use 16"]),
    ] {
        let problem = train(config, data, &out).unwrap_err();
        let line = problem.to_string();
        assert!(causes.iter().all(|cause| line.contains(cause)), "{line}");
        assert!(problem.exit_code() == 2 && !out.exists(), "{line}");
    }
}

#[test]
fn a_run_is_the_same_bytes_on_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let data = data(folder.path(), Regime::Slices(24));
    for engine in [None, Some(EngineKind::Candle)] {
        let runs = [1, 3].map(|threads| {
            let out = folder.path().join(format!("{engine:?}-{threads}"));
            let pool = rayon_pool(threads);
            pool.install(|| train(config(5, engine), &data, &out)).unwrap();
            let checkpoint = checkpoint::load(&out).unwrap();
            checkpoint.tensors
        });
        assert_eq!(runs[0], runs[1], "{engine:?}");
        let out = folder.path().join(format!("{engine:?}-other"));
        let mut other = config(5, engine);
        other.train.seed += 1;
        train(other, &data, &out).unwrap();
        assert_ne!(checkpoint::load(&out).unwrap().tensors, runs[0]);
    }
}

fn rayon_pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap()
}
