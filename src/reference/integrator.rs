//! Light that a material sends to a viewer.

use super::geometry::{Geometry, Point};
use crate::random::Random;

/// Bounces after which a path under the sky is given up. A path that loses nothing needs about ten to leave a deep
/// pit; at a thousand nothing measurable is left.
const MAX_SKY_BOUNCES: usize = 1000;

/// Bounces after which a path under the sky may be ended by chance.
const ROULETTE_AFTER: usize = 4;

/// What paths do on a material.
impl Geometry {
    /// Radiance towards the unit vector `wo` along the ray that crosses the plane z = 0 at `p`, under a distant light
    /// from the unit vector `wi` with irradiance 1 on a plane facing it: f cos(theta) at the point that is seen, times
    /// its visibility from the light, plus that light after 1 to `bounces` further bounces. Both have z > 0. Counts the
    /// rays it casts in `rays`.
    pub fn radiance(
        &self,
        p: [f64; 2],
        wi: [f64; 3],
        wo: [f64; 3],
        bounces: usize,
        random: &mut Random,
        rays: &mut u64,
    ) -> [f32; 3] {
        *rays += 1;
        match self.first_point(p, wo) {
            Some(point) => self.leaving(point, wi, bounces, random, rays),
            None => [0.0; 3],
        }
    }

    /// Radiance that leaves a point towards its viewer.
    fn leaving<'a>(
        &'a self,
        mut point: Point<'a>,
        wi: [f64; 3],
        bounces: usize,
        random: &mut Random,
        rays: &mut u64,
    ) -> [f32; 3] {
        let mut sum = self.direct(&point, wi, rays);
        let mut throughput = [1.0_f32; 3];
        for _ in 0..bounces {
            let Some((direction, weight)) = point.sample(random) else { break };
            *rays += 1;
            let Some(next) = self.intersect(point.departure, direction) else { break };
            throughput = std::array::from_fn(|c| throughput[c] * weight[c]);
            point = next;
            let direct = self.direct(&point, wi, rays);
            sum = std::array::from_fn(|c| sum[c] + throughput[c] * direct[c]);
        }
        sum
    }

    /// Radiance towards `wo` under a white sky of radiance 1, all bounces: 1 for a surface that absorbs nothing.
    pub fn sky_radiance(&self, p: [f64; 2], wo: [f64; 3], random: &mut Random) -> [f32; 3] {
        let Some(mut point) = self.first_point(p, wo) else {
            return [1.0; 3];
        };
        let mut throughput = [1.0_f32; 3];
        for count in 0..MAX_SKY_BOUNCES {
            let Some((direction, weight)) = point.sample(random) else { break };
            throughput = std::array::from_fn(|c| throughput[c] * weight[c]);
            let Some(next) = self.intersect(point.departure, direction) else {
                return throughput;
            };
            let survival = throughput.iter().fold(0.0_f32, |a, &b| a.max(b)).min(1.0);
            if count >= ROULETTE_AFTER && survival < 1.0 {
                if random.uniform() >= survival {
                    break;
                }
                throughput = throughput.map(|c| c / survival);
            }
            point = next;
        }
        [0.0; 3]
    }

    /// What is seen towards `wo` along the ray that crosses the plane z = 0 at `p`.
    fn first_point(&self, p: [f64; 2], wo: [f64; 3]) -> Option<Point<'_>> {
        let high = self.range()[1];
        let climb = high / wo[2];
        let origin = [p[0] + wo[0] * climb, p[1] + wo[1] * climb, high];
        self.intersect(origin, wo.map(|c| -c))
    }

    fn direct(&self, point: &Point<'_>, wi: [f64; 3], rays: &mut u64) -> [f32; 3] {
        if !point.may_leave(wi) {
            return [0.0; 3];
        }
        let reflected = point.reflected(wi);
        if reflected == [0.0; 3] {
            return reflected;
        }
        *rays += 1;
        if self.occluded(point.departure, wi) { [0.0; 3] } else { reflected }
    }
}
