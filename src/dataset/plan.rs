//! What is asked in each block of each split, as a function of the seed and the block's index alone.

use super::{
    block::{Layout, Patch},
    config::{GenerateConfig, MAX_FILES, MIN_BLOCKS, Regime},
    format::SplitName,
};
use crate::{
    error::{Error, Result},
    random::{Random, Stream},
};

/// Squared radius of the disc that directions are drawn from: z is at least 0.1.
const DISC: f32 = 0.99;
/// sin^2 of 62 degrees: beyond it a direction grazes.
const GRAZING: f32 = 0.779_596_4;
/// Fractional part of the golden ratio: its multiples fill \[0, 1) evenly from any start.
const GOLDEN: f64 = 0.618_033_988_749_894_9;
/// Index of the permutation of a split's blocks, out of the way of blocks and pairs.
const ORDER: u64 = u64::MAX;

/// One split: how many blocks, and what is in them.
pub(crate) struct Plan {
    pub(crate) name: SplitName,
    pub(crate) side: usize,
    pub(crate) blocks: usize,
    pub(crate) spp: usize,
    blocks_per_file: usize,
    seed: u64,
    tile: usize,
    kind: Kind,
}

enum Kind {
    /// Every patch has its own random corner and pair. Shares are cumulative, one a level.
    Scattered { shares: Vec<f64>, fractional: f32, grazing: bool },
    /// Aligned slices: the level of each block and its first patch among those of its level; patch k has pair
    /// k, or k modulo the number of pairs.
    Slices { blocks: Vec<(u32, usize)>, pairs: Option<usize> },
}

/// The plans of all splits in the order in which they are made: training data last.
pub(crate) fn plans(config: &GenerateConfig) -> Result<Vec<Plan>> {
    config.validate()?;
    let mut all = Vec::new();
    if config.validation_samples > 0 {
        let samples = config.validation_samples;
        all.push(scattered(config, SplitName::Validation, samples, config.fractional_share, false));
    }
    if config.test_pairs > 0 {
        let blocks = slice_blocks(config.levels(), config.test_pairs, 0.0);
        all.push(Plan::new(config, SplitName::Test, Kind::Slices { blocks, pairs: None }, 0));
    }
    if config.offgrid_samples > 0 {
        all.push(scattered(config, SplitName::Offgrid, config.offgrid_samples, 1.0, false));
    }
    if config.grazing_samples > 0 {
        all.push(scattered(config, SplitName::Grazing, config.grazing_samples, 0.0, true));
    }
    all.push(match config.regime {
        Regime::Scattered => {
            scattered(config, SplitName::Train, config.samples, config.fractional_share, false)
        }
        Regime::Slices(pairs) => {
            let ordered = slice_blocks(config.levels(), pairs, f64::from(config.least_level_share));
            // Mixed, so that every file has its share of levels and a stopped run has them all.
            let order = Random::sub_stream(config.seed, Stream::Patches, SplitName::Train as u64, ORDER)
                .permutation(ordered.len());
            let blocks = order.into_iter().map(|k| ordered[k as usize]).collect();
            Plan::new(config, SplitName::Train, Kind::Slices { blocks, pairs: Some(pairs) }, 0)
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

fn scattered(config: &GenerateConfig, name: SplitName, samples: u64, fractional: f32, grazing: bool) -> Plan {
    let mut sum = 0.0;
    let shares = config.level_shares().into_iter().map(|share| {
        sum += share;
        sum
    });
    let shares = shares.collect();
    Plan::new(config, name, Kind::Scattered { shares, fractional, grazing }, samples)
}

/// Blocks of whole slices, level by level: every pair once at each level, and a level at least `least` of all
/// blocks.
fn slice_blocks(levels: usize, pairs: usize, least: f64) -> Vec<(u32, usize)> {
    let full: Vec<usize> = (0..levels).map(|level| pairs.div_ceil(1 << (2 * level))).collect();
    let raised = |floor: usize| -> Vec<usize> { full.iter().map(|n| (*n).max(floor)).collect() };
    let mut floor = 1;
    // All levels together need at most 1 / least times the floor, so a floor is found; levels x least = 1
    // asks for equal counts, which the largest count gives.
    while (floor as f64) < least * raised(floor).iter().sum::<usize>() as f64 && floor < full[0] {
        floor += 1;
    }
    let counts = raised(floor).into_iter().enumerate();
    counts.flat_map(|(level, n)| (0..n).map(move |k| (level as u32, k << (2 * level)))).collect()
}

impl Plan {
    fn new(config: &GenerateConfig, name: SplitName, kind: Kind, samples: u64) -> Self {
        let (side, blocks) = match &kind {
            Kind::Scattered { .. } => {
                let each = (config.block_side * config.block_side) as u64;
                (config.block_side, (samples.div_ceil(each) as usize).max(MIN_BLOCKS))
            }
            Kind::Slices { blocks, .. } => (config.resolution, blocks.len()),
        };
        Self {
            name,
            side,
            blocks,
            spp: if name == SplitName::Train { config.spp } else { config.held_out_spp },
            blocks_per_file: (config.file_samples / (side * side)).max(1),
            seed: config.seed,
            tile: config.resolution,
            kind,
        }
    }

    /// Number of files.
    pub(crate) fn files(&self) -> usize {
        self.blocks.div_ceil(self.blocks_per_file)
    }

    /// The blocks of a file.
    pub(crate) fn blocks_of(&self, file: usize) -> std::ops::Range<usize> {
        let start = file * self.blocks_per_file;
        start..(start + self.blocks_per_file).min(self.blocks)
    }

    /// What is asked in block `index`.
    pub(crate) fn layout(&self, index: usize) -> Result<Layout> {
        match &self.kind {
            Kind::Scattered { shares, fractional, grazing } => {
                let mut random =
                    Random::sub_stream(self.seed, Stream::Patches, self.name as u64, index as u64);
                // A low-discrepancy sequence: shares hold in every run of blocks, so in every file.
                let x = (0.5 + index as f64 * GOLDEN).fract();
                let whole = shares.partition_point(|sum| *sum <= x).min(shares.len() - 1);
                let mut level = whole as f32;
                if random.uniform() < *fractional {
                    // Up to half a level aside, so that the share of the nearest integer stays what it is.
                    let aside = random.uniform() - 0.5;
                    level += if whole == 0 {
                        aside.abs()
                    } else if whole + 1 == shares.len() {
                        -aside.abs()
                    } else {
                        aside
                    };
                }
                let patch = self.patch_side(level);
                let patches = (self.side / patch) * (self.side / patch);
                let patches = (0..patches).map(|_| {
                    let corner = [random.uniform(), random.uniform()];
                    let (wi, wo) = directions(&mut random, *grazing);
                    Patch { corner, wi, wo }
                });
                Layout::new(self.side, patch, level, patches.collect())
            }
            Kind::Slices { blocks, pairs } => {
                let (level, first) = blocks[index];
                let patch = self.patch_side(level as f32);
                let patches = (0..(self.side / patch) * (self.side / patch)).map(|k| {
                    let pair = pairs.map_or(first + k, |n| (first + k) % n);
                    let mut random =
                        Random::sub_stream(self.seed, Stream::Patches, self.name as u64, pair as u64);
                    let (wi, wo) = directions(&mut random, false);
                    Patch { corner: [0.0; 2], wi, wo }
                });
                Layout::new(self.side, patch, level as f32, patches.collect())
            }
        }
    }

    /// The largest power of two that neither the block nor the tile at that level is smaller than.
    fn patch_side(&self, level: f32) -> usize {
        let tile = (self.tile as f64 / f64::from(level).exp2()).floor().max(1.0) as usize;
        1 << tile.min(self.side).ilog2()
    }
}

fn directions(random: &mut Random, grazing: bool) -> ([f32; 2], [f32; 2]) {
    let beyond = |w: [f32; 2]| w[0] * w[0] + w[1] * w[1] > GRAZING;
    loop {
        let (wi, wo) = (random.disc(DISC), random.disc(DISC));
        if !grazing || beyond(wi) || beyond(wo) {
            return (wi, wo);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(config: &GenerateConfig, name: SplitName) -> Plan {
        plans(config).unwrap().into_iter().find(|p| p.name == name).unwrap()
    }

    #[test]
    fn every_level_has_its_share() {
        let config = GenerateConfig::new(128);
        let train = plan(&config, SplitName::Train);
        let mut counts = vec![0.0; config.levels()];
        for b in 0..train.blocks {
            counts[train.layout(b).unwrap().level().round() as usize] += 1.0 / train.blocks as f64;
        }
        // The golden sequence misses a share of n blocks by a few blocks at most.
        let few = 4.0 / train.blocks as f64;
        for (count, share) in counts.iter().zip(config.level_shares()) {
            assert!((count - share).abs() < few && share >= 0.05, "{count} {share}");
        }
        assert!((counts[0] - config.level_shares()[1]).abs() > few);
    }

    #[test]
    fn slices_show_every_pair_at_every_level() {
        let config = GenerateConfig { regime: Regime::Slices(9), ..GenerateConfig::new(16) };
        let train = plan(&config, SplitName::Train);
        for level in 0..4 {
            let mut pairs = Vec::new();
            let mut blocks = 0;
            for b in 0..train.blocks {
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
            assert_eq!(pairs.len(), 9, "level {level}");
            assert!(blocks as f32 >= config.least_level_share * train.blocks as f32);
        }
    }

    #[test]
    fn grazing_pairs_graze() {
        let grazing = plan(&GenerateConfig::new(16), SplitName::Grazing);
        let limit = 62.0f32.to_radians().sin();
        for b in 0..grazing.blocks {
            for p in grazing.layout(b).unwrap().patches() {
                let radius = |w: [f32; 2]| w[0].hypot(w[1]);
                // Half a millionth for the rounding of sin^2.
                assert!(radius(p.wi).max(radius(p.wo)) > limit - 5e-7);
            }
        }
    }
}
