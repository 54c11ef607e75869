//! Whether a map tiles: the step across its seam beside the steps inside; and a cross-fade that makes it tile.
//!
//! The step between two neighbouring columns (or rows) is the root mean square of their differences, over texels and
//! channels. Where a map repeats, the step from its last column to its first is one like all others. It is compared with
//! the largest inside and not with the mean, so that a joint of a wall may lie on the seam.

/// A seam is open if its step is more than this many times the largest inside. Of as many steps of a tiling noise, the
/// one at the seam is the largest by chance; it is then larger than the next by far less than half.
const OPEN_RATIO: f64 = 1.5;

/// Smallest step that can be seen, as a share of the span of values: two of the 255 steps of an 8-bit map, so that the
/// rounding of a smooth map does not pass for a seam.
const VISIBLE_STEP: f64 = 2.0 / 255.0;

/// The share of width and height that a cross-fade takes: wide enough to hide the change from one end to the other,
/// narrow enough to leave most of the map as it is.
const FADE_SHARE: f64 = 0.125;

/// How much longer everything is in widths of the tile that a cross-fade leaves.
pub const FADE_GROWTH: f64 = 1.0 / (1.0 - FADE_SHARE);

/// Texels row by row, not yet square.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid<const N: usize> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `height * width` texels.
    pub texels: Vec<[f32; N]>,
}

/// Which two edges of a map meet at a seam.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// The last column meets the first.
    Columns,
    /// The last row meets the first.
    Rows,
}

/// The step across a seam and the largest inside.
#[derive(Clone, Copy, Debug)]
pub struct Seam {
    /// Which edges meet.
    pub axis: Axis,
    /// Root mean square step across the seam, in the map's values.
    pub step: f64,
    /// The largest between neighbours inside.
    pub inside: f64,
}

impl Seam {
    /// True if the seam shows in a map whose values span `span`.
    pub fn is_open(&self, span: f64) -> bool {
        self.step > OPEN_RATIO * self.inside && self.step > VISIBLE_STEP * span
    }
}

impl std::fmt::Display for Seam {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (ends, neighbours) = match self.axis {
            Axis::Columns => ("right edge to the left", "columns"),
            Axis::Rows => ("bottom edge to the top", "rows"),
        };
        let Self { step, inside, .. } = self;
        write!(f, "from its {ends} its values step by {step:.3}, between neighbouring {neighbours} inside ")?;
        write!(f, "by at most {inside:.3}")
    }
}

impl<const N: usize> Grid<N> {
    /// The seams between columns and between rows. A side of 1 has none: its steps are 0.
    pub fn seams(&self) -> [Seam; 2] {
        let (w, h) = (self.width, self.height);
        let mut columns = vec![0.0; w];
        let mut rows = vec![0.0; h];
        for (i, row_sum) in rows.iter_mut().enumerate() {
            let row = &self.texels[i * w..][..w];
            let below = &self.texels[(i + 1) % h * w..][..w];
            for j in 0..w {
                columns[j] += squared(row[j], row[(j + 1) % w]);
                *row_sum += squared(row[j], below[j]);
            }
        }
        let seam = |axis, sums: &[f64], count: usize| {
            let rms = |sum: f64| (sum / (count * N) as f64).sqrt();
            let (last, inside) = sums.split_last().map_or((0.0, &[][..]), |(last, rest)| (*last, rest));
            Seam { axis, step: rms(last), inside: rms(inside.iter().fold(0.0, |a: f64, &b| a.max(b))) }
        };
        [seam(Axis::Columns, &columns, h), seam(Axis::Rows, &rows, w)]
    }

    /// Crops an eighth of width and height and fades it into the opposite end, so that the map tiles: the first column
    /// becomes the one that followed the last that is left, and from there the old ones come in linearly.
    #[must_use]
    pub fn cross_faded(&self) -> Self {
        let strip = |side: usize| ((side as f64 * FADE_SHARE).round() as usize).clamp(1, side.max(2) - 1);
        let (across, down) = (strip(self.width), strip(self.height));
        let (width, height) = (self.width - across, self.height - down);
        let blend = |fresh: [f32; N], old: [f32; N], k: usize, strip: usize| {
            let share = k as f32 / strip as f32;
            std::array::from_fn(|c| fresh[c] + (old[c] - fresh[c]) * share)
        };
        let column = |i: usize, j: usize| {
            let row = &self.texels[i * self.width..][..self.width];
            if j < across { blend(row[j + width], row[j], j, across) } else { row[j] }
        };
        let texels = (0..width * height)
            .map(|k| {
                let (i, j) = (k / width, k % width);
                if i < down { blend(column(i + height, j), column(i, j), i, down) } else { column(i, j) }
            })
            .collect();
        Self { width, height, texels }
    }
}

fn squared<const N: usize>(a: [f32; N], b: [f32; N]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(b)).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};
    use std::f64::consts::TAU;

    fn grid(width: usize, height: usize, value: impl Fn(usize, usize) -> f64) -> Grid<1> {
        let texels = (0..width * height).map(|k| [value(k / width, k % width) as f32]).collect();
        Grid { width, height, texels }
    }

    fn open(grid: &Grid<1>) -> [bool; 2] {
        grid.seams().map(|seam| seam.is_open(1.0))
    }

    /// Waves of whole numbers of periods: it tiles.
    fn waves(i: usize, j: usize, width: usize, height: usize) -> f64 {
        let (x, y) = (j as f64 / width as f64, i as f64 / height as f64);
        0.5 + 0.2 * (TAU * (2.0 * x + y)).sin() + 0.2 * (TAU * (5.0 * y - 3.0 * x) + 1.0).cos()
    }

    #[test]
    fn waves_tile_until_a_part_of_them_is_cut_off() {
        let whole = grid(96, 64, |i, j| waves(i, j, 96, 64));
        assert_eq!(open(&whole), [false, false]);
        assert_eq!(open(&grid(80, 64, |i, j| waves(i, j, 96, 64))), [true, false]);
        assert_eq!(open(&grid(96, 50, |i, j| waves(i, j, 96, 64))), [false, true]);
    }

    #[test]
    fn white_noise_passes() {
        for index in 0..20 {
            let mut random = Random::new(4, Stream::Probe, index);
            let values: Vec<f64> = (0..40 * 24).map(|_| random.uniform_f64()).collect();
            assert_eq!(open(&grid(40, 24, |i, j| values[i * 40 + j])), [false, false]);
        }
    }

    /// Bricks of 32 x 16 with joints 4 wide, moved by (di, dj).
    fn bricks(i: usize, j: usize) -> f64 {
        if j % 32 < 4 || i % 16 < 4 { 0.1 } else { 0.8 }
    }

    #[test]
    fn joints_on_the_seam_pass() {
        for shift in 0..5 {
            assert_eq!(open(&grid(64, 64, |i, j| bricks(i + shift, j + shift))), [false, false]);
        }
        // Half a joint stays half a joint: only the change of brightness along the wall makes a seam.
        let darker = grid(64, 64, |i, j| bricks(i + 6, j + 6) + 2.0 * j as f64 / 64.0);
        assert_eq!(open(&darker), [true, false]);
    }

    #[test]
    fn gradients_do_not_tile_unless_nobody_sees_it() {
        assert_eq!(open(&grid(32, 32, |_, j| j as f64 / 31.0)), [true, false]);
        assert_eq!(open(&grid(32, 32, |i, j| (i + j) as f64 / 62.0)), [true, true]);
        // A step of 1.9 and of 2.1 in 255.
        assert_eq!(open(&grid(32, 32, |_, j| 1.9 / 255.0 * j as f64 / 31.0)), [false, false]);
        assert_eq!(open(&grid(32, 32, |_, j| 2.1 / 255.0 * j as f64 / 31.0)), [true, false]);
    }

    #[test]
    fn steps_are_root_mean_squares() {
        let seams = grid(3, 2, |i, j| [[0.0, 1.0, 3.0], [0.0, 1.0, 1.0]][i][j]).seams();
        assert_eq!((seams[0].step, seams[0].inside), (5.0_f64.sqrt(), 2.0_f64.sqrt()));
        assert_eq!(seams[1].step, seams[1].inside);
        assert_eq!(grid(1, 1, |_, _| 0.5).seams().map(|s| s.step), [0.0, 0.0]);
    }

    #[test]
    fn cross_fade_closes_both_seams() {
        let ramp = grid(64, 40, |i, j| (3 * i + 2 * j) as f64 / 250.0);
        assert_eq!(open(&ramp), [true, true]);
        let faded = ramp.cross_faded();
        assert_eq!((faded.width, faded.height), (56, 35));
        assert_eq!(open(&faded), [false, false]);
        // What is not faded is as it was.
        assert_eq!(faded.texels[20 * 56 + 30], ramp.texels[20 * 64 + 30]);
        // Without the blend it would stay open.
        assert_eq!(open(&grid(56, 35, |i, j| (3 * i + 2 * j) as f64 / 250.0)), [true, true]);
        for side in [1, 2, 3] {
            let small = grid(side, 2, |i, j| (i + j) as f64).cross_faded();
            assert_eq!(small.texels.len(), small.width * small.height);
        }
    }
}
