//! The whole way on made-up results: 25 variants on 3 materials, and on bad ones.

use super::*;
use crate::results::{Cell, Metrics};

/// Deterministic noise in \[0, 1).
fn noise(k: u64) -> f64 {
    let mixed = (k + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    ((mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40) as f64 / (1u64 << 24) as f64
}

/// Label, \[ns, bytes\] and error of 24 networks and the maps, as training might give them.
fn variants() -> Vec<(String, [f64; 2], f64)> {
    let mut out = vec![("maps".to_string(), [610.0, 1.6e6], 4e-5)];
    for (family, cost, quality) in [("neumip", 0.8, 2.1), ("improved", 1.1, 1.0), ("paper", 1.0, 1.35)] {
        for width in [8, 16, 32, 64] {
            let ns = cost * (60.0 + 0.19 * f64::from(width * width));
            let error = quality * 9e-4 * (8.0 / f64::from(width)).powf(0.7) + 8e-5;
            out.push((format!("{family}-w{width}"), [ns, 1.4e6], error));
            out.push((format!("{family}-w{width}-c3-half"), [0.85 * ns, 2.6e5], 1.9 * error));
        }
    }
    out
}

/// Cells of all variants on three materials, three seeds each where something is trained.
pub(super) fn synthetic() -> Results {
    let mut results = Results { machines: vec!["made up, 2 cores".into()], ..Results::default() };
    for (m, material) in ["metal-rings", "rocks", "weave"].into_iter().enumerate() {
        for (v, (label, [ns, bytes], error)) in variants().into_iter().enumerate() {
            let trained = !label.starts_with("maps");
            for seed in if trained { 1..=3 } else { 0..=0 } {
                let k = (m * 1000 + v * 10) as u64 + seed;
                let mse = error * [1.0, 4.0, 1.7][m] * (0.8 + 0.4 * noise(k)) * (0.7 + 0.6 * noise(k / 10));
                for (split, level) in
                    [("test", None), ("test", Some(0)), ("views/a", None), ("views/b", None)]
                {
                    let flip = (split != "test").then_some(mse.sqrt() * 3.0);
                    results.cells.push(Cell {
                        material: material.into(),
                        preset: label.clone(),
                        seed,
                        resolution: [128, 128],
                        samples_per_texel: if trained { 1200.0 } else { 0.0 },
                        unique_samples_per_texel: 400.0,
                        regime: "scattered".into(),
                        split: split.into(),
                        level,
                        metrics: Metrics {
                            mse: Some(mse),
                            psnr: Some(-10.0 * mse.log10()),
                            flip,
                            ..Metrics::default()
                        },
                        noise: None,
                        ns_per_query: Some(ns * (0.97 + 0.06 * noise(k + 7))),
                        bytes: bytes as u64,
                        flops: if trained { (ns * 20.0) as u64 } else { 0 },
                        engine: "fused, f32".into(),
                    });
                }
            }
        }
    }
    results
}

fn chart(change: impl FnOnce(&mut Settings)) -> Result<Chart> {
    let mut settings = Settings { timed_queries: 262_144, ..Settings::default() };
    change(&mut settings);
    Chart::new(&synthetic(), settings)
}

/// Every tag is closed in turn and attributes are quoted: what XML asks of what we write. Returns the texts.
fn checked_xml(text: &str) -> Vec<String> {
    let (mut open, mut texts) = (Vec::new(), Vec::new());
    let mut pieces = text.split('<');
    assert_eq!(pieces.next(), Some(""));
    for piece in pieces {
        let (tag, rest) = piece.split_once('>').unwrap_or_else(|| panic!("<{piece} does not end"));
        assert!(!rest.contains('>'), "a bare > in {rest}");
        for entity in rest.split('&').skip(1).chain(tag.split('&').skip(1)) {
            let known = ["amp;", "lt;", "gt;", "quot;", "#39;"].iter().any(|name| entity.starts_with(name));
            assert!(known, "&{entity}");
        }
        let name = |tag: &str| tag.split(' ').next().unwrap().to_string();
        match (tag.strip_prefix('/'), tag.strip_suffix('/')) {
            (Some(end), _) => assert_eq!(open.pop().as_deref(), Some(end)),
            (_, Some(_)) => {}
            _ => open.push(name(tag)),
        }
        let quotes = tag.matches('"').count();
        assert!(quotes.is_multiple_of(2) && tag.matches('=').count() * 2 == quotes, "<{tag}>");
        texts.push(rest.trim().to_string());
    }
    assert!(open.is_empty(), "not closed: {open:?}");
    texts
}

#[test]
fn a_picture_has_a_mark_for_each_variant_and_panel() {
    let chart = chart(|_| ()).unwrap();
    assert_eq!(chart.summary().unwrap(), "25 variants, 3 materials, 8 panels");
    let svg = chart.svg().unwrap();
    let texts = checked_xml(&svg);
    assert_eq!(svg.matches("class=\"mark\"").count(), 25 * 4 * 2);
    for (label, ..) in variants() {
        let says = texts.iter().filter(|t| t.lines().next() == Some(label.as_str()) && t.contains("seed"));
        assert_eq!(says.count(), 8, "{label}");
    }
    for needed in
        ["128 \u{d7} 128", "1,200 samples a texel", "one thread", "262,144", "1 to 3 seeds", "weave"]
    {
        assert!(svg.contains(needed), "{needed}");
    }
    for absent in ["NaN", "inf", "<script", "without"] {
        assert!(!svg.contains(absent), "{absent}");
    }
    assert_eq!(svg, chart.svg().unwrap());
}

#[test]
#[should_panic(expected = "Some(\"g\")")]
fn tags_out_of_turn_are_found() {
    checked_xml("<svg><g><text></g></text></svg>");
}

#[test]
fn a_png_has_the_width_that_was_asked_for() {
    let chart = chart(|s| s.panels = Panels::Mean).unwrap();
    let png = chart.png(640).unwrap();
    let image = image::load_from_memory(&png).unwrap().to_rgb8();
    assert_eq!(image.width(), 640);
    let colours: BTreeSet<[u8; 3]> = image.pixels().map(|p| p.0).collect();
    assert!(family::COLOURS[..3].iter().all(|c| colours.contains(c)), "the families' colours are there");
    assert_eq!(png, chart.png(640).unwrap());
    assert_eq!(chart.png(299).unwrap_err().exit_code(), 2);
}

#[test]
fn seeds_make_one_mark_with_its_spread() {
    let results = synthetic();
    let cells: Vec<_> = results.cells.iter().collect();
    let groups = points::groups(&cells);
    let wanted = |g: &&Group| {
        g.material.as_deref() == Some("rocks") && g.variant.preset == "improved-w8" && g.level.is_none()
    };
    let group = groups.iter().filter(wanted).find(|g| g.split == "test").unwrap();
    let of_cells: Vec<f64> = results
        .cells
        .iter()
        .filter(|c| {
            c.material == "rocks" && c.preset == "improved-w8" && c.split == "test" && c.level.is_none()
        })
        .map(|c| c.metrics.mse.unwrap())
        .collect();
    let (spread, lost) = points::spread(group, "mse", true);
    let spread = spread.unwrap();
    assert_eq!((spread.n, lost, of_cells.len()), (3, 0, 3));
    assert_eq!(spread.mean, of_cells.iter().sum::<f64>() / 3.0);
    assert_eq!(spread.low, of_cells.iter().copied().fold(f64::MAX, f64::min));
    assert_eq!(spread.high, of_cells.iter().copied().fold(0.0, f64::max));
    // The mean of the views, and the geometric mean over the materials.
    let views = groups.iter().filter(wanted).find(|g| g.split == "views").unwrap();
    assert_eq!(views.seeds.len(), 3);
    let mean = groups.iter().find(|g| {
        g.material.is_none() && g.variant.preset == "maps" && g.split == "test" && g.level == Some(0)
    });
    let of_maps = |c: &&&Cell| c.preset == "maps" && c.split == "test" && c.level == Some(0);
    let product: f64 = cells.iter().filter(of_maps).map(|c| c.metrics.mse.unwrap()).product();
    let mean = mean.unwrap().seeds[&0]["mse"];
    assert!((mean / product.cbrt() - 1.0).abs() < ROUNDING, "{mean} {}", product.cbrt());
    assert!((1.001 * mean / product.cbrt() - 1.0).abs() > ROUNDING);
}

/// A mean by logarithms beside a cube root.
const ROUNDING: f64 = 1e-12;

#[test]
fn what_cannot_be_drawn_is_counted() {
    let mut results = synthetic();
    for cell in results.cells.iter_mut().filter(|c| c.split == "test" && c.level.is_none()) {
        match (cell.preset.as_str(), cell.seed) {
            ("neumip-w8", _) => cell.metrics.mse = None,
            ("neumip-w16", _) => cell.metrics.mse = Some(0.0),
            ("neumip-w32", 2) => cell.metrics.mse = Some(f64::NAN),
            ("neumip-w64", _) => cell.ns_per_query = Some(f64::INFINITY),
            ("paper-w8", _) => cell.ns_per_query = Some(-1.0),
            _ => {}
        }
    }
    let settings = Settings { against: Against::Ns, panels: Panels::Materials, ..Settings::default() };
    let panels = panel::panels(&Chart::new(&results, settings.clone()).unwrap()).unwrap();
    assert_eq!(panels.len(), 3);
    for panel in panels {
        assert_eq!(panel.marks.len(), 25 - 4);
        let counts: Vec<(&str, usize)> = panel.left_out.iter().map(|(why, n)| (why.as_str(), *n)).collect();
        let expected = [
            ("single seeds without a value", 1),
            ("with mse of 0 or less", 1),
            ("with ns of 0 or less", 1),
            ("without mse", 1),
            ("without ns", 1),
        ];
        assert_eq!(counts, expected);
    }
    let svg = Chart::new(&results, settings).unwrap().svg().unwrap();
    assert!(svg.contains("left out: 1 single seeds without a value"));
    // Rivals without a network do no work in one.
    let svg = chart(|s| s.against = Against::Flops).unwrap().svg().unwrap();
    assert!(svg.contains("1 with flops of 0 or less"));
}

#[test]
fn what_no_result_has_is_said_with_what_there_is() {
    let said = |change: fn(&mut Settings)| {
        let error = chart(change).and_then(|c| c.svg()).unwrap_err();
        assert_eq!((error.exit_code(), error.to_string().lines().count()), (2, 1));
        error.to_string()
    };
    assert_eq!(
        said(|s| s.metric = "msq".into()),
        "--metric msq: no result has it; there are flip, mse, psnr"
    );
    assert!(said(|s| s.split = "tset".into()).ends_with("there are test, views, views/a, views/b"));
    assert!(said(|s| s.level = Some(4)).ends_with("there are 0, all"));
    assert!(said(|s| s.regime = Some("slices-9".into())).ends_with("there are scattered"));
    assert!(said(|s| s.materials = vec!["wool".into()]).ends_with("metal-rings, rocks, weave"));
    assert!(said(|s| s.metric = "flip".into()).ends_with("those of views, views/a, views/b do"));
    let alone = said(|s| (s.materials, s.panels) = (vec!["rocks".into()], Panels::Mean));
    assert!(alone.contains("no variant on two or more materials"), "{alone}");
    assert!(chart(|s| (s.metric, s.split) = ("flip".into(), "views".into())).unwrap().svg().is_ok());
}

#[test]
fn any_label_is_harmless() {
    let mut results = synthetic();
    let evil = "</script><script>alert(1)</script><!-- ]]> & \" ' \u{0} {{DATA}} \u{2028}".to_string();
    results.cells.iter_mut().filter(|c| c.preset == "maps").for_each(|c| c.preset = evil.clone());
    results.cells.iter_mut().filter(|c| c.material == "rocks").for_each(|c| c.material = evil.repeat(50));
    results.machines = vec![evil.clone()];
    let settings = Settings { title: Some(evil.clone()), ..Settings::default() };
    let chart = Chart::new(&results, settings).unwrap();
    checked_xml(&chart.svg().unwrap());
    assert!(chart.png(600).is_ok());
    let html = chart.html().unwrap();
    assert_eq!((html.matches("</script").count(), html.matches("<script").count()), (2, 2));
    let json = html.split("id=\"data\">").nth(1).unwrap().split("</script>").next().unwrap();
    let data: serde_json::Value = serde_json::from_str(json).unwrap();
    let variants = data["variants"].as_array().unwrap();
    assert!(variants.iter().any(|v| v["preset"] == evil), "the label arrives as it is");
    assert_eq!(html.matches("id=\"data\"").count(), 1);
}

#[test]
fn the_page_has_all_numbers_and_no_other_file() {
    let html = chart(|s| s.against = Against::Bytes).unwrap().html().unwrap();
    let json = html.split("id=\"data\">").nth(1).unwrap().split("</script>").next().unwrap();
    let data: serde_json::Value = serde_json::from_str(json).unwrap();
    // Three materials and their mean; test, one level of it, two views and all views.
    assert_eq!(data["groups"].as_array().unwrap().len(), 25 * 4 * 5);
    assert_eq!(data["start"]["cost"], "bytes");
    let group = &data["groups"][0];
    assert_eq!(group["seeds"].as_array().unwrap().len(), group["values"]["mse"].as_array().unwrap().len());
    for absent in [" src=", "href=", "@import", "url(", "fetch("] {
        assert!(!html.contains(absent), "{absent}");
    }
    assert_eq!(html, chart(|s| s.against = Against::Bytes).unwrap().html().unwrap());
}

#[test]
fn results_are_gathered_from_folders() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    for name in ["a/deep", "b", "empty", ".hidden"] {
        std::fs::create_dir_all(place(name)).unwrap();
    }
    let (mut first, mut second) = (synthetic(), synthetic());
    first.cells.truncate(5);
    second.cells.truncate(5);
    second.cells[0].metrics.mse = Some(7.0);
    first.write(&place("a/deep/results.json")).unwrap();
    second.write(&place("b/results.json")).unwrap();
    second.write(&place(".hidden/results.json")).unwrap();
    let (merged, files) = gather(&[folder.path().to_path_buf(), place("b/results.json")]).unwrap();
    assert_eq!((merged.cells.len(), files.len()), (5, 2));
    assert!(merged.cells.iter().any(|c| c.metrics.mse == Some(7.0)), "the later file counts");
    for (path, says) in [(place("empty"), "holds no results.json"), (place("absent"), "no such file")] {
        let error = gather(&[path]).unwrap_err();
        assert!(error.to_string().contains(says), "{error}");
    }
    Results::default().write(&place("empty/results.json")).unwrap();
    assert!(gather(&[place("empty")]).unwrap_err().to_string().contains("no cells"));
}

#[test]
fn variants_of_a_preset_are_told_apart() {
    let mut results = synthetic();
    let mut more: Vec<Cell> = results.cells.iter().filter(|c| c.preset == "paper-w8").cloned().collect();
    more.iter_mut().for_each(|c| (c.regime, c.samples_per_texel) = ("slices-9".into(), 100.0));
    results.cells.extend(more);
    let chart = Chart::new(&results, Settings::default()).unwrap();
    let panels = panel::panels(&chart).unwrap();
    let labels: Vec<&str> = panels[0].marks.iter().map(|m| m.label.as_str()).collect();
    for label in [
        "paper-w8 \u{b7} scattered \u{b7} 1,200/texel",
        "paper-w8 \u{b7} slices-9 \u{b7} 100/texel",
        "paper-w16",
    ] {
        assert!(labels.contains(&label), "{labels:?}");
    }
}
