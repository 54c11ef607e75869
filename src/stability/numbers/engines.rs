//! candle, the fused kernels and the exported graph at extreme queries.

use super::published::{Habits, Published};
use super::queries::adversarial;
use crate::error::Result;
use crate::model::NeuralMaterial;
use crate::onnx_material::{OnnxMaterial, largest_difference};
use crate::query::{QueryBuffer, Reflectance};
use crate::stability::probe::{Bound, Group, Outcome, Probe};
use crate::stability::workshop::Workshop;

/// Largest difference at the extremes.
const EXTREMES: f64 = 1e-4;
use candle_core::Device;
use neumip_export::onnx::{Options, material_graph};
use std::path::Path;

/// Queries of each engine.
const QUERIES: usize = 1 << 15;

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "engines",
        group: Group::Numbers,
        provokes: "A material is trained in one engine, rendered in another and exported to a third. Where they read the format \
                   apart at the edges (level, wrap, horizon) the picture is not the one that was measured.",
        naive: "a renderer's own reader that rounds the level to the nearest",
        cured: "candle, fused kernels and material.onnx in rten",
        figure: "largest difference to the fused kernels / (1 + value), ordinary and extreme queries",
        bound: Bound::new(
            EXTREMES,
            "f32 knows z of a direction that is one rounding above the horizon to 2.4e-4; elsewhere 2e-5 hold",
        ),
        run,
    }]
}

fn run(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let trained = workshop.train(&material, "improved", &[])?;
    let model = trained.sound()?;
    let checkpoint = &model.checkpoint;
    let queries = adversarial(&checkpoint.header.architecture, QUERIES, 1 << 41);
    let fused = model.material.evaluate(&queries)?.pixels;
    let candle = NeuralMaterial::from_checkpoint(checkpoint, &Device::Cpu)?.evaluate(&queries)?.pixels;
    let graph = material_graph(checkpoint, Options::default())?;
    let onnx = OnnxMaterial::from_bytes(Path::new("material.onnx"), graph)?.evaluate(&queries)?.pixels;
    let mut notes = Vec::new();
    let mut values = Vec::new();
    let mut cured = 0.0f64;
    for (name, answers) in [("candle", &candle), ("onnx", &onnx)] {
        let found = largest_difference(answers, &fused);
        values.push((name.into(), found));
        notes.push(format!("{name} against fused: {found:.1e}; worst {}.", worst(&queries, answers, &fused)));
        cured = if found <= cured { cured } else { found };
    }
    let naive = |habits: Habits| -> Result<f64> {
        Ok(largest_difference(&Published::new(checkpoint, habits)?.answers(&queries), &fused))
    };
    let nearest = naive(Habits { nearest_level: true, ..Habits::GOOD })?;
    let unwrapped = naive(Habits { guarded: false, ..Habits::GOOD })?;
    let scalar = naive(Habits::GOOD)?;
    values.push(("scalar".into(), scalar));
    notes.push(match unwrapped.is_finite() {
        true => format!("A reader without wrap, clamp and horizon is off by {unwrapped:.1e}."),
        false => "A reader without wrap, clamp and horizon has answers without number.".into(),
    });
    notes.push(format!("A scalar reader without such habits: {scalar:.1e}."));
    Ok(Outcome { notes, values, ..Outcome::new(nearest, cured) })
}

/// The query at which two answers are farthest apart.
fn worst(queries: &QueryBuffer, a: &[[f32; 3]], b: &[[f32; 3]]) -> String {
    let apart = |k: &usize| largest_difference(&a[*k..*k + 1], &b[*k..*k + 1]);
    match (0..queries.len()).max_by(|i, j| apart(i).total_cmp(&apart(j))) {
        None => "nowhere".into(),
        Some(k) => {
            let QueryBuffer { u, wi, wo, level, .. } = queries;
            format!("at u {:?}, wi {:?}, wo {:?}, level {}", u[k], wi[k], wo[k], level[k])
        }
    }
}
