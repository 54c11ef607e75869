//! The material written down once more, query by query in 64-bit floats, to compare the graphs with.
//!
//! Small differences in four quantities grow (a rounding of p by 2^k pi, one of z near the horizon by 1 / z),
//! so those are taken in 32-bit floats as the format has them: the wrapped u, p, x^2 + y^2 and z.

use neumip_export::config::*;
use neumip_export::{Checkpoint, Golden};

/// Texture features at `u` (wrapped) after parallax.
pub fn features(checkpoint: &Checkpoint, u: [f32; 2], wo: [f32; 2], level: f32) -> Vec<f64> {
    let architecture = &checkpoint.header.architecture;
    let (u, level) = led(architecture, u, level);
    let mut at = wrapped(u).map(f64::from);
    if let ParallaxConfig::Offset(offset) = &architecture.model.parallax {
        let mut input = bilinear(checkpoint, OFFSET_TEXTURE, at);
        input.extend(wo.map(f64::from));
        let depth = network(checkpoint, OFFSET_MLP, input)[0] * f64::from(offset.scale);
        let z = f64::from(z(wo)).max(f64::from(offset.min_z));
        at = [0, 1].map(|c| at[c] + 0.5 * depth * f64::from(wo[c]) / z);
    }
    let last = architecture.levels() - 1;
    let finest = architecture.model.texture.finest as f64;
    let level = (f64::from(level) - finest).clamp(0.0, last as f64);
    let fine = level.floor() as usize;
    let fraction = level - level.floor();
    let a = bilinear(checkpoint, &texture_name(fine), at);
    let b = bilinear(checkpoint, &texture_name((fine + 1).min(last)), at);
    a.iter().zip(&b).map(|(a, b)| (1.0 - fraction) * a + fraction * b).collect()
}

/// Where a material with a domain looks in place of a query, in 32-bit floats as the format has it.
fn led(architecture: &Architecture, u: [f32; 2], level: f32) -> ([f32; 2], f32) {
    let Some(domain) = &architecture.domain else { return (u, level) };
    let clamped = level.max(domain.levels[0]).min(domain.levels[1]);
    if domain.tile == architecture.resolution {
        return (u, clamped);
    }
    let mut inside = true;
    let mut place = [0.0; 2];
    for (c, axis) in [(0, 1), (1, 0)] {
        let [tile, size] = [domain.tile[axis] as f32, architecture.resolution[axis] as f32];
        let moved = u[c] - domain.corner[axis] as f32 / tile;
        let windows = (moved - moved.floor()) * (tile / size);
        inside &= tile == size || windows < 1.0;
        place[c] = windows - windows.floor();
    }
    (place, if inside { clamped } else { architecture.coarsest() as f32 })
}

/// RGB from features: 0 below the horizon, never negative.
pub fn decode(
    checkpoint: &Checkpoint,
    features: &[f64],
    u: [f32; 2],
    wi: [f32; 2],
    wo: [f32; 2],
    level: f32,
) -> [f64; 3] {
    if square(wi) >= 1.0 || square(wo) >= 1.0 {
        return [0.0; 3];
    }
    colour(checkpoint, features, u, wi, wo, level).map(|x| x.max(0.0))
}

/// RGB from features as training sees it, not clamped.
pub fn colour(
    checkpoint: &Checkpoint,
    features: &[f64],
    u: [f32; 2],
    wi: [f32; 2],
    wo: [f32; 2],
    level: f32,
) -> [f64; 3] {
    let mut input = features.to_vec();
    input.extend(encoding(&checkpoint.header.architecture, u, wi, wo, level));
    shown(checkpoint, &network(checkpoint, DECODER_MLP, input))
}

/// RGB of periodic images from the features of their queries, 0 below the horizon and never negative.
pub fn decode_images(checkpoint: &Checkpoint, features: &[Vec<f64>], queries: &Golden) -> Vec<[f64; 3]> {
    let [_, height, width] = queries.images.unwrap();
    let inputs = features.iter().enumerate().map(|(k, features)| {
        let (u, wi, wo, level) = (queries.u[k], queries.wi[k], queries.wo[k], queries.level[k]);
        let mut input = features.clone();
        input.extend(encoding(&checkpoint.header.architecture, u, wi, wo, level));
        input
    });
    let inputs: Vec<Vec<f64>> = inputs.collect();
    let outputs = inputs.chunks(height * width).flat_map(|image| inception(checkpoint, image, height, width));
    let above = |k: usize| square(queries.wi[k]) < 1.0 && square(queries.wo[k]) < 1.0;
    let rgb = outputs.enumerate().map(|(k, y)| match above(k) {
        true => shown(checkpoint, &y).map(|x| x.max(0.0)),
        false => [0.0; 3],
    });
    rgb.collect()
}

fn inception(checkpoint: &Checkpoint, input: &[Vec<f64>], height: usize, width: usize) -> Vec<Vec<f64>> {
    let DecoderConfig::Inception(config) = &checkpoint.header.architecture.model.decoder else {
        panic!("no convolutions")
    };
    let around = |k: usize, side: usize| {
        let near = |at: usize, by: usize, n: usize| (at + by + side * n - side / 2) % n;
        let (row, column) = (k / width, k % width);
        let places =
            (0..side * side).map(move |s| (near(row, s / side, height), near(column, s % side, width)));
        places.map(move |(i, j)| i * width + j).collect::<Vec<_>>()
    };
    let convolved = |name: &str, x: &[Vec<f64>], relu: bool| -> Vec<Vec<f64>> {
        let weight = &checkpoint.tensors[&format!("decoder.{name}.weight")];
        let bias = &checkpoint.tensors[&format!("decoder.{name}.bias")].data;
        let [_, inputs, side, _] = weight.shape[..] else { panic!("{name}") };
        let pixel = |k: usize| {
            let near = around(k, side);
            let rows = weight.data.chunks(inputs * side * side).zip(bias);
            let sums = rows.map(|(row, bias)| {
                let products = near.iter().enumerate().flat_map(|(s, at)| {
                    x[*at].iter().enumerate().map(move |(c, x)| f64::from(row[c * side * side + s]) * x)
                });
                f64::from(*bias) + products.sum::<f64>()
            });
            sums.map(|v| if relu { v.max(0.0) } else { v }).collect()
        };
        (0..x.len()).map(pixel).collect()
    };
    let mut x = convolved("in", input, true);
    for module in 0..config.modules {
        let path = |name: &str, x: &[Vec<f64>]| convolved(&format!("module{module}.{name}"), x, true);
        let largest = |k: usize| -> Vec<f64> {
            let near = around(k, 3);
            (0..config.width).map(|c| near.iter().map(|at| x[*at][c]).fold(f64::MIN, f64::max)).collect()
        };
        let most: Vec<Vec<f64>> = (0..x.len()).map(largest).collect();
        let paths = [
            path("path1", &x),
            path("path2", &path("path2.reduce", &x)),
            path("path3", &path("path3.reduce", &x)),
            path("path4", &most),
        ];
        x = (0..x.len()).map(|k| paths.iter().flat_map(|path| path[k].clone()).collect()).collect();
    }
    convolved("out", &x, false)
}

/// RGB from the network's outputs.
fn shown(checkpoint: &Checkpoint, y: &[f64]) -> [f64; 3] {
    let output = &checkpoint.header.architecture.model.output;
    [0, 1, 2].map(|c| {
        let mut x = match output.space {
            OutputSpace::Rgb => y[c],
            OutputSpace::Yuv => (0..3).map(|k| f64::from(YUV_TO_RGB[c][k]) * y[k]).sum(),
        };
        if output.transform == OutputTransform::ExpMinusOne {
            x = x.exp() - 1.0;
        }
        if output.mask {
            x *= 0.1 + 1.0 / (1.0 + (-y[3 + c]).exp());
        }
        x
    })
}

fn encoding(architecture: &Architecture, u: [f32; 2], wi: [f32; 2], wo: [f32; 2], level: f32) -> Vec<f64> {
    let encoding = &architecture.model.encoding;
    let base = if encoding.pi { std::f64::consts::PI } else { 1.0 };
    let (u, level) = led(architecture, u, level);
    let mut out = Vec::new();
    let mut bands = |p: &[f64], count: usize, raw: bool, factor: &dyn Fn(usize, usize) -> f64| {
        for k in 0..count {
            let f = 2f64.powi(k as i32) * base;
            out.extend(p.iter().enumerate().map(|(c, p)| (f * p).sin() * factor(k, c)));
            out.extend(p.iter().enumerate().map(|(c, p)| (f * p).cos() * factor(k, c)));
        }
        if raw {
            out.extend(p);
        }
    };
    let p = wrapped(u).map(|u| f64::from(2.0 * u - 1.0));
    let level = f64::from(level).clamp(0.0, architecture.coarsest() as f64);
    let attenuation = |k: usize, c: usize| {
        let texels = [architecture.resolution[1], architecture.resolution[0]][c] as f64;
        let deviation = level.exp2() * 2.0 / texels / 12f64.sqrt();
        let x = 2f64.powi(k as i32) * base * deviation;
        if encoding.u.attenuate { (-x * x / 2.0).exp() } else { 1.0 }
    };
    bands(&p, architecture.u_bands(), encoding.u.raw, &attenuation);
    for (w, config) in [(wi, &encoding.wi), (wo, &encoding.wo)] {
        let w = [w[0], w[1], z(w)].map(f64::from);
        let amplitude = f64::from(config.amplitude);
        bands(&w[..encoding.components], config.bands, config.raw, &|_, _| amplitude);
    }
    out
}

fn network(checkpoint: &Checkpoint, prefix: &str, mut x: Vec<f64>) -> Vec<f64> {
    let mut layer = 0;
    while let Some(weight) = checkpoint.tensors.get(&weight_name(prefix, layer)) {
        let bias = &checkpoint.tensors[&bias_name(prefix, layer)].data;
        if layer > 0 {
            x.iter_mut().for_each(|v| *v = v.max(0.0));
        }
        let rows = weight.data.chunks(weight.shape[1]).zip(bias);
        x = rows
            .map(|(row, bias)| {
                f64::from(*bias) + row.iter().zip(&x).map(|(w, x)| f64::from(*w) * x).sum::<f64>()
            })
            .collect();
        layer += 1;
    }
    x
}

fn bilinear(checkpoint: &Checkpoint, name: &str, u: [f64; 2]) -> Vec<f64> {
    let texture = &checkpoint.tensors[name];
    let [height, width, channels] = texture.shape[..] else { panic!("{name} is no texture") };
    let (x, y) = (u[0] * width as f64 - 0.5, u[1] * height as f64 - 0.5);
    let mut out = vec![0.0; channels];
    for (dy, dx) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        let (fx, fy) = (x - x.floor(), y - y.floor());
        let weight = if dx == 0 { 1.0 - fx } else { fx } * if dy == 0 { 1.0 - fy } else { fy };
        let row = (y.floor() as i64 + dy).rem_euclid(height as i64) as usize;
        let column = (x.floor() as i64 + dx).rem_euclid(width as i64) as usize;
        for (c, out) in out.iter_mut().enumerate() {
            *out += weight * f64::from(texture.data[(row * width + column) * channels + c]);
        }
    }
    out
}

fn wrapped(u: [f32; 2]) -> [f32; 2] {
    u.map(|u| u - u.floor())
}

fn square(w: [f32; 2]) -> f32 {
    w[0] * w[0] + w[1] * w[1]
}

fn z(w: [f32; 2]) -> f32 {
    (1.0 - square(w)).max(0.0).sqrt()
}
