//! Thick, soft three-ply yarns in basket weave, undyed: visible plies and fibres, deep gaps.

use super::fibres::Spin;
use super::weave::{Weave, basket};
use super::yarn::Lay;
use super::{Design, add_shades, draw, vary};
use crate::reference::fibre_shading::FibreLook;

/// Yarns a tile, either way.
const YARNS: usize = 12;
/// Yarns that go over and under together.
const GROUP: usize = 2;

/// Cream to grey-beige, linear RGB, as the colour of a mass of fibres.
const CREAM: [f64; 3] = [0.90, 0.59, 0.29];
const GREIGE: [f64; 3] = [0.76, 0.53, 0.32];

/// The parameters under one seed.
pub fn design(seed: u64) -> Design {
    let random = &mut draw(seed, "basket-cloth", 0, 0);
    let thickness = vary(random, 1.0, 0.05);
    let tone = random.uniform_f64();
    let colour = std::array::from_fn(|c| (CREAM[c] + (GREIGE[c] - CREAM[c]) * tone) as f32);
    let look =
        FibreLook { colour, longitudinal_roughness: 0.8, azimuthal_roughness: 1.0, ior: 1.35, tilt: 0.0 };
    let mut looks = Vec::new();
    let lay = Lay {
        half_width: 0.47 * thickness,
        half_height: 0.30 * thickness,
        crimp: 0.5,
        passage: 0.9,
        bow: 0.25,
        spread: 0.10,
        bunching: 0.035,
        wander: 0.03,
        slub: 0.06,
    };
    let mut spin = |ply_turns: i32, hairs: usize, contrast: f32| Spin {
        plies: 3,
        ply_turns,
        fibre_turns: -ply_turns / 2,
        fibres: 42,
        fibre_radius: 0.0021,
        migration: 0.11,
        uneven: 0.06,
        loops: 0.2,
        loop_height: 0.35,
        hairs,
        hair_length: 0.07,
        places: 160,
        shades: add_shades(&mut looks, look, 6, contrast),
    };
    let hairs = vary(random, 30.0, 0.4) as usize;
    let warp = (lay.clone(), spin(7, hairs, 0.10));
    let weft = (Lay { half_width: 0.48 * thickness, ..lay }, spin(6, hairs, 0.12));
    let weave = Weave::new(YARNS, YARNS, |i, j| basket(GROUP, i, j));
    Design { weave, warp, weft, looks, base_colour: colour.map(|c| 0.25 * c) }
}
