//! What a tile computes, derived once from the architecture.

use crate::kernels::encoding::footprint_sigma;
use crate::kernels::output::Output;
use crate::kernels::rows::Parallax;
use crate::kernels::simd::Isa;
use neumip_export::config::{Architecture, OutputSpace, OutputTransform, ParallaxConfig, YUV_TO_RGB};
use std::ops::Range;

/// The order of the decoder's inputs in a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// As the checkpoint has them: features, u, wi, wo.
    Stored,
    /// Features, u, wo, wi: what depends on the light comes last, so that the first layer can be split there.
    LightLast,
}

/// What a tile computes.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Instruction set.
    pub isa: Isa,
    /// The model.
    pub architecture: Architecture,
    /// Rows of gamma(u).
    pub(super) u: Range<usize>,
    /// Rows of gamma(wi).
    pub(super) wi: Range<usize>,
    /// Rows of gamma(wo).
    pub(super) wo: Range<usize>,
    /// Channels of the offset texture, and what its network's output does.
    pub(super) offset: Option<(usize, Parallax)>,
    pub(super) output: Output,
    /// Standard deviation of a texel's footprint in units of p, for x and y.
    pub(super) sigma: [f32; 2],
}

impl Plan {
    /// The plan of a model.
    pub fn new(architecture: &Architecture, isa: Isa, order: Order) -> Self {
        let model = &architecture.model;
        let [height, width] = architecture.resolution;
        let u = model.texture.channels..model.texture.channels + architecture.u_inputs();
        let of_wi = architecture.direction_inputs(&model.encoding.wi);
        let of_wo = architecture.direction_inputs(&model.encoding.wo);
        let (wi, wo) = match order {
            Order::Stored => (u.end..u.end + of_wi, u.end + of_wi..u.end + of_wi + of_wo),
            Order::LightLast => (u.end + of_wo..u.end + of_wo + of_wi, u.end..u.end + of_wo),
        };
        let offset = match &model.parallax {
            ParallaxConfig::None {} => None,
            ParallaxConfig::Offset(o) => Some((o.channels, Parallax { scale: o.scale, min_z: o.min_z })),
        };
        Self {
            isa,
            architecture: architecture.clone(),
            u,
            wi,
            wo,
            offset,
            output: Output {
                matrix: (model.output.space == OutputSpace::Yuv).then_some(YUV_TO_RGB),
                exponential: model.output.transform == OutputTransform::ExpMinusOne,
                mask: model.output.mask,
            },
            sigma: [footprint_sigma(0.0, width), footprint_sigma(0.0, height)],
        }
    }

    /// Channels of the pyramid.
    pub(super) fn channels(&self) -> usize {
        self.architecture.model.texture.channels
    }

    /// The stored input of each row of the decoder's tile.
    pub(super) fn columns(&self) -> Vec<usize> {
        let inputs = self.architecture.decoder_inputs();
        let (of_wi, of_wo) = (self.wi.len(), self.wo.len());
        let mut columns: Vec<usize> = (0..inputs).collect();
        for k in 0..of_wi {
            columns[self.wi.start + k] = self.u.end + k;
        }
        for k in 0..of_wo {
            columns[self.wo.start + k] = self.u.end + of_wi + k;
        }
        columns
    }
}
