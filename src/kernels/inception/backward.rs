//! The way back: gradients of weights, then of a layer's inputs, from the last layer to the first.

use super::super::simd::Isa;
use super::conv::{End, Packed, Start};
use super::gradient::{self, Flow};
use super::grid::{Grid, Halo, Images, Plane};
use super::network::{self, Back, Module, Network, split};
use super::{Convolution, OF_MODULE, Shape, pool};

/// Planes of the way back.
#[derive(Debug, Default)]
pub struct Room {
    /// Gradient of the outputs.
    output: Plane,
    /// Gradients of the sums that became a module's outputs, and of those that became its inputs.
    g: [Plane; 2],
    /// Gradients of the reductions' sums.
    reduced: Plane,
    /// Max-pool: the largest, which input it was, and its gradient.
    pooled: Plane,
    places: Plane,
    of_pooled: Plane,
    /// Gradient of the network's inputs.
    input: Plane,
}

/// Where the gradients of weights go.
struct Weights<'a> {
    isa: Isa,
    /// Of each convolution, where it begins among all parameters.
    places: Vec<usize>,
    all: &'a mut [f32],
}

impl Weights<'_> {
    fn add(&mut self, grid: &Grid, flows: &[Flow]) {
        gradient::add(self.isa, grid, flows, self.all);
    }
}

impl Network {
    /// Gradients of what [`Self::forward_keeping`] answered last: from those of the outputs \[pixel\]\[outputs\], adds
    /// those of the weights, each convolution's weight and then its bias in the order of [`Shape::convolutions`], and
    /// writes those of the first inputs \[pixel\]\[learned\]. A ReLU passes none at 0; a max-pool gives all to the first
    /// of equals in scan order.
    ///
    /// # Panics
    /// If the network is not one that learns, `room` does not hold such a batch, or a slice has another length.
    pub fn backward(
        &self,
        images: Images,
        room: &mut network::Room,
        by_output: &[f32],
        by_weights: &mut [f32],
        by_input: &mut [f32],
    ) {
        let shape = &self.shape;
        let Some(back) = &self.back else { panic!("the network was built to answer, not to learn") };
        let learned = back.first.outputs();
        assert_eq!(room.kept, Some(images), "forward_keeping comes before backward");
        assert_eq!(room.x.len(), shape.modules + 1, "the room is another network's");
        assert_eq!(by_output.len(), images.pixels() * shape.outputs, "gradients do not fit the images");
        assert_eq!(by_input.len(), images.pixels() * learned, "gradients of inputs do not fit the images");
        assert_eq!(by_weights.len(), shape.parameters(), "gradients of weights do not fit the network");

        let grid = &Grid::new(images);
        let network::Room { input, x, reduced, back: own, .. } = room;
        own.fit(grid, shape, learned);
        let mut weights = Weights { isa: self.isa, places: places(&self.convolutions), all: by_weights };

        grid.gather(by_output, &mut own.output);
        let [g, next] = &mut own.g;
        let flow = Flow {
            input: x[shape.modules].from(0),
            inputs: shape.width,
            gradient: own.output.from(0),
            outputs: shape.outputs,
            kernel: 1,
            place: weights.places[self.convolutions.len() - 1],
        };
        weights.add(grid, &[flow]);
        through(grid, &back.last, &own.output, &x[shape.modules], g);
        let Room { reduced: by_reduced, pooled, places, of_pooled, .. } = own;
        let mut parts = Parts { g, next, by_reduced, pooled, places, of_pooled };
        for k in (0..shape.modules).rev() {
            self.module_back(grid, back, k, &x[k], &reduced[k], &mut parts, &mut weights);
            std::mem::swap(&mut parts.g, &mut parts.next);
        }
        let flow = Flow {
            input: input.from(0),
            inputs: shape.inputs,
            gradient: parts.g.from(0),
            outputs: shape.width,
            kernel: 1,
            place: 0,
        };
        weights.add(grid, &[flow]);
        if learned > 0 {
            let from = parts.g.from(0);
            own.input.by_line(grid, |line, rows| {
                back.first.apply(grid, from, line, Start::Bias, End::Linear, rows);
            });
            grid.scatter(&own.input, learned, by_input);
        }
    }

    #[allow(clippy::too_many_arguments)]
    fn module_back(
        &self,
        grid: &Grid,
        back: &Back,
        k: usize,
        x: &Plane,
        reduced: &Plane,
        parts: &mut Parts,
        weights: &mut Weights,
    ) {
        let (isa, width, [r2, r3], [p1, p2, p3, p4]) =
            (self.isa, self.shape.width, self.shape.reduce, self.shape.paths);
        let module: &Module = &back.modules[k];
        let Parts { g, next, by_reduced, pooled, places, of_pooled } = parts;
        let (from2, from3, from4) = (p1, p1 + p2, p1 + p2 + p3);
        let place = |part: usize| 1 + k * OF_MODULE + part;

        // The max-pool again: cheaper than to keep what it said.
        pooled.by_line_with(places, grid, |line, pooled, places| {
            pool::winners(isa, grid, x.from(0), line, pooled, places);
            grid.finish(line, pooled, Halo::Zero);
            grid.finish(line, places, Halo::Border);
        });
        let flow = |input, inputs, first, outputs, kernel, part| Flow {
            input,
            inputs,
            gradient: g.from(first),
            outputs,
            kernel,
            place: weights.places[place(part)],
        };
        let flows = [
            flow(x.from(0), width, 0, p1, 1, 0),
            flow(reduced.from(0), r2, from2, p2, 3, 2),
            flow(reduced.from(r2), r3, from3, p3, 5, 4),
            flow(pooled.from(0), width, from4, p4, 1, 5),
        ];
        weights.add(grid, &flows);

        // From here on gradients have the border about them.
        g.by_line(grid, |line, rows| grid.finish(line, rows, Halo::Border));
        by_reduced.by_line_with(of_pooled, grid, |line, rows, of_pooled| {
            let was = reduced.from(0).rows(grid, line, r2 + r3);
            let ((rows2, rows3), (was2, was3)) = (split(rows, grid, r2), was.split_at(r2 * grid.stride));
            module.path2.apply(grid, g.from(from2), line, Start::Bias, End::Where(was2), rows2);
            module.path3.apply(grid, g.from(from3), line, Start::Bias, End::Where(was3), rows3);
            grid.finish(line, rows, Halo::Zero);
            module.path4.apply(grid, g.from(from4), line, Start::Bias, End::Linear, of_pooled);
            grid.finish(line, of_pooled, Halo::Border);
        });
        let flow = |first, outputs, part| Flow {
            input: x.from(0),
            inputs: width,
            gradient: by_reduced.from(first),
            outputs,
            kernel: 1,
            place: weights.places[place(part)],
        };
        let flows = [flow(0, r2, 1), flow(r2, r3, 3)];
        weights.add(grid, &flows);

        next.by_line(grid, |line, rows| {
            pool::back(isa, grid, of_pooled.from(0), places.from(0), line, rows);
            module.path1.apply(grid, g.from(0), line, Start::Own, End::Linear, rows);
            let was = x.from(0).rows(grid, line, width);
            module.reduce.apply(grid, by_reduced.from(0), line, Start::Own, End::Where(was), rows);
            grid.finish(line, rows, Halo::Zero);
        });
    }
}

/// Planes that a module's way back reads and writes.
struct Parts<'a> {
    g: &'a mut Plane,
    next: &'a mut Plane,
    by_reduced: &'a mut Plane,
    pooled: &'a mut Plane,
    places: &'a mut Plane,
    of_pooled: &'a mut Plane,
}

impl Room {
    fn fit(&mut self, grid: &Grid, shape: &Shape, learned: usize) {
        let width = shape.width;
        for plane in self.g.iter_mut().chain([&mut self.pooled, &mut self.places, &mut self.of_pooled]) {
            plane.fit(grid, width);
        }
        self.reduced.fit(grid, shape.reduce[0] + shape.reduce[1]);
        self.output.fit(grid, shape.outputs);
        self.input.fit(grid, learned);
    }
}

/// Back through a convolution of 1x1 and the ReLU before it.
fn through(grid: &Grid, packed: &Packed, gradient: &Plane, was: &Plane, out: &mut Plane) {
    out.by_line(grid, |line, rows| {
        let was = was.from(0).rows(grid, line, packed.outputs());
        packed.apply(grid, gradient.from(0), line, Start::Bias, End::Where(was), rows);
        grid.finish(line, rows, Halo::Zero);
    });
}

/// Where each convolution begins among all parameters.
fn places(convolutions: &[Convolution]) -> Vec<usize> {
    let mut next = 0;
    let mut place = |c: &Convolution| {
        let place = next;
        next += c.weights() + c.outputs;
        place
    };
    convolutions.iter().map(&mut place).collect()
}
