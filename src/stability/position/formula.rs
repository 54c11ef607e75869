//! A decoder with gamma(u) as the paper writes it, in f32, term by term: sin(2^k pi p) of the position as it comes.

use crate::engine::FusedMaterial;
use crate::error::{Error, Result};
use crate::kernels::encoding::{attenuation, footprint_sigma};
use crate::query::{QueryBuffer, RgbImage, unit};
use neumip_export::checkpoint::Checkpoint;
use neumip_export::config::{
    Architecture, DECODER_MLP, OutputSpace, OutputTransform, YUV_TO_RGB, bias_name, weight_name,
};

/// The encoding of p = 2u - 1: u is not wrapped, and every angle is a product in f32.
fn gamma(out: &mut Vec<f32>, architecture: &Architecture, u: [f32; 2], level: f32) {
    let encoding = &architecture.model.encoding;
    let sides = [architecture.resolution[1], architecture.resolution[0]];
    for band in 0..architecture.u_bands() {
        let angle = |d: usize| {
            let frequency = (1u32 << band) as f32 * if encoding.pi { std::f32::consts::PI } else { 1.0 };
            frequency * (2.0 * u[d] - 1.0)
        };
        let factor = |d: usize| {
            if encoding.u.attenuate {
                attenuation(band, encoding.pi, footprint_sigma(level, sides[d]))
            } else {
                1.0
            }
        };
        out.extend((0..2).map(|d| angle(d).sin() * factor(d)));
        out.extend((0..2).map(|d| angle(d).cos() * factor(d)));
    }
}

/// Answers of a model whose directions enter as they are: features as the product fetches them, everything after them by the
/// formula.
///
/// # Errors
/// `Config` for a model with another encoding of directions, raw u, a mask or another decoder.
pub(super) fn answers(
    checkpoint: &Checkpoint,
    material: &FusedMaterial,
    queries: &QueryBuffer,
) -> Result<RgbImage> {
    let architecture = material.architecture();
    let (encoding, output) = (&architecture.model.encoding, &architecture.model.output);
    let raw = |d: &neumip_export::config::DirectionEncoding| d.raw && d.bands == 0;
    let plain = raw(&encoding.wi) && raw(&encoding.wo) && !encoding.u.raw;
    let (Some(widths), true) = (architecture.decoder_widths(), plain && !output.mask) else {
        return Err(Error::config(
            "model",
            "the formula is written out for raw directions and a plain decoder",
        ));
    };
    let tensor = |name: String| {
        let found = checkpoint.tensors.get(&name).map(|t| t.data.as_slice());
        found.ok_or_else(|| Error::config(&name, "this tensor is missing"))
    };
    let mut layers = Vec::new();
    for layer in 0..widths.len() - 1 {
        layers.push((tensor(weight_name(DECODER_MLP, layer))?, tensor(bias_name(DECODER_MLP, layer))?));
    }
    let features = material.features(&queries.u, &queries.level, &queries.wo)?;
    let channels = architecture.model.texture.channels;
    let coarsest = architecture.coarsest() as f32;
    let mut pixels = Vec::with_capacity(queries.len());
    for (k, features) in features.chunks_exact(channels).enumerate() {
        let mut x = features.to_vec();
        gamma(&mut x, architecture, queries.u[k], queries.level[k].clamp(0.0, coarsest));
        for w in [queries.wi[k], queries.wo[k]] {
            x.extend(&unit(w)[..encoding.components]);
        }
        for (layer, (weight, bias)) in layers.iter().enumerate() {
            let row =
                |(row, bias): (&[f32], &f32)| bias + row.iter().zip(&x).map(|(w, x)| w * x).sum::<f32>();
            let mut y: Vec<f32> = weight.chunks_exact(x.len()).zip(bias.iter()).map(row).collect();
            if layer + 1 < layers.len() {
                y.iter_mut().for_each(|v| *v = v.max(0.0));
            }
            x = y;
        }
        pixels.push(colour(&x, output.space, output.transform));
    }
    Ok(RgbImage { height: queries.height(), width: queries.width(), pixels })
}

fn colour(outputs: &[f32], space: OutputSpace, transform: OutputTransform) -> [f32; 3] {
    let rgb: [f32; 3] = std::array::from_fn(|r| match space {
        OutputSpace::Rgb => outputs[r],
        OutputSpace::Yuv => YUV_TO_RGB[r].iter().zip(outputs).map(|(m, y)| m * y).sum(),
    });
    rgb.map(|v| match transform {
        OutputTransform::Identity => v.max(0.0),
        OutputTransform::ExpMinusOne => v.exp_m1().max(0.0),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    #[test]
    fn the_formula_is_periodic_near_the_tile_and_not_far_away() {
        // f32's rounding of 2^6 pi 3.
        const ROUNDING: f32 = 1e-4;
        let model = Config::preset("improved").unwrap().model;
        let architecture = Architecture::new(model, [64, 64]).unwrap();
        let of = |x: f32| {
            let mut out = Vec::new();
            gamma(&mut out, &architecture, [x, x], 0.0);
            out
        };
        let apart = |away: f32| {
            let pairs = of(0.375).into_iter().zip(of(0.375 + away));
            pairs.fold(0.0f32, |most, (a, b)| most.max((a - b).abs()))
        };
        assert!(apart(1.0) < ROUNDING, "{}", apart(1.0));
        assert!(apart(10_000.0) > ROUNDING, "{}", apart(10_000.0));
    }
}
