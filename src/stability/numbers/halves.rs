//! Textures and weights in 16 bits.

use super::published::{Gamma, Habits, Published};
use crate::dataset::{Dataset, SplitName};
use crate::engine::FusedMaterial;
use crate::error::Result;
use crate::query::{QueryBuffer, Reflectance, RgbImage};
use crate::stability::probe::{Bound, Group, Outcome, Probe};
use crate::stability::workshop::{Workshop, split_errors};
use half::{bf16, f16};
use neumip_export::{Checkpoint, Precision, Storage};

/// Of the error: what five seeds of a training differ by is several times as much.
const MOST: f64 = 0.01;
/// Tiles between the origin and where positions in f16 are looked at: a floor has hundreds.
const TILES: f32 = 20.0;
/// Why bytes do nothing.
const SAFE: &str = "The channels of a trained texture are alike in size, and a step of a byte is small against the model's own \
                    error.";
/// Largest integer of a signed byte.
const BYTE: f32 = 127.0;

pub(super) fn probes() -> Vec<Probe> {
    let bound = Bound::new(MOST, "a hundredth: seeds of a training differ by several");
    vec![
        Probe {
            name: "half-textures",
            group: Group::Numbers,
            provokes: "Renderers want textures small. Channels of a neural texture differ in size, and what is rounded away is \
                       multiplied up by the decoder.",
            naive: "bytes, one factor for the whole texture",
            cured: "f16",
            figure: "change of the mse on the test split over the mse",
            bound,
            run: textures,
        },
        Probe {
            name: "half-weights",
            group: Group::Numbers,
            provokes: "Shaders compute in 16 bits where they can. A position in f16 has 11 bits: a few tiles from the origin \
                       they no longer find the texel.",
            naive: "everything in f16, positions and sums too",
            cured: "textures and weights stored as f16, arithmetic in f32",
            figure: "change of the mse on the test split over the mse, 20 tiles from the origin",
            bound,
            run: weights,
        },
    ]
}

/// Answers queries some tiles away: nothing changes but positions.
struct Moved<'a> {
    answerer: &'a dyn Reflectance,
    tiles: f32,
}

impl Reflectance for Moved<'_> {
    fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage> {
        let mut moved = queries.clone();
        moved.u.iter_mut().for_each(|u| *u = u.map(|x| x + self.tiles));
        self.answerer.evaluate(&moved)
    }
}

/// mse of an answerer over that of the checkpoint as it is.
struct Scales<'a> {
    checkpoint: &'a Checkpoint,
    data: Dataset,
    mse: f64,
}

impl Scales<'_> {
    fn change(&self, mse: f64) -> f64 {
        (mse / self.mse - 1.0).abs()
    }

    fn of(&self, checkpoint: &Checkpoint) -> Result<f64> {
        let material = FusedMaterial::from_checkpoint(checkpoint)?;
        Ok(self.change(split_errors(&material, &self.data, SplitName::Test)?.mse))
    }

    fn stored(&self, storage: Storage) -> Result<f64> {
        self.of(&storage.round(self.checkpoint.clone())?)
    }

    /// Every value of textures, or of networks, through a function of the value and the largest one.
    fn rounded(&self, textures: bool, round: impl Fn(f32, f32) -> f32) -> Result<f64> {
        self.of(&rounded(self.checkpoint, textures, round))
    }
}

fn rounded(checkpoint: &Checkpoint, textures: bool, round: impl Fn(f32, f32) -> f32) -> Checkpoint {
    let mut checkpoint = checkpoint.clone();
    for offset in [true, false] {
        let named = |name: &str, shape: &[usize]| {
            (shape.len() == 3) == textures && name.starts_with("offset") == offset
        };
        let parts = || checkpoint.tensors.iter().filter(|(name, t)| named(name, &t.shape));
        let largest = parts().flat_map(|(_, t)| &t.data).fold(0.0f32, |m, v| m.max(v.abs()));
        for (_, tensor) in checkpoint.tensors.iter_mut().filter(|(name, t)| named(name, &t.shape)) {
            tensor.data.iter_mut().for_each(|value| *value = round(*value, largest));
        }
    }
    checkpoint
}

fn byte(value: f32, largest: f32) -> f32 {
    let factor = largest.max(f32::MIN_POSITIVE) / BYTE;
    (value / factor).round_ties_even() * factor
}

fn measured(workshop: &mut Workshop, run: &dyn Fn(&Scales) -> Result<Outcome>) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let trained = workshop.train(&material, "improved", &[])?;
    let model = trained.sound()?;
    let data = workshop.data(&material)?;
    let mse = split_errors(&model.material, &data, SplitName::Test)?.mse;
    run(&Scales { checkpoint: &model.checkpoint, data, mse })
}

fn textures(workshop: &mut Workshop) -> Result<Outcome> {
    measured(workshop, &|scales| {
        let cured = scales.stored(Storage::HALF_TEXTURES)?;
        let naive = scales.rounded(true, byte)?;
        let channels = scales.stored(Storage { textures: Precision::Byte, weights: Precision::Single })?;
        let brain = scales.rounded(true, |value, _| bf16::from_f32(value).to_f32())?;
        let notes =
            vec![format!("bf16 {brain:.1e}; bytes with a factor a channel, as exported, {channels:.1e}.")];
        let values = vec![("bf16".into(), brain), ("bytes_a_channel".into(), channels)];
        let safe = (naive <= MOST).then(|| SAFE.to_string());
        Ok(Outcome { safe, notes, values, ..Outcome::new(naive, cured) })
    })
}

fn weights(workshop: &mut Workshop) -> Result<Outcome> {
    measured(workshop, &|scales| {
        let checkpoint = Storage::HALF.round(scales.checkpoint.clone())?;
        let stored = FusedMaterial::from_checkpoint(&checkpoint)?;
        let habits = Habits { gamma: Gamma::Plain, round: |x| f16::from_f32(x).to_f32(), ..Habits::GOOD };
        let shader = Published::new(&checkpoint, habits)?;
        let change = |answerer: &dyn Reflectance, tiles: f32| -> Result<f64> {
            let moved = Moved { answerer, tiles };
            Ok(scales.change(split_errors(&moved, &scales.data, SplitName::Test)?.mse))
        };
        let (naive, cured) = (change(&shader, TILES)?, change(&stored, TILES)?);
        let at_origin = change(&shader, 0.0)?;
        let brain = scales.rounded(false, |value, _| bf16::from_f32(value).to_f32())?;
        let bytes = scales.rounded(false, byte)?;
        let notes = vec![
            format!("Everything in f16 in the first tile: {at_origin:.1e}."),
            format!("Arithmetic in f32, weights in bf16 {brain:.1e}, in bytes with one factor {bytes:.1e}."),
        ];
        let values =
            vec![("f16_first_tile".into(), at_origin), ("bf16".into(), brain), ("bytes".into(), bytes)];
        Ok(Outcome { notes, values, ..Outcome::new(naive, cured) })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_have_steps_and_a_larger_value_makes_them_coarser() {
        assert_eq!(byte(0.5, 127.0), 0.0);
        assert_eq!(byte(2.4, 127.0), 2.0);
        assert_eq!(byte(2.6, 63.5), 2.5);
        assert_eq!(byte(0.0, 0.0), 0.0);
    }
}
