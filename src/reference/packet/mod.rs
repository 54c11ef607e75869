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
use walk::{GROUP, Steps};

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
        let mut steps = Steps::default();
        let mut rays = Rays::default();
        let mut meetings = Meetings::default();
        let largest = ceiling.largest as f32;
        for first in (0..self.count).step_by(GROUP) {
            let n = GROUP.min(self.count - first);
            for k in 0..GROUP {
                let (origin, direction) = (self.ray)(first + k.min(n - 1));
                rays.set(k, origin, direction);
            }
            let (near, inside) = rays.start(field, largest, &mut steps);
            let mut live = near & (ALL >> (GROUP - n));
            let mut held = inside & live;
            loop {
                if held != 0 {
                    rays.meet::<NORMALS>(field, ceiling, &steps, held, &mut meetings);
                    for k in 0..GROUP {
                        if held >> k & 1 == 1 {
                            if meetings.met[k] {
                                (self.found)(first + k, &meetings, k);
                                live &= !(1 << k);
                            } else {
                                steps.pass.0[k] = 1.0;
                            }
                        }
                    }
                }
                if live == 0 {
                    break;
                }
                held = 0;
                let mut struck = 0;
                for at in (0..GROUP).step_by(S::LANES) {
                    let idle = !live >> at;
                    let all = ((1_u64 << S::LANES) - 1) as u32;
                    if idle & all == all {
                        continue;
                    }
                    let stopped = if NORMALS {
                        walk::walk::<S, false>(s, ceiling, &mut steps, at, idle)
                    } else {
                        walk::walk::<S, true>(s, ceiling, &mut steps, at, idle)
                    };
                    held |= (stopped.held & !idle) << at;
                    struck |= (stopped.struck & !idle) << at;
                }
                for k in 0..GROUP {
                    if (live & !held) >> k & 1 == 1 {
                        if struck >> k & 1 == 1 {
                            (self.found)(first + k, &meetings, k);
                            live &= !(1 << k);
                        } else if !rays.next_tile(field, k, &mut steps) {
                            live &= !(1 << k);
                        }
                    }
                }
            }
        }
    }
}
