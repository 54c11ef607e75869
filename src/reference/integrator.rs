//! Light that a surface sends to a viewer.

use super::heightfield::Heightfield;
use super::material::Material;
use super::raycast::Hit;
use super::shading::Brdf;
use crate::random::Random;

/// Bounces after which a path under the sky is given up. A path that loses nothing needs about ten to leave a deep
/// pit; at a thousand nothing measurable is left.
const MAX_SKY_BOUNCES: usize = 1000;

/// Bounces after which a path under the sky may be ended by chance.
const ROULETTE_AFTER: usize = 4;

/// A displaced surface with its shading.
#[derive(Clone, Debug)]
pub struct Surface {
    /// The geometry.
    pub field: Heightfield,
    /// The shading.
    pub material: Material,
}

/// A point seen from a direction.
struct Point {
    departure: [f64; 3],
    frame: Frame,
    brdf: Brdf,
    /// Towards the viewer, in the point's frame.
    wo: [f32; 3],
}

impl Surface {
    /// Radiance towards the unit vector `wo` along the ray that crosses the plane z = 0 at `p`, under a distant light
    /// from the unit vector `wi` with irradiance 1 on a plane facing it: f cos(theta) at the point that is seen, times
    /// its visibility from the light, plus that light after 1 to `bounces` further bounces. Both have z > 0.
    pub fn radiance(
        &self,
        p: [f64; 2],
        wi: [f64; 3],
        wo: [f64; 3],
        bounces: usize,
        random: &mut Random,
    ) -> [f32; 3] {
        let Some(mut point) = self.first_point(p, wo) else {
            return [0.0; 3];
        };
        let mut sum = self.direct(&point, wi);
        let mut throughput = [1.0_f32; 3];
        for _ in 0..bounces {
            let Some((next, weight)) = self.bounce(&point, random) else { break };
            let Some(next) = next else { break };
            throughput = std::array::from_fn(|c| throughput[c] * weight[c]);
            let direct = self.direct(&next, wi);
            sum = std::array::from_fn(|c| sum[c] + throughput[c] * direct[c]);
            point = next;
        }
        sum
    }

    /// Radiance towards `wo` under a white sky of radiance 1, all bounces: 1 for a surface that absorbs nothing.
    pub fn sky_radiance(&self, p: [f64; 2], wo: [f64; 3], random: &mut Random) -> [f32; 3] {
        let Some(mut point) = self.first_point(p, wo) else {
            return [1.0; 3];
        };
        let mut throughput = [1.0_f32; 3];
        for bounce in 0..MAX_SKY_BOUNCES {
            let Some((next, weight)) = self.bounce(&point, random) else { break };
            throughput = std::array::from_fn(|c| throughput[c] * weight[c]);
            let Some(next) = next else { return throughput };
            let survival = throughput.iter().fold(0.0_f32, |a, &b| a.max(b)).min(1.0);
            if bounce >= ROULETTE_AFTER && survival < 1.0 {
                if random.uniform() >= survival {
                    break;
                }
                throughput = throughput.map(|c| c / survival);
            }
            point = next;
        }
        [0.0; 3]
    }

    fn first_point(&self, p: [f64; 2], wo: [f64; 3]) -> Option<Point> {
        let climb = self.field.high / wo[2];
        let origin = [p[0] + wo[0] * climb, p[1] + wo[1] * climb, self.field.high];
        let hit = self.field.intersect(origin, wo.map(|c| -c), f64::INFINITY)?;
        Some(self.point(&hit, wo))
    }

    fn point(&self, hit: &Hit, wo: [f64; 3]) -> Point {
        let frame = Frame::new(hit.normal);
        let brdf = self.material.brdf(hit.position[0], hit.position[1]);
        Point { departure: hit.departure(), wo: frame.to_local(wo), frame, brdf }
    }

    fn direct(&self, point: &Point, wi: [f64; 3]) -> [f32; 3] {
        let local = point.frame.to_local(wi);
        if local[2] <= 0.0 || point.wo[2] <= 0.0 || self.field.occluded(point.departure, wi) {
            return [0.0; 3];
        }
        point.brdf.eval(local, point.wo).map(|f| f * local[2])
    }

    /// The next point of a path with its weight; no point where the path leaves the surface, nothing where it ends.
    fn bounce(&self, point: &Point, random: &mut Random) -> Option<(Option<Point>, [f32; 3])> {
        let sampled = point.brdf.sample(point.wo, [random.uniform(), random.uniform(), random.uniform()])?;
        let direction = point.frame.to_world(sampled.direction);
        let hit = self.field.intersect(point.departure, direction, f64::INFINITY);
        Some((hit.map(|hit| self.point(&hit, direction.map(|c| -c))), sampled.weight))
    }
}

/// Tangent, bitangent and normal (Duff et al. 2017, without their sign: normals of a heightfield point up).
struct Frame {
    axes: [[f64; 3]; 3],
}

impl Frame {
    fn new(n: [f64; 3]) -> Self {
        let a = -1.0 / (1.0 + n[2]);
        let b = n[0] * n[1] * a;
        Self { axes: [[1.0 + n[0] * n[0] * a, b, -n[0]], [b, 1.0 + n[1] * n[1] * a, -n[1]], n] }
    }

    fn to_local(&self, w: [f64; 3]) -> [f32; 3] {
        self.axes.map(|a| (a[0] * w[0] + a[1] * w[1] + a[2] * w[2]) as f32)
    }

    fn to_world(&self, w: [f32; 3]) -> [f64; 3] {
        let w = w.map(f64::from);
        std::array::from_fn(|c| (0..3).map(|k| self.axes[k][c] * w[k]).sum())
    }
}
