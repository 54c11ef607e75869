//! Woven cloth down to the fibres: three materials, each a page of parameters.
//!
//! `weave` says which yarn is on top, `yarn` where each runs, `fibres` winds fibres along it. Everything repeats
//! with the tile: a fibre that leaves the tile comes in again on the other side, at the same place and in the same
//! direction.

mod basket_cloth;
mod fibres;
mod figure;
mod twill;
mod victorian_fabric;
mod weave;
mod yarn;

#[cfg(test)]
mod tests;

use super::fibre_shading::FibreLook;
use super::primitives::Curve;
use crate::error::{Error, Result};
use crate::random::{Random, Stream};
use fibres::{Spin, Spun};
use rayon::prelude::*;
use std::ops::Range;
use weave::Weave;
use yarn::{Family, Lay, Path};

/// Names of the cloths.
pub const NAMES: [&str; 3] = ["basket-cloth", "twill", "victorian-fabric"];

/// Distance of the base from the lowest fibre, in tile widths: no ray squeezes in between.
const BASE_CLEARANCE: f64 = 0.001;

/// A tile of cloth.
#[derive(Clone, Debug)]
pub struct Cloth {
    /// What it is called.
    pub name: String,
    /// The fibres. They start in or near the tile; the cloth is all their copies, whole tiles apart.
    pub curves: Vec<Curve>,
    /// How many of the curves, from the first, go on in the next tile: their last point is their first, one tile
    /// further on. The others are hairs with free ends.
    pub endless: usize,
    /// What the curves' looks point into.
    pub looks: Vec<FibreLook>,
    /// Height of the flat base under the cloth, in tile widths.
    pub base_height: f64,
    /// Diffuse colour of the base, linear RGB.
    pub base_colour: [f32; 3],
    /// Roughness of the base.
    pub base_roughness: f32,
}

/// The parameters of a cloth.
struct Design {
    weave: Weave,
    warp: (Lay, Spin),
    weft: (Lay, Spin),
    looks: Vec<FibreLook>,
    base_colour: [f32; 3],
}

/// The cloth of that name, varied by the seed.
///
/// # Errors
/// `Config` for a name that is not in [`NAMES`].
pub fn make(name: &str, seed: u64) -> Result<Cloth> {
    Ok(design(name, seed)?.weave_it(name, seed))
}

fn design(name: &str, seed: u64) -> Result<Design> {
    match name {
        "basket-cloth" => Ok(basket_cloth::design(seed)),
        "twill" => Ok(twill::design(seed)),
        "victorian-fabric" => Ok(victorian_fabric::design(seed)),
        _ => Err(Error::config(
            "material",
            format!("no cloth is called {name}; there are {}", NAMES.join(", ")),
        )),
    }
}

impl Cloth {
    /// Pieces of all curves.
    pub fn segments(&self) -> usize {
        self.curves.iter().map(|curve| curve.points.len().saturating_sub(1)).sum()
    }

    /// Height of the base and of the highest point of a fibre, in tile widths.
    pub fn height_range(&self) -> [f64; 2] {
        let tops = self.curves.iter().flat_map(|c| c.points.iter().map(|p| p[2] + c.radius));
        [self.base_height, tops.fold(self.base_height, f64::max)]
    }
}

impl Design {
    /// Distance between the centres of warp and weft that touch at a crossing, in tile widths.
    fn touching(&self) -> f64 {
        let half_height = |lay: &Lay, yarns: usize| lay.half_height / yarns as f64;
        half_height(&self.warp.0, self.weave.warps()) + half_height(&self.weft.0, self.weave.wefts())
    }

    fn weave_it(&self, name: &str, seed: u64) -> Cloth {
        let touching = self.touching();
        let (mut curves, mut hairs) = (Vec::new(), Vec::new());
        for (family, yarns) in [(Family::Warp, self.weave.warps()), (Family::Weft, self.weave.wefts())] {
            let (lay, spin) = if family == Family::Warp { &self.warp } else { &self.weft };
            let spin_yarn = |index| {
                let mut random = draw(seed, name, 1 + family as u64, index);
                let path = Path::new(&self.weave, (family, index), lay, touching, spin.places, &mut random);
                fibres::spin(&path, spin, &mut random)
            };
            let spun: Vec<Spun> = (0..yarns).into_par_iter().map(spin_yarn).collect();
            for yarn in spun {
                curves.extend(yarn.endless);
                hairs.extend(yarn.hairs);
            }
        }
        let endless = curves.len();
        curves.extend(hairs);
        let bottoms = curves.iter().flat_map(|c| c.points.iter().map(|p| p[2] - c.radius));
        let base_height = bottoms.fold(f64::INFINITY, f64::min) - BASE_CLEARANCE;
        Cloth {
            name: name.to_owned(),
            curves,
            endless,
            looks: self.looks.clone(),
            base_height,
            base_colour: self.base_colour,
            base_roughness: 1.0,
        }
    }
}

/// Random numbers of a cloth: part 0 is for its design, the others for its families of yarns.
fn draw(seed: u64, name: &str, part: u64, index: usize) -> Random {
    let tag = name.bytes().fold(0, |tag, byte| crate::random::hash(tag ^ u64::from(byte)));
    Random::sub_stream(seed ^ tag, Stream::Material, part, index as u64)
}

/// A number around `middle`, at most `share` of it away.
fn vary(random: &mut Random, middle: f64, share: f64) -> f64 {
    middle * (1.0 + share * (2.0 * random.uniform_f64() - 1.0))
}

/// Appends `count` shades of a look, from `1 - contrast` to `1 + contrast` times its colour, and says where they are.
fn add_shades(looks: &mut Vec<FibreLook>, look: FibreLook, count: u32, contrast: f32) -> Range<u32> {
    let start = looks.len() as u32;
    for k in 0..count {
        let scale = 1.0 + contrast * (2.0 * (k as f32 + 0.5) / count as f32 - 1.0);
        looks.push(FibreLook { colour: look.colour.map(|c| (c * scale).clamp(0.0, 1.0)), ..look });
    }
    start..start + count
}
