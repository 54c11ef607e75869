//! The same query among other queries.

use super::padded::{Padded, cut};
use crate::error::Result;
use crate::kernels::inception::Border;
use crate::onnx_material::largest_difference;
use crate::query::{QueryBuffer, Reflectance};
use crate::report::figures::Series;
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::workshop::Workshop;

/// Directions of the slice: from both sides, neither grazing nor above.
const WI: [f32; 2] = [0.4, 0.3];
const WO: [f32; 2] = [-0.3, 0.2];
/// Sides of square cut-outs that are asked for.
const SIDES: [usize; 6] = [1, 2, 4, 8, 16, 32];
/// Where cut-outs begin: row and column.
const CORNER: [usize; 2] = [5, 9];
/// Of answers in images of another size: positions and sums are rounded anew.
const SAME: f64 = 2e-5;

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "inception-layout",
        group: Group::Inception,
        provokes: "An Inception decoder reads the queries around each one: the same query in another buffer has other \
                   neighbours.",
        naive: "the network on each rectangle as it comes, zeros around it",
        cured: "missing neighbours are added, and what is no regular grid is refused",
        figure: "largest difference between a query's answers in two layouts / (1 + value)",
        bound: Bound::new(SAME, "the tolerance of golden answers in bundles"),
        run,
    }]
}

fn run(workshop: &mut Workshop) -> Result<Outcome> {
    let model = super::trained(workshop)?;
    let padded = Padded::new(&model.checkpoint)?;
    let side = workshop.scale().resolution;
    let whole = QueryBuffer::slice(side, side, WI, WO, 0.0);
    let exact = model.material.evaluate(&whole)?.pixels;
    let mut layouts: Vec<(usize, QueryBuffer, Vec<usize>)> = Vec::new();
    for square in SIDES {
        let (part, places) = cut(&whole, CORNER, [square; 2])?;
        layouts.push((square, part, places));
    }
    // Strips, and all queries in one row.
    for size in [[side, 3], [2, side]] {
        let (part, places) = cut(&whole, [0, 0], size)?;
        layouts.push((0, part, places));
    }
    let QueryBuffer { u, wi, wo, level, .. } = whole.clone();
    let row = QueryBuffer::new(1, side * side, u, wi, wo, level)?;
    layouts.push((0, row, (0..side * side).collect()));
    let (mut naive, mut cured) = (0.0f64, 0.0f64);
    let mut of_naive = Vec::new();
    let mut of_cured = Vec::new();
    for (square, part, places) in &layouts {
        let expected: Vec<[f32; 3]> = places.iter().map(|k| exact[*k]).collect();
        let as_it_comes = largest_difference(&padded.answers(part, Border::Zero)?, &expected);
        let with_margin = largest_difference(&model.material.evaluate(part)?.pixels, &expected);
        naive = if as_it_comes <= naive { naive } else { as_it_comes };
        cured = if with_margin <= cured { cured } else { with_margin };
        if *square > 0 {
            of_naive.push((*square as f64, as_it_comes));
            of_cured.push((*square as f64, with_margin));
        }
    }
    let mut moved = whole.clone();
    moved.u.iter_mut().for_each(|u| u[0] += 0.3 / side as f32);
    let note = match model.material.evaluate(&moved) {
        Ok(_) => {
            cured = f64::INFINITY;
            "Positions between the texels are answered, which they must not be.".to_string()
        }
        Err(problem) => format!("Positions between the texels are refused: {problem}"),
    };
    let circular = largest_difference(&padded.answers(&whole, Border::Wrap)?, &exact);
    let values = vec![("whole_tile_wrapped".into(), circular)];
    let series = vec![
        Series { name: "as it comes".into(), points: of_naive },
        Series { name: "with its margin".into(), points: of_cured },
    ];
    let plot = Plot { x: "side of the cut-out".into(), y: "largest difference".into(), series };
    Ok(Outcome { notes: vec![note], values, plot: Some(plot), ..Outcome::new(naive, cured) })
}
