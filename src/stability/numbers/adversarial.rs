//! Answers without a number.

use super::published::{Habits, Published};
use super::queries::adversarial;
use crate::engine::FusedMaterial;
use crate::error::Result;
use crate::query::{QueryBuffer, Reflectance};
use crate::stability::probe::{Bound, Group, Outcome, Probe};
use crate::stability::workshop::Workshop;
use rayon::prelude::*;

/// Queries of a buffer: small enough to stay in a cache.
const PART: u64 = 4096;
/// Buffers between two looks at whether to stop.
const PARTS: u64 = 512;
/// One buffer of so many is also read as published, which takes a hundred times as long.
const PUBLISHED: u64 = 64;

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "adversarial-queries",
        group: Group::Numbers,
        provokes: "Path tracers ask anything: positions far away, directions a rounding beyond the horizon, footprints of 0 or \
                   without end. One answer without number blackens a picture.",
        naive: "the formulas as printed: z = sqrt(1 - x^2 - y^2), level = log2(radius), gamma of u as it comes, exp(x) - 1 of \
                any direction",
        cured: "u wrapped first, level clamped, z guarded, 0 on and below the horizon",
        figure: "answers without number (as printed: among one of 64 queries)",
        bound: Bound::new(0.0, "one is a black or white pixel that no number of samples mends"),
        run,
    }]
}

fn run(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let trained = workshop.train(&material, "improved", &[])?;
    let model = trained.sound()?;
    let architecture = &model.checkpoint.header.architecture;
    let habits = Habits { gamma: super::published::Gamma::Plain, guarded: false, ..Habits::GOOD };
    let printed = Published::new(&model.checkpoint, habits)?;
    let parts = workshop.scale().queries.div_ceil(PART);
    let (mut naive, mut cured, mut of_printed) = (0, 0, 0);
    for first in (0..parts).step_by(PARTS as usize) {
        workshop.check()?;
        let counts = (first..(first + PARTS).min(parts)).into_par_iter().map(|part| {
            let queries = adversarial(architecture, PART as usize, part);
            let looked = part.is_multiple_of(PUBLISHED);
            let as_printed = if looked { lost(&printed.answers(&queries)) } else { 0 };
            (as_printed, refused(&model.material, &queries), if looked { PART } else { 0 })
        });
        // Sums of integers are the same in any order.
        let sum = counts.reduce(|| (0, 0, 0), |a, b| (a.0 + b.0, a.1 + b.1, a.2 + b.2));
        (naive, cured, of_printed) = (naive + sum.0, cured + sum.1, of_printed + sum.2);
    }
    let asked = parts * PART;
    let share = 100.0 * naive as f64 / of_printed as f64;
    let note = format!(
        "{asked} queries, every other one ordinary. As printed {share:.1} % of the {of_printed} that were looked at have no \
         number."
    );
    let values = vec![("queries".into(), asked as f64), ("queries_as_printed".into(), of_printed as f64)];
    Ok(Outcome { notes: vec![note], values, ..Outcome::new(naive as f64, cured as f64) })
}

/// Answers that are no finite numbers.
fn lost(pixels: &[[f32; 3]]) -> u64 {
    pixels.iter().filter(|p| !p.iter().all(|v| v.is_finite())).count() as u64
}

/// Queries that the fused engine has no finite answer to: it refuses a buffer that holds one.
fn refused(material: &FusedMaterial, queries: &QueryBuffer) -> u64 {
    if material.evaluate(queries).is_ok() {
        return 0;
    }
    match queries.len() {
        1 => 1,
        n => [(0, n / 2), (n / 2, n)]
            .map(|(start, end)| refused(material, &queries.range(start, end)))
            .iter()
            .sum(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::kernels::simd::Isa;
    use crate::model::Variables;
    use candle_core::Device;
    use neumip_export::{Architecture, Precision};

    #[test]
    fn every_answer_without_number_is_counted() {
        let model = Config::preset("improved").unwrap().model;
        let architecture = Architecture::new(model, [16, 16]).unwrap();
        let mut tensors = Variables::initial(&architecture, 1, &Device::Cpu).unwrap().to_stored().unwrap();
        let queries = adversarial(&architecture, 512, 0);
        let isa = Isa::chosen().unwrap();
        let sound = FusedMaterial::new(&architecture, &tensors, Precision::Single, isa).unwrap();
        assert_eq!(refused(&sound, &queries), 0);
        let answers = sound.evaluate(&queries).unwrap().pixels;
        assert_eq!(lost(&answers), 0);
        assert_eq!(lost(&[[0.0, f32::NAN, 0.0], [0.0; 3], [f32::INFINITY; 3]]), 2);
        let bias = tensors.get_mut("decoder.mlp.3.bias").unwrap();
        bias.data[0] = f32::NAN;
        let poisoned = FusedMaterial::new(&architecture, &tensors, Precision::Single, isa).unwrap();
        let lit = queries
            .wi
            .iter()
            .zip(&queries.wo)
            .filter(|(wi, wo)| crate::query::above_horizon(**wi) && crate::query::above_horizon(**wo));
        assert_eq!(refused(&poisoned, &queries), lit.count() as u64);
    }
}
