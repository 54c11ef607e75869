//! Denormals flushed to zero, as game engines and audio hosts set their threads.

use super::SAME;
use super::queries::adversarial;
use crate::engine::FusedMaterial;
use crate::error::{Error, Result};
use crate::kernels::simd::flushing;
use crate::onnx_material::largest_difference;
use crate::query::Reflectance;
use crate::stability::probe::{Bound, Group, Outcome, Probe};
use crate::stability::workshop::Workshop;
use half::f16;
use neumip_export::{Checkpoint, Storage};

/// Why nothing happens.
const SAFE: &str = "Features and weights are near 1 and are added up: what a denormal contributes is below a rounding of f32, \
                    and of f16 it is below the step to the next stored value.";
/// Queries that are answered both ways.
const QUERIES: usize = 1 << 16;

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "flush-to-zero",
        group: Group::Numbers,
        provokes: "Renderers set their threads to flush denormals: whatever lives below 1e-38 is 0 there.",
        naive: "f16 storage on hardware that flushes f16 denormals, below 6e-5",
        cured: "the fused kernels on a thread that flushes f32 denormals",
        figure: "largest difference / (1 + value) between flushed and not",
        bound: Bound::new(SAME, "the tolerance of golden answers in bundles"),
        run,
    }]
}

fn run(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let trained = workshop.train(&material, "improved", &[])?;
    let model = trained.sound()?;
    let queries = adversarial(&model.checkpoint.header.architecture, QUERIES, 1 << 42);
    let before = model.material.evaluate(&queries)?.pixels;
    // One thread, so that everything happens where the mode is set.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    let pool = pool.map_err(|e| Error::config("threads", e))?;
    let flushed = pool.install(|| flushing(|| model.material.evaluate(&queries)));
    let mut notes = Vec::new();
    let after = match flushed {
        Some(after) => after?.pixels,
        None => {
            notes.push("Not measured: this machine has no such mode that is known here.".into());
            before.clone()
        }
    };
    let difference = largest_difference(&after, &before);
    let all = || model.checkpoint.tensors.values().flat_map(|tensor| &tensor.data);
    let denormal = all().filter(|v| v.is_subnormal()).count();
    let least = all().filter(|v| **v != 0.0).fold(f32::INFINITY, |least, v| least.min(v.abs()));
    let exact = after == before;
    notes.push(format!(
        "In f32 {denormal} of {} stored values are denormal, the least that is not 0 is {least:.1e}; answers of a flushing \
         thread are {}.",
        all().count(),
        if exact { "the same bytes" } else { "not the same bytes" }
    ));
    let half = Storage::HALF.round(model.checkpoint.clone())?;
    let (starved, flushed) = without_denormals(half.clone());
    let answers = |checkpoint| -> Result<Vec<[f32; 3]>> {
        Ok(FusedMaterial::from_checkpoint(checkpoint)?.evaluate(&queries)?.pixels)
    };
    let naive = largest_difference(&answers(&starved)?, &answers(&half)?);
    notes.push(format!("In f16 {flushed} values are denormal."));
    let safe = (naive <= SAME).then(|| SAFE.to_string());
    Ok(Outcome { safe, notes, ..Outcome::new(naive, difference) })
}

/// Stored values that are denormal in f16 as 0, and how many those are.
fn without_denormals(mut checkpoint: Checkpoint) -> (Checkpoint, usize) {
    let mut flushed = 0;
    for value in checkpoint.tensors.values_mut().flat_map(|tensor| &mut tensor.data) {
        if *value != 0.0 && value.abs() < f16::MIN_POSITIVE.to_f32() {
            *value = 0.0;
            flushed += 1;
        }
    }
    (checkpoint, flushed)
}
