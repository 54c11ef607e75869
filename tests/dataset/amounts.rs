//! How much a dataset has: budgets, appending, noise.

use super::*;

/// Every kind of training data in a first amount and a larger one.
fn growing() -> [(GenerateConfig, GenerateConfig); 2] {
    let slices = |pairs| GenerateConfig { regime: Regime::Slices(pairs), ..small() };
    [(small(), GenerateConfig { samples: 333 * 64, ..small() }), (slices(6), slices(17))]
}

#[test]
fn slices_take_the_pairs_that_samples_pay_for() {
    let folder = tempfile::tempdir().unwrap();
    let asked = GenerateConfig { regime: Regime::Slices(0), samples: 12_000, ..small() };
    let data = make(folder.path(), &asked);
    let made = data.split(SplitName::Train).unwrap().info().samples();
    let config = data.manifest().generation.clone().unwrap();
    let Regime::Slices(pairs) = config.regime else { panic!("{}", config.regime) };
    assert_eq!(config.samples, made);
    let more = GenerateConfig { regime: Regime::Slices(pairs + 1), ..small() }.resolved(&[]).unwrap();
    assert!(made <= 12_000 && more.samples > 12_000, "{made} {}", more.samples);
    // The number by its name gives the same dataset.
    let named = GenerateConfig { regime: Regime::Slices(pairs), ..small() };
    generate(&NOISY, &named, folder.path(), Existing::Resume, &mut go).unwrap();
}

#[test]
fn appending_keeps_every_file_and_can_be_stopped() {
    for (before, after) in growing() {
        let folder = tempfile::tempdir().unwrap();
        make(folder.path(), &before);
        let old = contents(folder.path());
        let files = |folder: &Path| Dataset::open(folder).unwrap().split(SplitName::Train).unwrap().files();
        let before_files = files(folder.path());
        let grow = |folder: &Path, existing, chunks: usize| {
            let mut left = chunks;
            generate(&NOISY, &after, folder, existing, &mut |progress| {
                left -= 1;
                assert!(progress.done <= progress.total && progress.split == "train");
                if left == 0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            })
        };
        grow(folder.path(), Existing::Append, usize::MAX).unwrap();
        let grown = contents(folder.path());
        let data = Dataset::open(folder.path()).unwrap();
        assert!(data.manifest().complete);
        assert_eq!(data.manifest().appended_at, [before.amount()]);
        assert_eq!(data.manifest().generation.as_ref().unwrap().amount(), after.amount());
        let kept = |name: &str| ![MANIFEST, CONTACT_SHEET].contains(&name);
        assert!(old.iter().all(|(name, bytes)| !kept(name) || grown[name] == *bytes));
        assert!(grown.len() > old.len());
        let info = &data.manifest().splits[&SplitName::Train];
        assert_eq!(info.blocks(), info.planned_blocks);

        // Stopped after its first file, then resumed in either way.
        for existing in [Existing::Append, Existing::Resume] {
            let again = tempfile::tempdir().unwrap();
            make(again.path(), &before);
            let stopped = grow(again.path(), Existing::Append, 1);
            assert!(matches!(stopped, Err(Error::Interrupted(_))));
            let data = Dataset::open(again.path()).unwrap();
            assert!(!data.manifest().complete);
            assert_eq!(files(again.path()), before_files + 1);
            let other = GenerateConfig { samples: 99_999, ..small() };
            if before.regime == Regime::Scattered {
                let refused = generate(&NOISY, &other, again.path(), Existing::Append, &mut go).unwrap_err();
                assert!(refused.to_string().contains("is not complete"), "{refused}");
            }
            grow(again.path(), existing, usize::MAX).unwrap();
            assert!(contents(again.path()) == grown);
            // There is nothing left to append.
            grow(again.path(), existing, usize::MAX).unwrap();
            assert!(contents(again.path()) == grown);
        }
    }
}

#[test]
fn appended_blocks_are_those_of_a_longer_run() {
    let [(before, after), _] = growing();
    let folder = tempfile::tempdir().unwrap();
    make(folder.path(), &before);
    let more = GenerateConfig { samples: 250 * 64, ..after.clone() };
    generate(&NOISY, &more, folder.path(), Existing::Append, &mut go).unwrap();
    generate(&NOISY, &after, folder.path(), Existing::Append, &mut go).unwrap();
    let data = Dataset::open(folder.path()).unwrap();
    assert_eq!(data.manifest().appended_at, [200 * 64, 250 * 64]);
    let whole = tempfile::tempdir().unwrap();
    let whole = make(whole.path(), &after);
    assert!(blocks(&data, SplitName::Train) == blocks(&whole, SplitName::Train));
    let nearest = |data: &Dataset| data.manifest().splits[&SplitName::Test].nearest_training;
    assert_eq!(nearest(&data), nearest(&whole));
}

#[test]
fn appended_slices_are_further_pairs() {
    let [_, (before, after)] = growing();
    let folder = tempfile::tempdir().unwrap();
    make(folder.path(), &before);
    generate(&NOISY, &after, folder.path(), Existing::Append, &mut go).unwrap();
    let data = Dataset::open(folder.path()).unwrap();
    for level in 0..4 {
        let train = blocks(&data, SplitName::Train);
        let pairs: BTreeSet<_> = train
            .iter()
            .filter(|block| block.level() == level as f32)
            .flat_map(|block| block.patches())
            .map(|p| (p.wi.map(f32::to_bits), p.wo.map(f32::to_bits)))
            .collect();
        assert_eq!(pairs.len(), 17, "level {level}");
    }
}

#[test]
fn nothing_but_the_amount_may_grow() {
    let folder = tempfile::tempdir().unwrap();
    make(folder.path(), &small());
    let before = contents(folder.path());
    let more = GenerateConfig { samples: 99_999, ..small() };
    let cases = [
        ("generation.seed", GenerateConfig { seed: 4, ..more.clone() }),
        ("generation.noise", GenerateConfig { noise: Some(0.5), ..more.clone() }),
        ("generation.test_pairs", GenerateConfig { test_pairs: 6, ..more.clone() }),
        ("generation.regime", GenerateConfig { regime: Regime::Slices(9), ..more.clone() }),
        ("samples: ", GenerateConfig { samples: 199 * 64, ..more.clone() }),
    ];
    for (field, config) in cases {
        let error = generate(&NOISY, &config, folder.path(), Existing::Append, &mut go).unwrap_err();
        assert!(error.to_string().contains(field), "{error}");
    }
    let error = generate(&QUIET, &more, folder.path(), Existing::Append, &mut go).unwrap_err();
    assert!(error.to_string().contains("source differs"), "{error}");
    assert!(contents(folder.path()) == before);

    let empty = tempfile::tempdir().unwrap();
    let error = generate(&NOISY, &more, empty.path(), Existing::Append, &mut go).unwrap_err();
    assert!(error.to_string().contains("no dataset to append to"), "{error}");
}

/// Noise that depends on where one looks: half of the patches are four times as noisy.
struct Uneven;

impl Source for Uneven {
    fn name(&self) -> &str {
        "uneven"
    }

    fn height_range(&self) -> [f32; 2] {
        [0.0; 2]
    }

    fn height_map(&self) -> Option<(usize, usize, Vec<f32>)> {
        None
    }

    fn measure(&self, queries: &QueryBuffer, spp: usize, seed: u64, first: u64) -> Result<Answers> {
        let mut answers = Answers { rays: queries.len() as u64 * spp as u64, ..Answers::default() };
        for k in 0..queries.len() {
            let noise: f32 = if queries.wi[k][0] > 0.0 { 0.4 } else { 0.1 };
            let mut random = Random::new(seed, RandomStream::Reference, first + k as u64);
            let sum: f32 = (0..spp).map(|_| noise * random.normal()).sum();
            answers.rgb.push([0.5 + sum / spp as f32; 3]);
            answers.variance.push(noise * noise / spp as f32);
        }
        Ok(answers)
    }

    fn description(&self) -> serde_json::Value {
        "uneven".into()
    }
}

#[test]
fn blocks_are_measured_until_they_are_quiet() {
    let config = GenerateConfig {
        regime: Regime::Slices(24),
        noise: Some(0.06),
        spp: 4,
        held_out_spp: 4,
        most_spp: 24,
        ..small()
    };
    let folder = tempfile::tempdir().unwrap();
    let mut rays = 0;
    generate(&Uneven, &config, folder.path(), Existing::Refuse, &mut |progress| {
        assert!(progress.done <= progress.total);
        rays = progress.rays;
        ControlFlow::Continue(())
    })
    .unwrap();
    let data = Dataset::open(folder.path()).unwrap();
    let (mut all, mut still) = (0, 0);
    for name in SplitName::ALL {
        let info = &data.manifest().splits[&name];
        let split = blocks(&data, name);
        for block in &split {
            let spp = block.spp().unwrap();
            all += u64::from(spp) * (block.side() * block.side()) as u64;
            assert!([4, 8, 16, 24].contains(&spp));
            let quiet = block.noise().sqrt() <= 0.06;
            // As many sub-samples as it takes, and no more.
            assert!(quiet || spp == 24, "{spp} {}", block.noise());
            assert!(spp == 4 || (block.noise() * spp as f32 / (spp / 2) as f32).sqrt() > 0.06);
            if block.level() == 0.0 && block.patches().len() == 1 {
                let noise = if block.patches()[0].wi[0] > 0.0 { 0.4f32 } else { 0.1 };
                assert!((block.noise() * spp as f32 / (noise * noise) - 1.0).abs() < 1e-4);
                assert_eq!(spp, if noise > 0.2 { 24 } else { 4 });
            }
        }
        still += info.noisy_blocks;
        assert_eq!(info.noisy_blocks, split.iter().filter(|b| b.noise().sqrt() > 0.06).count());
    }
    assert!(still > 0);
    let views = data.manifest().views.iter().map(|view| (view.height * view.width) as u64).sum::<u64>();
    assert!(rays >= all + 4 * views && rays <= all + 24 * views, "{rays} {all}");
}

#[test]
fn averages_of_rounds_are_as_quiet_as_they_say() {
    /// Relative error of a variance that is estimated from n = 30 000 values: sqrt(2 / n) = 0.8 %; four of those.
    const ESTIMATED: f64 = 0.033;
    let config = GenerateConfig {
        regime: Regime::Slices(50),
        noise: Some(0.06),
        spp: 4,
        held_out_spp: 4,
        most_spp: 24,
        ..GenerateConfig::new(32)
    };
    let folder = tempfile::tempdir().unwrap();
    generate(&Uneven, &config, folder.path(), Existing::Refuse, &mut go).unwrap();
    let data = Dataset::open(folder.path()).unwrap();
    let (mut squares, mut stated, mut sum, mut n) = (0.0, 0.0, 0.0, 0.0);
    for block in blocks(&data, SplitName::Train) {
        for pixel in block.target() {
            let off = f64::from(pixel[0]) - 0.5;
            sum += off;
            squares += off * off;
            stated += f64::from(block.noise());
            n += 1.0;
        }
    }
    assert!(n > 30_000.0);
    assert!((squares / stated - 1.0).abs() < ESTIMATED, "{}", squares / stated);
    assert!((1.05 * squares / stated - 1.0).abs() > ESTIMATED);
    // Five standard errors of the mean.
    assert!((sum / n).abs() < 5.0 * (stated / n / n).sqrt(), "{}", sum / n);
}

#[test]
fn a_held_noise_leaves_everything_as_it_was() {
    let run = |config: &GenerateConfig| {
        let folder = tempfile::tempdir().unwrap();
        make(folder.path(), config);
        contents(folder.path())
    };
    let held = run(&GenerateConfig { noise: Some(1.0), ..small() });
    let plain = run(&small());
    let frames = || plain.iter().filter(|(name, _)| name.ends_with(".exr"));
    assert!(frames().all(|(name, bytes)| held[name] == *bytes) && frames().count() > 8);
}
