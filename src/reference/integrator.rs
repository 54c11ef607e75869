//! Light that a material sends to a viewer.

use super::geometry::{Geometry, Point};
use super::raycast::Hit;
use crate::random::Random;

/// Bounces after which a path under the sky is given up. A path that loses nothing needs about ten to leave a deep
/// pit; at a thousand nothing measurable is left.
const MAX_SKY_BOUNCES: usize = 1000;

/// Bounces after which a path under the sky may be ended by chance.
const ROULETTE_AFTER: usize = 4;

/// Light at the start of many paths. Kept by a thread, it saves allocations.
#[derive(Debug, Default)]
pub struct Paths<'a> {
    origins: Vec<[f64; 3]>,
    hits: Vec<Option<Hit>>,
    points: Vec<Option<Point<'a>>>,
    /// Light that the points reflect, shadows aside, and which of them that is.
    reflected: Vec<[f32; 3]>,
    lit: Vec<usize>,
    departures: Vec<[f64; 3]>,
    blocked: Vec<bool>,
}

/// A distant light, a viewer, and how long paths are.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Unit vector to the light, above the horizon. Its irradiance is 1 on a plane facing it.
    pub wi: [f64; 3],
    /// Unit vector to the viewer, above the horizon.
    pub wo: [f64; 3],
    /// Indirect bounces after the direct light.
    pub bounces: usize,
}

/// What paths do on a material.
impl Geometry {
    /// Radiance towards the viewer along the rays that cross the plane z = 0 at `positions`, one entry each in `radiance`:
    /// f cos(theta) at the point that is seen, times its visibility from the light, plus that light after 1 to `bounces`
    /// further bounces. Returns the number of rays that were cast.
    pub fn radiances<'a>(
        &'a self,
        positions: &[[f64; 2]],
        view: &View,
        random: &mut Random,
        paths: &mut Paths<'a>,
        radiance: &mut Vec<[f32; 3]>,
    ) -> u64 {
        let Paths { origins, hits, points, reflected, lit, departures, blocked } = paths;
        origins.clear();
        origins.extend(positions.iter().map(|p| self.above(*p, view.wo)));
        self.intersect_all(origins, view.wo.map(|c| -c), hits, points);

        (reflected.clear(), lit.clear(), departures.clear());
        for (k, point) in points.iter().enumerate() {
            let light = point.as_ref().map_or([0.0; 3], |point| unshadowed(point, view.wi));
            reflected.push(light);
            if let Some(point) = point.as_ref().filter(|_| light != [0.0; 3]) {
                lit.push(k);
                departures.push(point.departure);
            }
        }
        self.occluded_all(departures, view.wi, blocked);
        for (k, _) in lit.iter().zip(blocked).filter(|(_, blocked)| **blocked) {
            reflected[*k] = [0.0; 3];
        }

        let mut rays = (origins.len() + departures.len()) as u64;
        radiance.clear();
        for (point, direct) in points.drain(..).zip(reflected) {
            let indirect = point.map_or([0.0; 3], |point| self.indirect(point, view, random, &mut rays));
            radiance.push(std::array::from_fn(|c| direct[c] + indirect[c]));
        }
        rays
    }

    /// [`Geometry::radiances`] along one ray.
    pub fn radiance(&self, position: [f64; 2], view: &View, random: &mut Random) -> [f32; 3] {
        let mut radiance = Vec::with_capacity(1);
        self.radiances(&[position], view, random, &mut Paths::default(), &mut radiance);
        radiance.first().copied().unwrap_or_default()
    }

    /// Light that a point sends to its viewer after 1 to `bounces` bounces.
    fn indirect<'a>(
        &'a self,
        mut point: Point<'a>,
        view: &View,
        random: &mut Random,
        rays: &mut u64,
    ) -> [f32; 3] {
        let (mut sum, mut throughput) = ([0.0; 3], [1.0_f32; 3]);
        for _ in 0..view.bounces {
            let Some((direction, weight)) = point.sample(random) else { break };
            *rays += 1;
            let Some(next) = self.intersect(point.departure, direction) else { break };
            throughput = std::array::from_fn(|c| throughput[c] * weight[c]);
            point = next;
            let light = unshadowed(&point, view.wi);
            if light != [0.0; 3] {
                *rays += 1;
                if !self.occluded(point.departure, view.wi) {
                    sum = std::array::from_fn(|c| sum[c] + throughput[c] * light[c]);
                }
            }
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
        self.intersect(self.above(p, wo), wo.map(|c| -c))
    }

    /// Where the ray towards `wo` that crosses the plane z = 0 at `p` leaves the material's highest point behind.
    fn above(&self, p: [f64; 2], wo: [f64; 3]) -> [f64; 3] {
        let high = self.range()[1];
        let climb = high / wo[2];
        [p[0] + wo[0] * climb, p[1] + wo[1] * climb, high]
    }
}

/// What a point reflects of the light if nothing is between them.
fn unshadowed(point: &Point<'_>, wi: [f64; 3]) -> [f32; 3] {
    if point.may_leave(wi) { point.reflected(wi) } else { [0.0; 3] }
}
