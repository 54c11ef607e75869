//! Where on the tile is asked.

use super::histogram::Histogram;
use serde::Serialize;

/// Cells along a side of the map.
pub(super) const CELLS: usize = 64;

/// The places that are asked.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Position {
    /// 64 x 64 cells of the tile, row by row, the first at the smallest v.
    pub map: Histogram,
    /// Cells of the map in which something is asked, as a share of all.
    pub cells: f64,
    /// What holds all places. Their footprints reach half a pixel beyond it.
    pub window: Window,
}

/// The smallest rectangle of whole texels that holds all places; it may go over the border of the tile. Of the tile's sides
/// \[H, W\].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Window {
    /// Where it begins, as a fraction of the tile, from 0 to below 1.
    pub start: [f64; 2],
    /// How long it is, as a fraction of the tile; start and length may add up to more than 1.
    pub length: [f64; 2],
}

impl Window {
    /// Its area as a share of the tile's.
    pub fn area(&self) -> f64 {
        self.length[0] * self.length[1]
    }
}

impl Position {
    pub(super) fn new(u: &[[f32; 2]], weight: &[f64], resolution: [usize; 2]) -> Self {
        let cell = |u: &[f32; 2]| place(u[1], CELLS) * CELLS + place(u[0], CELLS);
        let map = Histogram::of(CELLS * CELLS, u.iter().zip(weight).map(|(u, weight)| (cell(u), *weight)));
        let cells = map.queries.iter().filter(|n| **n > 0).count() as f64 / (CELLS * CELLS) as f64;
        Self { map, cells, window: window(u, resolution) }
    }
}

fn window(u: &[[f32; 2]], resolution: [usize; 2]) -> Window {
    // Rows go by the second coordinate.
    let arcs = [1, 0].map(|axis| {
        let side = resolution[1 - axis].max(1);
        let mut asked = vec![false; side];
        u.iter().for_each(|u| asked[place(u[axis], side)] = true);
        arc(&asked).map(|texels| texels as f64 / side as f64)
    });
    Window { start: arcs.map(|[start, _]| start), length: arcs.map(|[_, length]| length) }
}

/// In which of `count` equal parts of a period a coordinate falls.
fn place(u: f32, count: usize) -> usize {
    let within = f64::from(u) - f64::from(u).floor();
    ((within * count as f64) as usize).min(count - 1)
}

/// The start and length of the shortest arc of a circle that holds all that are marked: what the longest gap leaves.
pub fn arc(marked: &[bool]) -> [usize; 2] {
    let (count, mut longest, mut after) = (marked.len(), 0, 0);
    let places: Vec<usize> = (0..count).filter(|k| marked[*k]).collect();
    for (k, place) in places.iter().enumerate() {
        let next = places[(k + 1) % places.len()];
        // One that is marked alone has all others as its gap.
        let gap = (next + count - place - 1) % count;
        if gap > longest {
            (longest, after) = (gap, next);
        }
    }
    [after, count - longest]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_goes_over_the_border_where_that_is_shorter() {
        let arc_of = |places: &[usize]| {
            let mut marked = [false; 10];
            places.iter().for_each(|k| marked[*k] = true);
            arc(&marked)
        };
        assert_eq!(arc_of(&[2, 3, 5]), [2, 4]);
        assert_eq!(arc_of(&[0, 1, 9]), [9, 3]);
        assert_eq!(arc_of(&[0, 9]), [9, 2]);
        assert_eq!(arc_of(&[4]), [4, 1]);
        assert_eq!(arc_of(&[0, 1, 2, 3, 4, 5, 6, 7, 8, 9]), [0, 10]);
        // A place in the gap makes another window.
        assert_eq!(arc_of(&[0, 1, 5, 9]), [5, 7]);
    }

    #[test]
    fn places_repeat_and_rows_go_by_the_second_coordinate() {
        // Columns 0 and 7 of 8, rows 1 and 2 of 4; one period away is the same place.
        let u = [[0.05, 0.3], [-0.05, 0.6], [3.05, -0.5]];
        let position = Position::new(&u, &[1.0; 3], [4, 8]);
        assert_eq!(position.window, Window { start: [0.25, 0.875], length: [0.5, 0.25] });
        assert_eq!(position.window.area(), 0.125);
        assert_eq!(position.map.queries.iter().sum::<u64>(), 3);
        assert_eq!(position.map.queries[38 * CELLS + 60], 1);
        assert_eq!(position.cells, 3.0 / 4096.0);
        let elsewhere = Position::new(&[u[0], u[1], [0.5, 0.5]], &[1.0; 3], [4, 8]);
        assert_ne!(elsewhere.window, position.window);
        // What rounds to a whole period is its end.
        assert_eq!([-1e-9f32, 0.999_999_94, 1.0].map(|u| place(u, 64)), [63, 63, 0]);
    }
}
