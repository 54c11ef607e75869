//! What a kind of primitive must tell so that its copies can be found by rays.

/// Primitives side by side: the lanes of a vector.
pub(super) const LANES: usize = 4;

/// A primitive, moved by whole tiles so that it touches the unit cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Placed {
    pub(super) index: u32,
    /// Tiles in x and y that are subtracted from the primitive's own position.
    pub(super) shift: [i8; 2],
}

impl Placed {
    /// A point of the primitive, in the unit cell's frame.
    pub(super) fn place(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        [x - f64::from(self.shift[0]), y - f64::from(self.shift[1]), z]
    }
}

/// A ray inside one cell: its origin is where it enters, its direction has unit length.
#[derive(Clone, Copy, Debug)]
pub(super) struct CellRay {
    pub(super) origin: [f64; 3],
    pub(super) direction: [f64; 3],
    /// t of the whole ray's origin, at most 0.
    pub(super) start: f64,
    /// Hits count from this t,
    pub(super) near: f64,
    /// to this one.
    pub(super) far: f64,
}

/// Primitives of one kind.
pub(super) trait Shapes {
    /// Up to [`LANES`] primitives, placed, side by side. Their coordinates are exact: see [`Grid`].
    type Packet: Send;
    /// What is worked out once a ray.
    type Aim: Copy;
    /// What is worked out once a cell.
    type Local: Copy;
    /// What a hit is described from.
    type Hit: Copy;

    /// Indices are below this.
    fn len(&self) -> usize;
    /// Least and greatest x and y of a primitive where it lies: \[\[x, x\], \[y, y\]\]; None if none has the index.
    fn extent(&self, index: u32) -> Option<[[f64; 2]; 2]>;
    /// Least and greatest z of the part of a primitive over a rectangle; None if nothing is there.
    fn heights_over(&self, placed: Placed, low: [f64; 2], high: [f64; 2]) -> Option<[f64; 2]>;
    fn packet(&self, members: [Option<Placed>; LANES]) -> Self::Packet;
    fn aim(&self, direction: [f64; 3]) -> Self::Aim;
    fn local(&self, aim: &Self::Aim, ray: &CellRay) -> Self::Local;
    /// A bit for each primitive that the ray may hit at t <= far; misses no hit.
    fn candidates(&self, packet: &Self::Packet, local: &Self::Local, far: f64) -> u32;
    /// The exact answer for one of them: where in \[near, far\] the ray hits.
    fn intersect(
        &self,
        packet: &Self::Packet,
        lane: usize,
        aim: &Self::Aim,
        ray: &CellRay,
    ) -> Option<(f64, Self::Hit)>;
    /// True unless there is no surface at a hit after all: asked of the nearest only.
    fn stands(&self, _placed: Placed, _t: f64, _ray: &CellRay) -> bool {
        true
    }
}

/// Grid of coordinates, such that f32 holds them exactly wherever copies of primitives lie: every copy has the same
/// shape to the last bit, and packets need no other numbers than their own.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    step: f64,
}

impl Grid {
    /// The grid for primitives that are at most `extent` wide. Below 1 tile it rounds by 6e-8 tile widths.
    pub(super) fn new(extent: f64) -> Self {
        let mut step = 1.0 / f64::from(1 << 23);
        let mut reach = 2.0;
        while reach < 1.0 + extent {
            (step, reach) = (2.0 * step, 2.0 * reach);
        }
        Self { step }
    }

    pub(super) fn snap(self, point: [f64; 3]) -> [f64; 3] {
        point.map(|x| (x / self.step).round() * self.step)
    }
}
