//! What stands over the unit cell, in columns.
//!
//! A material is a thin slab: over a small square of the plane only few primitives lie, and a ray crosses few such
//! squares. Each column lists its primitives from the top down, four side by side in the lanes of a vector; a pyramid
//! of least and greatest heights skips columns that the ray passes above or below (the maximum-mipmap walk of Tevs et
//! al. 2008, as in [`crate::reference::raycast`]).

use super::shapes::{CellRay, LANES, Placed, Shapes};
use crate::error::{Error, Result};
use rayon::prelude::*;
use std::cmp::Ordering;

/// How far the content of a column exceeds it on all sides, in tile widths: far above the rounding of a walk (1e-15),
/// and what heights lose in f32.
pub(super) const MARGIN: f64 = 1e-6;

/// Most columns along a side: finer ones than 5e-4 tile widths no longer pay, and the lists of 4 M primitives fit.
const MAX_SIDE: usize = 2048;

/// Entries of all columns' lists per primitive that the side is chosen by: fewer, larger columns test more in vain,
/// more, smaller ones cost more steps and memory. The best of 4, 8, 16 and 32 for fibres and meshes together.
const ENTRIES_PER_PRIMITIVE: usize = 8;

/// Most entries of all lists: 3 GiB.
const MAX_ENTRIES: usize = 1 << 26;

/// Least and greatest height.
type Heights = [f32; 2];

/// Nothing stands here.
const EMPTY: Heights = [f32::INFINITY, f32::NEG_INFINITY];

/// A primitive in a column.
#[derive(Clone, Copy)]
struct Entry {
    column: u32,
    placed: Placed,
    heights: Heights,
}

impl Entry {
    /// By column, from the top down; the rest makes the order total.
    fn order(&self, other: &Self) -> Ordering {
        let by_height = || other.heights[1].total_cmp(&self.heights[1]);
        self.column.cmp(&other.column).then_with(by_height).then_with(|| self.placed.cmp(&other.placed))
    }
}

/// Up to four primitives.
#[derive(Debug)]
pub(super) struct Group<P> {
    pub(super) packet: P,
    pub(super) members: [Placed; LANES],
}

/// Primitives by column.
#[derive(Debug)]
pub(super) struct Columns<P> {
    /// Columns along a side: a power of two.
    side: usize,
    /// Heights of blocks of 2^level x 2^level columns, the single columns first.
    levels: Vec<Vec<Heights>>,
    /// Where the groups of each column start; one more for the end.
    starts: Vec<u32>,
    /// Heights of the groups, apart from them: most groups are passed over.
    heights: Vec<Heights>,
    groups: Vec<Group<P>>,
}

impl<P: Send> Columns<P> {
    /// # Errors
    /// `Config` on `field` if no primitive touches the cell, or their copies are too many.
    pub(super) fn new<S: Shapes<Packet = P> + Sync>(shapes: &S, field: &str) -> Result<Self> {
        let side = choose_side(shapes, field)?;
        let mut entries: Vec<Entry> = (0..shapes.len() as u32)
            .into_par_iter()
            .fold(Vec::new, |mut entries, index| {
                rasterise(shapes, index, side, &mut entries);
                entries
            })
            .reduce(Vec::new, |mut all, part| {
                all.extend(part);
                all
            });
        if entries.is_empty() {
            return Err(Error::config(field, "nothing is left of positive size; give at least one piece"));
        }
        entries.par_sort_unstable_by(Entry::order);

        let (mut starts, mut single) = (vec![0], vec![EMPTY; side * side]);
        let mut chunks = Vec::with_capacity(entries.len() / 2);
        let mut at = 0;
        for (column, span) in single.iter_mut().enumerate() {
            let count = entries[at..].iter().take_while(|entry| entry.column as usize == column).count();
            let list = &entries[at..at + count];
            *span = list.iter().fold(EMPTY, |all, entry| joined(all, entry.heights));
            chunks.extend(list.chunks(LANES));
            starts.push(chunks.len() as u32);
            at += count;
        }
        let (heights, groups) = chunks
            .into_par_iter()
            .map(|chunk| {
                let copies = std::array::from_fn(|lane| chunk.get(lane).map(|entry| entry.placed));
                let members = copies.map(|copy| copy.unwrap_or(chunk[0].placed));
                let heights = chunk.iter().fold(EMPTY, |all, entry| joined(all, entry.heights));
                (heights, Group { packet: shapes.packet(copies), members })
            })
            .unzip();
        Ok(Self { side, levels: pyramid(side, single), starts, heights, groups })
    }

    /// Calls `visit` for the groups that the ray may meet at 0 <= t <= `far`, column by column. `visit` answers with
    /// the new `far`: the nearest hit so far, or a negative number to end the walk.
    #[inline]
    pub(super) fn walk(&self, ray: &CellRay, mut far: f64, mut visit: impl FnMut(&Group<P>, f64) -> f64) {
        let side = self.side as i64;
        let scale = self.side as f64;
        let [ox, oy, oz] = [ray.origin[0] * scale, ray.origin[1] * scale, ray.origin[2]];
        let [dx, dy, dz] = [ray.direction[0] * scale, ray.direction[1] * scale, ray.direction[2]];
        let inverse = |d: f64| 1.0 / if d.abs() < TINY { TINY.copysign(d) } else { d };
        let (inv_x, inv_y, inv_z) = (inverse(dx), inverse(dy), inverse(dz));
        let (right, up) = (inv_x > 0.0, inv_y > 0.0);
        let falling = dz < 0.0;

        let (mut column, mut row) = ((ox as i64).clamp(0, side - 1), (oy as i64).clamp(0, side - 1));
        let top = self.levels.len() - 1;
        let mut level = if falling { START_DOWNWARDS } else { START_UPWARDS }.min(top);
        let mut t = 0.0;
        loop {
            // Where does the ray leave the block that holds the current column?
            let (left, bottom) = ((column >> level) << level, (row >> level) << level);
            let (end_x, end_y) = (left + (1 << level), bottom + (1 << level));
            let tx = (if right { end_x } else { left } as f64 - ox) * inv_x;
            let ty = (if up { end_y } else { bottom } as f64 - oy) * inv_y;
            let exit = tx.min(ty).min(far).max(t);

            // Skip the block if the ray stays above or below all of it; otherwise look closer.
            let (enters, leaves) = (oz + dz * t, oz + dz * exit);
            let (lowest, highest) = if falling { (leaves, enters) } else { (enters, leaves) };
            let index = (row as usize >> level) * (self.side >> level) + (column as usize >> level);
            let [least, most] = self.levels[level][index].map(f64::from);
            if lowest <= most && highest >= least {
                if level > 0 {
                    // The closer look starts where the ray gets as low as the block's top, or as high as its bottom.
                    let reach = (if falling { most } else { least } - oz) * inv_z;
                    if reach > t {
                        t = reach.min(exit);
                        let (x, y) = ((ox + dx * t) as i64, (oy + dy * t) as i64);
                        column = if right { x.clamp(column, end_x - 1) } else { x.clamp(left, column) };
                        row = if up { y.clamp(row, end_y - 1) } else { y.clamp(bottom, row) };
                    }
                    level -= 1;
                    continue;
                }
                far = self.visit_column(index, [lowest, highest], [oz, dz], far, &mut visit);
            }
            if exit >= far {
                return;
            }

            // Move on to the column behind the block's border, and look at larger blocks once a larger one ends.
            t = exit;
            let parent = level + 1;
            let rises;
            if tx <= ty {
                column = if right { end_x } else { left - 1 };
                if column < 0 || column == side {
                    return;
                }
                rises = column >> parent != left >> parent;
                let y = (oy + dy * t) as i64;
                row = if up { y.clamp(row, end_y - 1) } else { y.clamp(bottom, row) };
            } else {
                row = if up { end_y } else { bottom - 1 };
                if row < 0 || row == side {
                    return;
                }
                rises = row >> parent != bottom >> parent;
                let x = (ox + dx * t) as i64;
                column = if right { x.clamp(column, end_x - 1) } else { x.clamp(left, column) };
            }
            if rises && level < top {
                level += 1;
            }
        }
    }

    /// Visits the groups of a column that overlap the heights of the ray there, those first that it meets first.
    #[inline]
    fn visit_column(
        &self,
        index: usize,
        [lowest, highest]: [f64; 2],
        [oz, dz]: [f64; 2],
        mut far: f64,
        visit: &mut impl FnMut(&Group<P>, f64) -> f64,
    ) -> f64 {
        let (first, end) = (self.starts[index] as usize, self.starts[index + 1] as usize);
        let (mut lowest, mut highest) = (lowest as f32, highest as f32);
        if dz < 0.0 {
            for k in first..end {
                let [least, most] = self.heights[k];
                if most < lowest {
                    break;
                }
                if least > highest {
                    continue;
                }
                let before = far;
                far = visit(&self.groups[k], far);
                if far < before {
                    lowest = lowest.max((oz + dz * far) as f32);
                }
                if far < 0.0 {
                    return far;
                }
            }
        } else {
            for k in (first..end).rev() {
                let [least, most] = self.heights[k];
                if most < lowest || least > highest {
                    continue;
                }
                let before = far;
                far = visit(&self.groups[k], far);
                if far < before {
                    highest = highest.min((oz + dz * far) as f32);
                }
                if far < 0.0 {
                    return far;
                }
            }
        }
        far
    }
}

/// Direction components below this count as 0.
const TINY: f64 = 1e-30;

/// Block size, as a level, with which a walk starts: from above it first sinks through empty space; from the surface
/// what is nearest decides.
const START_DOWNWARDS: usize = 2;
const START_UPWARDS: usize = 0;

/// The columns that a primitive's box covers in a plane of `side` columns a tile: \[\[first, last\]; 2\].
fn covered(extent: [[f64; 2]; 2], side: usize) -> [[i64; 2]; 2] {
    let at = |x: f64| (x * side as f64).floor() as i64;
    extent.map(|[low, high]| [at(low - MARGIN), at(high + MARGIN)])
}

/// The largest power of two at which the lists stay short; see [`ENTRIES_PER_PRIMITIVE`].
fn choose_side(shapes: &impl Shapes, field: &str) -> Result<usize> {
    let entries_at = |side: usize| -> usize {
        let one = |index| {
            let extent = shapes.extent(index)?;
            Some(covered(extent, side).iter().map(|[a, b]| (b - a + 1) as usize).product::<usize>())
        };
        (0..shapes.len() as u32).filter_map(one).fold(0, usize::saturating_add)
    };
    let budget = (ENTRIES_PER_PRIMITIVE * shapes.len()).min(MAX_ENTRIES);
    let mut side = 1;
    while side < MAX_SIDE && side * side < budget && entries_at(2 * side) <= budget {
        side *= 2;
    }
    if side == 1 && entries_at(1) > MAX_ENTRIES {
        return Err(Error::config(
            field,
            format!(
                "more than {MAX_ENTRIES} pieces overlap in one tile; make them fewer or smaller than a tile"
            ),
        ));
    }
    Ok(side)
}

/// Adds the primitive to all columns that it touches.
fn rasterise(shapes: &impl Shapes, index: u32, side: usize, entries: &mut Vec<Entry>) {
    let Some(extent) = shapes.extent(index) else { return };
    let [columns, rows] = covered(extent, side);
    let across = side as i64;
    for (row, column) in (rows[0]..=rows[1]).flat_map(|y| (columns[0]..=columns[1]).map(move |x| (y, x))) {
        let tile = [column.div_euclid(across), row.div_euclid(across)];
        let placed = Placed { index, shift: tile.map(|shift| shift as i8) };
        let inside = [column.rem_euclid(across), row.rem_euclid(across)];
        let low = inside.map(|k| k as f64 / across as f64 - MARGIN);
        let high = inside.map(|k| (k + 1) as f64 / across as f64 + MARGIN);
        let Some([least, most]) = shapes.heights_over(placed, low, high) else { continue };
        let heights = [(least - MARGIN) as f32, (most + MARGIN) as f32];
        entries.push(Entry { column: (inside[1] * across + inside[0]) as u32, placed, heights });
    }
}

fn joined([a, b]: Heights, [c, d]: Heights) -> Heights {
    [a.min(c), b.max(d)]
}

fn pyramid(side: usize, single: Vec<Heights>) -> Vec<Vec<Heights>> {
    let mut levels = vec![single];
    let mut side = side;
    while side > 1 {
        let below = &levels[levels.len() - 1];
        let half = side / 2;
        let block = |k: usize| {
            let at = 2 * (k / half) * side + 2 * (k % half);
            joined(joined(below[at], below[at + 1]), joined(below[at + side], below[at + side + 1]))
        };
        let level = (0..half * half).map(block).collect();
        levels.push(level);
        side = half;
    }
    levels
}
