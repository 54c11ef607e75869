//! Datasets: what is written is read back, a killed run leaves a smaller dataset, every order is repeatable.

#[path = "dataset/amounts.rs"]
mod amounts;
#[path = "dataset/files.rs"]
mod files;
#[path = "dataset/motion.rs"]
mod motion;
#[path = "dataset/shards.rs"]
mod shards;

use neumip::dataset::{
    Answers, Block, CONTACT_SHEET, Dataset, Existing, GenerateConfig, Layout, MANIFEST, Manifest, Patch,
    Progress, Regime, SCENES, Scene, Source, SplitName, Stream, Writer, generate, read_query_frame,
    write_query_frame,
};
use neumip::error::{Error, Result};
use neumip::query::{QueryBuffer, RgbImage, above_horizon, unit};
use neumip::random::{Random, Stream as RandomStream};
use rayon::prelude::*;
use std::{
    collections::{BTreeMap, BTreeSet},
    ops::ControlFlow,
    path::Path,
};

/// Half floats have 11 significant bits.
const HALF: f32 = 1.0 / 2048.0;
/// Positions are sums of two f32 values below 1, rounded once more.
const POSITION: f32 = 2.0 / 16_777_216.0;

/// A smooth function of everything that is asked, with noise that depends on the query's number.
struct Smooth {
    noise: f32,
    poison: bool,
}

const QUIET: Smooth = Smooth { noise: 0.0, poison: false };
const NOISY: Smooth = Smooth { noise: 0.1, poison: false };

impl Smooth {
    fn answer(&self, u: [f32; 2], wi: [f32; 2], wo: [f32; 2], level: f32) -> [f32; 3] {
        if !above_horizon(wi) || !above_horizon(wo) {
            return [0.0; 3];
        }
        let wave = (std::f32::consts::TAU * u[0]).sin() * (std::f32::consts::TAU * u[1]).cos();
        let base = unit(wi)[2] * (2.0 + wave / (1.0 + level));
        [base, base * (1.5 + wi[0] * wo[1]), 0.25 * base + wo[0] * wo[0]]
    }
}

impl Source for Smooth {
    fn name(&self) -> &str {
        "smooth"
    }

    fn height_range(&self) -> [f32; 2] {
        [-0.01, 0.02]
    }

    fn height_map(&self) -> Option<(usize, usize, Vec<f32>)> {
        Some((4, 8, (0..32).map(|k| 0.001 * k as f32 - 0.01).collect()))
    }

    fn measure(&self, queries: &QueryBuffer, spp: usize, seed: u64, first: u64) -> Result<Answers> {
        let rgb = (0..queries.len()).into_par_iter().map(|k| {
            let mut random = Random::new(seed, RandomStream::Reference, first + k as u64);
            let shift = self.noise * random.normal() / (spp as f32).sqrt();
            let answer = self.answer(queries.u[k], queries.wi[k], queries.wo[k], queries.level[k]);
            answer.map(|v| if self.poison && k == 7 { f32::NAN } else { v + shift })
        });
        let variance = vec![self.noise * self.noise / spp as f32; queries.len()];
        Ok(Answers { rgb: rgb.collect(), variance, rays: 3 * queries.len() as u64 * spp as u64 })
    }

    fn description(&self) -> serde_json::Value {
        serde_json::json!({ "kind": "smooth", "noise": self.noise })
    }
}

/// Every split on a tile of 16 x 16, a few files each.
fn small() -> GenerateConfig {
    GenerateConfig {
        samples: 200 * 64,
        validation_samples: 64,
        offgrid_samples: 64,
        grazing_samples: 64,
        test_pairs: 5,
        view_size: 12,
        block_side: 8,
        file_samples: 4096,
        seed: 3,
        ..GenerateConfig::new(16)
    }
}

fn go(_: Progress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn make(folder: &Path, config: &GenerateConfig) -> Dataset {
    generate(&NOISY, config, folder, Existing::Refuse, &mut go).unwrap();
    Dataset::open(folder).unwrap()
}

fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    entries.map(|e| (e.file_name().into_string().unwrap(), std::fs::read(e.path()).unwrap())).collect()
}

fn blocks(data: &Dataset, name: SplitName) -> Vec<Block> {
    let split = data.split(name).unwrap();
    (0..split.files()).flat_map(|file| split.read_file(file).unwrap()).collect()
}

/// Largest relative difference of a block from what the source says without noise.
fn difference(source: &Smooth, block: &Block, resolution: [usize; 2]) -> f32 {
    let queries = block.queries(resolution);
    let target = block.target();
    let each = (0..queries.len()).flat_map(|k| {
        let answer = source.answer(queries.u[k], queries.wi[k], queries.wo[k], queries.level[k]);
        (0..3).map(move |c| (k, c, answer[c]))
    });
    each.map(|(k, c, answer)| (target[k][c] - answer).abs() / answer.abs().max(HALF)).fold(0.0, f32::max)
}

#[test]
fn every_split_holds_what_the_source_says() {
    let folder = tempfile::tempdir().unwrap();
    generate(&QUIET, &small(), folder.path(), Existing::Refuse, &mut go).unwrap();
    let data = Dataset::open(folder.path()).unwrap();
    assert!(data.manifest().complete);
    assert_eq!(data.split_names(), SplitName::ALL);
    for name in SplitName::ALL {
        let all = blocks(&data, name);
        assert_eq!(all.len(), data.manifest().splits[&name].planned_blocks);
        for block in &all {
            assert!(difference(&QUIET, block, data.resolution()) <= HALF);
        }
        // One value that is off by a percent is noticed.
        let mut rgb = all[0].rgb().to_vec();
        rgb[5][0] *= half::f16::from_f32(1.01);
        let off = Block::new(all[0].layout().clone(), rgb, 0.0).unwrap();
        assert!(difference(&QUIET, &off, data.resolution()) > HALF);
    }
    let (height, width, values) = data.read_heights().unwrap().unwrap();
    assert_eq!(Some((height, width, values)), QUIET.height_map());
    assert_eq!(data.manifest().height_range, QUIET.height_range());
}

#[test]
fn heights_can_be_withheld() {
    let folder = tempfile::tempdir().unwrap();
    let data = make(folder.path(), &GenerateConfig { heights: false, ..small() });
    assert_eq!(data.read_heights().unwrap(), None);
    assert!(!folder.path().join("height.exr").exists());
}

#[test]
fn noise_is_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let data = make(folder.path(), &small());
    for name in SplitName::ALL {
        let info = &data.manifest().splits[&name];
        let expected = NOISY.noise / (info.spp.unwrap() as f32).sqrt();
        // Means of equal values, in single precision.
        assert!((info.noise / expected - 1.0).abs() < 1e-5, "{} {expected}", info.noise);
        assert!((info.files[0].summary.variance / (expected * expected) - 1.0).abs() < 1e-5);
        assert!((info.noise / (1.1 * expected) - 1.0).abs() > 1e-5);
    }
}

#[test]
fn a_stopped_run_leaves_a_smaller_dataset_and_resumes_to_the_same_bytes() {
    let whole = tempfile::tempdir().unwrap();
    make(whole.path(), &small());
    let expected = contents(whole.path());
    // After the n-th chunk: in the first split, in a held-out one or a view, in training data.
    for n in [1, 5, 8] {
        let folder = tempfile::tempdir().unwrap();
        let mut left = n;
        let mut last = None;
        let stopped = generate(&NOISY, &small(), folder.path(), Existing::Refuse, &mut |progress| {
            left -= 1;
            last = Some(progress);
            if left == 0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        assert!(matches!(stopped, Err(Error::Interrupted(_))));
        let last = last.unwrap();
        assert!(last.done < last.total);
        std::fs::write(folder.path().join(".neumip-killed"), "half a file").unwrap();
        match Dataset::open(folder.path()) {
            Ok(data) => {
                assert!(!data.manifest().complete);
                let train = blocks(&data, SplitName::Train).len();
                assert!(train > 0 && train < data.manifest().splits[&SplitName::Train].planned_blocks);
                assert_eq!(
                    blocks(&data, SplitName::Test).len(),
                    data.manifest().splits[&SplitName::Test].planned_blocks
                );
            }
            Err(error) => {
                assert_ne!(last.split, "train");
                assert!(error.to_string().contains("no training data yet"), "{error}");
            }
        }
        generate(&NOISY, &small(), folder.path(), Existing::Resume, &mut go).unwrap();
        assert_eq!(contents(folder.path()), expected);
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let run = |threads: usize, seed: u64| {
        let folder = tempfile::tempdir().unwrap();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| make(folder.path(), &GenerateConfig { seed, ..small() }));
        contents(folder.path())
    };
    let one = run(1, 3);
    assert_eq!(one, run(2, 3));
    assert_eq!(one, run(4, 3));
    assert_ne!(one, run(1, 4));
}

#[test]
fn an_existing_folder_is_not_lost() {
    let folder = tempfile::tempdir().unwrap();
    make(folder.path(), &small());
    let before = contents(folder.path());
    let refused = generate(&NOISY, &small(), folder.path(), Existing::Refuse, &mut go).unwrap_err();
    assert!(refused.to_string().contains("holds a dataset already"), "{refused}");
    let other = GenerateConfig { spp: 17, ..small() };
    let refused = generate(&NOISY, &other, folder.path(), Existing::Resume, &mut go).unwrap_err();
    assert!(refused.to_string().contains("generation.spp differs"), "{refused}");
    let refused = generate(&QUIET, &small(), folder.path(), Existing::Resume, &mut go).unwrap_err();
    assert!(refused.to_string().contains("source differs"), "{refused}");
    assert_eq!(contents(folder.path()), before);

    std::fs::write(folder.path().join("notes.txt"), "mine").unwrap();
    let fewer = GenerateConfig { samples: 64, view_size: 0, ..small() };
    generate(&NOISY, &fewer, folder.path(), Existing::Replace, &mut go).unwrap();
    let after = contents(folder.path());
    assert!(after.contains_key("notes.txt") && !after.contains_key("views-s2.exr"));
    assert!(!after.contains_key("train-00003.exr") && before.contains_key("train-00003.exr"));

    let foreign = tempfile::tempdir().unwrap();
    std::fs::write(foreign.path().join("notes.txt"), "mine").unwrap();
    for existing in [Existing::Refuse, Existing::Resume, Existing::Replace] {
        let refused = generate(&NOISY, &small(), foreign.path(), existing, &mut go).unwrap_err();
        assert!(refused.to_string().contains("not a dataset"), "{refused}");
    }
}

#[test]
fn levels_have_the_shares_that_are_stated() {
    let folder = tempfile::tempdir().unwrap();
    let config = GenerateConfig { samples: 400 * 64, ..small() };
    let data = make(folder.path(), &config);
    let train = blocks(&data, SplitName::Train);
    let info = &data.manifest().splits[&SplitName::Train];
    for (level, planned) in config.level_shares().into_iter().enumerate() {
        let count = train.iter().filter(|block| block.level().round() as usize == level).count();
        let share = count as f32 / train.len() as f32;
        assert_eq!(share, info.level_shares[level]);
        // The cycle of levels misses a share by a few blocks at most.
        assert!(
            (f64::from(share) - planned).abs() < 4.0 / train.len() as f64,
            "level {level}: {share}, {planned}"
        );
        assert!(share >= 0.04);
    }
    let fractional = train.iter().filter(|block| block.level().fract() != 0.0).count() as f32;
    // A quarter of 400, give or take one of each of the six kinds of levels between two.
    assert!((94.0..=106.0).contains(&fractional), "{fractional}");
    for name in [SplitName::Test, SplitName::Grazing] {
        assert!(blocks(&data, name).iter().all(|block| block.level().fract() == 0.0));
    }
    assert!(blocks(&data, SplitName::Offgrid).iter().all(|block| block.level().fract() != 0.0));
}

#[test]
fn patches_never_cross_and_never_lap_the_tile() {
    let folder = tempfile::tempdir().unwrap();
    let data = make(folder.path(), &small());
    for name in SplitName::ALL {
        for block in blocks(&data, name) {
            let (side, patch) = (block.side(), block.patch());
            assert!(patch as f32 * block.level().exp2() <= 16.0 && patch >= 2);
            assert_eq!(block.patches().len(), (side / patch) * (side / patch));
            let queries = block.queries(data.resolution());
            let step = block.level().exp2() / 16.0;
            let apart = |a: f32, b: f32| (b - a).rem_euclid(1.0);
            for k in 0..side * side {
                let (row, column) = (k / side, k % side);
                let own = block.patches()[row / patch * (side / patch) + column / patch];
                assert_eq!((queries.wi[k], queries.wo[k]), (own.wi, own.wo));
                if column % patch > 0 {
                    let d = apart(queries.u[k - 1][0], queries.u[k][0]);
                    assert!((d - step).abs() < 2.0 * POSITION || (d - step).abs() > 1.0 - 2.0 * POSITION);
                    assert_eq!(queries.u[k - 1][1], queries.u[k][1]);
                }
            }
        }
    }
}

#[test]
fn test_slices_lie_on_the_grid_and_share_no_direction_with_training() {
    let folder = tempfile::tempdir().unwrap();
    let data = make(folder.path(), &small());
    let key = |p: &Patch| (p.wi.map(f32::to_bits), p.wo.map(f32::to_bits));
    let pairs = |name| -> BTreeSet<_> {
        blocks(&data, name).iter().flat_map(|b| b.patches().iter().map(key).collect::<Vec<_>>()).collect()
    };
    let train = pairs(SplitName::Train);
    for name in &SplitName::ALL[1..] {
        assert!(pairs(*name).is_disjoint(&train), "{name}");
    }
    let test = blocks(&data, SplitName::Test);
    assert_eq!(test.iter().filter(|b| b.level() == 0.0).count(), 5);
    for block in &test {
        let patch = block.patches()[0];
        let queries = block.queries(data.resolution());
        if block.level() == 0.0 {
            assert_eq!(queries, QueryBuffer::slice(16, 16, patch.wi, patch.wo, 0.0));
        }
        assert!(block.patches().iter().all(|p| p.corner == [0.0; 2]));
    }
    for level in 0..4 {
        let at_level = test.iter().filter(|b| b.level() == level as f32);
        assert!(at_level.map(|b| b.patches().len()).sum::<usize>() >= 5);
    }
}

#[test]
fn the_nearest_training_pair_is_the_nearest() {
    let folder = tempfile::tempdir().unwrap();
    let data = make(folder.path(), &small());
    let train: Vec<Patch> =
        blocks(&data, SplitName::Train).iter().flat_map(|b| b.patches().to_vec()).collect();
    let angle = |a: [f32; 2], b: [f32; 2]| {
        let (a, b) = (unit(a).map(f64::from), unit(b).map(f64::from));
        (0..3).map(|c| a[c] * b[c]).sum::<f64>().min(1.0).acos().to_degrees()
    };
    let mut seen = BTreeSet::new();
    let mut all = Vec::new();
    for p in blocks(&data, SplitName::Test).iter().flat_map(|b| b.patches()) {
        if seen.len() < 512 && seen.insert((p.wi.map(f32::to_bits), p.wo.map(f32::to_bits))) {
            let distance = train.iter().map(|t| angle(t.wi, p.wi).hypot(angle(t.wo, p.wo)));
            all.push(distance.fold(f64::INFINITY, f64::min));
        }
    }
    let stated = data.manifest().splits[&SplitName::Test].nearest_training.unwrap();
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    // Stored in single precision.
    assert!((f64::from(stated.mean_degrees) - mean).abs() < 1e-4 * mean);
    assert!((f64::from(stated.min_degrees) - all.iter().copied().fold(180.0, f64::min)).abs() < 1e-3);
    assert!((f64::from(stated.mean_degrees) - 1.01 * mean).abs() > 1e-4 * mean);
    assert!(data.manifest().splits[&SplitName::Train].nearest_training.is_none());
}

#[test]
fn slices_are_whole_images_of_few_pairs() {
    let folder = tempfile::tempdir().unwrap();
    let data =
        make(folder.path(), &GenerateConfig { regime: Regime::Slices(6), file_samples: 1024, ..small() });
    let train = blocks(&data, SplitName::Train);
    let mut pairs = BTreeSet::new();
    for block in &train {
        assert_eq!(block.side(), 16);
        pairs.extend(block.patches().iter().map(|p| (p.wi.map(f32::to_bits), p.wo.map(f32::to_bits))));
    }
    assert_eq!(pairs.len(), 6);
    assert_eq!(train.iter().filter(|b| b.level() == 0.0).count(), 6);
    assert!(serde_json::from_str::<Regime>("\"slices-\"").is_err());
}

#[test]
fn a_single_pair_of_directions_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let manifest = Manifest::new("imported", serde_json::Value::Null, [8, 12], [0.0, 0.0]);
    let block = |wi: [f32; 2]| {
        let patch = Patch { corner: [0.25, 0.5], wi, wo: [0.0; 2] };
        let layout = Layout::new(4, 4, 0.0, vec![patch]).unwrap();
        Block::new(layout, vec![[half::f16::ONE; 3]; 16], 0.0).unwrap()
    };
    let mut writer = Writer::create(folder.path(), manifest.clone(), Existing::Refuse).unwrap();
    writer.plan_split(SplitName::Train, 4, 3, None).unwrap();
    writer.push(SplitName::Train, &[block([0.1, 0.2]), block([0.1, 0.2])]).unwrap();
    let error = Dataset::open(folder.path()).unwrap_err();
    assert!(error.to_string().contains("single pair"), "{error}");
    writer.push(SplitName::Train, &[block([0.1, 0.3])]).unwrap();
    writer.finish().unwrap();
    assert_eq!(blocks(&Dataset::open(folder.path()).unwrap(), SplitName::Train).len(), 3);
    assert!(Manifest { resolution: [0, 8], ..manifest }.validate().is_err());
}

#[test]
fn pieces_keep_positions_and_answers() {
    let folder = tempfile::tempdir().unwrap();
    let data = make(folder.path(), &small());
    let resolution = data.resolution();
    for block in blocks(&data, SplitName::Train).iter().chain(&blocks(&data, SplitName::Test)) {
        let (side, queries) = (block.side(), block.queries(resolution));
        for piece_side in [2, 4, side] {
            for (index, piece) in block.cut(piece_side, resolution).unwrap().iter().enumerate() {
                let (y, x) =
                    (index / (side / piece_side) * piece_side, index % (side / piece_side) * piece_side);
                let cut = piece.queries(resolution);
                let moved = |k: usize, by: f32| {
                    let whole = (y + k / piece_side) * side + x + k % piece_side;
                    assert_eq!(piece.rgb()[k], block.rgb()[whole]);
                    assert_eq!(
                        (cut.wi[k], cut.wo[k], cut.level[k]),
                        (queries.wi[whole], queries.wo[whole], queries.level[whole])
                    );
                    let d = [0, 1].map(|c| (cut.u[k][c] + by - queries.u[whole][c]).abs());
                    d.iter().all(|d| *d < POSITION || *d > 1.0 - POSITION)
                };
                for k in 0..piece_side * piece_side {
                    assert!(moved(k, 0.0) && !moved(k, 0.001));
                }
            }
        }
        assert!(block.cut(3, resolution).is_err() && block.cut(0, resolution).is_err());
    }
}

/// What tells a piece from every other.
fn identity(piece: &Block) -> String {
    format!("{:?} {:?} {:?}", piece.patches()[0], piece.level(), piece.rgb()[0])
}

#[test]
fn an_epoch_shows_every_piece_once_in_any_memory() {
    let folder = tempfile::tempdir().unwrap();
    let data = make(folder.path(), &small());
    let expected: BTreeSet<String> = blocks(&data, SplitName::Train)
        .iter()
        .flat_map(|block| block.cut(4, data.resolution()).unwrap())
        .map(|piece| identity(&piece))
        .collect();
    let mut orders = Vec::new();
    for memory in [1, 100_000, usize::MAX] {
        let mut stream = Stream::new(&data, SplitName::Train, 4, 7, memory, 5).unwrap();
        assert_eq!(stream.epoch_pieces(), expected.len() as u64);
        assert_eq!(stream.in_memory(), memory == usize::MAX);
        let n = expected.len();
        let mut order: Vec<String> = Vec::new();
        while order.len() < 3 * n {
            order.extend(stream.next_batch().unwrap().pieces.iter().map(identity));
        }
        for epoch in 0..3 {
            let seen: BTreeSet<String> = order[epoch * n..(epoch + 1) * n].iter().cloned().collect();
            assert_eq!(seen, expected, "memory {memory} epoch {epoch}");
        }
        assert_ne!(order[..n], order[n..2 * n]);
        orders.push(order);
    }
    assert_ne!(orders[0], orders[2]);
}

#[test]
fn seeking_equals_stepping() {
    let folder = tempfile::tempdir().unwrap();
    let data = make(folder.path(), &small());
    for memory in [1, 100_000, usize::MAX] {
        let open = |seed| Stream::new(&data, SplitName::Train, 8, 9, memory, seed).unwrap();
        let mut stream = open(5);
        let stepped: Vec<_> = (0..70).map(|_| stream.next_batch().unwrap()).collect();
        let mut sought = open(5);
        for step in [0u64, 69, 3, 22, 23, 44, 45, 46, 1] {
            sought.seek(step);
            assert_eq!(sought.step(), step);
            let batch = sought.next_batch().unwrap();
            assert_eq!(batch.step, step);
            assert_eq!(batch, stepped[step as usize], "memory {memory} step {step}");
        }
        assert_ne!(open(6).next_batch().unwrap(), stepped[0]);
        let batch = &stepped[0];
        let queries = batch.queries(data.resolution());
        assert_eq!((queries.height(), queries.width()), (9 * 8, 8));
        assert_eq!(queries.u[8 * 64..], batch.pieces[8].queries(data.resolution()).u);
        assert_eq!(batch.target()[8 * 64..], batch.pieces[8].target());
    }
    let open = |piece, pieces| Stream::new(&data, SplitName::Train, piece, pieces, 1, 0);
    assert!(
        open(3, 1).is_err() && open(0, 1).is_err() && open(8, 0).is_err() && open(8, usize::MAX).is_err()
    );
}

#[test]
fn views_are_pictures_of_the_plane() {
    let folder = tempfile::tempdir().unwrap();
    generate(&QUIET, &small(), folder.path(), Existing::Refuse, &mut go).unwrap();
    let data = Dataset::open(folder.path()).unwrap();
    assert_eq!(data.manifest().views.len(), SCENES.len());
    for (view, scene) in data.manifest().views.iter().zip(SCENES) {
        let (queries, rgb) = data.read_view(&view.name).unwrap();
        assert_eq!(queries, scene.queries(12, 1, [16, 16]));
        for k in 0..queries.len() {
            let answer = QUIET.answer(queries.u[k], queries.wi[k], queries.wo[k], queries.level[k]);
            for (stored, exact) in rgb.pixels[k].iter().zip(answer) {
                assert!((stored - exact).abs() <= HALF * exact.abs());
            }
        }
    }
    let lights = vec![[60.0, 210.0], [45.0, 30.0], [12.5, 0.0]];
    let folder = tempfile::tempdir().unwrap();
    let data = make(folder.path(), &GenerateConfig { lights, ..small() });
    let names: Vec<&str> = data.manifest().views.iter().map(|view| view.name.as_str()).collect();
    assert_eq!(names, ["light-60-210", "s4", "light-12p5-0"]);
    let (queries, _) = data.read_view(names[0]).unwrap();
    assert_eq!(queries, Scene::new(60.0, 210.0).queries(12, 1, [16, 16]));
    assert!(data.read_view("s3").unwrap_err().to_string().contains("no view s3"));
}

#[test]
fn a_query_frame_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frame.exr");
    let queries = SCENES[1].queries(9, 2, [64, 32]);
    let pixels: Vec<_> = (0..81).map(|k| [k as f32 / 64.0, 0.5, 1e6]).collect();
    let rgb = RgbImage { height: 9, width: 9, pixels };
    write_query_frame(&path, &queries, &rgb).unwrap();
    let (read, answers) = read_query_frame(&path).unwrap();
    assert_eq!(read, queries);
    // Beyond the range of half floats is their largest value.
    assert_eq!(answers.pixels[80], [1.25, 0.5, 65504.0]);

    let short = RgbImage { height: 3, ..rgb };
    assert!(write_query_frame(&path, &queries, &short).is_err());
}

#[test]
fn a_header_cannot_allocate_what_the_file_cannot_hold() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frame.exr");
    let queries = SCENES[0].queries(9, 1, [64, 64]);
    write_query_frame(&path, &queries, &RgbImage { height: 9, width: 9, pixels: vec![[0.5; 3]; 81] })
        .unwrap();
    for width in [1u32 << 20, 1 << 28] {
        let mut bytes = std::fs::read(&path).unwrap();
        for name in ["dataWindow\0box2i\0", "displayWindow\0box2i\0"] {
            let at = bytes.windows(name.len()).position(|w| w == name.as_bytes()).unwrap() + name.len() + 4;
            bytes[at + 8..at + 12].copy_from_slice(&width.to_le_bytes());
        }
        let large = folder.path().join("large.exr");
        std::fs::write(&large, &bytes).unwrap();
        let error = read_query_frame(&large).unwrap_err().to_string();
        assert!(error.contains("declares") || error.contains("outside"), "{error}");
    }
}

/// Changes one file of a copy of a dataset and returns what opening and reading everything says.
fn damaged(original: &BTreeMap<String, Vec<u8>>, name: &str, change: impl Fn(&mut Vec<u8>)) -> Result<()> {
    let folder = tempfile::tempdir().unwrap();
    for (file, bytes) in original {
        let mut bytes = bytes.clone();
        if file == name {
            change(&mut bytes);
        }
        std::fs::write(folder.path().join(file), bytes).unwrap();
    }
    let data = Dataset::open(folder.path())?;
    for split in data.split_names() {
        let split = data.split(split)?;
        (0..split.files()).try_for_each(|file| split.read_file(file).map(drop))?;
    }
    data.read_heights()?;
    data.manifest().views.iter().try_for_each(|view| data.read_view(&view.name).map(drop))
}

#[test]
fn damage_is_named_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    make(folder.path(), &small());
    let original = contents(folder.path());
    let cut = |bytes: &mut Vec<u8>| bytes.truncate(bytes.len() - 9);
    let flip = |bytes: &mut Vec<u8>| bytes.iter_mut().rev().take(400).for_each(|b| *b ^= 0x55);
    let replace = |from: &'static str, to: &'static str| {
        move |bytes: &mut Vec<u8>| {
            let text = String::from_utf8(bytes.clone()).unwrap();
            assert!(text.contains(from));
            *bytes = text.replacen(from, to, 1).into_bytes();
        }
    };
    // The header of a table is its length and that many bytes; f32 data follow it.
    let poison = |bytes: &mut Vec<u8>| {
        let header = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        for word in bytes[header..].chunks_exact_mut(4) {
            word.copy_from_slice(&f32::NAN.to_le_bytes());
        }
    };
    let huge = |bytes: &mut Vec<u8>| bytes[..8].copy_from_slice(&u64::MAX.to_le_bytes());
    type Change<'a> = &'a dyn Fn(&mut Vec<u8>);
    let cases: [(&str, Change); 16] = [
        ("train-00001.exr", &cut),
        ("train-00001.exr", &flip),
        ("train-00001.exr", &|bytes| bytes[0] = 0),
        ("grazing-00000.safetensors", &cut),
        ("train-00000.safetensors", &poison),
        ("train-00000.safetensors", &huge),
        ("test-00000.exr", &cut),
        ("views-s4.exr", &cut),
        ("views-s4.exr", &flip),
        ("height.exr", &cut),
        (MANIFEST, &cut),
        (MANIFEST, &replace("\"format\": 1", "\"format\": 2")),
        (MANIFEST, &replace("\"format\": 1", "\"format\": 1, \"colour\": 3")),
        (MANIFEST, &replace("\"train-00000\"", "\"../secret\"")),
        (MANIFEST, &replace("\"side\": 8", "\"side\": 80000")),
        (MANIFEST, &replace("\"blocks\": 64", "\"blocks\": 63")),
    ];
    for (k, (name, change)) in cases.iter().enumerate() {
        let error = damaged(&original, name, change).expect_err(&format!("case {k}: {name}"));
        let line = error.to_string();
        assert!(line.contains(name) || *name == MANIFEST, "case {k}: {line}");
        assert!(matches!(error, Error::File { .. }) && !line.contains('\n'), "case {k}: {line}");
    }
    // People look at the contact sheet; nothing reads it.
    for name in original.keys().filter(|name| *name != CONTACT_SHEET) {
        let mut missing = original.clone();
        missing.remove(name);
        let line = damaged(&missing, "", |_| ()).unwrap_err().to_string();
        assert!(line.contains(name.as_str()), "{line}");
    }
    damaged(&original, "", |_| ()).unwrap();
}

#[test]
fn poisoned_pixels_are_found_when_read() {
    let folder = tempfile::tempdir().unwrap();
    let data = make(folder.path(), &small());
    let info = &data.manifest().splits[&SplitName::Train].files[0];
    assert_eq!(info.blocks, 64);
    let path = folder.path().join("train-00000.exr");
    exr::prelude::write_rgb_file(&path, 64, 64, |x, y| {
        let value = half::f16::from_f32(if (x, y) == (9, 17) { f32::INFINITY } else { 1.0 });
        (value, value, value)
    })
    .unwrap();
    let json = std::fs::read_to_string(folder.path().join(MANIFEST)).unwrap();
    let length = std::fs::metadata(&path).unwrap().len();
    let json = json.replacen(
        &format!("\"frame_bytes\": {}", info.frame_bytes),
        &format!("\"frame_bytes\": {length}"),
        1,
    );
    let all = json.matches(&format!("\"frame_bytes\": {length}")).count();
    assert_eq!(all, 1);
    std::fs::write(folder.path().join(MANIFEST), json).unwrap();
    let split = Dataset::open(folder.path()).unwrap().split(SplitName::Train).unwrap();
    // Pixel (17, 9) is row 1, column 1 of block 17.
    let error = split.read_file(0).unwrap_err().to_string();
    assert!(
        error.contains("train-00000.exr") && error.contains("block 17") && error.contains("rgb[9]"),
        "{error}"
    );
    assert!(split.read_file(1).is_ok() && split.read_file(999).is_err());
}

#[test]
fn a_bad_source_or_configuration_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let poisoned = Smooth { noise: 0.0, poison: true };
    let error =
        generate(&poisoned, &small(), folder.path(), Existing::Refuse, &mut go).unwrap_err().to_string();
    assert!(error.contains("material smooth") && error.contains("NaN"), "{error}");
    let bad = [
        ("resolution", GenerateConfig { resolution: 100, ..small() }),
        ("resolution", GenerateConfig { resolution: 0, ..small() }),
        ("block_side", GenerateConfig { block_side: 12, ..small() }),
        ("spp", GenerateConfig { spp: 0, ..small() }),
        ("regime", GenerateConfig { regime: Regime::Slices(1), ..small() }),
        ("samples", GenerateConfig { regime: Regime::Slices(0), samples: 1200, ..small() }),
        ("grazing_floor", GenerateConfig { grazing_floor: -0.1, ..small() }),
        ("lights[1]", GenerateConfig { lights: vec![[0.0, 0.0], [91.0, 0.0]], ..small() }),
        ("noise", GenerateConfig { noise: Some(0.0), ..small() }),
        ("noise", GenerateConfig { noise: Some(f32::NAN), ..small() }),
        ("spp", GenerateConfig { noise: Some(0.1), spp: 1, ..small() }),
        ("most_spp", GenerateConfig { noise: Some(0.1), most_spp: 63, ..small() }),
        ("fractional_share", GenerateConfig { fractional_share: f32::NAN, ..small() }),
        ("least_level_share", GenerateConfig { least_level_share: 0.3, ..small() }),
        ("samples", GenerateConfig { samples: u64::MAX, ..small() }),
        ("file_samples", GenerateConfig { samples: 1 << 40, ..small() }),
    ];
    for (field, config) in bad {
        let path = folder.path().join("new");
        let error = generate(&QUIET, &config, &path, Existing::Refuse, &mut go).unwrap_err();
        assert!(error.to_string().starts_with(field), "{error}");
        assert!(!path.exists());
    }
}
