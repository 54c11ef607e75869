//! Instruction sets against each other.

use super::SAME;
use super::published::{Gamma, Habits, Published};
use super::queries::adversarial;
use crate::engine::FusedMaterial;
use crate::error::Result;
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
        figure: "largest difference between two ways / (1 + value), ordinary and extreme queries",
        bound: Bound { most: SAME, reason: "the tolerance of golden answers in bundles" },
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
    let mut cured = 0.0f64;
    let mut notes = Vec::new();
    for (isa, answer) in sets.iter().zip(&answers).skip(1) {
        let found = largest_difference(answer, &answers[0]);
        notes.push(format!("{} against {}: {found:.1e}.", isa.name(), sets[0].name()));
        cured = if found <= cured { cured } else { found };
    }
    if sets.len() == 1 {
        notes.push("This machine has the portable set only.".into());
    }
    let naive_of = |gamma| -> Result<f64> {
        let reader = Published::new(&model.checkpoint, Habits { gamma, ..Habits::GOOD })?;
        Ok(largest_difference(&reader.answers(&queries), &answers[0]))
    };
    let naive = naive_of(Gamma::Doubled)?;
    let (plain, exact) = (naive_of(Gamma::Plain)?, naive_of(Gamma::Exact)?);
    notes.push(format!(
        "In scalar arithmetic: sines of the formula in f32 {plain:.1e}, in double precision {exact:.1e}."
    ));
    let values = vec![("plain_formula".into(), plain), ("double_precision".into(), exact)];
    Ok(Outcome { notes, values, plot: Some(drift()), ..Outcome::new(naive, cured) })
}

/// Largest error of the sine of each octave.
fn drift() -> Plot {
    let mut worst = [[0.0f64; OCTAVES]; 3];
    for k in 0..POSITIONS {
        let p = 2.0 * (k as f32 + 0.5) / POSITIONS as f32 - 1.0;
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
    }
}
