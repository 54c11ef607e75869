//! Directions on and below the horizon.

use super::asking::asked;
use crate::engine::FusedMaterial;
use crate::error::Result;
use crate::model::texture::Sigmas;
use crate::model::{Inputs, Networks, NeuralMaterial, Tables, Variables};
use crate::onnx_material::OnnxMaterial;
use crate::query::{QueryBuffer, Reflectance, project};
use crate::random::Random;
use crate::stability::probe::{Bound, Group, Outcome, Probe};
use crate::stability::workshop::Workshop;
use candle_core::Device;
use neumip_export::checkpoint::Checkpoint;
use neumip_export::onnx;
use std::path::Path;

/// Queries.
const QUERIES: usize = 8192;

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "below-horizon",
        group: Group::Direction,
        provokes: "On and beyond the unit disc there is no light to answer for, and z = sqrt(1 - x^2 - y^2) is no number: a \
                   renderer that asks there gets light through the surface, or NaN.",
        naive: "decoder asked as it is, z as the formula has it",
        cured: "0 by rule in the fused engine, candle and ONNX",
        figure: "share of answers on and below the horizon that are not exactly 0",
        bound: Bound::new(0.0, "the conventions promise 0"),
        run: horizon,
    }]
}

/// A direction on the horizon, a step of f32 beyond it, folded below it, or far away.
fn below(random: &mut Random) -> [f32; 2] {
    let (sin, cos) = (std::f32::consts::TAU * random.uniform()).sin_cos();
    match random.below(5) {
        0 => [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]][random.below(4)],
        1 => [1.0f32.next_up() * if random.below(2) == 0 { 1.0 } else { -1.0 }, 0.0],
        2 => {
            let z = -random.uniform();
            let radius = (1.0 - z * z).sqrt();
            project([radius * cos, radius * sin, z])
        }
        3 => [2.0 * cos, 2.0 * sin],
        _ => [1e6 * cos, 1e6 * sin],
    }
}

/// Light, view, or both on or below the horizon.
fn queries() -> Result<QueryBuffer> {
    asked(QUERIES, 5, |random| {
        let (low, high) = (below(random), random.disc(0.99));
        match random.below(3) {
            0 => [low, high],
            1 => [high, low],
            _ => [low, below(random)],
        }
    })
}

/// Share of pixels with a value that is not 0, not a number included.
fn lit(pixels: &[[f32; 3]]) -> f64 {
    let lit = pixels.iter().filter(|p| !p.iter().all(|v| *v == 0.0)).count();
    lit as f64 / pixels.len().max(1) as f64
}

/// What the networks say without the rule, with z as the formula has it.
fn without_rule(checkpoint: &Checkpoint, queries: &QueryBuffer) -> Result<(f64, f64)> {
    let device = Device::Cpu;
    let architecture = &checkpoint.header.architecture;
    let variables = Variables::from_stored(architecture, &checkpoint.tensors, &device)?;
    let tables = Tables::new(architecture, &variables, &Sigmas::none(architecture))?;
    let networks = Networks::detached(architecture, &variables)?;
    let QueryBuffer { u, wi, wo, level, .. } = queries;
    let inputs = Inputs::new(architecture, u, wi, wo, level, &device)?;
    let rgb: Vec<f32> = networks.forward(&inputs, &tables)?.flatten_all()?.to_vec1()?;
    let pixels: Vec<[f32; 3]> =
        rgb.as_chunks().0.iter().map(|p: &[f32; 3]| p.map(|v| if v < 0.0 { 0.0 } else { v })).collect();
    let no_number = |w: &[f32; 2]| (1.0 - w[0] * w[0] - w[1] * w[1]).sqrt().is_nan();
    let lost = wi.iter().zip(wo).filter(|(wi, wo)| no_number(wi) || no_number(wo)).count();
    Ok((lit(&pixels), lost as f64 / queries.len() as f64))
}

fn horizon(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let trained = workshop.train(&material, "improved", &[])?;
    let model = trained.sound()?;
    let queries = queries()?;
    let (naive, no_number) = without_rule(&model.checkpoint, &queries)?;
    let graph = onnx::material_graph(&model.checkpoint, onnx::Options::default())?;
    let graph = OnnxMaterial::from_bytes(Path::new("material.onnx"), graph)?;
    let candle = NeuralMaterial::from_checkpoint(&model.checkpoint, &Device::Cpu)?;
    let engines: [(&str, &dyn Reflectance); 3] =
        [("fused", &model.material), ("candle", &candle), ("ONNX", &graph)];
    let mut values = vec![("share where z as the formula has it is no number".to_string(), no_number)];
    let mut cured = 0.0f64;
    for (name, engine) in engines {
        let share = lit(&engine.evaluate(&queries)?.pixels);
        values.push((format!("share of answers that are not 0, {name}"), share));
        cured = cured.max(share);
    }
    let share = prepared(&model.material, &queries)?;
    values.push(("share of answers that are not 0, fused with the view prepared".to_string(), share));
    Ok(Outcome { values, ..Outcome::new(naive, cured.max(share)) })
}

/// The engine's other way to an answer: the view first, the light later.
fn prepared(material: &FusedMaterial, queries: &QueryBuffer) -> Result<f64> {
    let prepared = material.prepare(&queries.u, &queries.level, &queries.wo)?;
    Ok(lit(&material.light(&prepared, &queries.wi)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::above_horizon;

    #[test]
    fn every_query_has_a_direction_below() {
        let queries = queries().unwrap();
        let mut pairs = queries.wi.iter().zip(&queries.wo);
        assert!(pairs.all(|(wi, wo)| !(above_horizon(*wi) && above_horizon(*wo))));
        assert!(queries.wi.iter().any(|w| above_horizon(*w)) && queries.wi.contains(&[1.0, 0.0]));
    }

    #[test]
    fn what_is_no_number_counts_as_light() {
        assert_eq!(lit(&[[0.0; 3], [-0.0; 3]]), 0.0);
        assert_eq!(lit(&[[0.0; 3], [0.0, f32::NAN, 0.0], [1e-30, 0.0, 0.0], [0.0; 3]]), 0.5);
    }
}
