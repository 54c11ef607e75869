//! Promises of the page and of its JSON twin.

use super::*;
use crate::query::RgbImage;

fn image(side: usize, of: impl Fn(f32, f32) -> [f32; 3]) -> RgbImage {
    let at = |k: usize| ((k % side) as f32 + 0.5) / side as f32;
    let pixels = (0..side * side).map(|k| of(at(k), ((k / side) as f32 + 0.5) / side as f32)).collect();
    RgbImage { height: side, width: side, pixels }
}

fn weave(x: f32, y: f32) -> [f32; 3] {
    let wave = ((x * 25.0).sin() * (y * 25.0).sin()).abs();
    [0.05 + 0.5 * wave, 0.05 + 0.3 * wave * x, 0.04 + 0.2 * y]
}

/// A report with a bit of everything, names that need escaping and numbers that are not finite.
fn sample() -> Report {
    let panel = |side: usize, title: &str| Panel {
        title: title.into(),
        caption: "wi (0.30, -0.20), wo (0.10, 0.60)".into(),
        reference: image(side, weave),
        answers: vec![
            ("neumip".into(), image(side, |x, y| weave(x + 0.02, y).map(|v| v * 0.9))),
            ("improved".into(), image(side, |x, y| weave(x + 0.005, y))),
        ],
    };
    let curve = |name: &str, floor: f64| {
        let at = |n: u32| (f64::from(n) * 150.0, floor + 0.05 / f64::from(n + 1));
        Curve {
            name: name.into(),
            training: (0..200).map(at).collect(),
            validation: (0..20).map(at).collect(),
        }
    };
    let row = |model: &str, level: &str, mse: f64, noise| TableRow {
        model: model.into(),
        split: "test".into(),
        level: level.into(),
        samples: 262_144,
        mse,
        mse_linear: mse * 1.3,
        mse_log1p: mse * 0.6,
        psnr: (mse > 0.0).then(|| -10.0 * mse.log10()),
        ssim: Some(0.9 - mse),
        flip: Some(0.5 * mse),
        noise,
    };
    let cost = |model: &str, ns: f64, weights, mse| CostRow {
        model: model.into(),
        ns,
        ns_low: ns * 0.97,
        ns_high: ns * 1.08,
        weights,
        flops: 2 * weights,
        bytes: 1_300_000,
        mse,
    };
    Report {
        title: "Rocks & <rings>".into(),
        facts: vec![
            ("material".into(), "rocks".into()),
            ("resolution".into(), "64 x 64 texels".into()),
            ("samples a texel".into(), "2,400 presented, 310 unique".into()),
            ("steps".into(), "2,400".into()),
            ("machine".into(), "2 threads".into()),
            ("seconds".into(), "183".into()),
        ],
        verdict: "improved has 17 % less error than neumip at 1.4 times its cost.".into(),
        panels: vec![panel(64, "Level 0, oblique light"), panel(8, "Level 3"), panel(2, "Level 5")],
        curves: vec![curve("neumip", 3.4e-3), curve("improved", 2.7e-3)],
        table: vec![
            row("neumip", "0", 4.1e-3, Some(1.2e-5)),
            row("improved", "0", 3.4e-3, Some(1.2e-5)),
            row("neumip", "1", 2.2e-3, None),
            row("improved", "1", f64::NAN, None),
        ],
        costs: vec![cost("neumip", 92.0, 3_332, 3.1e-3), cost("improved", 131.0, 5_132, 2.6e-3)],
        exports: vec![ExportRow {
            model: "improved".into(),
            file: "bundle/material.onnx".into(),
            bytes: 1_345_678,
            what: "the whole material as one graph".into(),
        }],
        commands: vec!["neumip demo --seed 1 --out \"my demo\"".into()],
    }
}

/// The page without what is inside its pictures, where any letters may stand side by side.
fn words(page: &str) -> String {
    let mut parts = page.split("base64,");
    let first = parts.next().unwrap().to_string();
    parts.fold(first, |words, part| words + part.split_once('"').unwrap().1)
}

#[test]
fn the_page_has_everything_and_needs_nothing() {
    let report = sample();
    let page = html(&report).unwrap();
    for panel in &report.panels {
        assert!(page.contains(&panel.title));
        for (model, _) in &panel.answers {
            assert!(page.contains(&format!("|{model} \u{2212} reference|")));
        }
    }
    assert_eq!(page.matches("src=\"data:image/png;base64,").count(), 15);
    assert_eq!(page.matches("<svg ").count(), 3);
    for part in ["bundle/material.onnx", "1.35 MB", "183", "17 % less error", "5,132", "<b>3.40</b>", "4.10"]
    {
        assert!(page.contains(part), "{part}");
    }
    for absent in ["http", "<script", "NaN", "url("] {
        assert!(!words(&page).contains(absent), "{absent}");
    }
    assert_eq!(page, html(&report).unwrap());
}

#[test]
fn text_is_escaped_wherever_it_stands() {
    let poison = "<i onload='x'>\"&";
    let mut report = sample();
    report.title = poison.into();
    report.verdict = poison.into();
    report.facts.push((poison.into(), poison.into()));
    report.panels[0].title = poison.into();
    report.panels[0].caption = poison.into();
    report.panels[0].answers[0].0 = poison.into();
    report.curves[0].name = poison.into();
    report.table[0].model = poison.into();
    report.table[1].split = poison.into();
    report.table[2].level = poison.into();
    report.costs[0].model = poison.into();
    report.exports[0] =
        ExportRow { model: poison.into(), file: poison.into(), bytes: 0, what: poison.into() };
    report.commands.push(poison.into());
    let page = html(&report).unwrap();
    assert!(!page.contains("<i ") && !page.contains("onload='"));
    assert!(page.matches("&lt;i onload=").count() >= 18);
}

#[test]
fn json_keeps_the_numbers_and_says_null_where_there_is_none() {
    let report = sample();
    let text = serde_json::to_string(&json(&report).unwrap()).unwrap();
    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(value["table"][0]["mse"].as_f64(), Some(report.table[0].mse));
    assert_eq!(value["table"][0]["samples"].as_u64(), Some(262_144));
    assert!(value["table"][3]["mse"].is_null() && value["table"][2]["noise"].is_null());
    assert_eq!(value["curves"][1]["validation"][7][1].as_f64(), Some(report.curves[1].validation[7].1));
    assert_eq!(value["costs"][0]["ns_high"].as_f64(), Some(report.costs[0].ns_high));
    assert_eq!(value["facts"][1], serde_json::json!(["resolution", "64 x 64 texels"]));
    let panel = &value["panels"][0];
    assert_eq!(panel["answers"][1]["model"], "improved");
    assert_eq!(panel["answers"][1]["mse"].as_f64(), Some(report.panels[0].errors()[1].mse));
    assert!(panel.get("reference").is_none() && !text.contains("pixels"));
}

#[test]
fn a_panel_whose_answer_is_the_reference_has_no_error() {
    let mut report = sample();
    report.panels.truncate(1);
    report.panels[0].answers[1].1 = report.panels[0].reference.clone();
    let value = json(&report).unwrap();
    assert_eq!(value["panels"][0]["answers"][1]["mse"].as_f64(), Some(0.0));
    assert!(value["panels"][0]["answers"][1]["psnr"].is_null());
    assert!(html(&report).unwrap().contains("mse <b>0</b>"));
}

#[test]
fn empty_and_broken_reports_do_not_panic() {
    let page = html(&Report::default()).unwrap();
    assert!(page.contains("</html>") && !page.contains("<h2>"));
    assert!(json(&Report::default()).unwrap()["panels"].as_array().unwrap().is_empty());

    let mut report = sample();
    report.curves = vec![
        Curve::default(),
        Curve { name: "x".into(), training: vec![(f64::NAN, 1.0)], validation: vec![] },
    ];
    report.panels[0].answers[0].1.pixels[3] = [f32::NAN; 3];
    report.panels[1].answers.clear();
    report.costs[0].ns = f64::NAN;
    report.costs[1].mse = 0.0;
    let page = html(&report).unwrap();
    assert!(page.contains("mse not finite") && !words(&page).contains("NaN"));
    assert!(json(&report).unwrap()["panels"][0]["answers"][0]["mse"].is_null());

    report.panels[2].answers[1].1 = image(3, weave);
    let message = html(&report).unwrap_err().to_string();
    assert!(message.contains("report.panels[2]") && message.contains("improved"), "{message}");
    assert!(json(&report).is_err());
    report.panels[2].reference = RgbImage::default();
    assert!(html(&report).is_err());
}

#[test]
fn scales_are_round_and_hold_the_values() {
    let mut panel = sample().panels.remove(0);
    let maximum = panel.maximum();
    let mantissa = maximum / 10f64.powf(maximum.log10().floor());
    assert!([1.0, 2.0, 5.0].iter().any(|m| (mantissa - m).abs() < 1e-6), "{maximum}");
    let dim = |v: f32| RgbImage { height: 1, width: 1, pixels: vec![[v; 3]] };
    for (value, stops) in [(0.0, 0.0), (1e-6, 4.0), (0.2, 2.0), (0.9, 0.0), (30.0, 0.0)] {
        panel.reference = dim(value);
        assert_eq!(panel.exposure(), stops, "{value}");
    }
    for (value, expected) in [(0.0, 1e-3), (0.03, 0.05), (0.2, 0.2), (0.7, 1.0)] {
        (panel.reference, panel.answers) = (dim(0.0), vec![("model".into(), dim(value))]);
        assert!((panel.maximum() - expected).abs() < 1e-9, "{value}");
    }
}
