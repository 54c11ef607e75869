//! Sequences: what moves, what stays, and what is said of an answerer that follows.

use super::*;
use neumip::dataset::{Motion, SEQUENCES, Shard, generate_shard};
use neumip::evaluate::{Row, motion_table};
use neumip::query::Reflectance;

/// Steps so large that the little surface moves well beyond the noise.
const MOTION: Motion = Motion { frames: 4, step: 5.0 };
/// Half floats in differences of frames: their energy over that of the motion. Measured: 0.4e-4 at most.
const ROUNDED: f64 = 2e-4;
/// A still answer's flicker is a sum over itself, but for rounding in f64.
const ITSELF: f64 = 1e-9;
/// Largest difference of two half floats of one value of up to 2 with noise of 0.1 on it.
const STORED: f32 = 2.0 * 4.0 / 2048.0;

fn moving() -> GenerateConfig {
    GenerateConfig { motion: Some(MOTION), ..small() }
}

/// Answers as the source does without noise, clamped to what shows.
struct Exact;

impl Reflectance for Exact {
    fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage> {
        let answer = |k: usize| QUIET.answer(queries.u[k], queries.wi[k], queries.wo[k], queries.level[k]);
        let pixels = (0..queries.len()).map(answer).collect();
        Ok(RgbImage { height: queries.height(), width: queries.width(), pixels })
    }
}

/// The same picture whatever is asked.
struct Still;

impl Reflectance for Still {
    fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage> {
        let pixels = vec![[0.3; 3]; queries.len()];
        Ok(RgbImage { height: queries.height(), width: queries.width(), pixels })
    }
}

/// The exact answer, darker by a hundredth in every other pair of frames that it is asked for.
struct Jump(std::sync::atomic::AtomicUsize);

impl Reflectance for Jump {
    fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage> {
        let frame = self.0.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        let mut image = Exact.evaluate(queries)?;
        let shift = if frame % 4 < 2 { 0.0 } else { 0.01 };
        image.pixels.as_flattened_mut().iter_mut().for_each(|v| *v -= shift);
        Ok(image)
    }
}

#[test]
fn frames_are_the_scenes_of_the_sequences() {
    let folder = tempfile::tempdir().unwrap();
    generate(&QUIET, &moving(), folder.path(), Existing::Refuse, &mut go).unwrap();
    let data = Dataset::open(folder.path()).unwrap();
    let motion = &data.manifest().motion;
    assert_eq!(motion.iter().map(|sequence| sequence.name.as_str()).collect::<Vec<_>>(), SEQUENCES);
    assert_eq!(data.manifest().views.len(), SCENES.len());
    for (place, sequence) in motion.iter().enumerate() {
        assert_eq!(sequence.frames.len(), MOTION.frames);
        for (k, frame) in sequence.frames.iter().enumerate() {
            let (queries, _) = data.read_view(&frame.name).unwrap();
            assert_eq!(queries, MOTION.scene(place, k).queries(12, 1, [16, 16]));
        }
    }
    // Nothing is said of sequences where there are none, as it was before there were any.
    let folder = tempfile::tempdir().unwrap();
    make(folder.path(), &small());
    let text = std::fs::read_to_string(folder.path().join(MANIFEST)).unwrap();
    assert!(!text.contains("motion"), "{text}");
    let without_views = GenerateConfig { view_size: 0, ..moving() };
    assert!(without_views.validate().unwrap_err().to_string().starts_with("view_size (with motion)"));
}

#[test]
fn noise_does_not_move() {
    let folder = tempfile::tempdir().unwrap();
    // A noise that no view holds with the sub-samples that it begins with.
    let config = GenerateConfig { noise: Some(0.006), spp: 2, held_out_spp: 4, most_spp: 1024, ..moving() };
    let data = make(folder.path(), &config);
    let noise = |name: &str| -> Vec<f32> {
        let (queries, rgb) = data.read_view(name).unwrap();
        let exact = Exact.evaluate(&queries).unwrap();
        // Where nothing is seen, nothing is shaded.
        let seen = (0..queries.len()).filter(|k| above_horizon(queries.wo[*k]));
        seen.map(|k| rgb.pixels[k][0] - exact.pixels[k][0]).collect()
    };
    let apart = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    for name in SEQUENCES {
        let frames: Vec<_> = (0..MOTION.frames).map(|k| noise(&format!("{name}-{k:03}"))).collect();
        for frame in &frames[1..] {
            assert!(apart(&frames[0], frame) <= STORED, "{name}: {}", apart(&frames[0], frame));
        }
        // Another picture has noise of its own.
        assert!(apart(&frames[0], &noise("s4")) > STORED);
    }
}

#[test]
fn sequences_are_resumed_and_made_by_shards() {
    let whole = tempfile::tempdir().unwrap();
    make(whole.path(), &moving());
    let expected = contents(whole.path());
    let folder = tempfile::tempdir().unwrap();
    let mut frames = 0;
    let stopped = generate(&NOISY, &moving(), folder.path(), Existing::Refuse, &mut |progress| {
        frames += usize::from(progress.split == "motion");
        if frames == 6 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    assert!(matches!(stopped, Err(Error::Interrupted(_))));
    let made = contents(folder.path());
    assert!(made.contains_key("views-camera-arc-001.exr") && !made.contains_key("views-camera-arc-002.exr"));
    generate(&NOISY, &moving(), folder.path(), Existing::Resume, &mut go).unwrap();
    assert!(contents(folder.path()) == expected);

    let folder = tempfile::tempdir().unwrap();
    for index in [2, 1] {
        let shard = Shard { index, count: 2 };
        generate_shard(&NOISY, &moving(), shard, folder.path(), Existing::Refuse, &mut go).unwrap();
    }
    let mut rays = 0;
    generate(&NOISY, &moving(), folder.path(), Existing::Resume, &mut |progress| {
        rays = progress.rays;
        ControlFlow::Continue(())
    })
    .unwrap();
    assert_eq!((contents(folder.path()) == expected, rays), (true, 0));
}

#[test]
fn a_perfect_answer_does_not_flicker_and_a_still_one_is_one() {
    let folder = tempfile::tempdir().unwrap();
    generate(&QUIET, &moving(), folder.path(), Existing::Refuse, &mut go).unwrap();
    let data = Dataset::open(folder.path()).unwrap();
    let names: Vec<String> = SEQUENCES.iter().map(|name| format!("motion/{name}")).collect();
    let flicker = |rows: &[Row]| -> Vec<f64> {
        assert_eq!(rows.iter().map(|row| row.split.clone()).collect::<Vec<_>>(), names);
        rows.iter().map(|row| row.flicker.unwrap()).collect()
    };
    let exact = motion_table(&Exact, &data, None).unwrap();
    println!("flicker of the exact answer: {:?}", flicker(&exact));
    assert!(flicker(&exact).iter().all(|v| *v <= ROUNDED), "{exact:?}");
    assert!(exact.iter().all(|row| row.flicker_noise == Some(0.0) && row.queries == 4 * 144));
    assert!(exact.iter().all(|row| row.metrics().flicker == row.flicker && row.flip.is_some()));
    // A hundredth in the second half of the frames is one jump, and noticed.
    let jump = motion_table(&Jump(Default::default()), &data, None).unwrap();
    assert!(flicker(&jump).iter().all(|v| *v > ROUNDED), "{jump:?}");
    let still = flicker(&motion_table(&Still, &data, None).unwrap());
    assert!(still.iter().all(|v| (v - 1.0).abs() <= ITSELF), "{still:?}");
}

#[test]
fn frames_out_of_place_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    make(folder.path(), &moving());
    let path = folder.path().join(MANIFEST);
    let text = std::fs::read_to_string(&path).unwrap();
    for (from, to, expected) in [
        ("\"name\": \"zoom-002\"", "\"name\": \"zoom-001\"", "motion.zoom.frames[2]: is named zoom-001"),
        ("\"name\": \"zoom\"", "\"name\": \"../zoom\"", "motion.../zoom.frames[0]: is named zoom-000"),
        ("\"frames\": 4", "\"frames\": 1", "motion.frames: 1"),
    ] {
        assert!(text.contains(from), "{from}");
        std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let error = Dataset::open(folder.path()).unwrap_err().to_string();
        assert!(error.contains(expected) && !error.contains('\n'), "{error}");
    }
    std::fs::write(&path, &text).unwrap();
    std::fs::write(folder.path().join("views-zoom-003.exr"), "damaged").unwrap();
    let error = Dataset::open(folder.path()).unwrap_err().to_string();
    assert!(error.contains("views-zoom-003.exr: has 7 bytes"), "{error}");
}
