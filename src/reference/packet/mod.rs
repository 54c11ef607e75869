//! Many rays on a heightfield at once.

mod ceiling;
mod ray;
#[cfg(test)]
mod tests;
mod walk;

use super::heightfield::Heightfield;
use super::raycast::Hit;
use crate::error::Result;
use crate::kernels::simd::{Isa, Simd, Work, dispatch};
use ceiling::Ceiling;
use ray::{Meetings, Rays};
use walk::{Chunk, GROUP, Steps};

/// A heightfield with what packets of rays need besides.
#[derive(Clone, Debug)]
pub struct Tracer {
    field: Heightfield,
    ceiling: Ceiling,
    isa: Isa,
}

impl Tracer {
    /// Prepares a field.
    pub fn new(field: Heightfield) -> Result<Self> {
        Ok(Self::with_isa(field, Isa::chosen()?))
    }

    /// Prepares a field for an instruction set.
    pub fn with_isa(field: Heightfield, isa: Isa) -> Self {
        Self { ceiling: Ceiling::new(&field), field, isa }
    }

    /// The field.
    pub fn field(&self) -> &Heightfield {
        &self.field
    }

    /// [`Heightfield::intersect`] for many rays of one direction.
    pub fn intersect_packet(&self, origins: &[[f64; 3]], direction: [f64; 3], hits: &mut Vec<Option<Hit>>) {
        hits.clear();
        hits.resize(origins.len(), None);
        let ray = |k: usize| (origins[k], direction);
        let found = |k: usize, meetings: &Meetings, lane: usize| hits[k] = Some(meetings.hit(lane));
        dispatch(self.isa, Trace::<_, _, true> { tracer: self, count: origins.len(), ray, found });
    }

    /// Many rays of their own directions.
    pub fn intersect_many(&self, rays: &[([f64; 3], [f64; 3])], hits: &mut Vec<Option<Hit>>) {
        hits.clear();
        hits.resize(rays.len(), None);
        let ray = |k: usize| rays[k];
        let found = |k: usize, meetings: &Meetings, lane: usize| hits[k] = Some(meetings.hit(lane));
        dispatch(self.isa, Trace::<_, _, true> { tracer: self, count: rays.len(), ray, found });
    }

    /// Many rays of their own directions.
    pub fn occluded_many(&self, rays: &[([f64; 3], [f64; 3])], blocked: &mut Vec<bool>) {
        blocked.clear();
        blocked.resize(rays.len(), false);
        let ray = |k: usize| rays[k];
        let found = |k: usize, _: &Meetings, _: usize| blocked[k] = true;
        dispatch(self.isa, Trace::<_, _, false> { tracer: self, count: rays.len(), ray, found });
    }

    /// [`Heightfield::occluded`] for many rays of one direction.
    pub fn occluded_packet(&self, departures: &[[f64; 3]], direction: [f64; 3], blocked: &mut Vec<bool>) {
        blocked.clear();
        blocked.resize(departures.len(), false);
        let ray = |k: usize| (departures[k], direction);
        let found = |k: usize, _: &Meetings, _: usize| blocked[k] = true;
        dispatch(self.isa, Trace::<_, _, false> { tracer: self, count: departures.len(), ray, found });
    }
}

/// Follows rays and tells which meet the surface.
struct Trace<'a, R, F, const NORMALS: bool> {
    tracer: &'a Tracer,
    count: usize,
    ray: R,
    found: F,
}

const ALL: u32 = ((1_u64 << GROUP) - 1) as u32;

impl<R: Fn(usize) -> ([f64; 3], [f64; 3]), F: FnMut(usize, &Meetings, usize), const NORMALS: bool> Work for Trace<'_, R, F, NORMALS> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) {
        let field = &self.tracer.field;
        let ceiling = &self.tracer.ceiling;
        let mut steps = [Steps::default(); GROUPS];
        let mut rays: [Rays; GROUPS] = Default::default();
        let mut meetings = Meetings::default();
        let largest = (1_u32 << ceiling.top) as f32;
        for first in (0..self.count).step_by(GROUP * GROUPS) {
            let mut live = [0; GROUPS];
            for g in 0..GROUPS {
                let first = first + g * GROUP;
                if first >= self.count {
                    break;
                }
                let n = GROUP.min(self.count - first);
                for k in 0..GROUP {
                    let (origin, direction) = (self.ray)(first + k.min(n - 1));
                    rays[g].set(k, origin, direction);
                }
                live[g] = rays[g].start(field, largest, &mut steps[g]) & (ALL >> (GROUP - n));
            }
            while live != [0; GROUPS] {
                let mut held = [0; GROUPS];
                walk_all(s, ceiling, &mut steps, live, &mut held);
                for g in 0..GROUPS {
                    let held = held[g];
                    for k in 0..GROUP {
                        if (live[g] & !held) >> k & 1 == 1 && !rays[g].next_tile(field, k, &mut steps[g]) {
                            live[g] &= !(1 << k);
                        }
                    }
                    if held == 0 {
                        continue;
                    }
                    rays[g].meet::<NORMALS>(field, &steps[g], held, &mut meetings);
                    for k in 0..GROUP {
                        if held >> k & 1 == 1 {
                            if meetings.met[k] {
                                (self.found)(first + g * GROUP + k, &meetings, k);
                                live[g] &= !(1 << k);
                            } else {
                                steps[g].pass.0[k] = 1.0;
                            }
                        }
                    }
                }
            }
        }
    }
}

const GROUPS: usize = 2;

#[inline(always)]
fn walk_all<S: Simd>(s: S, ceiling: &Ceiling, steps: &mut [Steps; GROUPS], live: [u32; GROUPS], held: &mut [u32; GROUPS]) {
    let mut waiting: Option<Chunk> = None;
    let all = ((1_u64 << S::LANES) - 1) as u32;
    for group in 0..GROUPS {
        for at in (0..GROUP).step_by(S::LANES) {
            let chunk = Chunk { group, at, idle: !live[group] >> at };
            if chunk.idle & all == all {
                continue;
            }
            match waiting.take() {
                None => waiting = Some(chunk),
                Some(other) => {
                    let stopped = walk::walk(s, ceiling, steps, [other, chunk]);
                    held[other.group] |= (stopped[0].held & !other.idle) << other.at;
                    held[group] |= (stopped[1].held & !chunk.idle) << at;
                }
            }
        }
    }
    if let Some(chunk) = waiting {
        let [stopped] = walk::walk(s, ceiling, steps, [chunk]);
        held[chunk.group] |= (stopped.held & !chunk.idle) << chunk.at;
    }
}
