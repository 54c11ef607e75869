//! Light that a material sends to a viewer.

use super::geometry::{Geometry, Point};
use super::packet::Ray;
use super::raycast::Hit;
use crate::random::Random;

/// Bounces after which a path under the sky is given up. A path that loses nothing needs about ten to leave a deep
/// pit; at a thousand nothing measurable is left.
const MAX_SKY_BOUNCES: usize = 1000;

/// Bounces after which a path under the sky may be ended by chance.
const ROULETTE_AFTER: usize = 4;

/// Paths that are followed together. Kept by a thread, it saves allocations.
#[derive(Debug, Default)]
pub struct Paths<'a> {
    /// The paths that go on, and where.
    owners: Vec<usize>,
    rays: Vec<Ray>,
    hits: Vec<Option<Hit>>,
    points: Vec<Option<Point<'a>>>,
    /// What each path's light is worth at its first point.
    throughput: Vec<[f32; 3]>,
    /// Paths with what they would gain from the light, and whether something is in between.
    lit: Vec<(usize, [f32; 3])>,
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
        let Paths { owners, rays, hits, points, throughput, lit, departures, blocked } = paths;
        owners.clear();
        owners.extend(0..positions.len());
        rays.clear();
        rays.extend(positions.iter().map(|p| (self.above(*p, view.wo), view.wo.map(|c| -c))));
        throughput.clear();
        throughput.resize(positions.len(), [1.0; 3]);
        radiance.clear();
        radiance.resize(positions.len(), [0.0; 3]);
        let mut count = 0;
        for bounce in 0..=view.bounces {
            self.intersect_all(rays, hits, points);
            count += rays.len() as u64;

            lit.clear();
            departures.clear();
            for (&owner, point) in owners.iter().zip(&*points) {
                let Some(point) = point else { continue };
                let light = unshadowed(point, view.wi);
                if light != [0.0; 3] {
                    lit.push((owner, std::array::from_fn(|c| throughput[owner][c] * light[c])));
                    departures.push(point.departure);
                }
            }
            self.occluded_all(departures, view.wi, blocked);
            count += departures.len() as u64;
            for ((owner, light), blocked) in lit.iter().zip(&*blocked) {
                if !blocked {
                    let sum = &mut radiance[*owner];
                    *sum = std::array::from_fn(|c| sum[c] + light[c]);
                }
            }
            if bounce == view.bounces {
                break;
            }

            rays.clear();
            let mut going_on = 0;
            for k in 0..points.len() {
                let Some((point, (direction, weight))) =
                    points[k].as_ref().and_then(|point| Some((point, point.sample(random)?)))
                else {
                    continue;
                };
                let owner = owners[k];
                throughput[owner] = std::array::from_fn(|c| throughput[owner][c] * weight[c]);
                rays.push((point.departure, direction));
                owners[going_on] = owner;
                going_on += 1;
            }
            owners.truncate(going_on);
        }
        points.clear();
        count
    }

    /// [`Geometry::radiances`] along one ray.
    pub fn radiance(&self, position: [f64; 2], view: &View, random: &mut Random) -> [f32; 3] {
        let mut radiance = Vec::with_capacity(1);
        self.radiances(&[position], view, random, &mut Paths::default(), &mut radiance);
        radiance.first().copied().unwrap_or_default()
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
