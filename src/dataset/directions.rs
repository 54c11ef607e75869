//! Evenly spread corners and pairs of directions: an Owen-scrambled Sobol sequence, mapped to the hemisphere.

use super::block::Patch;
use crate::random::{Random, Stream};

/// Squared radius of the projected disc that most directions are drawn from: z is at least 0.1 there.
pub(super) const DISC: f32 = 0.99;
/// Sine of 0.5 degrees: so far above the horizon the directions near it begin.
const LOWEST: f64 = 0.008_726_535_498_373_935;
/// Points of one scrambled sequence; the crate has no more.
const LENGTH: u64 = 1 << 16;
/// Bits of a sequence's index that count its scrambles; the rest tells sequences of a split apart.
const SCRAMBLES: u32 = 48;

/// Points of six dimensions (wi, wo, corner): any run of them fills the space more evenly than chance would, the
/// better the longer it is, and a prefix of a sequence is a sequence.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sequence {
    /// Everything random follows from it.
    pub seed: u64,
    /// Number of the split.
    pub split: u64,
    /// Number of the sequence within the split.
    pub part: u64,
    /// Where directions come from.
    pub hemisphere: Hemisphere,
}

impl Sequence {
    /// The pair of directions and the corner at place `ordinal`.
    pub(super) fn patch(&self, ordinal: u64) -> Patch {
        // After the last point the next scramble of the same points goes on.
        let index = (self.part << SCRAMBLES) | (ordinal / LENGTH);
        let scramble = Random::sub_stream(self.seed, Stream::Patches, self.split, index).next_u32();
        let point = (ordinal % LENGTH) as u32;
        let [light, light_turn, view, view_turn] = sobol_burley::sample_4d(point, 0, scramble);
        let [x, y, ..] = sobol_burley::sample_4d(point, 1, scramble);
        Patch {
            corner: [x, y],
            wi: self.hemisphere.direction(light, light_turn),
            wo: self.hemisphere.direction(view, view_turn),
        }
    }
}

/// Directions uniform in the projected disc, and a share of them uniform in solid angle down to the horizon.
///
/// In the projected disc the last ten degrees get 2 % of the directions; there is where a surface looks most unlike
/// itself.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hemisphere {
    /// Share that is uniform in solid angle, from 0 to 1.
    pub floor: f64,
}

impl Hemisphere {
    /// The direction of a point of the unit square, (x, y). The map is continuous: points that are spread evenly give
    /// directions that are.
    fn direction(self, along: f32, turn: f32) -> [f32; 2] {
        // The distribution of w = 1 - z: a w (2 - w) + b w up to the disc's edge, where the first part is complete.
        let disc = f64::from(DISC);
        let edge = 1.0 - (1.0 - disc).sqrt();
        let (a, b) = ((1.0 - self.floor) / disc, self.floor / (1.0 - LOWEST));
        let x = f64::from(along);
        let w = if x < (1.0 - self.floor) + b * edge {
            let half = a + 0.5 * b;
            x / (half + (half * half - a * x).max(0.0).sqrt())
        } else {
            (x - (1.0 - self.floor)) / b
        };
        let radius = (w * (2.0 - w)).sqrt() as f32;
        let (sin, cos) = (std::f32::consts::TAU * turn).sin_cos();
        [radius * cos, radius * sin]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::unit;

    fn sequence(floor: f64) -> Sequence {
        Sequence { seed: 3, split: 0, part: 2, hemisphere: Hemisphere { floor } }
    }

    /// Distribution function of z: the share of directions that are lower.
    fn lower(z: f64, floor: f64) -> f64 {
        let disc = ((z * z - 0.01) / 0.99).clamp(0.0, 1.0);
        (1.0 - floor) * disc + floor * ((z - LOWEST) / (1.0 - LOWEST)).clamp(0.0, 1.0)
    }

    /// Largest distance of the measured distribution of z from the one that is stated.
    fn off(floor: f64, stated: f64, n: u64) -> f64 {
        let sequence = sequence(floor);
        let mut heights: Vec<f64> = (0..n).map(|k| f64::from(unit(sequence.patch(k).wi)[2])).collect();
        heights.sort_by(f64::total_cmp);
        let distances =
            heights.iter().enumerate().map(|(k, z)| ((k as f64 + 0.5) / n as f64 - lower(*z, stated)).abs());
        distances.fold(0.0, f64::max)
    }

    #[test]
    fn heights_follow_the_stated_density_more_evenly_than_chance() {
        /// A stratified set of n numbers is off by 1 / n at most, a random one by about 0.9 / sqrt(n) = 0.014; the
        /// lowest heights lose digits because only x and y are stored.
        const EVEN: f64 = 1.5e-3;
        for floor in [0.0, 0.1, 0.6, 1.0] {
            assert!(off(floor, floor, 4096) < EVEN, "{floor}: {}", off(floor, floor, 4096));
        }
        assert!(off(0.1, 0.11, 4096) > EVEN);
    }

    #[test]
    fn all_directions_are_above_the_horizon() {
        /// z follows from x^2 + y^2 near 1 in single precision: 2e-7 of error over 2 z = 0.017.
        const ROUNDED: f32 = 2e-5;
        for (floor, lowest) in [(0.0, 0.1), (0.1, LOWEST as f32), (1.0, LOWEST as f32)] {
            let sequence = sequence(floor);
            let heights = (0..LENGTH).map(|k| unit(sequence.patch(k).wo)[2]);
            let least = heights.fold(1.0, f32::min);
            assert!(least > lowest - ROUNDED && least < lowest + 0.01, "{least} {lowest}");
        }
    }

    /// How many of the 4^4 cells of the space of pairs, each a 256th of it, a run of 1024 points leaves empty.
    fn empty_cells(patches: impl Iterator<Item = Patch>) -> usize {
        let cell = |w: [f32; 2]| {
            let height = 4.0 * (1.0 - (w[0] * w[0] + w[1] * w[1]) / DISC);
            let turn = 4.0 * (w[1].atan2(w[0]) / std::f32::consts::TAU).rem_euclid(1.0);
            height.clamp(0.0, 3.0) as usize * 4 + turn.clamp(0.0, 3.0) as usize
        };
        let mut hits = [0; 256];
        patches.for_each(|patch| hits[cell(patch.wi) * 16 + cell(patch.wo)] += 1);
        hits.iter().filter(|n| **n == 0).count()
    }

    #[test]
    fn pairs_fill_their_space() {
        let sequence = sequence(0.0);
        // Aligned runs of a sequence, the last of them beyond its length.
        for start in [0, 1024, 5 * 1024, 3 * LENGTH] {
            assert_eq!(empty_cells((start..start + 1024).map(|k| sequence.patch(k))), 0);
        }
        // By chance 256 e^-4 = 4.7 cells stay empty.
        let mut random = Random::new(1, Stream::Probe, 0);
        let chance = std::iter::repeat_with(|| Patch {
            corner: [0.0; 2],
            wi: random.disc(DISC),
            wo: random.disc(DISC),
        });
        assert!(empty_cells(chance.take(1024)) > 0);
    }

    #[test]
    fn a_sequence_goes_on_with_other_points() {
        let sequence = sequence(0.1);
        assert_eq!(sequence.patch(7), sequence.patch(7));
        for other in [LENGTH + 7, 2 * LENGTH + 7, 8] {
            assert_ne!(sequence.patch(7), sequence.patch(other));
        }
        assert_ne!(sequence.patch(7), Sequence { part: 3, ..sequence }.patch(7));
        assert_ne!(sequence.patch(7), Sequence { split: 1, ..sequence }.patch(7));
    }
}
