//! The network: packed weights, room for what lies between layers, and the way forward.

use super::super::simd::Isa;
use super::conv::{End, Packed, Start};
use super::grid::{Grid, Halo, Images, Plane};
use super::{Convolution, OF_MODULE, Shape, pool};
use crate::error::{Error, Result};
use rayon::prelude::*;

/// Weight \[out, in, k, k\] and bias \[out\] of one convolution.
pub type Weights<'a> = (&'a [f32], &'a [f32]);

/// A module's convolutions; both reductions are one.
#[derive(Clone, Debug)]
pub(super) struct Module {
    pub path1: Packed,
    pub reduce: Packed,
    pub path2: Packed,
    pub path3: Packed,
    pub path4: Packed,
}

/// The network with weights packed for one instruction set.
#[derive(Clone, Debug)]
pub struct Network {
    pub(super) isa: Isa,
    pub(super) shape: Shape,
    pub(super) convolutions: Vec<Convolution>,
    pub(super) first: Packed,
    pub(super) modules: Vec<Module>,
    pub(super) last: Packed,
    /// The way back, of a network that learns.
    pub(super) back: Option<Back>,
}

/// The way back: transposed convolutions, whose inputs are gradients of outputs.
#[derive(Clone, Debug)]
pub(super) struct Back {
    pub first: Packed,
    pub modules: Vec<Module>,
    pub last: Packed,
}

/// Planes between layers, kept from one call to the next.
#[derive(Debug, Default)]
pub struct Room {
    pub(super) input: Plane,
    /// Inputs of each module, and of the last convolution.
    pub(super) x: Vec<Plane>,
    /// Reductions of each module.
    pub(super) reduced: Vec<Plane>,
    pub(super) output: Plane,
    pub(super) back: super::backward::Room,
    /// The batch of which the planes hold all that the way back needs.
    pub(super) kept: Option<Images>,
}

/// Rows of a plane's channels before and from one on.
pub(super) fn split<'a>(rows: &'a mut [f32], grid: &Grid, channels: usize) -> (&'a mut [f32], &'a mut [f32]) {
    rows.split_at_mut(channels * grid.stride)
}

impl Network {
    /// A network that answers. Weights are in the order of [`Shape::convolutions`].
    ///
    /// # Errors
    /// `Config` if a size cannot be, or weights are not of that size.
    pub fn new(isa: Isa, shape: &Shape, weights: &[Weights]) -> Result<Self> {
        Self::build(isa, shape, None, weights)
    }

    /// A network that learns, and gives gradients of its first `learned` inputs.
    ///
    /// # Errors
    /// As [`Self::new`]; also if there are not as many inputs.
    pub fn learning(isa: Isa, shape: &Shape, learned: usize, weights: &[Weights]) -> Result<Self> {
        if learned > shape.inputs {
            let problem = format!("gradients of {learned} inputs of {} are asked for", shape.inputs);
            return Err(Error::config("decoder.inputs", problem));
        }
        Self::build(isa, shape, Some(learned), weights)
    }

    fn build(isa: Isa, shape: &Shape, learned: Option<usize>, weights: &[Weights]) -> Result<Self> {
        shape.check()?;
        let (width, [r2, r3], [p1, p2, p3, p4]) = (shape.width, shape.reduce, shape.paths);
        let new = |inputs, outputs, kernel| Packed::new(isa, inputs, outputs, kernel);
        let module = Module {
            path1: new(width, p1, 1),
            reduce: new(width, r2 + r3, 1),
            path2: new(r2, p2, 3),
            path3: new(r3, p3, 5),
            path4: new(width, p4, 1),
        };
        let module_back = Module {
            path1: new(p1, width, 1),
            reduce: new(r2 + r3, width, 1),
            path2: new(p2, r2, 3),
            path3: new(p3, r3, 5),
            path4: new(p4, width, 1),
        };
        let back = |learned| Back {
            first: new(width, learned, 1),
            modules: vec![module_back; shape.modules],
            last: new(shape.outputs, width, 1),
        };
        let mut this = Self {
            isa,
            shape: shape.clone(),
            convolutions: shape.convolutions(),
            first: new(shape.inputs, width, 1),
            modules: vec![module; shape.modules],
            last: new(width, shape.outputs, 1),
            back: learned.map(back),
        };
        this.repack(weights)?;
        Ok(this)
    }

    /// Takes other weights: after each step of an optimizer.
    ///
    /// # Errors
    /// `Config` if they are not of the network's sizes.
    pub fn repack(&mut self, weights: &[Weights]) -> Result<()> {
        let all = &self.convolutions;
        if all.len() != weights.len() {
            let problem = format!("{} convolutions are given, the network has {}", weights.len(), all.len());
            return Err(Error::config("decoder", problem));
        }
        for (one, (weight, bias)) in all.iter().zip(weights) {
            if (weight.len(), bias.len()) != (one.weights(), one.outputs) {
                let (o, i, k) = (one.outputs, one.inputs, one.kernel);
                let problem = format!(
                    "{} weights and {} biases; it needs {o} x {i} x {k} x {k} and {o}",
                    weight.len(),
                    bias.len()
                );
                return Err(Error::config(format!("decoder.{}", one.name), problem));
            }
        }
        let [r2, _] = self.shape.reduce;
        let (first, last) = (weights[0], weights[weights.len() - 1]);
        forward(&mut self.first, first);
        forward(&mut self.last, last);
        let of_modules = &weights[1..weights.len() - 1];
        self.modules.par_iter_mut().zip(of_modules.par_chunks_exact(OF_MODULE)).for_each(|(m, w)| {
            forward(&mut m.path1, w[0]);
            let inputs = self.shape.width;
            let of = |o: usize| if o < r2 { (w[1], o) } else { (w[3], o - r2) };
            let weight = |o, c, _, _| {
                let ((weight, _), o) = of(o);
                weight[o * inputs + c]
            };
            m.reduce.fill(weight, |o| {
                let ((_, bias), o) = of(o);
                bias[o]
            });
            forward(&mut m.path2, w[2]);
            forward(&mut m.path3, w[4]);
            forward(&mut m.path4, w[5]);
        });
        let Some(back) = &mut self.back else { return Ok(()) };
        backward(&mut back.first, first, self.shape.inputs, 1);
        backward(&mut back.last, last, self.shape.width, 1);
        let [_, r3] = self.shape.reduce;
        let width = self.shape.width;
        back.modules.par_iter_mut().zip(of_modules.par_chunks_exact(OF_MODULE)).for_each(|(m, w)| {
            backward(&mut m.path1, w[0], width, 1);
            let weight =
                |o, c, _, _| if c < r2 { w[1].0[c * width + o] } else { w[3].0[(c - r2) * width + o] };
            m.reduce.fill(weight, |_| 0.0);
            backward(&mut m.path2, w[2], r2, 3);
            backward(&mut m.path3, w[4], r3, 5);
            backward(&mut m.path4, w[5], width, 1);
        });
        Ok(())
    }

    /// Its sizes.
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// Outputs \[pixel\]\[outputs\] of inputs \[pixel\]\[inputs\].
    ///
    /// # Panics
    /// If a slice is not as long as that.
    pub fn forward(&self, images: Images, input: &[f32], room: &mut Room, output: &mut [f32]) {
        self.run(images, input, room, output, false);
    }

    /// As [`Self::forward`]; keeps in `room` what the way back needs.
    ///
    /// # Panics
    /// If a slice is not as long as that.
    pub fn forward_keeping(&self, images: Images, input: &[f32], room: &mut Room, output: &mut [f32]) {
        self.run(images, input, room, output, true);
    }

    fn run(&self, images: Images, input: &[f32], room: &mut Room, output: &mut [f32], keep: bool) {
        let shape = &self.shape;
        assert_eq!(input.len(), images.pixels() * shape.inputs, "inputs do not fit the images");
        assert_eq!(output.len(), images.pixels() * shape.outputs, "outputs do not fit the images");
        let grid = &Grid::new(images);
        // Without the way back, a module's input makes room for the next one's.
        let (planes, reductions) = if keep { (shape.modules + 1, shape.modules) } else { (2, 1) };
        room.kept = keep.then_some(images);
        room.x.resize_with(planes, Plane::default);
        room.reduced.resize_with(reductions, Plane::default);
        room.x.iter_mut().for_each(|plane| plane.fit(grid, shape.width));
        room.reduced.iter_mut().for_each(|plane| plane.fit(grid, shape.reduce[0] + shape.reduce[1]));
        room.input.fit(grid, shape.inputs);
        room.output.fit(grid, shape.outputs);

        grid.gather(input, &mut room.input);
        let from = room.input.from(0);
        room.x[0].by_line(grid, |line, rows| {
            self.first.apply(grid, from, line, Start::Bias, End::Relu, rows);
            grid.finish(line, rows, Halo::Border);
        });
        for (k, module) in self.modules.iter().enumerate() {
            let [before, after] = [k % planes, (k + 1) % planes];
            let (x, next) = if before < after {
                let (head, tail) = room.x.split_at_mut(after);
                (&head[before], &mut tail[0])
            } else {
                let (head, tail) = room.x.split_at_mut(before);
                (&tail[0], &mut head[after])
            };
            self.module(grid, module, x, &mut room.reduced[k % reductions], next);
        }
        let from = room.x[shape.modules % planes].from(0);
        room.output.by_line(grid, |line, rows| {
            self.last.apply(grid, from, line, Start::Bias, End::Linear, rows);
        });
        grid.scatter(&room.output, shape.outputs, output);
    }

    fn module(&self, grid: &Grid, module: &Module, x: &Plane, reduced: &mut Plane, next: &mut Plane) {
        let [p1, p2, p3, _] = self.shape.paths;
        let relu = |packed: &Packed, from, line, rows: &mut [f32]| {
            packed.apply(grid, from, line, Start::Bias, End::Relu, rows);
        };
        reduced.by_line(grid, |line, reduced| {
            relu(&module.reduce, x.from(0), line, reduced);
            grid.finish(line, reduced, Halo::Border);
        });
        let reduced = &*reduced;
        next.by_line(grid, |line, rows| {
            let (path1, rest) = split(rows, grid, p1);
            let (path2, rest) = split(rest, grid, p2);
            let (path3, path4) = split(rest, grid, p3);
            relu(&module.path1, x.from(0), line, path1);
            relu(&module.path2, reduced.from(0), line, path2);
            relu(&module.path3, reduced.from(self.shape.reduce[0]), line, path3);
            let mut pooled = vec![0.0; self.shape.width * grid.stride];
            pool::largest(self.isa, grid, x.from(0), line, &mut pooled);
            module.path4.apply_rows(grid, &pooled, Start::Bias, End::Relu, path4);
            grid.finish(line, rows, Halo::Border);
        });
    }
}

fn forward(packed: &mut Packed, (weight, bias): Weights) {
    let outputs = bias.len();
    let (inputs, kernel) = packed.sizes();
    debug_assert_eq!(weight.len(), outputs * inputs * kernel * kernel);
    packed.fill(|o, c, ky, kx| weight[((o * inputs + c) * kernel + ky) * kernel + kx], |o| bias[o]);
}

/// A gradient goes back through the kernel turned around.
fn backward(packed: &mut Packed, (weight, _): Weights, inputs: usize, kernel: usize) {
    let turned = kernel - 1;
    let weight = |o, c, ky, kx| weight[((c * inputs + o) * kernel + turned - ky) * kernel + turned - kx];
    packed.fill(weight, |_| 0.0);
}
