//! Light that has bounced off the material, baked from the reference.

use super::MapsConfig;
use crate::error::Result;
use crate::random::{Random, Stream};
use crate::reference::{Geometry, Heightfield, Layer, Material, Paths, View};
use rayon::prelude::*;

/// Squared radius of the projected disc of directions: that of the queries that are timed and measured.
const DISC: f32 = 0.99;

/// Per texel the colour c for which c cos(theta_i) comes nearest, in squares, to what the texel sends of bounced light.
/// Empty without bounces.
pub(super) fn bake(
    material: &Material,
    layer: &Layer,
    [rows, columns]: [usize; 2],
    config: &MapsConfig,
) -> Result<Vec<[f32; 3]>> {
    if config.bounces == 0 {
        return Ok(Vec::new());
    }
    let geometry = Geometry::new(material.clone())?;
    let field = Heightfield::new(&layer.height)?;
    let scratch = || (Paths::default(), Vec::new());
    let baked = (0..rows * columns).into_par_iter().map_init(scratch, |(paths, radiance), k| {
        let mut random = Random::new(config.seed, Stream::Probe, k as u64);
        let (mut sum, mut weight) = ([0.0; 3], 0.0);
        for path in 0..config.paths {
            let x = ((k % columns) as f64 + random.uniform_f64()) / columns as f64;
            let y = ((k / columns) as f64 + random.uniform_f64()) / rows as f64;
            let [wi, wo] = [random.disc(DISC), random.disc(DISC)].map(|w| {
                let [x, y] = w.map(f64::from);
                [x, y, (1.0 - x * x - y * y).sqrt()]
            });
            // The ray that would see this point if nothing were in between.
            let height = field.height_at(x, y);
            let u = [x - wo[0] / wo[2] * height, y - wo[1] / wo[2] * height];
            let mut of = |bounces| {
                // The same path, with and without what comes after its first point.
                let mut same = Random::new(config.seed, Stream::Reference, (k * config.paths + path) as u64);
                geometry.radiances(&[u], &View { wi, wo, bounces }, &mut same, paths, radiance);
                radiance.first().copied().unwrap_or_default()
            };
            let (all, direct) = (of(config.bounces), of(0));
            for c in 0..3 {
                sum[c] += f64::from(all[c] - direct[c]) * wi[2];
            }
            weight += wi[2] * wi[2];
        }
        sum.map(|v| (v / weight) as f32)
    });
    Ok(baked.collect())
}
