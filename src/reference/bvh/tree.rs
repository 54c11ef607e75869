//! A bounding-volume hierarchy with four children a node and four primitives a leaf.
//!
//! The binary tree comes from `obvhs` (PLOC with reinsertion; Benthin et al. 2022, Meister and Bittner 2018). Its
//! nodes are merged into wide ones (Wald et al. 2008), so that one step tests four boxes, and one leaf four primitives,
//! in the lanes of a [`Vec4`].

use glam::{Vec3A, Vec4};
use obvhs::aabb::Aabb;
use obvhs::bvh2::{Bvh2, reinsertion::ReinsertionOptimizer};
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

/// Primitives a leaf, boxes a node: the lanes of the vectors.
pub(super) const LANES: usize = 4;

/// Share of the binary tree's nodes that are moved to better places: more gains under 3 % of speed and costs more
/// building than all the rest.
const REINSERTED: f32 = 0.02;

/// Marks a child that is a leaf.
const LEAF: u32 = 1 << 31;

/// Entries of the walk's stack that need no allocation: the deepest measured tree (4 M segments) needs half of it.
const STACK: usize = 64;

/// Direction components below this count as this: the inverse then times any coordinate stays finite.
const TINY: f32 = 1e-20;

/// Four boxes.
#[derive(Clone, Debug)]
struct Node {
    /// Per axis the lower and upper sides.
    sides: [[Vec4; 2]; 3],
    /// Index of a node, or [`LEAF`] and the index of a leaf. A lane without child has a box that nothing hits.
    children: [u32; LANES],
}

/// Boxes over leaves of type `L`.
#[derive(Clone, Debug)]
pub(super) struct Tree<L> {
    nodes: Vec<Node>,
    leaves: Vec<L>,
}

/// What the walk needs of a ray, four times each.
#[derive(Clone, Copy, Debug)]
pub(super) struct BoxRay {
    origin: [Vec4; 3],
    inverse: [Vec4; 3],
    /// 1 where the ray comes from the upper side.
    from_above: [usize; 3],
}

impl BoxRay {
    pub(super) fn new(origin: [f64; 3], direction: [f64; 3]) -> Self {
        let direction = direction.map(|d| {
            let d = d as f32;
            if d.abs() < TINY { TINY.copysign(d) } else { d }
        });
        Self {
            origin: origin.map(|o| Vec4::splat(o as f32)),
            inverse: direction.map(|d| Vec4::splat(1.0 / d)),
            from_above: direction.map(|d| usize::from(d < 0.0)),
        }
    }

    /// The ray from another origin.
    pub(super) fn with_origin(self, origin: [f64; 3]) -> Self {
        Self { origin: origin.map(|o| Vec4::splat(o as f32)), ..self }
    }
}

/// Pending children with the distance at which the ray enters them.
pub(super) struct Stack {
    near: [(f32, u32); STACK],
    len: usize,
    spill: Vec<(f32, u32)>,
}

impl Stack {
    pub(super) fn new() -> Self {
        Self { near: [(0.0, 0); STACK], len: 0, spill: Vec::new() }
    }

    #[inline]
    fn push(&mut self, entry: (f32, u32)) {
        if let Some(slot) = self.near.get_mut(self.len) {
            *slot = entry;
            self.len += 1;
        } else {
            self.spill.push(entry);
        }
    }

    #[inline]
    fn pop(&mut self) -> Option<(f32, u32)> {
        if self.len == STACK
            && let Some(entry) = self.spill.pop()
        {
            return Some(entry);
        }
        self.len = self.len.checked_sub(1)?;
        Some(self.near[self.len])
    }
}

impl<L> Tree<L> {
    /// A tree over `boxes`, at least one; `leaf` makes the leaf of up to [`LANES`] of them.
    pub(super) fn new(boxes: &[Aabb], mut leaf: impl FnMut(&[u32]) -> L) -> Self {
        let binary = binary_tree(boxes);
        let counts = primitive_counts(&binary);
        let mut this = Self { nodes: Vec::new(), leaves: Vec::new() };
        this.nodes.push(Node::empty());
        // Children of the binary tree that become children of a wide node: (binary node, wide node).
        let mut pending = vec![(0, 0)];
        let mut members = Vec::with_capacity(LANES);
        while let Some((top, at)) = pending.pop() {
            let first_pending = pending.len();
            for (lane, child) in widen(&binary, &counts, top).into_iter().flatten().enumerate() {
                let link = if counts[child] <= LANES as u32 {
                    members.clear();
                    collect(&binary, child, &mut members);
                    this.leaves.push(leaf(&members));
                    LEAF | (this.leaves.len() - 1) as u32
                } else {
                    this.nodes.push(Node::empty());
                    pending.push((child, this.nodes.len() - 1));
                    (this.nodes.len() - 1) as u32
                };
                this.nodes[at].set(lane, binary.nodes[child].aabb(), link);
            }
            // The first child is taken next: it then lies behind its parent in memory more often.
            pending[first_pending..].reverse();
        }
        this
    }

    /// Calls `visit` for the leaves whose boxes the ray meets at t in \[`near`, `far`\], nearest boxes first if
    /// `ORDERED`. `visit` answers with the new `far`; a negative infinity ends the walk.
    #[inline]
    pub(super) fn walk<const ORDERED: bool>(
        &self,
        stack: &mut Stack,
        ray: &BoxRay,
        near: f32,
        mut far: f32,
        mut visit: impl FnMut(&L, f32) -> f32,
    ) {
        stack.len = 0;
        stack.spill.clear();
        let start = Vec4::splat(near);
        let mut current = 0;
        loop {
            if current & LEAF != 0 {
                far = visit(&self.leaves[(current & !LEAF) as usize], far);
                if far == f32::NEG_INFINITY {
                    return;
                }
            } else {
                let node = &self.nodes[current as usize];
                let (mut enter, mut leave) = (start, Vec4::splat(far));
                for axis in 0..3 {
                    let sides = &node.sides[axis];
                    let side = ray.from_above[axis];
                    enter = enter.max((sides[side] - ray.origin[axis]) * ray.inverse[axis]);
                    leave = leave.min((sides[1 - side] - ray.origin[axis]) * ray.inverse[axis]);
                }
                let mut met = enter.cmple(leave).bitmask();
                let enter = enter.to_array();
                let bottom = stack.len;
                while met != 0 {
                    let lane = met.trailing_zeros() as usize & (LANES - 1);
                    met &= met - 1;
                    stack.push((enter[lane], node.children[lane]));
                }
                if ORDERED {
                    sort_farthest_first(&mut stack.near[bottom..stack.len]);
                }
            }
            loop {
                let Some((distance, next)) = stack.pop() else { return };
                if distance <= far {
                    current = next;
                    break;
                }
            }
        }
    }
}

impl Node {
    fn empty() -> Self {
        Self {
            sides: [[Vec4::splat(f32::INFINITY), Vec4::splat(f32::NEG_INFINITY)]; 3],
            children: [0; LANES],
        }
    }

    fn set(&mut self, lane: usize, bounds: &Aabb, link: u32) {
        for axis in 0..3 {
            self.sides[axis][0][lane] = bounds.min[axis];
            self.sides[axis][1][lane] = bounds.max[axis];
        }
        self.children[lane] = link;
    }
}

/// At most [`LANES`] entries: insertion is fastest.
#[inline]
fn sort_farthest_first(entries: &mut [(f32, u32)]) {
    for k in 1..entries.len() {
        let mut j = k;
        while j > 0 && entries[j - 1].0 < entries[j].0 {
            entries.swap(j - 1, j);
            j -= 1;
        }
    }
}

fn binary_tree(boxes: &[Aabb]) -> Bvh2 {
    let indices = (0..boxes.len() as u32).collect();
    let mut tree = PlocBuilder::with_capacity(boxes.len()).build(
        PlocSearchDistance::Low,
        boxes,
        indices,
        SortPrecision::U64,
        2,
    );
    ReinsertionOptimizer::default().run(&mut tree, REINSERTED, None);
    tree.reorder_in_stack_traversal_order();
    tree
}

/// Primitives below every node of a tree whose children lie behind their parents.
fn primitive_counts(tree: &Bvh2) -> Vec<u32> {
    let mut counts = vec![0; tree.nodes.len()];
    for (k, node) in tree.nodes.iter().enumerate().rev() {
        counts[k] = if node.is_leaf() {
            node.prim_count
        } else {
            let first = node.first_index as usize;
            counts[first] + counts[first + 1]
        };
    }
    counts
}

/// The descendants of `top` that become the children of one wide node: the largest are opened first.
fn widen(tree: &Bvh2, counts: &[u32], top: usize) -> [Option<usize>; LANES] {
    let mut children = [None; LANES];
    children[0] = Some(top);
    for free in 1..LANES {
        let mut largest: Option<(usize, usize)> = None;
        for (lane, child) in children[..free].iter().enumerate() {
            let Some(child) = *child else { continue };
            let opens = counts[child] > LANES as u32;
            let area = |k: usize| tree.nodes[k].aabb().half_area();
            if opens && largest.is_none_or(|(_, most)| area(child) > area(most)) {
                largest = Some((lane, child));
            }
        }
        let Some((lane, child)) = largest else { break };
        let first = tree.nodes[child].first_index as usize;
        children[lane] = Some(first);
        children[free] = Some(first + 1);
    }
    children
}

/// Primitives below `top`, of which there are at most [`LANES`].
fn collect(tree: &Bvh2, top: usize, members: &mut Vec<u32>) {
    let mut pending = vec![top];
    while let Some(k) = pending.pop() {
        let node = &tree.nodes[k];
        let first = node.first_index as usize;
        if node.is_leaf() {
            members.extend_from_slice(&tree.primitive_indices[first..first + node.prim_count as usize]);
        } else {
            pending.extend([first + 1, first]);
        }
    }
}

/// The f32 box around an f64 one, `margin` wider on all sides.
pub(super) fn widened_box(low: [f64; 3], high: [f64; 3], margin: f64) -> Aabb {
    Aabb {
        min: Vec3A::from_array(low.map(|x| (x - margin) as f32)),
        max: Vec3A::from_array(high.map(|x| (x + margin) as f32)),
    }
}
