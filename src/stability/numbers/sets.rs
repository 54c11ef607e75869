//! Instruction sets against each other.

use super::SAME;
use super::published::{Gamma, Habits, Published};
use super::queries::adversarial;
use crate::engine::FusedMaterial;
use crate::error::Result;
use crate::kernels::encoding_rows::{Factor, encode};
use crate::kernels::simd::Isa;
use crate::onnx_material::largest_difference;
use crate::query::Reflectance;
use crate::report::figures::Series;
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::workshop::Workshop;
use neumip_export::Precision;

/// Queries that every set answers.
const QUERIES: usize = 1 << 16;
/// Octaves of the method's gamma.
const OCTAVES: usize = 10;
/// Positions at which gamma alone is looked at.
const POSITIONS: usize = 4096;

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "instruction-sets",
        group: Group::Numbers,
        provokes: "Sets round and add in another order, and sines by double angles double an error at every octave: the same \
                   material looks different on another machine.",
        naive: "gamma by double angles through all 10 octaves",
        cured: "portable, AVX2 and AVX-512 kernels: double angles with an exact restart every 4 octaves",
        figure: "largest difference / (1 + value) of encodings from double precision, and of answers between sets",
        bound: Bound::new(SAME, "the tolerance of golden answers in bundles"),
        run,
    }]
}

fn run(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    // The paper's own encoding: all octaves of u, none of them damped.
    let trained = workshop.train(&material, "paper", &[])?;
    let model = trained.sound()?;
    let architecture = &model.checkpoint.header.architecture;
    let queries = adversarial(architecture, QUERIES, 1 << 40);
    let sets = Isa::all();
    let mut answers = Vec::new();
    for isa in &sets {
        let tensors = &model.checkpoint.tensors;
        let material = FusedMaterial::new(architecture, tensors, Precision::Single, *isa)?;
        answers.push(material.evaluate(&queries)?.pixels);
    }
    let [doubled, plain_error] = worst_of(&drift());
    let mut cured = 0.0f64;
    let mut notes = Vec::new();
    for isa in &sets {
        let found = encoded(*isa);
        notes.push(format!("Encoding with {}: {found:.1e}.", isa.name()));
        cured = if found <= cured { cured } else { found };
    }
    for (isa, answer) in sets.iter().zip(&answers).skip(1) {
        let found = largest_difference(answer, &answers[0]);
        notes.push(format!("Answers with {} against {}: {found:.1e}.", isa.name(), sets[0].name()));
        cured = if found <= cured { cured } else { found };
    }
    if sets.len() == 1 {
        notes.push("This machine has the portable set only.".into());
    }
    let naive_of = |gamma| -> Result<f64> {
        let reader = Published::new(&model.checkpoint, Habits { gamma, ..Habits::GOOD })?;
        Ok(largest_difference(&reader.answers(&queries), &answers[0]))
    };
    let by_doubled = naive_of(Gamma::Doubled)?;
    let (plain, exact) = (naive_of(Gamma::Plain)?, naive_of(Gamma::Exact)?);
    notes.push(format!(
        "Answers in scalar arithmetic against {}: with double angles {by_doubled:.1e}, with the formula in f32 (its encoding is \
         off by {plain_error:.1e}) {plain:.1e}, with double precision {exact:.1e}.",
        sets[0].name()
    ));
    let values = vec![
        ("answers_of_double_angles".into(), by_doubled),
        ("answers_of_plain_formula".into(), plain),
        ("answers_of_double_precision".into(), exact),
    ];
    Ok(Outcome { notes, values, plot: Some(drift()), ..Outcome::new(doubled.max(by_doubled), cured) })
}

/// Largest errors of double angles and of the plain formula.
fn worst_of(plot: &Plot) -> [f64; 2] {
    [0, 1].map(|k| plot.series[k].points.iter().fold(0.0, |worst: f64, point| worst.max(point.1)))
}

fn position(k: usize) -> f32 {
    2.0 * (k as f32 + 0.5) / POSITIONS as f32 - 1.0
}

/// Largest error of a set's encoding.
fn encoded(isa: Isa) -> f64 {
    let p: Vec<f32> = (0..POSITIONS).map(position).collect();
    let mut out = vec![0.0; 2 * OCTAVES * POSITIONS];
    encode(isa, POSITIONS, &p, OCTAVES, true, Factor::Amplitude(1.0), &mut out);
    let mut worst = 0.0f64;
    for (row, values) in out.chunks(POSITIONS).enumerate() {
        for (value, p) in values.iter().zip(&p) {
            let angle = f64::from(1u32 << (row / 2)) * std::f64::consts::PI * f64::from(*p);
            let exact = if row.is_multiple_of(2) { angle.sin() } else { angle.cos() };
            let error = (f64::from(*value) - exact).abs();
            worst = if error <= worst { worst } else { error };
        }
    }
    worst
}

/// Largest error of the sine of each octave.
fn drift() -> Plot {
    let mut worst = [[0.0f64; OCTAVES]; 3];
    for k in 0..POSITIONS {
        let p = position(k);
        let mut restarted = Vec::new();
        crate::kernels::encoding::encode(&mut restarted, [p], OCTAVES, true, |_, _| 1.0);
        let (mut sin, mut cos) = (std::f32::consts::PI * p).sin_cos();
        for band in 0..OCTAVES {
            let octave = (1u32 << band) as f32;
            let exact = (f64::from(octave) * std::f64::consts::PI * f64::from(p)).sin();
            let ways = [sin, (octave * std::f32::consts::PI * p).sin(), restarted[2 * band]];
            for (worst, way) in worst.iter_mut().zip(ways) {
                worst[band] = worst[band].max((f64::from(way) - exact).abs());
            }
            (sin, cos) = (2.0 * sin * cos, 1.0 - 2.0 * sin * sin);
        }
    }
    let series = |name: &str, worst: &[f64; OCTAVES]| Series {
        name: name.into(),
        points: worst.iter().enumerate().map(|(band, e)| (band as f64, *e)).collect(),
    };
    Plot {
        x: "octave k of sin(2^k pi p)".into(),
        y: "largest error".into(),
        series: vec![
            series("double angles", &worst[0]),
            series("plain formula", &worst[1]),
            series("restarts", &worst[2]),
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::encoding::DRIFT;

    #[test]
    fn angles_drift_without_restarts_only() {
        let plot = drift();
        let last = |k: usize| plot.series[k].points[OCTAVES - 1].1;
        assert!(last(0) > 10.0 * f64::from(DRIFT) && last(1) > 10.0 * f64::from(DRIFT));
        assert!(last(2) < f64::from(DRIFT));
        for isa in Isa::all() {
            assert!(encoded(isa) < f64::from(DRIFT), "{}", isa.name());
        }
    }
}
