//! Which level each scattered block has, and how many patches of that level came before it.
//!
//! Levels repeat in a cycle of blocks whose composition follows the shares. So the place of a block within its level
//! is known without walking there, and a longer dataset starts with a shorter one.

use super::config::GenerateConfig;
use crate::random::hash;

/// Blocks of a cycle: a share is off by half a block of so many.
const LENGTH: usize = 1024;
/// Fractional part of the golden ratio: its multiples fill \[0, 1) evenly from any start.
const GOLDEN: f64 = 0.618_033_988_749_894_9;
/// Keeps a level aside from both the whole one and the middle, where it would round to another.
const MARGIN: f64 = 1.0 / 4096.0;

/// On which side of its whole level a block lies, up to half a level away.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Aside {
    Finer,
    Whole,
    Coarser,
}

#[derive(Clone, Copy, Debug)]
struct Slot {
    level: usize,
    aside: Aside,
    /// Blocks of the same level and side in the cycle before this one, and in all of it.
    before: usize,
    of_kind: usize,
    /// Patches of the same level in the cycle before this one.
    patches_before: u64,
}

/// One block as the cycle has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    /// The whole level that its level rounds to.
    pub whole: usize,
    /// Its level.
    pub level: f32,
    /// Patches of that whole level in all blocks before.
    pub first_patch: u64,
}

/// The repeating order of levels.
#[derive(Clone, Debug)]
pub(super) struct Cycle {
    slots: Vec<Slot>,
    /// Patches of each level in a whole cycle.
    patches: Vec<u64>,
    /// Where the fractions of levels start.
    start: f64,
}

impl Cycle {
    /// The cycle of a split of which the share `fractional` lies between two whole levels. `patches_of` says how many
    /// patches a block of a level has.
    pub(super) fn new(
        config: &GenerateConfig,
        fractional: f32,
        key: u64,
        patches_of: impl Fn(f32) -> usize,
    ) -> Self {
        let shares = config.level_shares();
        let last = shares.len() - 1;
        let fractional = f64::from(fractional);
        let mut kinds = Vec::new();
        let mut counts = Vec::new();
        for (level, of_level) in apportion(&shares, LENGTH).into_iter().enumerate() {
            // There is nothing finer than the finest level, nor coarser than the coarsest.
            let (finer, coarser) = (f64::from(u8::from(level > 0)), f64::from(u8::from(level < last)));
            let aside = fractional / (finer + coarser).max(1.0);
            let sides = [
                (Aside::Finer, finer * aside),
                (Aside::Whole, 1.0 - (finer + coarser) * aside),
                (Aside::Coarser, coarser * aside),
            ];
            let sides: Vec<_> = sides.into_iter().filter(|(_, part)| *part > 0.0).collect();
            let parts: Vec<f64> = sides.iter().map(|(_, part)| *part).collect();
            kinds.extend(sides.into_iter().map(|(aside, _)| (level, aside)));
            counts.extend(apportion(&parts, of_level));
        }

        // Every kind is spread over the cycle at equal distances, so that every file and every stopped run has its
        // share of all.
        let mut order = Vec::new();
        for (kind, &count) in counts.iter().enumerate() {
            let offset = (hash(key ^ hash(kind as u64)) >> 11) as f64 / (1u64 << 53) as f64;
            order.extend((0..count).map(|k| ((k as f64 + offset) / count as f64, kind, k)));
        }
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut patches = vec![0; shares.len()];
        let slots = order.into_iter().map(|(_, kind, before)| {
            let (level, aside) = kinds[kind];
            let slot = Slot { level, aside, before, of_kind: counts[kind], patches_before: patches[level] };
            patches[level] += patches_of(level_of(level, aside, 0.5)) as u64;
            slot
        });
        let slots = slots.collect();
        Self { slots, patches, start: (hash(key) >> 11) as f64 / (1u64 << 53) as f64 }
    }

    /// The block at place `index`.
    pub(super) fn place(&self, index: usize) -> Place {
        let (round, at) = ((index / self.slots.len()) as u64, index % self.slots.len());
        let slot = self.slots[at];
        let ordinal = round * slot.of_kind as u64 + slot.before as u64;
        Place {
            whole: slot.level,
            level: level_of(slot.level, slot.aside, (self.start + ordinal as f64 * GOLDEN).fract()),
            first_patch: round * self.patches[slot.level] + slot.patches_before,
        }
    }
}

/// The level at `x` in \[0, 1) of half a level to a side of a whole one.
fn level_of(whole: usize, aside: Aside, x: f64) -> f32 {
    let away = 0.5 * x.clamp(MARGIN, 1.0 - MARGIN);
    (match aside {
        Aside::Finer => whole as f64 - away,
        Aside::Whole => whole as f64,
        Aside::Coarser => whole as f64 + away,
    }) as f32
}

/// Splits `total` by shares that add up to 1: largest remainders, but nothing gets less than 1.
fn apportion(shares: &[f64], total: usize) -> Vec<usize> {
    let exact = |k: usize| shares[k] * total as f64;
    let mut counts: Vec<usize> = (0..shares.len()).map(|k| (exact(k).floor() as usize).max(1)).collect();
    let mut sum: usize = counts.iter().sum();
    while sum != total {
        let missing = |k: &usize| exact(*k) - counts[*k] as f64;
        let by_missing = |a: &usize, b: &usize| missing(a).total_cmp(&missing(b)).then(b.cmp(a));
        // Where the ones that were raised to 1 take too much, the one that is furthest above its share gives.
        let chosen = if sum < total {
            (0..counts.len()).max_by(by_missing)
        } else {
            (0..counts.len()).filter(|k| counts[*k] > 1).min_by(by_missing)
        };
        let Some(k) = chosen else { break };
        if sum < total {
            counts[k] += 1;
            sum += 1;
        } else {
            counts[k] -= 1;
            sum -= 1;
        }
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    fn patches_of(level: f32) -> usize {
        1 << (2 * level.ceil() as usize)
    }

    #[test]
    fn places_count_the_patches_before_them() {
        let config = GenerateConfig::new(128);
        for fractional in [0.0, 0.25, 1.0] {
            let cycle = Cycle::new(&config, fractional, 5, patches_of);
            let mut seen = vec![0; config.levels()];
            for index in 0..3 * LENGTH + 17 {
                let place = cycle.place(index);
                assert_eq!(place.first_patch, seen[place.whole], "block {index}");
                assert_eq!(place.level.round() as usize, place.whole);
                seen[place.whole] += patches_of(place.level) as u64;
            }
        }
    }

    #[test]
    fn every_run_of_blocks_has_its_shares() {
        /// Each of up to three kinds of a level is spread at equal distances: a run has one more or one less of it.
        const ASIDE: f64 = 3.0;
        for side in [4, 128, 4096] {
            let config = GenerateConfig::new(side);
            let cycle = Cycle::new(&config, 0.25, 9, patches_of);
            for (start, n) in [(0, 40), (0, LENGTH), (300, 777)] {
                for (level, share) in config.level_shares().into_iter().enumerate() {
                    let found = (start..start + n).filter(|k| cycle.place(*k).whole == level).count() as f64;
                    assert!((found - share * n as f64).abs() < ASIDE, "{side}: {level} {found} {share}");
                    assert!(found > 0.0);
                }
            }
        }
        let config = GenerateConfig::new(128);
        let cycle = Cycle::new(&config, 0.25, 9, patches_of);
        let finest = (0..LENGTH).filter(|k| cycle.place(*k).whole == 0).count() as f64;
        assert!((finest - 0.52 * LENGTH as f64).abs() > ASIDE);
    }

    #[test]
    fn fractions_of_levels_are_spread() {
        let cycle = Cycle::new(&GenerateConfig::new(16), 1.0, 2, patches_of);
        let coarser: Vec<f32> =
            (0..LENGTH).map(|k| cycle.place(k).level).filter(|l| (1.0..1.5).contains(l)).collect();
        let mut tenths = [0; 10];
        coarser.iter().for_each(|l| tenths[((l - 1.0) * 20.0) as usize] += 1);
        let even = coarser.len() as f32 / 10.0;
        assert!(tenths.iter().all(|n| (*n as f32 - even).abs() < 2.5), "{tenths:?} of {even}");
    }

    #[test]
    fn shares_become_counts() {
        assert_eq!(apportion(&[0.5, 0.26, 0.24], 10), [5, 3, 2]);
        assert_eq!(apportion(&[0.9996, 0.0004, 0.0], 10), [8, 1, 1]);
    }
}
