//! Materials that are bad in one way each, and a smooth one.

use super::*;
use crate::query::{QueryBuffer, Reflectance, RgbImage, above_horizon, unit};
use neumip_export::checkpoint::Measure;
use std::f32::consts::TAU;

struct Nobody;

impl Watch for Nobody {
    fn say(&self, _: &str) {}

    fn flow(&self) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
}

const SIDE: f32 = 32.0;
const COARSEST: usize = 3;

/// Answers to u, wi, wo and level within the tile and the levels, above the horizon.
struct Formula<F>(F);

impl<F: Fn([f32; 2], [f32; 2], [f32; 2], f32) -> f32 + Sync> Reflectance for Formula<F> {
    fn evaluate(&self, q: &QueryBuffer) -> Result<RgbImage> {
        let answer = |k: usize| {
            if !(above_horizon(q.wi[k]) && above_horizon(q.wo[k])) {
                return [0.0; 3];
            }
            let u = q.u[k].map(|x| x - x.floor());
            let value = (self.0)(u, q.wi[k], q.wo[k], q.level[k].clamp(0.0, COARSEST as f32));
            [value, 0.8 * value, 0.6 * value]
        };
        Ok(RgbImage { height: q.height(), width: q.width(), pixels: (0..q.len()).map(answer).collect() })
    }
}

/// A wavy Lambertian surface seen through the footprint of a level.
fn smooth(u: [f32; 2], wi: [f32; 2], _: [f32; 2], level: f32) -> f32 {
    let wave = |bands: f32, amplitude: f32| {
        // A box's mean of a sine.
        let width = level.exp2() / SIDE * bands * std::f32::consts::PI;
        let faded = if width > 1e-4 { width.sin() / width } else { 1.0 };
        amplitude * faded * faded * (TAU * bands * u[0]).sin() * (TAU * bands * u[1] + 0.3).sin()
    };
    unit(wi)[2] / std::f32::consts::PI * (0.5 + wave(1.0, 0.2) + wave(2.0, 0.1))
}

fn examined(material: &dyn Reflectance, names: &[&str]) -> Examination {
    let subject = Subject {
        material,
        resolution: [SIDE as usize; 2],
        coarsest: COARSEST,
        measure: Measure::RadianceCosine,
        checkpoint: None,
        data: None,
        extent: Extent::Quick,
    };
    let names: Vec<String> = names.iter().map(|name| name.to_string()).collect();
    check(&subject, &names, &Nobody).unwrap()
}

/// The verdict of one check on a formula.
fn found(name: &str, formula: impl Fn([f32; 2], [f32; 2], [f32; 2], f32) -> f32 + Sync) -> Finding {
    examined(&Formula(formula), &[name]).findings.remove(0)
}

#[test]
fn a_smooth_material_is_fine() {
    let examination = examined(&Formula(smooth), &[]);
    assert!(examination.troubles().is_empty(), "{}", examination.table());
    assert_eq!(examination.verdict(), Verdict::Fine);
    assert!(examination.conclusion().contains("can ship"));
    let left: Vec<&str> = examination.left_out.iter().map(|left| left.name).collect();
    assert!(left.contains(&"engines") && left.contains(&"flicker"), "{left:?}");
}

#[test]
fn each_fault_is_found_by_its_check() {
    let wrong = |finding: Finding| assert_eq!(finding.verdict, Verdict::Wrong, "{finding:?}");
    let watch = |finding: Finding| assert_eq!(finding.verdict, Verdict::Watch, "{finding:?}");
    let unlike = |u: [f32; 2]| 1.0 + 0.2 * (u[0] - 0.5);
    wrong(found("seam", |u, wi, wo, l| unlike(u) * smooth(u, wi, wo, l)));
    // Constant at the centres of texels, waves between them.
    let alias = |u: [f32; 2]| 1.0 + 0.3 * ((TAU * SIDE * u[0] + 1.0).cos() - 1f32.cos());
    wrong(found("between-texels", |u, wi, wo, l| alias(u) * smooth(u, wi, wo, l)));
    wrong(found("popping", |u, wi, wo, l| smooth(u, wi, wo, l.round())));
    wrong(found("level-means", |u, wi, wo, l| (1.0 - 0.15 * l) * smooth(u, wi, wo, l)));
    watch(found("level-pairs", |u, wi, wo, l| smooth([u[0] + 0.25 * l.floor(), u[1]], wi, wo, l)));
    let jitter = |w: [f32; 2]| 1.0 + 0.1 * (5e4 * w[0]).sin();
    wrong(found("light-arc", |u, wi, wo, l| jitter(wi) * smooth(u, wi, wo, l)));
    wrong(found("camera-arc", |u, wi, wo, l| jitter(wo) * smooth(u, wi, wo, l)));
    let sided = |wi: [f32; 2]| 1.0 + 0.5 * (TAU * wi[0] * 0.5).sin() + 0.5 * (TAU * wi[1] * 0.5).sin();
    watch(found("opposite-lights", |u, wi, wo, l| sided(wi) * smooth(u, wi, wo, l)));
    let burning = |w: [f32; 2]| if unit(w)[2] < 0.05 { 1000.0 } else { 1.0 };
    wrong(found("grazing-glow", |u, wi, wo, l| burning(wo) * smooth(u, wi, wo, l)));
    wrong(found("energy", |u, wi, wo, l| 7.0 * smooth(u, wi, wo, l)));
    watch(found("reciprocity", |u, wi, wo, l| smooth(u, wi, wo, l) * (4.0 * wo[0]).exp()));
    let rare = |u: [f32; 2]| u[0] < 0.001 && u[1] < 0.2;
    wrong(found("numbers", |u, wi, wo, l| if rare(u) { f32::NAN } else { smooth(u, wi, wo, l) }));
    wrong(found("numbers", |u, wi, wo, l| if rare(u) { -0.1 } else { smooth(u, wi, wo, l) }));
}

/// Answers that do not clamp, wrap or end at the horizon.
struct Careless(bool);

impl Reflectance for Careless {
    fn evaluate(&self, q: &QueryBuffer) -> Result<RgbImage> {
        let value = |k: usize| if self.0 { 0.1 + q.level[k].clamp(-2.0, 9.0) } else { 0.1 };
        Ok(RgbImage {
            height: q.height(),
            width: q.width(),
            pixels: (0..q.len()).map(|k| [value(k); 3]).collect(),
        })
    }
}

#[test]
fn what_does_not_clamp_is_found() {
    let verdicts = |levels: bool| {
        examined(&Careless(levels), &["horizon", "range"])
            .findings
            .iter()
            .map(|f| f.verdict)
            .collect::<Vec<_>>()
    };
    assert_eq!(verdicts(true), [Verdict::Wrong, Verdict::Wrong]);
    assert_eq!(verdicts(false), [Verdict::Wrong, Verdict::Fine]);
}

/// Refuses a buffer that has a bad query, as the fused engine does.
struct Refusing;

impl Reflectance for Refusing {
    fn evaluate(&self, q: &QueryBuffer) -> Result<RgbImage> {
        if q.level.iter().any(|level| *level >= 1e6) {
            return Err(Error::config("query", "the model's answer is not finite"));
        }
        Formula(smooth).evaluate(q)
    }
}

#[test]
fn one_refused_answer_is_found_among_many_and_other_checks_say_that_they_failed() {
    let examination = examined(&Refusing, &["numbers", "range", "seam"]);
    let [numbers, range, seam] = &examination.findings[..] else { panic!("{examination:?}") };
    assert_eq!(numbers.verdict, Verdict::Wrong);
    assert!(numbers.places.iter().all(|place| place.level >= 1e6), "{:?}", numbers.places);
    assert!(range.says.contains("not finite") && range.figure.is_none(), "{range:?}");
    assert_eq!(seam.verdict, Verdict::Fine);
    assert!(examination.conclusion().contains("should not ship"), "{}", examination.conclusion());
}

#[test]
fn a_folder_is_written_once_and_replaced_by_force_and_others_are_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let examination = examined(&Formula(smooth), &["seam", "energy"]);
    examination.write(&out, false).unwrap();
    assert!(out.join("pictures/seam.png").is_file() && out.join("STABILITY.md").is_file());
    assert!(examination.write(&out, false).unwrap_err().to_string().contains("--force"));
    examined(&Formula(smooth), &["energy"]).write(&out, true).unwrap();
    assert!(!out.join("pictures/seam.png").exists() && out.join("pictures/energy.png").is_file());
    std::fs::write(out.join("pictures/mine.txt"), "").unwrap();
    assert!(examination.write(&out, true).unwrap_err().to_string().contains("mine.txt"));
    assert!(examination.write(folder.path(), true).unwrap_err().to_string().contains("another --out"));
}

#[test]
fn names_are_known() {
    assert!(known(&["seam".into()]).is_ok());
    assert!(known(&["sean".into()]).unwrap_err().to_string().contains("between-texels"));
    let names: std::collections::BTreeSet<&str> = checks().iter().map(|check| check.name).collect();
    assert_eq!(names.len(), checks().len(), "two checks have one name");
}
