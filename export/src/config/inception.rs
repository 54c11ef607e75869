//! The Inception decoder: a network over images of queries, whose every answer depends on the queries around it.
//!
//! Paper, section 3.3 (the modules are GoogLeNet's): a 1x1 convolution to `width` channels, modules, a 1x1 convolution to the
//! outputs. A module joins four paths of its input: 1x1; 1x1 and 3x3; 1x1 and 5x5; 3x3 maximum and 1x1. A ReLU follows every
//! convolution but the last. Images are periodic: what lies beyond one border is what lies inside the opposite one.

use super::{MAX_LAYERS, MAX_WIDTH};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Prefix of the decoder's convolutions.
pub const DECODER: &str = "decoder";
/// Side of the largest kernel.
const LARGEST_KERNEL: usize = 5;

/// Sizes of an Inception decoder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InceptionConfig {
    /// Channels between the modules: the sum of `paths`.
    pub width: usize,
    /// Modules.
    pub modules: usize,
    /// Channels of a module's 1x1, 3x3, 5x5 and maximum path.
    pub paths: [usize; 4],
    /// Channels to which the 3x3 and the 5x5 path reduce first.
    pub reduce: [usize; 2],
}

/// One convolution: weight \[outputs, inputs, side, side\], bias \[outputs\].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Convolution {
    /// Its tensors are `name.weight` and `name.bias`.
    pub name: String,
    /// Channels that it reads.
    pub inputs: usize,
    /// Channels that it gives.
    pub outputs: usize,
    /// Rows and columns of its kernel.
    pub side: usize,
}

impl Convolution {
    /// Names and shapes of its two tensors.
    pub fn tensors(&self) -> [(String, Vec<usize>); 2] {
        let Self { name, inputs, outputs, side } = self;
        [
            (format!("{name}.weight"), vec![*outputs, *inputs, *side, *side]),
            (format!("{name}.bias"), vec![*outputs]),
        ]
    }

    /// Multiply-adds a pixel.
    pub fn products(&self) -> usize {
        self.inputs * self.outputs * self.side * self.side
    }
}

impl InceptionConfig {
    /// How far away a query may lie that an answer depends on, in samples of the grid.
    pub fn radius(&self) -> usize {
        self.modules * (LARGEST_KERNEL / 2)
    }

    /// All convolutions in order: the first, of each module its 1x1 path, 3x3 path (reduction first), 5x5 path (reduction
    /// first) and maximum path, the last.
    pub fn convolutions(&self, inputs: usize, outputs: usize) -> Vec<Convolution> {
        let layer = |name: String, inputs, outputs, side| Convolution {
            name: format!("{DECODER}.{name}"),
            inputs,
            outputs,
            side,
        };
        let ([one, three, five, most], [to_three, to_five]) = (self.paths, self.reduce);
        let mut all = vec![layer("in".into(), inputs, self.width, 1)];
        for module in 0..self.modules {
            let of = |path: &str| format!("module{module}.{path}");
            all.push(layer(of("path1"), self.width, one, 1));
            all.push(layer(of("path2.reduce"), self.width, to_three, 1));
            all.push(layer(of("path2"), to_three, three, 3));
            all.push(layer(of("path3.reduce"), self.width, to_five, 1));
            all.push(layer(of("path3"), to_five, five, LARGEST_KERNEL));
            all.push(layer(of("path4"), self.width, most, 1));
        }
        all.push(layer("out".into(), self.width, outputs, 1));
        all
    }

    /// Checks every bound.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn validate(&self) -> Result<()> {
        let within = |field: &str, value: usize, high: usize| {
            if (1..=high).contains(&value) {
                return Ok(());
            }
            Err(Error::config(format!("decoder.{field}"), format!("{value} is outside 1 to {high}")))
        };
        within("width", self.width, MAX_WIDTH)?;
        within("modules", self.modules, MAX_LAYERS)?;
        self.paths.iter().try_for_each(|channels| within("paths", *channels, MAX_WIDTH))?;
        self.reduce.iter().try_for_each(|channels| within("reduce", *channels, MAX_WIDTH))?;
        let sum: usize = self.paths.iter().sum();
        if sum != self.width {
            let problem = format!("{:?} add up to {sum}, not to the width {}", self.paths, self.width);
            return Err(Error::config("decoder.paths", problem));
        }
        Ok(())
    }
}
