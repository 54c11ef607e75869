//! Queries without light that samplers are fitted and measured on.

use super::Part;
use crate::random::{Random, Stream};
use std::f32::consts::TAU;

/// Largest x^2 + y^2 of a viewer: half a degree above the horizon.
const LOWEST: f32 = 0.9999;

/// Positions, levels, viewers.
#[derive(Clone, Debug, Default)]
pub(super) struct Conditions {
    pub u: Vec<[f32; 2]>,
    pub level: Vec<f32>,
    pub wo: Vec<[f32; 2]>,
}

/// The conditions `first..first + n` of a part of the stream: positions uniform; levels over the whole range, more of the
/// fine ones; viewers uniform in the projected disc or, every other one, in solid angle.
pub(super) fn conditions(coarsest: usize, part: Part, seed: u64, first: u64, n: usize) -> Conditions {
    let mut this = Conditions::default();
    for index in first..first + n as u64 {
        let mut random = Random::sub_stream(seed, Stream::Sampler, part as u64, index);
        this.u.push([random.uniform(), random.uniform()]);
        let level = random.uniform();
        this.level.push(level * level * coarsest as f32);
        this.wo.push(if index.is_multiple_of(2) {
            random.disc(LOWEST)
        } else {
            let z = random.uniform();
            let radius = (1.0 - z * z).min(LOWEST).sqrt();
            let (sin, cos) = (TAU * random.uniform()).sin_cos();
            [radius * cos, radius * sin]
        });
    }
    this
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::{above_horizon, unit};

    #[test]
    fn conditions_cover_levels_and_viewers_and_do_not_depend_on_how_they_are_asked_for() {
        let all = conditions(6, Part::Fitted, 3, 0, 4000);
        let late = conditions(6, Part::Fitted, 3, 3990, 10);
        assert_eq!(late.wo, all.wo[3990..]);
        assert_ne!(conditions(6, Part::HeldOut, 3, 3990, 10).wo, late.wo);
        assert!(all.wo.iter().all(|w| above_horizon(*w)));
        let share = |chosen: &dyn Fn(usize) -> bool| (0..4000).filter(|k| chosen(*k)).count() as f64 / 4000.0;
        // Of viewers below 30 degrees: 1/4 of the disc, 1/2 of solid angle.
        let grazing = share(&|k| unit(all.wo[k])[2] < 0.5);
        assert!((0.33..0.42).contains(&grazing), "{grazing}");
        let (fine, coarse) = (share(&|k| all.level[k] < 1.0), share(&|k| all.level[k] > 5.0));
        assert!(fine > 0.35 && (0.05..0.15).contains(&coarse), "{fine}, {coarse}");
    }
}
