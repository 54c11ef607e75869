//! A 3/1 twill of smooth filaments: coloured warp that covers most of a light weft, diagonal ribs, strong anisotropy.

use super::fibres::Spin;
use super::weave::{Weave, twill};
use super::yarn::Lay;
use super::{Design, add_shades, draw, vary};
use crate::reference::fibre_shading::FibreLook;

/// Yarns a tile, either way.
const YARNS: usize = 32;
/// Wefts that a warp goes over, and under.
const OVER: usize = 3;
const UNDER: usize = 1;

/// Warp colours to choose from, linear RGB: indigo, bordeaux, bottle green, slate.
const DYES: [[f32; 3]; 4] =
    [[0.016, 0.030, 0.085], [0.16, 0.012, 0.022], [0.012, 0.07, 0.04], [0.045, 0.048, 0.055]];
/// Weft: unbleached.
const PLAIN: [f32; 3] = [0.80, 0.70, 0.55];

/// The parameters under one seed.
pub fn design(seed: u64) -> Design {
    let random = &mut draw(seed, "twill", 0, 0);
    let dye = DYES[(seed % DYES.len() as u64) as usize].map(|c| c * vary(random, 1.0, 0.15) as f32);
    let silk = FibreLook {
        colour: dye,
        longitudinal_roughness: 0.3,
        azimuthal_roughness: 0.95,
        ior: 1.45,
        tilt: 0.0,
    };
    let mut looks = Vec::new();
    let warp_shades = add_shades(&mut looks, silk, 6, 0.18);
    let cotton = FibreLook { colour: PLAIN, longitudinal_roughness: 0.6, azimuthal_roughness: 1.0, ..silk };
    let weft_shades = add_shades(&mut looks, cotton, 4, 0.06);
    let thickness = vary(random, 1.0, 0.05);
    let warp = Lay {
        half_width: 0.54 * thickness,
        half_height: 0.25 * thickness,
        crimp: 0.45,
        passage: 1.0,
        bow: 0.3,
        spread: 0.15,
        bunching: 0.03,
        wander: 0.05,
        slub: 0.07,
    };
    let weft =
        Lay { half_width: 0.44 * thickness, half_height: 0.22 * thickness, crimp: 0.5, ..warp.clone() };
    let spin = Spin {
        plies: 1,
        ply_turns: 3,
        fibre_turns: 0,
        fibres: 34,
        fibre_radius: 0.0018,
        migration: 0.08,
        uneven: 0.12,
        loops: 0.01,
        loop_height: 0.25,
        hairs: 2,
        hair_length: 0.04,
        places: 192,
        shades: warp_shades,
    };
    let weft_spin = Spin { ply_turns: 2, fibres: 28, shades: weft_shades, hairs: 0, ..spin.clone() };
    let weave = Weave::new(YARNS, YARNS, |i, j| twill(OVER, UNDER, i, j));
    Design { weave, warp: (warp, spin), weft: (weft, weft_spin), looks, base_colour: dye.map(|c| 0.3 * c) }
}
