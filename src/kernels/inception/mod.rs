//! The Inception decoder (the improved method's extension) on the CPU: forward, and back to weights and inputs.
//!
//! 1x1 convolution to `width` channels, then modules of four paths side by side (GoogLeNet's 3a), then 1x1 to the outputs;
//! ReLU after every convolution but the last. A module is
//!
//! | path | |
//! | --- | --- |
//! | 1 | 1x1 |
//! | 2 | 1x1 to `reduce[0]`, 3x3 |
//! | 3 | 1x1 to `reduce[1]`, 5x5 |
//! | 4 | 3x3 max-pool of stride 1, 1x1 |
//!
//! Inside, an image is lines of one channel after another (see `grid`): lanes are pixels of a line, and a block of output
//! channels stays in registers, so that channels of any number cost no padding.

mod backward;
mod conv;
mod gradient;
mod grid;
mod network;
mod pool;
#[cfg(test)]
mod tests;

pub use grid::{Border, Images};
pub use network::{Network, Room};

use crate::error::{Error, Result};

/// Paths of a module.
pub const PATHS: usize = 4;
/// Most channels of anything: products of sizes stay far below what a machine counts.
const MOST_CHANNELS: usize = 4096;
/// Most modules.
const MOST_MODULES: usize = 64;
/// Convolutions of a module: four paths and two reductions.
const OF_MODULE: usize = 6;

/// Sizes of the network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Input channels.
    pub inputs: usize,
    /// Channels between modules: the sum of the paths.
    pub width: usize,
    /// Number of modules.
    pub modules: usize,
    /// Channels of each path.
    pub paths: [usize; PATHS],
    /// Channels to which the paths of 3x3 and 5x5 reduce first.
    pub reduce: [usize; 2],
    /// Output channels.
    pub outputs: usize,
}

/// A convolution of the network: weight \[outputs, inputs, kernel, kernel\], bias \[outputs\].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Convolution {
    /// Name, such as `module0.path2.reduce`.
    pub name: String,
    /// Output channels.
    pub outputs: usize,
    /// Input channels.
    pub inputs: usize,
    /// Side of the kernel.
    pub kernel: usize,
}

impl Convolution {
    /// Number of weights, without biases.
    pub fn weights(&self) -> usize {
        self.outputs * self.inputs * self.kernel * self.kernel
    }
}

impl Shape {
    /// # Errors
    /// `Config` if a size is 0 or absurd, or the paths do not add up to the width.
    pub fn check(&self) -> Result<()> {
        let sizes = [
            ("inputs", self.inputs),
            ("width", self.width),
            ("outputs", self.outputs),
            ("reduce[0]", self.reduce[0]),
            ("reduce[1]", self.reduce[1]),
            ("paths[0]", self.paths[0]),
            ("paths[1]", self.paths[1]),
            ("paths[2]", self.paths[2]),
            ("paths[3]", self.paths[3]),
        ];
        for (name, size) in sizes {
            if !(1..=MOST_CHANNELS).contains(&size) {
                let problem = format!("{size} channels; use 1 to {MOST_CHANNELS}");
                return Err(Error::config(format!("decoder.{name}"), problem));
            }
        }
        if !(1..=MOST_MODULES).contains(&self.modules) {
            let problem = format!("{} modules; use 1 to {MOST_MODULES}", self.modules);
            return Err(Error::config("decoder.modules", problem));
        }
        let sum: usize = self.paths.iter().sum();
        if sum != self.width {
            let problem = format!("the paths have {sum} channels together, the width is {}", self.width);
            return Err(Error::config("decoder.paths", format!("{problem}; make them equal")));
        }
        Ok(())
    }

    /// All convolutions in the order of weights, gradients and checkpoints.
    pub fn convolutions(&self) -> Vec<Convolution> {
        let new = |name: String, outputs, inputs, kernel| Convolution { name, outputs, inputs, kernel };
        let (width, [r2, r3], [p1, p2, p3, p4]) = (self.width, self.reduce, self.paths);
        let mut all = vec![new("in".into(), width, self.inputs, 1)];
        for k in 0..self.modules {
            let of = |part: &str| format!("module{k}.{part}");
            all.extend([
                new(of("path1"), p1, width, 1),
                new(of("path2.reduce"), r2, width, 1),
                new(of("path2"), p2, r2, 3),
                new(of("path3.reduce"), r3, width, 1),
                new(of("path3"), p3, r3, 5),
                new(of("path4"), p4, width, 1),
            ]);
        }
        all.push(new("out".into(), self.outputs, width, 1));
        all
    }

    /// Number of weights and biases. A gradient is so long: for each convolution its weight, then its bias.
    pub fn parameters(&self) -> usize {
        self.convolutions().iter().map(|c| c.weights() + c.outputs).sum()
    }

    /// How far an output sees, in pixels: a patch of a larger image is right that far from its border.
    pub fn radius(&self) -> usize {
        2 * self.modules
    }
}
