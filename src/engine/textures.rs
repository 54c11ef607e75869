//! The tables that lookups read: borrowed from whoever owns them, or owned in half precision.

use super::plan::Plan;
use crate::kernels::fetch::{Pyramid, Texels, padded};
use half::f16;

/// Values of one texture \[H, W, C\].
#[derive(Clone, Debug)]
pub enum Table {
    /// Single precision.
    Single(Vec<f32>),
    /// Half precision, a texel padded to whole vectors.
    Half(Vec<f16>),
}

impl Table {
    /// A table in half precision.
    pub fn half(values: &[f32], channels: usize) -> Self {
        let wide = padded(channels);
        let texel =
            |t: &[f32]| (0..wide).map(|c| t.get(c).map_or(f16::ZERO, |v| f16::from_f32(*v))).collect();
        Self::Half(values.chunks(channels.max(1)).flat_map::<Vec<f16>, _>(texel).collect())
    }

    /// The values as lookups take them.
    pub fn texels(&self) -> Texels<'_> {
        match self {
            Self::Single(values) => Texels::Single(values),
            Self::Half(values) => Texels::Half(values),
        }
    }
}

/// All textures of a model.
#[derive(Clone, Debug)]
pub struct Textures<'a> {
    pub(super) pyramid: Pyramid<'a>,
    pub(super) offset: Option<Pyramid<'a>>,
}

impl<'a> Textures<'a> {
    /// The textures of a plan, from the values of its levels, finest first, and of the offset texture, where it has one.
    pub fn new(plan: &Plan, levels: Vec<Texels<'a>>, offset: Option<Texels<'a>>) -> Self {
        let [height, width] = plan.architecture.finest_size();
        let pyramid = |levels| Pyramid { levels, height, width };
        Self { pyramid: pyramid(levels), offset: offset.map(|texels| pyramid(vec![texels])) }
    }
}
