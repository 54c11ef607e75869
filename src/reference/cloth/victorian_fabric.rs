//! A lampas of two materials: matte, deep-coloured warp on the ground, glossy golden weft in the figure. The weave
//! changes from warp-faced to weft-faced satin along the figure's outline.

use super::fibres::Spin;
use super::figure::Figure;
use super::weave::{Weave, satin_tie};
use super::yarn::Lay;
use super::{Design, add_shades, draw, vary};
use crate::reference::fibre_shading::FibreLook;

/// Threads a tile, either way: a multiple of both satins' periods.
const THREADS: usize = 96;
/// Period and step of the ground's satin, and of the figure's.
const GROUND: [usize; 2] = [8, 3];
const FIGURE: [usize; 2] = [8, 5];

/// Ground colours to choose from, linear RGB: crimson, peacock, bottle green, aubergine.
const DYES: [[f32; 3]; 4] =
    [[0.17, 0.005, 0.010], [0.004, 0.035, 0.085], [0.007, 0.05, 0.018], [0.06, 0.007, 0.05]];
/// Silk over a golden core.
const GOLD: [f32; 3] = [0.95, 0.37, 0.05];

/// The parameters under one seed.
pub fn design(seed: u64) -> Design {
    let random = &mut draw(seed, "victorian-fabric", 0, 0);
    let dye = DYES[(seed % DYES.len() as u64) as usize].map(|c| c * vary(random, 1.0, 0.15) as f32);
    let wool =
        FibreLook { colour: dye, longitudinal_roughness: 0.5, azimuthal_roughness: 1.0, ior: 1.4, tilt: 0.0 };
    let gold = GOLD.map(|c| c * vary(random, 1.0, 0.04) as f32);
    let silk = FibreLook {
        colour: gold,
        longitudinal_roughness: 0.45,
        azimuthal_roughness: 0.95,
        ior: 1.5,
        tilt: 0.0,
    };
    let mut looks = Vec::new();
    let warp_shades = add_shades(&mut looks, wool, 5, 0.2);
    let weft_shades = add_shades(&mut looks, silk, 5, 0.08);
    let thickness = vary(random, 1.0, 0.05);
    let warp = Lay {
        half_width: 0.50 * thickness,
        half_height: 0.34 * thickness,
        crimp: 0.5,
        passage: 1.0,
        bow: 0.5,
        spread: 0.35,
        bunching: 0.04,
        wander: 0.04,
        slub: 0.06,
    };
    let weft =
        Lay { half_width: 0.52 * thickness, half_height: 0.46 * thickness, spread: 0.4, ..warp.clone() };
    let spin = Spin {
        plies: 2,
        ply_turns: 24,
        fibre_turns: -12,
        fibres: 3,
        fibre_radius: 0.0015,
        migration: 0.08,
        uneven: 0.1,
        loops: 0.02,
        loop_height: 0.5,
        hairs: 1,
        hair_length: 0.03,
        places: 384,
        shades: warp_shades,
    };
    let weft_spin = Spin {
        plies: 1,
        ply_turns: 6,
        fibre_turns: 0,
        fibres: 8,
        shades: weft_shades,
        hairs: 0,
        ..spin.clone()
    };
    let figure = Figure::new(random);
    let weave = Weave::new(THREADS, THREADS, |i, j| {
        let at = |k: usize| (k as f64 + 0.5) / THREADS as f64;
        if figure.covers(at(i), at(j)) {
            satin_tie(FIGURE[0], FIGURE[1], i, j)
        } else {
            !satin_tie(GROUND[0], GROUND[1], i, j)
        }
    });
    Design { weave, warp: (warp, spin), weft: (weft, weft_spin), looks, base_colour: dye.map(|c| 0.5 * c) }
}
