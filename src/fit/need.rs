//! What a material needs to hold for a scene: levels, a window of the tile, directions.

use crate::analyze::arc;
use crate::error::{Error, Result};
use crate::query::unit;
use crate::render::Demand;
use neumip_export::{Cone, Domain};
use serde::{Deserialize, Serialize};

/// Share of the weight of all queries that may be finer, or coarser, than the fitted levels: they are answered by the nearest
/// one, and half a percent of a picture is less than its edges.
const TAIL: f64 = 0.005;
/// Largest part of a tile that is cut out; above it, the rest is hardly worth its own level.
const LARGEST_WINDOW: f64 = 0.7;
/// Least share of a coarser level: a pixel that covers a fifth more than a texel hardly differs from one that covers it.
const LEAST_MIX: f32 = 0.2;
/// Texels of the coarsest fitted level around what is asked: a bilinear fetch reads one, its offset moves it by less than
/// another.
const MARGIN: usize = 2;
/// Texels of the coarsest fitted level along a window's side, so that a coarser one can hold the average.
const LEAST_SIDE: usize = 4;
/// Widening of the cones of directions, as a cosine: directions are drawn, and their edges are not.
const SLACK: f32 = 1e-3;

/// What a scene needs of a material.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Need {
    /// Texels \[H, W\] of the tile.
    pub tile: [usize; 2],
    /// First texel \[row, column\] of the window.
    pub corner: [usize; 2],
    /// Texels \[H, W\] of the window.
    pub size: [usize; 2],
    /// Finest and coarsest level that is asked, but for half a percent of the weight at either end.
    pub levels: [f32; 2],
    /// Light directions that are asked.
    pub wi: Cone,
    /// View directions that are asked.
    pub wo: Cone,
    /// Texels of the finest asked level that a tile spans in the picture, at most.
    pub span: f64,
}

impl Need {
    /// What a demand needs; `coarsest` is the coarsest level that the full model answers.
    ///
    /// # Errors
    /// `Config` if nothing is asked.
    pub fn new(demand: &Demand, coarsest: usize) -> Result<Self> {
        let queries = &demand.queries;
        if queries.is_empty() {
            let problem = "the scene never shows it: no ray that has light meets it";
            return Err(Error::config(format!("materials.{}", demand.material), problem));
        }
        let last = coarsest as f32;
        let levels =
            quantiles(&queries.level, &demand.weight, [TAIL, 1.0 - TAIL]).map(|l| l.clamp(0.0, last));
        let mut this = Self {
            tile: demand.resolution,
            corner: [0; 2],
            size: demand.resolution,
            levels,
            wi: cone(&queries.wi),
            wo: cone(&queries.wo),
            span: demand.resolution[0].max(demand.resolution[1]) as f64 / f64::from(levels[0].exp2()),
        };
        let last = this.coarsest() as f32;
        this.levels = this.levels.map(|level| level.min(last));
        this.cut(&queries.u, coarsest);
        Ok(this)
    }

    /// The finest level that has to be stored.
    pub fn finest(&self) -> usize {
        self.levels[0].floor() as usize
    }

    /// The coarsest level that has to be stored for what is asked: a level that is mixed in by less is not worth the time of
    /// reading it.
    pub fn coarsest(&self) -> usize {
        (self.levels[1] - LEAST_MIX).ceil().max(0.0) as usize
    }

    /// True if a part of the tile is enough.
    pub fn is_window(&self) -> bool {
        self.size != self.tile
    }

    /// The level that answers for the rest of the tile, where a part of it is enough.
    pub fn average(&self) -> Option<usize> {
        self.is_window().then(|| self.coarsest() + 1)
    }

    /// Stored levels of a pyramid from `finest` on.
    pub fn levels_from(&self, finest: usize) -> usize {
        self.average().unwrap_or(self.coarsest()) + 1 - finest
    }

    /// The domain of a material that is fitted to this.
    pub fn domain(&self, scene: &str, floor: f32) -> Domain {
        Domain {
            scene: scene.into(),
            tile: self.tile,
            corner: self.corner,
            levels: self.levels,
            wi: self.wi,
            wo: self.wo,
            floor,
        }
    }

    /// Cuts out the smallest window of whole texels of the coarsest level, shaped as the tile, that holds all positions: a
    /// neural offset moves both coordinates by one depth.
    fn cut(&mut self, u: &[[f32; 2]], coarsest: usize) {
        let unit = 1usize << self.coarsest();
        if self.coarsest() >= coarsest || self.tile.iter().any(|side| side % unit != 0) {
            return;
        }
        let texels = self.tile.map(|side| side / unit);
        let runs = [0, 1].map(|axis| {
            let mut asked = vec![false; texels[axis]];
            for u in u {
                let at = (u[1 - axis] * texels[axis] as f32) as usize;
                asked[at.min(texels[axis] - 1)] = true;
            }
            arc(&asked)
        });
        let part = |axis: usize| (runs[axis][1] + 2 * MARGIN).max(LEAST_SIDE) as f64 / texels[axis] as f64;
        let part = part(0).max(part(1));
        if part * part > LARGEST_WINDOW {
            return;
        }
        for (axis, [first, asked]) in runs.into_iter().enumerate() {
            let length = ((part * texels[axis] as f64).round() as usize).min(texels[axis]);
            let before = length.saturating_sub(asked) / 2;
            self.corner[axis] = (first + texels[axis] - before) % texels[axis] * unit;
            self.size[axis] = length * unit;
        }
    }
}

/// Values below which these shares of the weight lie.
pub fn quantiles<const N: usize>(values: &[f32], weight: &[f32], shares: [f64; N]) -> [f32; N] {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let total: f64 = weight.iter().map(|w| f64::from(*w)).sum();
    shares.map(|share| {
        let mut sum = 0.0;
        for &k in &order {
            sum += f64::from(weight[k]);
            if sum >= share * total {
                return values[k];
            }
        }
        order.last().map_or(0.0, |&k| values[k])
    })
}

/// A cone around the mean of stored directions that holds all of them.
fn cone(directions: &[[f32; 2]]) -> Cone {
    let mut sum = [0.0f64; 3];
    for w in directions {
        unit(*w).iter().zip(&mut sum).for_each(|(v, s)| *s += f64::from(*v));
    }
    let length = sum.iter().map(|v| v * v).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
    let axis = sum.map(|v| (v / length) as f32);
    let cosine = |w: &[f32; 2]| unit(*w).iter().zip(&axis).map(|(a, b)| a * b).sum::<f32>();
    let least = directions.iter().map(cosine).fold(1.0f32, f32::min);
    Cone { axis, cosine: (least - SLACK).clamp(-1.0, 1.0) }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::query::QueryBuffer;

    pub fn demand(u: Vec<[f32; 2]>, level: Vec<f32>) -> Demand {
        let n = u.len();
        let (wi, wo) = (vec![[0.3, 0.0]; n], vec![[0.0, -0.5]; n]);
        Demand {
            material: "rings".into(),
            resolution: [128, 128],
            queries: QueryBuffer::new(1, n, u, wi, wo, level).unwrap(),
            weight: vec![1.0; n],
            time: vec![0.0; n],
            asked: n as u64,
            rays: n as u64,
            pixels: 1.0,
        }
    }

    /// What a scene needs that shows all of the tile at these levels.
    pub fn whole(levels: [f32; 2]) -> Need {
        let all = Cone { axis: [0.0, 0.0, 1.0], cosine: -1.0 };
        Need { tile: [128; 2], corner: [0; 2], size: [128; 2], levels, wi: all, wo: all, span: 128.0 }
    }

    #[test]
    fn far_scenes_need_coarse_levels_and_the_whole_tile() {
        let n = 4096;
        let u = (0..n).map(|k| [(k % 64) as f32 / 64.0, (k / 64) as f32 / 64.0]).collect();
        let need = Need::new(&demand(u, (0..n).map(|k| 2.3 + k as f32 / n as f32).collect()), 6).unwrap();
        assert_eq!((need.finest(), need.coarsest(), need.is_window()), (2, 4, false));
        assert_eq!(need.levels_from(2), 3);
        assert!(need.wi.holds([0.3, 0.0]) && !need.wi.holds([-0.3, 0.0]));
    }

    #[test]
    fn a_part_over_the_border_is_one_window() {
        let u = (0..1000).map(|k| [(0.9 + 0.2 * k as f32 / 1000.0).fract(), 0.4 + 1e-4 * k as f32]).collect();
        let need = Need::new(&demand(u, vec![0.6; 1000]), 6).unwrap();
        assert!(need.is_window(), "{need:?}");
        // Level 1 has 64 texels: columns 57 to 63 and 0 to 6, with two around them; as many rows around its 7.
        assert_eq!((need.corner[1], need.size), (110, [36, 36]), "{need:?}");
        assert_eq!(need.average(), Some(2));
        let domain = need.domain("near", 0.1);
        domain.validate(need.size, 2).unwrap();
    }

    #[test]
    fn what_is_never_shown_is_said() {
        let problem = Need::new(&demand(vec![], vec![]), 6).unwrap_err().to_string();
        assert!(problem.contains("rings") && problem.contains("never shows"), "{problem}");
    }

    #[test]
    fn quantiles_go_by_weight() {
        let (values, weight) = ([3.0, 1.0, 2.0], [1.0, 1.0, 8.0]);
        assert_eq!(quantiles(&values, &weight, [0.05, 0.5, 0.95]), [1.0, 2.0, 3.0]);
        assert_eq!(quantiles(&values, &[1.0, 8.0, 1.0], [0.5]), [1.0]);
    }
}
