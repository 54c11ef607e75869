//! What is asked in each block of each split, as a function of the seed and the block's index alone.

use super::{
    block::{Layout, Patch},
    config::{GenerateConfig, MAX_FILES, MIN_BLOCKS},
    cycle::Cycle,
    directions::{DISC, Hemisphere, Sequence},
    format::SplitName,
    regime::Regime,
    slices::Slices,
};
use crate::{
    error::{Error, Result},
    random::{Random, Stream},
};
use std::ops::Range;

/// sin^2 of 62 degrees: beyond it a direction grazes.
const GRAZING: f32 = 0.779_596_4;

/// One split: how many blocks, and what is in them.
pub(crate) struct Plan {
    pub(crate) name: SplitName,
    pub(crate) side: usize,
    pub(crate) spp: usize,
    /// Blocks at the end of each part; all but the first part were appended, and a file holds blocks of one part.
    ends: Vec<usize>,
    blocks_per_file: usize,
    seed: u64,
    tile: usize,
    kind: Kind,
}

enum Kind {
    /// Every patch has its own corner and pair.
    Scattered { cycle: Cycle, directions: Directions },
    /// Aligned slices, one entry a part.
    Slices { parts: Vec<Slices>, directions: Directions },
}

/// Where pairs of directions come from.
#[derive(Clone, Copy)]
enum Directions {
    /// Evenly spread.
    Spread(Hemisphere),
    /// By chance, uniform in the projected disc.
    Disc,
    /// By chance, at least one of the two far from the normal.
    Grazing,
}

/// The plans of all splits in the order in which they are made: training data last. `earlier` are the amounts of
/// training data that were there before it was appended to; `config` must be resolved.
pub(crate) fn plans(config: &GenerateConfig, earlier: &[u64]) -> Result<Vec<Plan>> {
    config.validate()?;
    let spread = Directions::Spread(Hemisphere { floor: f64::from(config.grazing_floor) });
    // Offgrid differs from test by positions and levels, not by how often it grazes.
    let disc = Directions::Spread(Hemisphere { floor: 0.0 });
    let held_out = |samples: u64| [samples].into_iter().filter(|n| *n > 0);
    let mut all = Vec::new();
    for samples in held_out(config.validation_samples) {
        all.push(match config.regime {
            Regime::Scattered => {
                Plan::scattered(config, SplitName::Validation, &[samples], config.fractional_share, spread)
            }
            // A decoder that sees its neighbours can be asked on whole slices only, so these validate themselves.
            Regime::Slices(_) => {
                let pairs = samples.div_ceil((config.resolution * config.resolution) as u64) as usize;
                let parts = vec![Slices::in_order(config.levels(), pairs.max(2))];
                Plan::slices(config, SplitName::Validation, parts, spread)
            }
        });
    }
    if config.test_pairs > 0 {
        let parts = vec![Slices::in_order(config.levels(), config.test_pairs)];
        all.push(Plan::slices(config, SplitName::Test, parts, Directions::Disc));
    }
    for samples in held_out(config.offgrid_samples) {
        all.push(Plan::scattered(config, SplitName::Offgrid, &[samples], 1.0, disc));
    }
    for samples in held_out(config.grazing_samples) {
        all.push(Plan::scattered(config, SplitName::Grazing, &[samples], 0.0, Directions::Grazing));
    }
    let amounts: Vec<u64> = earlier.iter().copied().chain([config.amount()]).collect();
    all.push(match config.regime {
        Regime::Scattered => {
            Plan::scattered(config, SplitName::Train, &amounts, config.fractional_share, spread)
        }
        Regime::Slices(_) => {
            let starts = [0].into_iter().chain(amounts.iter().copied());
            let parts = starts.zip(&amounts).map(|(start, end)| {
                let pairs = start.min(*end)..*end;
                Slices::mixed(config, pairs, SplitName::Train as u64)
            });
            Plan::slices(config, SplitName::Train, parts.collect(), spread)
        }
    });
    match all.iter().find(|plan| plan.files() > MAX_FILES) {
        Some(plan) => Err(Error::config(
            "file_samples",
            format!("{} would need {} files; {MAX_FILES} work: make files larger", plan.name, plan.files()),
        )),
        None => Ok(all),
    }
}

impl Plan {
    /// `amounts` are the samples at the end of each part.
    fn scattered(
        config: &GenerateConfig,
        name: SplitName,
        amounts: &[u64],
        fractional: f32,
        directions: Directions,
    ) -> Self {
        let side = config.block_side;
        let blocks = |samples: &u64| samples.div_ceil((side * side) as u64) as usize;
        let ends = amounts.iter().map(|samples| blocks(samples).max(MIN_BLOCKS)).collect();
        let key = Random::sub_stream(config.seed, Stream::Patches, name as u64, u64::MAX).next_u32();
        let cycle = Cycle::new(config, fractional, u64::from(key), |level| {
            let across = side / patch_side(config.resolution, side, level);
            across * across
        });
        Self::new(config, name, side, ends, Kind::Scattered { cycle, directions })
    }

    fn slices(config: &GenerateConfig, name: SplitName, parts: Vec<Slices>, directions: Directions) -> Self {
        let mut blocks = 0;
        let ends = parts.iter().map(|part| {
            blocks += part.blocks();
            blocks
        });
        let ends = ends.collect();
        Self::new(config, name, config.resolution, ends, Kind::Slices { parts, directions })
    }

    fn new(config: &GenerateConfig, name: SplitName, side: usize, ends: Vec<usize>, kind: Kind) -> Self {
        Self {
            name,
            side,
            spp: if name == SplitName::Train { config.spp } else { config.held_out_spp },
            ends,
            blocks_per_file: (config.file_samples / (side * side)).max(1),
            seed: config.seed,
            tile: config.resolution,
            kind,
        }
    }

    /// Number of blocks.
    pub(crate) fn blocks(&self) -> usize {
        self.ends.last().copied().unwrap_or(0)
    }

    /// Number of files.
    pub(crate) fn files(&self) -> usize {
        self.parts().map(|part| part.len().div_ceil(self.blocks_per_file)).sum()
    }

    /// The blocks of a file.
    pub(crate) fn blocks_of(&self, mut file: usize) -> Range<usize> {
        for part in self.parts() {
            let files = part.len().div_ceil(self.blocks_per_file);
            if file < files {
                let start = part.start + file * self.blocks_per_file;
                return start..(start + self.blocks_per_file).min(part.end);
            }
            file -= files;
        }
        self.blocks()..self.blocks()
    }

    /// The blocks of each part.
    fn parts(&self) -> impl Iterator<Item = Range<usize>> {
        let starts = [0].into_iter().chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, end)| start..*end)
    }

    /// What is asked in block `index`.
    pub(crate) fn layout(&self, index: usize) -> Result<Layout> {
        match &self.kind {
            Kind::Scattered { cycle, directions } => {
                let place = cycle.place(index);
                let patch = patch_side(self.tile, self.side, place.level);
                let patches = (self.side / patch) * (self.side / patch);
                let part = place.whole as u64;
                let mut random =
                    Random::sub_stream(self.seed, Stream::Patches, self.name as u64, index as u64);
                let patches = (0..patches).map(|k| match directions {
                    Directions::Spread(hemisphere) => {
                        self.sequence(*hemisphere, part).patch(place.first_patch + k as u64)
                    }
                    by_chance => {
                        let corner = [random.uniform(), random.uniform()];
                        let (wi, wo) = by_chance.draw(&mut random);
                        Patch { corner, wi, wo }
                    }
                });
                Layout::new(self.side, patch, place.level, patches.collect())
            }
            Kind::Slices { parts, directions } => {
                let (part, of_part) =
                    self.parts().zip(parts).find(|(part, _)| part.contains(&index)).ok_or_else(|| {
                        Error::config(format!("splits.{}", self.name), format!("has no block {index}"))
                    })?;
                let place = of_part.place(index - part.start);
                let patch = patch_side(self.tile, self.side, place.level as f32);
                let patches = (0..(self.side / patch) * (self.side / patch)).map(|k| {
                    let pair = place.pair(k);
                    let (wi, wo) = match directions {
                        Directions::Spread(hemisphere) => {
                            let Patch { wi, wo, .. } = self.sequence(*hemisphere, 0).patch(pair);
                            (wi, wo)
                        }
                        by_chance => by_chance.draw(&mut Random::sub_stream(
                            self.seed,
                            Stream::Patches,
                            self.name as u64,
                            pair,
                        )),
                    };
                    Patch { corner: [0.0; 2], wi, wo }
                });
                Layout::new(self.side, patch, place.level as f32, patches.collect())
            }
        }
    }

    fn sequence(&self, hemisphere: Hemisphere, part: u64) -> Sequence {
        Sequence { seed: self.seed, split: self.name as u64, part, hemisphere }
    }
}

/// The largest power of two that neither the block nor the tile at that level is smaller than.
fn patch_side(tile: usize, side: usize, level: f32) -> usize {
    let tile = (tile as f64 / f64::from(level).exp2()).floor().max(1.0) as usize;
    1 << tile.min(side).ilog2()
}

impl Directions {
    /// A pair by chance.
    fn draw(self, random: &mut Random) -> ([f32; 2], [f32; 2]) {
        let beyond = |w: [f32; 2]| w[0] * w[0] + w[1] * w[1] > GRAZING;
        loop {
            let (wi, wo) = (random.disc(DISC), random.disc(DISC));
            if !matches!(self, Self::Grazing) || beyond(wi) || beyond(wo) {
                return (wi, wo);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(config: &GenerateConfig, earlier: &[u64], name: SplitName) -> Plan {
        plans(config, earlier).unwrap().into_iter().find(|p| p.name == name).unwrap()
    }

    #[test]
    fn every_level_has_its_share() {
        let config = GenerateConfig::new(128);
        let train = plan(&config, &[], SplitName::Train);
        let mut counts = vec![0.0; config.levels()];
        for b in 0..train.blocks() {
            counts[train.layout(b).unwrap().level().round() as usize] += 1.0 / train.blocks() as f64;
        }
        // Three cycles of levels miss a share of n blocks by a few blocks at most.
        let few = 4.0 / train.blocks() as f64;
        for (count, share) in counts.iter().zip(config.level_shares()) {
            assert!((count - share).abs() < few && share >= 0.05, "{count} {share}");
        }
        assert!((counts[0] - config.level_shares()[1]).abs() > few);
    }

    #[test]
    fn every_patch_of_a_level_is_the_next_of_its_sequence() {
        let config = GenerateConfig::new(32);
        let train = plan(&config, &[], SplitName::Train);
        let sequence = |part| train.sequence(Hemisphere { floor: 0.1f32.into() }, part);
        let mut next = vec![0; config.levels()];
        for b in 0..train.blocks() {
            let layout = train.layout(b).unwrap();
            let level = layout.level().round() as usize;
            for patch in layout.patches() {
                assert_eq!(*patch, sequence(level as u64).patch(next[level]));
                next[level] += 1;
            }
        }
        assert!(next.iter().all(|n| *n > 0));
    }

    #[test]
    fn slices_show_every_pair_at_every_level() {
        let config = GenerateConfig { regime: Regime::Slices(13), ..GenerateConfig::new(16) };
        let train = plan(&config, &[9], SplitName::Train);
        // The second part starts with a file of its own.
        assert_eq!(train.blocks_of(train.files() - 1).end, train.blocks());
        for (part, pairs_of_part) in [(0..train.ends[0], 9), (train.ends[0]..train.blocks(), 4)] {
            for level in 0..4 {
                let mut pairs = Vec::new();
                let mut blocks = 0;
                for b in part.clone() {
                    let layout = train.layout(b).unwrap();
                    if layout.level() == level as f32 {
                        blocks += 1;
                        pairs.extend(
                            layout.patches().iter().map(|p| (p.wi.map(f32::to_bits), p.wo.map(f32::to_bits))),
                        );
                    }
                }
                pairs.sort_unstable();
                pairs.dedup();
                assert_eq!(pairs.len(), pairs_of_part, "level {level}");
                assert!(blocks as f32 >= config.least_level_share * part.len() as f32);
            }
        }
    }

    #[test]
    fn a_longer_dataset_starts_with_a_shorter_one() {
        for (shorter, longer) in [
            (GenerateConfig::new(16), GenerateConfig { samples: 99_999, ..GenerateConfig::new(16) }),
            (
                GenerateConfig { regime: Regime::Slices(9), ..GenerateConfig::new(16) },
                GenerateConfig { regime: Regime::Slices(30), ..GenerateConfig::new(16) },
            ),
        ] {
            let small = GenerateConfig { file_samples: 4096, ..shorter };
            let large = GenerateConfig { file_samples: 4096, ..longer };
            let before = plan(&small, &[], SplitName::Train);
            let after = plan(&large, &[small.amount()], SplitName::Train);
            assert!(after.blocks() > before.blocks() && after.files() > before.files());
            for file in 0..before.files() {
                assert_eq!(before.blocks_of(file), after.blocks_of(file));
            }
            assert_eq!(after.blocks_of(before.files()).start, before.blocks());
            for block in 0..before.blocks() {
                assert_eq!(before.layout(block).unwrap(), after.layout(block).unwrap());
            }
        }
    }

    #[test]
    fn grazing_pairs_graze() {
        let grazing = plan(&GenerateConfig::new(16), &[], SplitName::Grazing);
        let limit = 62.0f32.to_radians().sin();
        for b in 0..grazing.blocks() {
            for p in grazing.layout(b).unwrap().patches() {
                let radius = |w: [f32; 2]| w[0].hypot(w[1]);
                // Half a millionth for the rounding of sin^2.
                assert!(radius(p.wi).max(radius(p.wo)) > limit - 5e-7);
            }
        }
    }
}
