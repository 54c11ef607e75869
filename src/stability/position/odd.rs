//! Tiles whose sides are no powers of two: sides of levels are floors, so that texels of levels do not nest.

use crate::config::Config;
use crate::engine::FusedMaterial;
use crate::error::Result;
use crate::model::{NeuralMaterial, Variables};
use crate::onnx_material::{OnnxMaterial, largest_difference};
use crate::query::{QueryBuffer, Reflectance};
use crate::random::{Random, Stream};
use crate::report::figures::Series;
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::workshop::Workshop;
use candle_core::Device;
use neumip_export::checkpoint::{Checkpoint, FORMAT, Header, Measure};
use neumip_export::config::{Architecture, DECODER_MLP, OFFSET_TEXTURE, bias_name, texture_name};
use neumip_export::onnx;
use std::path::Path;

/// \[height, width\] of the tiles.
const TILES: [[usize; 2]; 4] = [[31, 47], [47, 31], [33, 33], [100, 60]];
/// Random queries of the engines, borders and all levels among them.
const QUERIES: usize = 2048;
/// What engines may differ by, times (1 + |value|): the project's tolerance of exact artefacts.
const EXACT: f64 = 2e-5;
/// Values of the textures: far apart, so that a wrong texel is seen, and small enough that rounding of positions is not.
const SPREAD: f32 = 0.3;
/// Added to the luma that a random decoder gives: black answers would agree whatever they read.
const LIGHT: f32 = 1.0;

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "odd-tiles",
        group: Group::Position,
        provokes: "47 texels have levels of 23, 11, 5 and 2: halving the finest texel's index misses the texel of a coarser level, \
                   and points past its end.",
        naive: "the finest texel's index shifted right by the level",
        cured: "u times the level's own size, in candle, fused engine and ONNX",
        figure: "largest difference between the lookup at a texel's centre and the texel, or between two engines' answers",
        bound: Bound::new(EXACT, "the tolerance of exact artefacts"),
        run: odd,
    }]
}

/// A material of random numbers on a tile.
fn random_material(resolution: [usize; 2]) -> Result<Checkpoint> {
    let mut model = Config::preset("improved")?.model;
    model.texture.init_std = SPREAD;
    let architecture = Architecture::new(model, resolution)?;
    let mut tensors = Variables::initial(&architecture, 1, &Device::Cpu)?.to_stored()?;
    if let Some(offset) = tensors.get_mut(OFFSET_TEXTURE) {
        let mut random = Random::new(2, Stream::Probe, 0);
        offset.data.iter_mut().for_each(|v| *v = random.normal());
    }
    let last = architecture.decoder_widths().map_or(0, |widths| widths.len().saturating_sub(2));
    if let Some(bias) = tensors.get_mut(&bias_name(DECODER_MLP, last)) {
        bias.data.iter_mut().take(1).for_each(|luma| *luma += LIGHT);
    }
    let header = Header {
        format: FORMAT,
        architecture,
        height_range: [0.0, 0.0],
        measure: Measure::RadianceCosine,
        material: "random".into(),
        provenance: serde_json::Value::Null,
        errors: serde_json::Value::Null,
    };
    Ok(Checkpoint { header, tensors })
}

/// A place in a level: row and column.
type Texel = [usize; 2];

/// The row and column that halving indices reads for a centre (y, x) of a level, wrapped where it points past the end.
fn halved(centre: [f32; 2], resolution: [usize; 2], level: usize, size: [usize; 2]) -> Texel {
    std::array::from_fn(|d| {
        let finest = (centre[d] * resolution[d] as f32) as usize;
        (finest >> level) % size[d]
    })
}

/// Largest differences at texel centres of each level: by halving, and as the product fetches.
fn lookups(checkpoint: &Checkpoint, material: &FusedMaterial) -> Result<Vec<[f64; 2]>> {
    let architecture = &checkpoint.header.architecture;
    let mut all = Vec::new();
    for (level, size) in architecture.level_sizes().iter().enumerate() {
        let (height, width) = (size.height, size.width);
        let stored = &checkpoint.tensors[&texture_name(level)].data;
        let n = height * width;
        let centre = |k: usize| {
            [((k / width) as f32 + 0.5) / height as f32, ((k % width) as f32 + 0.5) / width as f32]
        };
        let u: Vec<[f32; 2]> = (0..n).map(|k| [centre(k)[1], centre(k)[0]]).collect();
        // Seen along the normal there is no parallax.
        let fetched = material.features(&u, &vec![level as f32; n], &vec![[0.0; 2]; n])?;
        let channels = architecture.model.texture.channels;
        let mut worst = [0.0f64; 2];
        for (k, (fetched, texel)) in fetched.chunks(channels).zip(stored.chunks(channels)).enumerate() {
            let [row, column] = halved(centre(k), architecture.resolution, level, [height, width]);
            let halved = &stored[(row * width + column) * channels..][..channels];
            for (worst, read) in worst.iter_mut().zip([halved, fetched]) {
                let apart = read.iter().zip(texel).map(|(a, b)| f64::from((a - b).abs()));
                *worst = apart.fold(*worst, f64::max);
            }
        }
        all.push(worst);
    }
    Ok(all)
}

/// Largest difference between the fused engine and the two others.
fn engines(checkpoint: &Checkpoint, fused: &FusedMaterial) -> Result<f64> {
    let coarsest = checkpoint.header.architecture.coarsest() as f32;
    let mut asked = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for k in 0..QUERIES {
        let mut random = Random::new(k as u64, Stream::Probe, 3);
        // Every fourth within a thousandth of the border.
        let near = if k % 4 == 0 { 1e-3 } else { 1.0 };
        let mut coordinate = || (random.uniform() - 0.5) * near;
        asked.0.push([coordinate(), coordinate()]);
        asked.1.push(random.disc(0.99));
        asked.2.push(random.disc(0.99));
        asked.3.push(random.uniform() * coarsest);
    }
    let queries = QueryBuffer::new(1, QUERIES, asked.0, asked.1, asked.2, asked.3)?;
    let graph = onnx::material_graph(checkpoint, onnx::Options::default())?;
    let expected = NeuralMaterial::from_checkpoint(checkpoint, &Device::Cpu)?.evaluate(&queries)?;
    let answers = fused.evaluate(&queries)?;
    let of_graph = OnnxMaterial::from_bytes(Path::new("material.onnx"), graph)?.evaluate(&queries)?;
    let apart = |pixels: &[[f32; 3]]| largest_difference(pixels, &answers.pixels);
    Ok(apart(&expected.pixels).max(apart(&of_graph.pixels)))
}

fn odd(_: &mut Workshop) -> Result<Outcome> {
    let mut outcome = Outcome::new(0.0, 0.0);
    let mut series = Vec::new();
    for resolution in TILES {
        let checkpoint = random_material(resolution)?;
        let fused = FusedMaterial::from_checkpoint(&checkpoint)?;
        let levels = lookups(&checkpoint, &fused)?;
        let apart = engines(&checkpoint, &fused)?;
        let [height, width] = resolution;
        let most = |of: usize| levels.iter().fold(0.0f64, |most, level| most.max(level[of]));
        outcome.naive = outcome.naive.max(most(0));
        outcome.cured = outcome.cured.max(most(1)).max(apart);
        outcome.values.push((format!("{height} x {width}, lookup"), most(1)));
        outcome.values.push((format!("{height} x {width}, engines"), apart));
        if resolution == TILES[0] {
            for (of, name) in ["halved", "product"].into_iter().enumerate() {
                let points = levels.iter().enumerate().map(|(level, worst)| (level as f64, worst[of]));
                series.push(Series { name: name.into(), points: points.collect() });
            }
        }
    }
    outcome.plot = Some(Plot { x: "level of 31 x 47".into(), y: "largest difference".into(), series });
    Ok(outcome)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halving_is_right_for_powers_of_two_and_wrong_for_others() {
        let wrong = |side: usize, level: usize| {
            let size = side >> level;
            let of = |j: usize| halved([(j as f32 + 0.5) / size as f32; 2], [side; 2], level, [size; 2]);
            (0..size).filter(|&j| of(j) != [j; 2]).count()
        };
        assert_eq!(wrong(64, 3), 0);
        assert!(wrong(47, 2) > 0);
    }

    #[test]
    fn a_moved_texel_is_noticed() {
        let mut checkpoint = random_material(TILES[0]).unwrap();
        let fused = FusedMaterial::from_checkpoint(&checkpoint).unwrap();
        let worst = |checkpoint: &Checkpoint| lookups(checkpoint, &fused).unwrap()[1][1];
        assert!(worst(&checkpoint) < EXACT, "{}", worst(&checkpoint));
        checkpoint.tensors.get_mut(&texture_name(1)).unwrap().data[0] += 1e-3;
        assert!(worst(&checkpoint) > EXACT);
    }

    #[test]
    fn engines_that_differ_are_noticed_and_answers_are_not_black() {
        let mut checkpoint = random_material(TILES[0]).unwrap();
        let fused = FusedMaterial::from_checkpoint(&checkpoint).unwrap();
        assert!(engines(&checkpoint, &fused).unwrap() < EXACT);
        checkpoint.tensors.get_mut(&texture_name(0)).unwrap().data.iter_mut().for_each(|v| *v += 1e-2);
        assert!(engines(&checkpoint, &fused).unwrap() > EXACT);
    }
}
