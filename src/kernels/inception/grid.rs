//! Where pixels lie: a plane is lines, a line is rows of one channel each, a row is the pixels of one line of an image with
//! [`HALO`] more on both sides. Small images lie side by side in a row, since rows are computed by whole vectors.

use crate::error::{Error, Result};
use rayon::prelude::*;

/// Pixels beside an image's own: the reach of a 5x5 kernel.
pub const HALO: usize = 2;
/// Pixels that a row has between two of its images.
const GAP: usize = 2 * HALO;
/// Rows are computed in such steps: two of the widest vectors.
const STEP: usize = 32;
/// Floats of a cache line.
const CACHE_LINE: usize = 16;
/// Small images are put side by side up to so many pixels: enough to waste little of a step.
const FULL: usize = 256;
/// Most pixels of a batch, so that sizes of buffers stay far below what a machine counts.
const MOST_PIXELS: usize = 1 << 32;
/// Fewest rows of an image that are worth a task.
const ROWS_OF_TASK: usize = 16;

/// What lies outside an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Border {
    /// The image again: a whole tile.
    Wrap,
    /// Zeros, which the max-pool ignores: a patch, whose outer pixels the caller drops.
    Zero,
}

/// A batch of images of one size, \[images, height, width, channels\] in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Images {
    images: usize,
    height: usize,
    width: usize,
    border: Border,
}

impl Images {
    /// # Errors
    /// `Config` if there is no pixel, or absurdly many.
    pub fn new(images: usize, height: usize, width: usize, border: Border) -> Result<Self> {
        let pixels = images.checked_mul(height).and_then(|n| n.checked_mul(width));
        match pixels {
            Some(1..=MOST_PIXELS) => Ok(Self { images, height, width, border }),
            _ => Err(Error::config(
                "images",
                format!("{images} x {height} x {width} pixels; use 1 to {MOST_PIXELS} altogether"),
            )),
        }
    }

    /// Pixels of all images.
    pub fn pixels(&self) -> usize {
        self.images * self.height * self.width
    }
}

/// What the pixels beside an image become.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Halo {
    /// As the border says.
    Border,
    /// 0: sums over rows are sums over pixels.
    Zero,
}

/// How a batch lies in planes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    images: Images,
    /// Images side by side.
    together: usize,
    /// Pixels of a row that are computed, from the first image's first on.
    pub computed: usize,
    /// Length of a row: what is computed and a kernel's reach on both sides, an odd number of cache lines.
    pub stride: usize,
    /// Number of lines.
    pub lines: usize,
}

impl Grid {
    pub fn new(images: Images) -> Self {
        let computed = |together: usize| (together * (images.width + GAP) - GAP).next_multiple_of(STEP);
        let most = (FULL / (images.width + GAP)).clamp(1, images.images);
        let groups = |together: usize| images.images.div_ceil(together);
        let together = (1..=most).min_by_key(|&k| groups(k) * computed(k)).unwrap_or(1);
        let stride = (computed(together) + GAP).next_multiple_of(CACHE_LINE);
        let lines = groups(together) * images.height;
        Self { images, together, computed: computed(together), stride, lines }
    }

    /// The line `by` below a line, if there is one.
    pub fn neighbour(&self, line: usize, by: isize) -> Option<usize> {
        let height = self.images.height;
        let (first, y) = (line - line % height, (line % height) as isize + by);
        match self.images.border {
            Border::Wrap => Some(first + y.rem_euclid(height as isize) as usize),
            Border::Zero => (0..height as isize).contains(&y).then(|| first + y as usize),
        }
    }

    /// Slots of the images' first pixels in a line's rows.
    fn starts(&self, line: usize) -> impl Iterator<Item = usize> + use<> {
        let first = line / self.images.height * self.together;
        let step = self.images.width + GAP;
        (0..self.together.min(self.images.images - first)).map(move |k| HALO + k * step)
    }

    /// Makes everything of a line's rows but its pixels what it must be.
    pub fn finish(&self, line: usize, rows: &mut [f32], halo: Halo) {
        let width = self.images.width;
        let wrap = halo == Halo::Border && self.images.border == Border::Wrap;
        for row in rows.chunks_exact_mut(self.stride) {
            let mut end = 0;
            for start in self.starts(line) {
                for k in 0..HALO {
                    let (left, right) = if wrap {
                        (row[start + width - 1 - k % width], row[start + k % width])
                    } else {
                        (0.0, 0.0)
                    };
                    row[start - 1 - k] = left;
                    row[start + width + k] = right;
                }
                end = start + width + HALO;
            }
            row[end..].fill(0.0);
        }
    }

    /// Pixels \[pixel\]\[channels\] into a plane.
    pub fn gather(&self, pixels: &[f32], plane: &mut Plane) {
        let (channels, Images { height, width, .. }) = (plane.channels, self.images);
        let fill = |line: usize, rows: &mut [f32]| {
            let first = line / height * self.together;
            for (k, start) in self.starts(line).enumerate() {
                let row = ((first + k) * height + line % height) * width;
                let pixels = &pixels[row * channels..(row + width) * channels];
                for (x, pixel) in pixels.chunks_exact(channels).enumerate() {
                    for (to, from) in rows[start + x..].iter_mut().step_by(self.stride).zip(pixel) {
                        *to = *from;
                    }
                }
            }
            self.finish(line, rows, Halo::Zero);
        };
        plane.by_line(self, fill);
    }

    /// The first `channels` of a plane as pixels \[pixel\]\[channels\].
    pub fn scatter(&self, plane: &Plane, channels: usize, pixels: &mut [f32]) {
        let Images { height, width, .. } = self.images;
        let line_of_plane = plane.channels * self.stride;
        let fill = |(row, pixels): (usize, &mut [f32])| {
            let image = row / height;
            let line = image / self.together * height + row % height;
            let start = HALO + image % self.together * (width + GAP);
            let rows = &plane.lines()[line * line_of_plane..(line + 1) * line_of_plane];
            for (x, pixel) in pixels.chunks_exact_mut(channels).enumerate() {
                for (to, from) in pixel.iter_mut().zip(rows[start + x..].iter().step_by(self.stride)) {
                    *to = *from;
                }
            }
        };
        if channels > 0 {
            pixels.par_chunks_mut(width * channels).with_min_len(ROWS_OF_TASK).enumerate().for_each(fill);
        }
    }
}

/// Channels of a batch, \[line\]\[channel\]\[stride\]; the first pixels of rows begin a cache line.
#[derive(Debug, Default)]
pub struct Plane {
    values: Vec<f32>,
    start: usize,
    len: usize,
    pub channels: usize,
}

impl Plane {
    /// Makes room; what is in it is finite or was put there by an earlier batch of the same grid.
    pub fn fit(&mut self, grid: &Grid, channels: usize) {
        self.channels = channels;
        self.len = grid.lines * channels * grid.stride;
        if self.values.len() < self.len + CACHE_LINE {
            // The old values go first: both at once may be more than the machine has.
            self.values = Vec::new();
            self.values = vec![0.0; self.len + CACHE_LINE];
        }
        let ahead = self.values.as_ptr().align_offset(CACHE_LINE * size_of::<f32>());
        self.start = (ahead % CACHE_LINE + CACHE_LINE - HALO) % CACHE_LINE;
    }

    /// All lines.
    pub fn lines(&self) -> &[f32] {
        &self.values[self.start..self.start + self.len]
    }

    /// Channels from one on.
    pub fn from(&self, first: usize) -> Source<'_> {
        Source { lines: self.lines(), channels: self.channels, first }
    }

    /// Writes each line's rows \[channel\]\[stride\].
    pub fn by_line(&mut self, grid: &Grid, write: impl Fn(usize, &mut [f32]) + Sync) {
        let rows = self.channels * grid.stride;
        let lines = &mut self.values[self.start..self.start + self.len];
        lines.par_chunks_mut(rows).enumerate().for_each(|(line, rows)| write(line, rows));
    }

    /// Writes each line's rows of this plane and of another.
    pub fn by_line_with(
        &mut self,
        other: &mut Self,
        grid: &Grid,
        write: impl Fn(usize, &mut [f32], &mut [f32]) + Sync,
    ) {
        let (rows, rows_of_other) = (self.channels * grid.stride, other.channels * grid.stride);
        let lines = &mut self.values[self.start..self.start + self.len];
        let others = &mut other.values[other.start..other.start + other.len];
        let both = lines.par_chunks_mut(rows).zip(others.par_chunks_mut(rows_of_other));
        both.enumerate().for_each(|(line, (rows, other))| write(line, rows, other));
    }
}

/// Channels of a plane from one on.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    lines: &'a [f32],
    channels: usize,
    first: usize,
}

impl<'a> Source<'a> {
    /// Rows of `count` channels of a line.
    pub fn rows(&self, grid: &Grid, line: usize, count: usize) -> &'a [f32] {
        let start = (line * self.channels + self.first) * grid.stride;
        &self.lines[start..start + count * grid.stride]
    }

    /// Rows of the line `by` below, if there is one.
    pub fn neighbour(&self, grid: &Grid, line: usize, by: isize, count: usize) -> Option<&'a [f32]> {
        grid.neighbour(line, by).map(|line| self.rows(grid, line, count))
    }
}
