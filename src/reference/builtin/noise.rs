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

/// Scattered points of several weights, one a lattice cell, that share the tile in rounded polygons (a power diagram).
pub struct Packing {
    /// Chooses the points.
    pub seed: u64,
    /// Points a side of the tile; even where `brick` is not 0.
    pub period: i64,
    /// How far points leave the lattice: up to half of it, in cells.
    pub jitter: f64,
    /// Shift of every other row, in cells: at 0.5 most polygons have six sides.
    pub brick: f64,
    /// Largest difference of two weights, in squared cells: points of more weight get larger polygons.
    pub spread: f64,
    /// Sharpness of the polygons' corners: about one over their radius, in cells.
    pub sharpness: f64,
}

/// A position in a polygon of a [`Packing`].
pub struct Polygon {
    /// Identifies the point; equal for its copies in other tiles.
    pub id: u64,
    /// From the point to the position, in cells.
    pub offset: [f64; 2],
    /// Distance to the polygon's border, in cells, a soft minimum over its sides.
    pub border: f64,
    /// 0 at the point, about 1 on the border: its level lines are copies of the polygon, shrunk towards the point.
    /// Only where `spread` is less than the squared distance of any two points: otherwise a point may lie outside.
    pub share: f64,
}

/// Power of the mean over a polygon's sides that [`Polygon::share`] is: higher powers have sharper corners.
const SHARE_POWER: i32 = 10;

impl Packing {
    /// The polygon that holds a position.
    pub fn at(&self, x: f64, y: f64) -> Polygon {
        let (px, py) = (x * self.period as f64, y * self.period as f64);
        let row = py.floor() as i64;
        let column = |i: i64| (px - self.shift(i)).floor() as i64;
        let near = (row - 2..=row + 2).flat_map(|i| (column(i) - 2..=column(i) + 2).map(move |j| (i, j)));
        let (mut i, mut j, mut offset, mut least) = (0, 0, [0.0; 2], f64::INFINITY);
        for (row, column) in near {
            let (to_point, power) = self.point(row, column, px, py);
            if power < least {
                (i, j, offset, least) = (row, column, to_point, power);
            }
        }
        // Sides are looked for around the point: all positions in its polygon see the same ones.
        let (mut nearness, mut share) = (0.0, 0.0);
        for (k, l) in (i - 3..=i + 3).flat_map(|k| (j - 3..=j + 3).map(move |l| (k, l))) {
            if (k, l) == (i, j) {
                continue;
            }
            let (to_other, power) = self.point(k, l, px, py);
            let apart = [offset[0] - to_other[0], offset[1] - to_other[1]];
            let length = squared(apart).sqrt().max(1e-9);
            let border = (power - least) / (2.0 * length);
            nearness += (-self.sharpness * border).exp();
            // The part of the way to this side that is behind us.
            let behind = (offset[0] * apart[0] + offset[1] * apart[1]) / length;
            if behind > 0.0 {
                share += (behind / (behind + border).max(1e-9)).powi(SHARE_POWER);
            }
        }
        Polygon {
            id: hash(self.seed ^ hash(self.key(i, j))),
            offset,
            border: -nearness.ln() / self.sharpness,
            share: share.powf(1.0 / f64::from(SHARE_POWER)),
        }
    }

    fn shift(&self, row: i64) -> f64 {
        if row.rem_euclid(2) == 1 { self.brick } else { 0.0 }
    }

    /// Offset from the point of a lattice cell to a position, in cells, and its square less the point's weight.
    fn point(&self, i: i64, j: i64, px: f64, py: f64) -> ([f64; 2], f64) {
        // Three numbers of 21 bits: a hash for each would take most of the time.
        let bits = hash(hash(self.seed) ^ self.key(i, j));
        let draw = |k: u32| ((bits >> (21 * k)) & 0x1f_ffff) as f64 / f64::from(1 << 21);
        let place = |k: u32| 0.5 + self.jitter * (draw(k) - 0.5);
        let offset = [px - self.shift(i) - j as f64 - place(0), py - i as f64 - place(1)];
        (offset, squared(offset) - self.spread * draw(2))
    }

    /// Number of a lattice cell in the tile.
    fn key(&self, i: i64, j: i64) -> u64 {
        (i.rem_euclid(self.period) * self.period + j.rem_euclid(self.period)) as u64
    }
}

fn squared(d: [f64; 2]) -> f64 {
    d[0] * d[0] + d[1] * d[1]
}

#[cfg(test)]
mod tests {
    use super::*;

    const PACKING: Packing =
        Packing { seed: 7, period: 6, jitter: 0.5, brick: 0.5, spread: 0.2, sharpness: 20.0 };

    /// Positions that leave no cell out.
    fn positions() -> impl Iterator<Item = (f64, f64)> {
        (0..400).map(|k| (k as f64 * 0.754_877 % 1.0, k as f64 * 0.569_840 % 1.0))
    }

    /// x + 1 rounds positions by 1e-16, and the steepest function here is a tenth power.
    const ROUNDING: f64 = 1e-9;

    #[test]
    fn polygons_repeat_with_the_tile_and_with_nothing_less() {
        for (x, y) in positions() {
            let (here, there) = (PACKING.at(x, y), PACKING.at(x - 1.0, y + 2.0));
            assert_eq!(here.id, there.id);
            assert!(
                (here.border - there.border).abs() < ROUNDING && (here.share - there.share).abs() < ROUNDING
            );
            let moved = PACKING.at(x + 0.5, y);
            assert!(here.id != moved.id && (here.border - moved.border).abs() > ROUNDING);
        }
    }

    #[test]
    fn a_share_grows_in_proportion_from_the_point_to_the_border() {
        let mut largest = 0.0_f64;
        for (x, y) in positions() {
            let here = PACKING.at(x, y);
            // Towards the point by a half: the level lines are copies of one polygon.
            let to_middle = here.offset.map(|d| 0.5 * d / PACKING.period as f64);
            let middle = PACKING.at(x - to_middle[0], y - to_middle[1]);
            assert_eq!(middle.id, here.id);
            assert!((middle.share - 0.5 * here.share).abs() < ROUNDING);
            assert!((middle.share - 0.51 * here.share).abs() > ROUNDING);
            largest = largest.max(here.share);
        }
        // 1 on a side, and the tenth root of 3 where three polygons meet and two sides and a bit count.
        assert!((0.95..1.12).contains(&largest), "{largest}");
    }
}
