//! The sampler's mixture written down once more, in 64-bit floats from the text of the format, to compare readers with.

use crate::materials::Numbers;
use neumip_export::sampler::{FORMAT, Frame, OUTPUTS_PER_LOBE, SAMPLER_MLP, SamplerHeader};
use neumip_export::{Sampler, SamplerConfig, Tensor};
use std::f64::consts::PI;

/// A sampler with random weights of usual size and biases that give lobes of all widths.
pub fn sampler(features: usize, lobes: &[Frame], seed: u64) -> Sampler {
    let config =
        SamplerConfig { features, hidden: vec![13, 8], lobes: lobes.to_vec(), cosine_floor: 0.1, min_z: 0.2 };
    let mut numbers = Numbers::new(seed);
    let mut tensor = |name: &str, shape: Vec<usize>| {
        let size = if name.ends_with("bias") { 0.2 } else { 0.5 };
        let mut data: Vec<f32> = (0..shape.iter().product()).map(|_| size * numbers.normal()).collect();
        if name == format!("{SAMPLER_MLP}.2.bias") {
            for (lobe, values) in data.chunks_mut(OUTPUTS_PER_LOBE).enumerate() {
                values[3] -= lobe as f32;
                values[5] -= 0.7 * lobe as f32;
            }
        }
        Tensor { shape, data }
    };
    let tensors = config
        .tensors()
        .into_iter()
        .map(|(name, shape)| {
            let tensor = tensor(&name, shape);
            (name, tensor)
        })
        .collect();
    Sampler { header: SamplerHeader { format: FORMAT, config, provenance: serde_json::Value::Null }, tensors }
}

/// A lobe: weight, centre, matrix.
pub struct Lobe {
    pub weight: f64,
    pub centre: [f64; 2],
    pub matrix: [[f64; 2]; 2],
}

/// The lobes of features and wo.
pub fn lobes(sampler: &Sampler, features: &[f64], wo: [f32; 2]) -> Vec<Lobe> {
    let config = &sampler.header.config;
    let mut x: Vec<f64> = features.iter().copied().chain(wo.map(f64::from)).collect();
    let layers = config.widths().len() - 1;
    for layer in 0..layers {
        let weight = &sampler.tensors[&format!("{SAMPLER_MLP}.{layer}.weight")];
        let bias = &sampler.tensors[&format!("{SAMPLER_MLP}.{layer}.bias")].data;
        let rows = weight.data.chunks(weight.shape[1]);
        let row = |row: &[f32]| row.iter().zip(&x).map(|(w, x)| f64::from(*w) * x).sum::<f64>();
        x = rows.zip(bias).map(|(r, b)| row(r) + f64::from(*b)).collect();
        if layer + 1 < layers {
            x.iter_mut().for_each(|v| *v = v.max(0.0));
        }
    }
    let z = f64::from((1.0 - (wo[0] * wo[0] + wo[1] * wo[1])).max(0.0).sqrt()).max(f64::from(config.min_z));
    let m = wo.map(|w| -f64::from(w) / z);
    let t = |i: usize, j: usize| f64::from(u8::from(i == j)) + m[i] * m[j];
    let mut lobes = vec![Lobe { weight: 1.0, centre: [0.0; 2], matrix: [[1.0, 0.0], [0.0, 1.0]] }];
    for (frame, raw) in config.lobes.iter().zip(x.chunks(OUTPUTS_PER_LOBE)) {
        let c = [raw[1].clamp(-8.0, 8.0), raw[2].clamp(-8.0, 8.0)];
        let (p, r, q) =
            (raw[3].clamp(-5.0, 2.0).exp(), raw[4].clamp(-4.0, 4.0), raw[5].clamp(-5.0, 2.0).exp());
        let l = [[p, 0.0], [r * p, q]];
        let weight = raw[0].clamp(-20.0, 20.0).exp();
        lobes.push(match frame {
            Frame::Surface => Lobe { weight, centre: c, matrix: l },
            Frame::Mirror => Lobe {
                weight,
                centre: [0, 1].map(|i| m[i] + t(i, 0) * c[0] + t(i, 1) * c[1]),
                matrix: [0, 1].map(|i| [0, 1].map(|j| t(i, 0) * l[0][j] + t(i, 1) * l[1][j])),
            },
        });
    }
    let sum: f64 = lobes.iter().map(|lobe| lobe.weight).sum();
    let floor = f64::from(config.cosine_floor);
    lobes.iter_mut().for_each(|lobe| lobe.weight *= (1.0 - floor) / sum);
    lobes[0].weight += floor;
    lobes
}

/// The mixture's density over solid angle.
pub fn density(lobes: &[Lobe], wi: [f64; 3]) -> f64 {
    let [x, y, z] = wi;
    let of = |lobe: &Lobe| {
        let [[a, b], [c, d]] = lobe.matrix;
        let determinant = a * d - b * c;
        let (dx, dy) = (x - lobe.centre[0] * z, y - lobe.centre[1] * z);
        let v = [(d * dx - b * dy) / determinant, (a * dy - c * dx) / determinant];
        lobe.weight * z / (PI * determinant.abs() * (z * z + v[0] * v[0] + v[1] * v[1]).powi(2))
    };
    if z > 0.0 { lobes.iter().map(of).sum() } else { 0.0 }
}

/// The direction of two numbers.
pub fn sample(lobes: &[Lobe], xi: [f32; 2]) -> [f64; 3] {
    let mut start = 0.0;
    let mut first = f64::from(xi[0]);
    let mut chosen = lobes.len() - 1;
    for (k, lobe) in lobes.iter().enumerate() {
        if first < start + lobe.weight {
            chosen = k;
            break;
        }
        start += if k + 1 < lobes.len() { lobe.weight } else { 0.0 };
    }
    let lobe = &lobes[chosen];
    first = ((first - start) / lobe.weight).clamp(0.0, 1.0);
    let second = f64::from(xi[1]);
    let (slope, angle) = ((second / (1.0 - second)).sqrt(), 2.0 * PI * first);
    let t = [slope * angle.cos(), slope * angle.sin()];
    let s = [0, 1].map(|i| lobe.matrix[i][0] * t[0] + lobe.matrix[i][1] * t[1] + lobe.centre[i]);
    let length = (1.0 + s[0] * s[0] + s[1] * s[1]).sqrt();
    [s[0] / length, s[1] / length, 1.0 / length]
}
