//! Gradient noise and scattered points that repeat over the tile.

use crate::random::hash;

/// A uniform number in \[0, 1) for lattice point (i, j) of a lattice with `period` points a side.
pub fn lattice(seed: u64, i: i64, j: i64, period: i64) -> f64 {
    let key = (i.rem_euclid(period) * period + j.rem_euclid(period)) as u64;
    (hash(hash(seed) ^ key) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Gradient noise (Perlin 2002) with `period` lattice cells a tile, about in \[-1, 1\].
pub fn gradient(seed: u64, x: f64, y: f64, period: i64) -> f64 {
    let (px, py) = (x * period as f64, y * period as f64);
    let (j, i) = (px.floor(), py.floor());
    let (u, v) = (px - j, py - i);
    let corner = |di: i64, dj: i64| {
        let angle = std::f64::consts::TAU * lattice(seed, i as i64 + di, j as i64 + dj, period);
        angle.cos() * (u - dj as f64) + angle.sin() * (v - di as f64)
    };
    let ease = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let upper = mix(corner(0, 0), corner(0, 1), ease(u));
    let lower = mix(corner(1, 0), corner(1, 1), ease(u));
    std::f64::consts::SQRT_2 * mix(upper, lower, ease(v))
}

/// Octaves of gradient noise, each twice as fine and half as strong.
pub fn octaves(seed: u64, x: f64, y: f64, period: i64, count: u32) -> f64 {
    (0..count)
        .map(|k| gradient(seed.wrapping_add(u64::from(k)), x, y, period << k) * 0.5_f64.powi(k as i32))
        .sum()
}

/// The point nearest to a position among one scattered point a lattice cell, and the cell border.
pub struct Cell {
    /// Identifies the point; equal for its copies in other tiles.
    pub id: u64,
    /// From the point to the position, in cells.
    pub offset: [f64; 2],
    /// Distance from the position to the cell's border, in cells: a soft minimum over the neighbours, so that corners
    /// are rounded (below 0 in their very tips) and no creases run from them to the middle.
    pub border: f64,
}

/// Sharpness of the cells' corners.
const SHARPNESS: f64 = 16.0;

/// Worley cells with `period` points a side of the tile, moved from their lattice by up to half of `jitter`.
pub fn cell(seed: u64, x: f64, y: f64, period: i64, jitter: f64) -> Cell {
    let (px, py) = (x * period as f64, y * period as f64);
    let (column, row) = (px.floor() as i64, py.floor() as i64);
    let offset = |i: i64, j: i64| {
        let place = |seed: u64| 0.5 + jitter * (lattice(seed, i, j, period) - 0.5);
        [px - j as f64 - place(seed), py - i as f64 - place(seed ^ 0x5bd1)]
    };
    let near = || (row - 2..=row + 2).flat_map(|i| (column - 2..=column + 2).map(move |j| (i, j)));
    let squared = |d: [f64; 2]| d[0] * d[0] + d[1] * d[1];
    let mut best = (row, column);
    for (i, j) in near() {
        if squared(offset(i, j)) < squared(offset(best.0, best.1)) {
            best = (i, j);
        }
    }
    let to_best = offset(best.0, best.1);
    let mut nearness = 0.0;
    for (i, j) in near().filter(|&other| other != best) {
        let to_other = offset(i, j);
        // Distance to the bisector of the two points.
        let between = [to_best[0] - to_other[0], to_best[1] - to_other[1]];
        let length = squared(between).sqrt();
        let border = (squared(to_other) - squared(to_best)) / (2.0 * length.max(1e-9));
        nearness += (-SHARPNESS * border).exp();
    }
    let border = -nearness.ln() / SHARPNESS;
    let (i, j) = (best.0.rem_euclid(period), best.1.rem_euclid(period));
    Cell { id: hash(seed ^ hash((i * period + j) as u64)), offset: to_best, border }
}
