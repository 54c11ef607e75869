//! Many rays on a heightfield at once.
//!
//! Rays walk over the pyramid of maxima in single precision, a ray a lane (`walk`), on heights that leave room for its
//! rounding (`heights`). Where a ray may meet a patch, double precision decides (`exact`), as it does for the patch
//! over which a ray starts: no ray meets the surface that it has just left.
//!
//! A lane knows nothing of its neighbours, and no instruction set rounds otherwise than another, so answers depend on
//! neither. They are those of [`Heightfield::intersect`] but for what a ray touches at a corner of a patch, which it
//! crosses within the rounding of single precision.
//!
//! Lanes are indexed by number on purpose: the compiler makes vectors of such loops.
#![allow(clippy::needless_range_loop)]

mod exact;
mod heights;
#[cfg(test)]
mod tests;
mod walk;

use super::heightfield::Heightfield;
use super::raycast::Hit;
use crate::error::Result;
use crate::kernels::simd::{Isa, Simd, Work, dispatch};
use exact::{Meetings, Rays};
use heights::Heights;
use walk::{ALL, GROUP, Steps};

/// A heightfield that answers many rays at once. It keeps a second copy of the heights and their maxima, 7/3 of the
/// samples for sides that are powers of two.
#[derive(Clone, Debug)]
pub struct Tracer {
    field: Heightfield,
    heights: Heights,
    isa: Isa,
}

/// A ray: its origin and its direction in tile widths. Those of more than 1e9, and of what is no number, meet nothing.
pub type Ray = ([f64; 3], [f64; 3]);

impl Tracer {
    /// Prepares a field.
    ///
    /// # Errors
    /// `Usage` if the environment names an instruction set that this machine has not.
    pub fn new(field: Heightfield) -> Result<Self> {
        Ok(Self::with_isa(field, Isa::chosen()?))
    }

    /// Prepares a field for an instruction set; answers are the same for each.
    pub fn with_isa(field: Heightfield, isa: Isa) -> Self {
        Self { heights: Heights::new(&field), field, isa }
    }

    /// The field.
    pub fn field(&self) -> &Heightfield {
        &self.field
    }

    /// [`Heightfield::intersect`] for many rays of one direction. Rays near each other should follow each other.
    pub fn intersect_packet(&self, origins: &[[f64; 3]], direction: [f64; 3], hits: &mut Vec<Option<Hit>>) {
        self.intersect_all(origins.len(), |k| (origins[k], direction), hits);
    }

    /// [`Heightfield::occluded`] for many rays of one direction.
    pub fn occluded_packet(&self, departures: &[[f64; 3]], direction: [f64; 3], blocked: &mut Vec<bool>) {
        self.occluded_all(departures.len(), |k| (departures[k], direction), blocked);
    }

    /// [`Heightfield::intersect`] for many rays.
    pub fn intersect_many(&self, rays: &[Ray], hits: &mut Vec<Option<Hit>>) {
        self.intersect_all(rays.len(), |k| rays[k], hits);
    }

    /// [`Heightfield::occluded`] for many rays.
    pub fn occluded_many(&self, rays: &[Ray], blocked: &mut Vec<bool>) {
        self.occluded_all(rays.len(), |k| rays[k], blocked);
    }

    fn intersect_all(&self, count: usize, ray: impl Fn(usize) -> Ray, hits: &mut Vec<Option<Hit>>) {
        hits.clear();
        hits.resize(count, None);
        let answer = |k: usize, found: Found<'_>| {
            let (origin, direction) = ray(k);
            hits[k] = match found {
                Found::Lane(meetings, lane) => Some(meetings.hit(lane)),
                _ => self.field.intersect(origin, direction, f64::INFINITY),
            };
        };
        dispatch(self.isa, Trace::<_, _, true> { tracer: self, count, ray: &ray, answer });
    }

    fn occluded_all(&self, count: usize, ray: impl Fn(usize) -> Ray, blocked: &mut Vec<bool>) {
        blocked.clear();
        blocked.resize(count, false);
        let answer = |k: usize, found: Found<'_>| {
            let (origin, direction) = ray(k);
            blocked[k] = !matches!(found, Found::Doubt) || self.field.occluded(origin, direction);
        };
        dispatch(self.isa, Trace::<_, _, false> { tracer: self, count, ray: &ray, answer });
    }
}

/// What became of a ray that does not miss.
enum Found<'a> {
    /// It has met a patch: this lane of these.
    Lane(&'a Meetings, usize),
    /// It is below the surface somewhere.
    Struck,
    /// Single precision has lost it: within its rounding of a border of patches, about one ray in 1e5.
    Doubt,
}

/// Follows rays, and tells what becomes of those that do not miss: hits with `HITS`, else only whether there are any.
struct Trace<'a, R, A, const HITS: bool> {
    tracer: &'a Tracer,
    count: usize,
    ray: R,
    answer: A,
}

impl<R: Fn(usize) -> Ray, A: FnMut(usize, Found<'_>), const HITS: bool> Work for Trace<'_, R, A, HITS> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) {
        let Tracer { field, heights, .. } = self.tracer;
        let (mut rays, mut steps, mut meetings) = (Rays::default(), Steps::default(), Meetings::default());
        for first in (0..self.count).step_by(GROUP) {
            let n = GROUP.min(self.count - first);
            for k in 0..GROUP {
                let (origin, direction) = (self.ray)(first + k.min(n - 1));
                rays.set(k, origin, direction);
            }
            let started = rays.start(field, heights.largest, &mut steps);
            let mut live = started.live & ALL >> (GROUP - n);
            let mut held = started.inside & live;
            while live != 0 {
                if held != 0 {
                    rays.meet::<HITS>(field, heights, &steps, held, &mut meetings);
                }
                for k in 0..n {
                    if held >> k & 1 == 0 {
                        continue;
                    }
                    if meetings.met[k] {
                        let late = HITS && meetings.late[k];
                        (self.answer)(first + k, if late { Found::Doubt } else { Found::Lane(&meetings, k) });
                        live &= !(1 << k);
                    } else {
                        steps.pass.0[k] = 1.0;
                    }
                }
                held = 0;
                let mut struck = 0;
                for at in (0..GROUP).step_by(S::LANES) {
                    let stopped = if HITS {
                        walk::walk::<S, false>(s, heights, &mut steps, at, live)
                    } else {
                        walk::walk::<S, true>(s, heights, &mut steps, at, live)
                    };
                    held |= stopped.held;
                    struck |= stopped.struck;
                }
                let resting = live & !held;
                for k in 0..n {
                    if resting >> k & 1 == 0 {
                        continue;
                    }
                    let found = if struck >> k & 1 == 1 {
                        Found::Struck
                    } else if rays.next_tile(field, k, &mut steps) {
                        continue;
                    } else if rays.lands(k) {
                        Found::Doubt
                    } else {
                        live &= !(1 << k);
                        continue;
                    };
                    (self.answer)(first + k, found);
                    live &= !(1 << k);
                }
            }
        }
    }
}
