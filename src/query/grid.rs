//! Regular grids in a query buffer, for answerers whose answers depend on the queries around each one.
//!
//! A grid is a rectangle of the buffer under one pair of directions at one whole level, a sample a texel of that level, at
//! the texels' centres. The neighbours of its samples are therefore known also where the buffer ends: an answerer gets
//! periodic images, either a whole tile or a part of one with a margin of the radius, and the margin is cut off its answers.

use super::QueryBuffer;
use crate::error::{Error, Result};

/// Distance from a texel's centre, in samples: an f32 position within a few tiles is off by a tenth of it.
const OFF_CENTRE: f64 = 1.0 / 64.0;
/// Samples along a side of an image: an Inception decoder's activations of that many fit a workstation's memory.
const LARGEST_SIDE: usize = 256;
/// Samples of images that are answered at a time.
const MOST: usize = LARGEST_SIDE * LARGEST_SIDE;

/// Images of one size beside and below each other, whose samples follow each other row by row of the whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mosaic {
    /// Images from top to bottom.
    pub down: usize,
    /// Images from left to right.
    pub across: usize,
    /// Rows of an image.
    pub height: usize,
    /// Columns of an image.
    pub width: usize,
}

impl Mosaic {
    /// Images.
    pub fn images(&self) -> usize {
        self.down * self.across
    }

    /// Samples of all images.
    pub fn samples(&self) -> usize {
        self.images() * self.height * self.width
    }

    /// The place in the whole of the first sample of each row of each image, image by image.
    pub fn rows(&self) -> impl Iterator<Item = usize> {
        let Self { across, height, width, .. } = *self;
        (0..self.images()).flat_map(move |image| {
            let start = image / across * height * across * width + image % across * width;
            (0..height).map(move |row| start + row * across * width)
        })
    }
}

/// A grid: a rectangle of the buffer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// First row in the buffer.
    pub row: usize,
    /// First column in the buffer.
    pub column: usize,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// The level.
    pub level: u32,
    /// Row and column of the first sample's texel on its level.
    pub first: [usize; 2],
    /// Light direction.
    pub wi: [f32; 2],
    /// View direction.
    pub wo: [f32; 2],
}

/// What one sample asks: level, texel, directions.
#[derive(Clone, Copy, PartialEq)]
struct Cell {
    level: u32,
    texel: [usize; 2],
    wi: [f32; 2],
    wo: [f32; 2],
}

/// Rows and columns of a tile at a level.
fn tile(resolution: [usize; 2], level: u32) -> [usize; 2] {
    resolution.map(|side| side >> level)
}

fn cell(queries: &QueryBuffer, k: usize, resolution: [usize; 2]) -> std::result::Result<Cell, String> {
    let level = queries.level[k];
    if !(0.0..32.0).contains(&level) || level.fract() != 0.0 {
        return Err(format!("has level {level}, which is not a whole one"));
    }
    let level = level as u32;
    if resolution.iter().any(|side| side % (1usize << level) != 0) {
        return Err(format!("has level {level}, into whose texels {resolution:?} is not divided"));
    }
    let [height, width] = tile(resolution, level);
    let index = |u: f32, side: usize| -> Option<usize> {
        let x = f64::from(u) * side as f64 - 0.5;
        ((x - x.round()).abs() < OFF_CENTRE).then(|| x.round().rem_euclid(side as f64) as usize % side)
    };
    let [x, y] = queries.u[k];
    let (Some(row), Some(column)) = (index(y, height), index(x, width)) else {
        return Err(format!("lies at [{x}, {y}], which is no texel's centre on level {level}"));
    };
    Ok(Cell { level, texel: [row, column], wi: queries.wi[k], wo: queries.wo[k] })
}

/// The grids of a buffer on a tile of \[height, width\] texels, in the order of their first samples.
///
/// # Errors
/// `Config`, naming the first query that is not on a regular grid.
pub fn parts(queries: &QueryBuffer, radius: usize, resolution: [usize; 2]) -> Result<Vec<Part>> {
    let (height, width) = (queries.height(), queries.width());
    let mut taken = vec![false; queries.len()];
    let mut parts = Vec::new();
    for k in 0..queries.len() {
        if taken[k] {
            continue;
        }
        let first = cell(queries, k, resolution).map_err(|problem| {
            Error::config(
                format!("query[{k}]"),
                format!(
                    "{problem}; this decoder reads all queries within {radius} samples and answers only regular \
                     grids: one pair of directions and one whole level, samples at the texels' centres"
                ),
            )
        })?;
        let [rows, columns] = tile(resolution, first.level);
        let (row, column) = (k / width, k % width);
        let fits = |i: usize, j: usize| {
            let at = (row + i) * width + column + j;
            let texel = [(first.texel[0] + i) % rows, (first.texel[1] + j) % columns];
            !taken[at] && cell(queries, at, resolution).is_ok_and(|c| c == Cell { texel, ..first })
        };
        let across = 1 + (1..width - column).take_while(|j| fits(0, *j)).count();
        let down = 1 + (1..height - row).take_while(|i| (0..across).all(|j| fits(*i, j))).count();
        for i in 0..down {
            let start = (row + i) * width + column;
            taken[start..start + across].fill(true);
        }
        let Cell { level, texel, wi, wo } = first;
        parts.push(Part { row, column, height: down, width: across, level, first: texel, wi, wo });
    }
    Ok(parts)
}

/// The samples of an axis of an image that answers `asked` samples of a tile's `tile`: how many, and how many of them come
/// before the first that is asked.
fn axis(asked: usize, tile: usize, radius: usize) -> (usize, usize) {
    if asked + 2 * radius >= tile { (tile, 0) } else { (asked + 2 * radius, radius) }
}

impl Part {
    /// The image whose answers hold this part's: rows, columns, and those of them before the part.
    fn image(&self, radius: usize, resolution: [usize; 2]) -> [(usize, usize); 2] {
        let [rows, columns] = tile(resolution, self.level);
        [axis(self.height, rows, radius), axis(self.width, columns, radius)]
    }

    /// The part in pieces whose images are small enough.
    fn cut(self, radius: usize, resolution: [usize; 2]) -> Vec<Self> {
        let most = |(samples, _): (usize, usize), asked: usize| match samples > LARGEST_SIDE {
            true => LARGEST_SIDE - 2 * radius.min(LARGEST_SIDE / 4),
            false => asked,
        };
        let [rows, columns] = self.image(radius, resolution);
        let (rows, columns) = (most(rows, self.height), most(columns, self.width));
        let [tile_rows, tile_columns] = tile(resolution, self.level);
        let mut pieces = Vec::new();
        for i in (0..self.height).step_by(rows) {
            for j in (0..self.width).step_by(columns) {
                pieces.push(Self {
                    row: self.row + i,
                    column: self.column + j,
                    height: rows.min(self.height - i),
                    width: columns.min(self.width - j),
                    first: [(self.first[0] + i) % tile_rows, (self.first[1] + j) % tile_columns],
                    ..self
                });
            }
        }
        pieces
    }
}

/// Answers the queries of some images, in their order.
pub type Answer<'a> = dyn Fn(&QueryBuffer, Mosaic) -> Result<Vec<[f32; 3]>> + 'a;

/// Answers the grids of a buffer through periodic images: `answer` gets the queries of some images of one size and gives an
/// answer each.
///
/// # Errors
/// `Config`, naming the first query that is not on a regular grid, or what `answer` reports.
pub fn answer(
    queries: &QueryBuffer,
    radius: usize,
    resolution: [usize; 2],
    answer: &Answer,
) -> Result<Vec<[f32; 3]>> {
    let parts = parts(queries, radius, resolution)?;
    let mut pieces: Vec<Part> = parts.into_iter().flat_map(|p| p.cut(radius, resolution)).collect();
    let size = |part: &Part| part.image(radius, resolution).map(|(samples, _)| samples);
    // Images of one size are answered together.
    pieces.sort_by_key(size);
    let mut pixels = vec![[0.0f32; 3]; queries.len()];
    for of_size in pieces.chunk_by(|a, b| size(a) == size(b)) {
        let [height, width] = size(&of_size[0]);
        for group in of_size.chunks((MOST / (height * width)).max(1)) {
            let mosaic = Mosaic { down: group.len(), across: 1, height, width };
            let answers = answer(&images(group, radius, resolution, mosaic), mosaic)?;
            for (part, answers) in group.iter().zip(answers.chunks(height * width)) {
                let [(_, above), (_, left)] = part.image(radius, resolution);
                for i in 0..part.height {
                    let from = &answers[(i + above) % height * width..][..width];
                    let to = &mut pixels[(part.row + i) * queries.width() + part.column..][..part.width];
                    for (j, pixel) in to.iter_mut().enumerate() {
                        *pixel = from[(j + left) % width];
                    }
                }
            }
        }
    }
    Ok(pixels)
}

/// The queries of the images of some parts, one below the other.
fn images(parts: &[Part], radius: usize, resolution: [usize; 2], mosaic: Mosaic) -> QueryBuffer {
    let Mosaic { height, width, .. } = mosaic;
    let mut queries = QueryBuffer::slice(mosaic.down * height, width, [0.0; 2], [0.0; 2], 0.0);
    for (k, part) in parts.iter().enumerate() {
        let [rows, columns] = tile(resolution, part.level);
        let [(_, above), (_, left)] = part.image(radius, resolution);
        let centre = |first: usize, before: usize, index: usize, tile: usize| {
            let texel = (first + tile * (1 + before / tile) - before + index) % tile;
            ((texel as f64 + 0.5) / tile as f64) as f32
        };
        let all = k * height * width..(k + 1) * height * width;
        queries.wi[all.clone()].fill(part.wi);
        queries.wo[all.clone()].fill(part.wo);
        queries.level[all.clone()].fill(part.level as f32);
        for (at, u) in queries.u[all].iter_mut().enumerate() {
            let (i, j) = (at / width, at % width);
            *u = [centre(part.first[1], left, j, columns), centre(part.first[0], above, i, rows)];
        }
    }
    queries
}

#[cfg(test)]
mod tests {
    use super::*;

    const RESOLUTION: [usize; 2] = [16, 32];

    /// An answerer of the given radius: the mean over a window of what names each sample.
    fn blur(queries: &QueryBuffer, mosaic: Mosaic, radius: usize) -> Vec<[f32; 3]> {
        let Mosaic { height, width, .. } = mosaic;
        let name = |k: usize| {
            let [x, y] = queries.u[k];
            [x * x + queries.wi[k][0], (9.0 * y).sin(), queries.level[k] * x]
        };
        let mut out = Vec::new();
        for image in 0..mosaic.images() {
            for (i, j) in (0..height * width).map(|k| (k / width, k % width)) {
                let mut sum = [0.0; 3];
                for (di, dj) in (0..=2 * radius).flat_map(|di| (0..=2 * radius).map(move |dj| (di, dj))) {
                    let row = (i + di + radius * height - radius) % height;
                    let column = (j + dj + radius * width - radius) % width;
                    let value = name((image * height + row) * width + column);
                    (0..3).for_each(|c| sum[c] += value[c]);
                }
                out.push(sum);
            }
        }
        out
    }

    fn ask(queries: &QueryBuffer, radius: usize, claimed: usize) -> Result<Vec<[f32; 3]>> {
        answer(queries, claimed, RESOLUTION, &|q, mosaic| Ok(blur(q, mosaic, radius)))
    }

    fn window(whole: &QueryBuffer, rows: [usize; 2], columns: [usize; 2]) -> (QueryBuffer, Vec<usize>) {
        let at: Vec<usize> = (rows[0]..rows[1])
            .flat_map(|i| (columns[0]..columns[1]).map(move |j| i * whole.width() + j))
            .collect();
        let pick = |v: &[[f32; 2]]| at.iter().map(|k| v[*k]).collect();
        let level = at.iter().map(|k| whole.level[*k]).collect();
        let (height, width) = (rows[1] - rows[0], columns[1] - columns[0]);
        let part =
            QueryBuffer::new(height, width, pick(&whole.u), pick(&whole.wi), pick(&whole.wo), level).unwrap();
        (part, at)
    }

    #[test]
    fn a_part_is_answered_as_in_the_whole_and_not_with_a_smaller_margin() {
        const RADIUS: usize = 3;
        // Sums of at most 49 values below 3 in another order.
        const ROUNDING: f32 = 1e-4;
        let whole = QueryBuffer::slice(16, 32, [0.3, 0.1], [0.0, 0.2], 0.0);
        let expected = ask(&whole, RADIUS, RADIUS).unwrap();
        let difference = |a: &[f32; 3], b: &[f32; 3]| (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f32::max);
        for (rows, columns) in [([5, 7], [9, 20]), ([0, 16], [0, 3]), ([15, 16], [31, 32]), ([0, 2], [0, 32])]
        {
            let (part, at) = window(&whole, rows, columns);
            for (claimed, right) in [(RADIUS, true), (RADIUS - 1, false)] {
                let answers = ask(&part, RADIUS, claimed).unwrap();
                let worst = answers.iter().zip(&at).map(|(a, k)| difference(a, &expected[*k]));
                let worst = worst.fold(0.0, f32::max);
                assert_eq!(worst < ROUNDING, right, "{rows:?} {columns:?} with {claimed}: {worst}");
            }
        }
    }

    #[test]
    fn images_side_by_side_are_told_apart() {
        // Four tiles of level 1 in a block, two of them alike, and a tile of level 0 that begins elsewhere.
        let mut all = QueryBuffer::slice(16, 32, [0.0; 2], [0.0; 2], 1.0);
        for (k, at) in (0..16 * 32).map(|k| (k, (k / 32 % 8, k % 32 % 16))) {
            all.u[k] = [(at.1 as f32 + 0.5) / 16.0, (at.0 as f32 + 0.5) / 8.0];
            all.wi[k] = [if k / 32 < 8 && k % 32 >= 16 { 0.5 } else { 0.25 }, 0.0];
        }
        let found = parts(&all, 2, RESOLUTION).unwrap();
        let sizes: Vec<_> = found.iter().map(|p| [p.row, p.column, p.height, p.width]).collect();
        assert_eq!(sizes, [[0, 0, 16, 16], [0, 16, 8, 16], [8, 16, 8, 16]]);
        let answers = ask(&all, 2, 2).unwrap();
        assert_eq!(answers[0], answers[8 * 32]);
        assert_ne!(answers[0], answers[16]);
        assert_eq!(answers[0], answers[8 * 32 + 16]);

        let mut moved = QueryBuffer::slice(16, 32, [0.0; 2], [0.0; 2], 0.0);
        let whole = ask(&moved, 2, 2).unwrap();
        moved.u.rotate_left(32 * 5 + 7);
        moved.u.iter_mut().for_each(|u| *u = [u[0] - 1.0, u[1] + 2.0]);
        // Rotation by columns breaks the rows that wrap: those are parts of their own.
        assert!(parts(&moved, 2, RESOLUTION).unwrap().len() > 1);
        let answers = ask(&moved, 2, 2).unwrap();
        let worst = (0..16 * 32 - 167).map(|k| (answers[k][1] - whole[k + 167][1]).abs()).fold(0.0, f32::max);
        assert!(worst < 1e-4, "{worst}");
    }

    #[test]
    fn large_grids_are_cut() {
        let whole = QueryBuffer::slice(512, 1024, [0.1; 2], [0.2; 2], 0.0);
        let count = std::sync::atomic::AtomicUsize::new(0);
        let centre = |q: &QueryBuffer, mosaic: Mosaic| {
            assert!(mosaic.samples() <= MOST && mosaic.height <= LARGEST_SIDE);
            count.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            Ok(q.u.iter().map(|u| [u[0], u[1], 0.0]).collect())
        };
        let answers = answer(&whole, 12, [512, 1024], &centre).unwrap();
        assert!(count.into_inner() > 8);
        assert!(answers.iter().zip(&whole.u).all(|(a, u)| a[..2] == *u));
    }

    #[test]
    fn what_is_no_regular_grid_is_refused_in_a_line_that_says_what_is_needed() {
        let whole = QueryBuffer::slice(16, 32, [0.1; 2], [0.2; 2], 0.0);
        let refused = |change: &dyn Fn(&mut QueryBuffer), cause: &str| {
            let mut queries = whole.clone();
            change(&mut queries);
            let problem = ask(&queries, 3, 3).unwrap_err().to_string();
            assert!(problem.contains(cause) && problem.contains("within 3 samples"), "{problem}");
            assert!(!problem.contains('\n'));
        };
        refused(&|q| q.level.fill(0.5), "level 0.5");
        refused(&|q| q.level.fill(5.0), "level 5");
        refused(&|q| q.level.fill(f32::MAX), "which is not a whole one");
        refused(&|q| q.u.iter_mut().for_each(|u| u[0] += 0.01), "no texel's centre");
        refused(&|q| q.u[77][1] = 0.3, "query[77]");
        assert!(ask(&QueryBuffer::default(), 3, 3).unwrap().is_empty());
        assert!(ask(&whole, 3, 3).is_ok());
    }
}
