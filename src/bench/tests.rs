use super::*;
use crate::kernels::simd::Isa;
use std::collections::BTreeSet;

/// More than a core does: a loop that the compiler has removed would be found here.
const MOST_GFLOPS: f64 = 1000.0;

fn tiny() -> Options {
    Options {
        subject: Subject::standard(32).unwrap(),
        kinds: vec![Kind::Train, Kind::Infer],
        batches: vec![256],
        threads: vec![1, 2],
        rounds: 1,
        sigma: 1.0,
        texture_every: 3,
        bare: false,
        seconds: 0.0,
    }
}

#[test]
fn rows_are_complete_and_say_what_they_promise() {
    let mut shares = vec![0.0];
    let mut listen = |share, _: &str| {
        shares.push(share);
        ControlFlow::Continue(())
    };
    let rows = run(&tiny(), &mut listen).unwrap();
    assert!(shares.is_sorted() && shares.iter().all(|s| *s < 1.0));
    let mut expected = BTreeSet::new();
    let mut expect = |work: &str, isa: &str, smoothing: &str| {
        for threads in [1, 2] {
            expected.insert((work.to_string(), isa.to_string(), threads, smoothing.to_string()));
        }
    };
    let chosen = Isa::chosen().unwrap().name();
    for isa in Isa::all().into_iter().map(Isa::name).chain(["auto"]) {
        expect("train", isa, "none");
        expect("train", isa, "sigma 1");
        expect("infer", isa, "none");
        if isa != "auto" {
            expect("infer-half", isa, "none");
        }
    }
    for isa in [chosen, "auto"] {
        expect("train", isa, "sigma 1, textures every 3");
    }
    for work in ["lights-1", "lights-4", "lights-16"] {
        expect(work, chosen, "none");
    }
    let found: Vec<_> =
        rows.iter().map(|r| (r.work.clone(), r.isa.clone(), r.threads, r.smoothing.clone())).collect();
    assert_eq!(found.len(), expected.len());
    assert_eq!(found.into_iter().collect::<BTreeSet<_>>(), expected);

    for row in &rows {
        let value = serde_json::to_value(row).unwrap();
        for field in ["work", "engine", "isa", "smoothing", "model"] {
            assert!(value[field].is_string(), "{field}: {value}");
        }
        for field in ["batch", "threads", "rounds"] {
            assert!(value[field].as_u64().is_some_and(|v| v > 0), "{field}: {value}");
        }
        let numbers = ["samples_per_s", "low", "high", "ratio_to_candle", "peak_share"];
        for field in numbers.into_iter().chain(["useful_gflops", "peak_gflops", "isa_peak_gflops"]) {
            assert!(value[field].as_f64().is_some_and(|v| v.is_finite() && v > 0.0), "{field}: {value}");
        }
        assert_eq!(value["engine"], if row.isa == "auto" { "candle" } else { "fused" });
        assert_eq!(value.get("ratio_to_whole").is_some(), row.work.starts_with("lights"), "{value}");
        assert!(row.low <= row.samples_per_s && row.samples_per_s <= row.high);
        assert!(row.peak_gflops < MOST_GFLOPS * row.threads as f64, "{value}");
    }
}

#[test]
fn a_bare_bench_times_the_fused_engine_alone() {
    let options = Options { bare: true, threads: vec![1], ..tiny() };
    let rows = run(&options, &mut |_, _| ControlFlow::Continue(())).unwrap();
    let works: Vec<&str> = rows.iter().map(|r| r.work.as_str()).collect();
    assert_eq!(works, ["train", "infer"]);
    assert!(rows.iter().all(|r| r.engine == EngineKind::Fused && r.ratio_to_candle.is_none()));
}

#[test]
fn options_out_of_range_are_refused_before_anything_is_timed() {
    let refused = |options: Options, field: &str| {
        let error = run(&options, &mut |_, _| panic!("{field}: something was timed")).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().starts_with(field), "{error}");
    };
    for batch in [0, 255, 257, 2 * MOST_SAMPLES] {
        refused(Options { batches: vec![256, batch], ..tiny() }, "batches");
    }
    refused(Options { batches: vec![], ..tiny() }, "batches");
    refused(Options { kinds: vec![], ..tiny() }, "work");
    refused(Options { rounds: 0, ..tiny() }, "rounds");
    for threads in [0, MOST_THREADS + 1] {
        refused(Options { threads: vec![threads], ..tiny() }, "threads");
    }
    refused(Options { texture_every: 0, ..tiny() }, "texture_every");
    for sigma in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        refused(Options { sigma, ..tiny() }, "sigma");
    }
    assert!(Subject::standard(1).is_err() && Subject::standard(0).is_err());
}

#[test]
fn a_listener_can_stop_it() {
    let error = run(&tiny(), &mut |_, _| ControlFlow::Break(())).unwrap_err();
    assert_eq!(error.exit_code(), 130);
}

#[test]
fn a_query_counts_what_its_networks_multiply() {
    let (all, without_light) = Subject::standard(512).unwrap().operations();
    let offset = 9 * 25 + 25 * 25 + 25 * 25 + 25;
    let decoder = 79 * 25 + 25 * 25 + 25 * 25 + 25 * 3;
    assert_eq!(all, f64::from(2 * (offset + decoder)));
    assert_eq!(without_light, f64::from(2 * (offset + (79 - 16) * 25)));
}

#[test]
fn a_decoder_that_sees_its_neighbours_is_refused() {
    let config = |name| crate::config::Config::preset(name).unwrap();
    let error = Subject::preset("inception", config("inception"), 64).unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains("neighbours"), "{error}");
    assert!(Subject::preset("improved", config("improved"), 64).is_ok());
}
