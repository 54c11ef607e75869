//! Which directions are asked.

use super::histogram::Histogram;
use crate::query::above_horizon;
use serde::Serialize;

/// Cells along a side of the square around the disc.
pub(super) const CELLS: usize = 32;
/// The part that the narrower cones hold.
const MOST: f64 = 0.99;
/// Steps towards the narrowest cone; its angle is within their reciprocal of the least one.
const STEPS: usize = 100;
/// Degrees above the horizon where views and lights graze.
const GRAZING: f64 = 10.0;

/// Directions of one kind, as points (x, y) of the disc of the hemisphere.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Directions {
    /// 32 x 32 cells of the square around the disc, row by row, the first at the smallest y.
    pub disc: Histogram,
    /// Cells of the disc in which something is asked, as a share of those that lie in it, in part or as a whole.
    pub cells: f64,
    /// Queries on or below the horizon, which have no place in the disc and whose answer is 0, as a share of all.
    pub below: f64,
    /// Queries within 10 degrees above the horizon, as a share of all.
    pub grazing: f64,
    /// What holds all above the horizon; None if none is.
    pub all: Option<Cone>,
    /// What holds 99 % of their number.
    pub most: Option<Cone>,
    /// What holds 99 % of their weight; None if they have none.
    pub most_of_weight: Option<Cone>,
}

/// A narrow cone of directions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Cone {
    /// Its axis.
    pub axis: [f64; 3],
    /// Least cosine between the axis and what it holds.
    pub cosine: f64,
}

impl Cone {
    /// Degrees between the axis and the mantle.
    pub fn degrees(&self) -> f64 {
        self.cosine.clamp(-1.0, 1.0).acos().to_degrees()
    }

    /// Degrees between the axis and the normal.
    pub fn tilt(&self) -> f64 {
        self.axis[2].clamp(-1.0, 1.0).acos().to_degrees()
    }
}

impl Directions {
    pub(super) fn new(w: &[[f32; 2]], weight: &[f64]) -> Self {
        let above: Vec<([f64; 3], f64)> = w
            .iter()
            .zip(weight)
            .filter(|(w, _)| above_horizon(**w))
            .map(|(w, weight)| {
                let [x, y] = w.map(f64::from);
                ([x, y, (1.0 - x * x - y * y).max(0.0).sqrt()], *weight)
            })
            .collect();
        let place = |x: f64| (((x + 1.0) / 2.0 * CELLS as f64) as usize).min(CELLS - 1);
        let bins = above.iter().map(|(w, weight)| (place(w[1]) * CELLS + place(w[0]), *weight));
        let disc = Histogram::of(CELLS * CELLS, bins);
        let cells = (0..CELLS * CELLS).filter(|k| in_disc(*k)).count();
        let asked = disc.queries.iter().filter(|n| **n > 0).count();
        let lowest = GRAZING.to_radians().sin();
        let grazing = above.iter().filter(|(w, _)| w[2] < lowest).count();
        let of = |count: usize| count as f64 / w.len().max(1) as f64;
        let counted: Vec<([f64; 3], f64)> = above.iter().map(|(w, _)| (*w, 1.0)).collect();
        Self {
            cells: asked as f64 / cells as f64,
            below: of(w.len() - above.len()),
            grazing: of(grazing),
            all: cone(&counted, 1.0),
            most: cone(&counted, MOST),
            most_of_weight: cone(&above, MOST),
            disc,
        }
    }
}

/// True for the cells that the open disc meets.
pub(super) fn in_disc(cell: usize) -> bool {
    // The corner next to the centre.
    let near = |k: usize| {
        let (low, high) = (2 * k as i64 - CELLS as i64, 2 * (k + 1) as i64 - CELLS as i64);
        if low >= 0 { low } else { -high }
    };
    let (x, y) = (near(cell % CELLS), near(cell / CELLS));
    x * x + y * y < (CELLS * CELLS) as i64
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn unit(v: [f64; 3]) -> Option<[f64; 3]> {
    let length = dot(v, v).sqrt();
    (length > 0.0).then(|| v.map(|x| x / length))
}

/// The narrowest cone around the `share` of the weight that lies nearest to the mean direction.
fn cone(all: &[([f64; 3], f64)], share: f64) -> Option<Cone> {
    let mut sum = [0.0; 3];
    for (w, weight) in all {
        (0..3).for_each(|c| sum[c] += w[c] * weight);
    }
    let mean = unit(sum)?;
    let mut near: Vec<(f64, [f64; 3], f64)> = all
        .iter()
        .filter(|(_, weight)| *weight > 0.0)
        .map(|(w, weight)| (dot(*w, mean), *w, *weight))
        .collect();
    near.sort_by(|a, b| b.0.total_cmp(&a.0));
    let total: f64 = near.iter().map(|(_, _, weight)| weight).sum();
    let mut held = 0.0;
    let last = near.iter().position(|(_, _, weight)| {
        held += weight;
        share < 1.0 && held >= share * total
    });
    near.truncate(last.map_or(near.len(), |last| last + 1));
    narrowest(&near, mean)
}

/// Badoiu and Clarkson's walk towards what lies farthest, on the sphere; the best axis on the way.
fn narrowest(near: &[(f64, [f64; 3], f64)], mean: [f64; 3]) -> Option<Cone> {
    let (mut axis, mut best) = (mean, None::<Cone>);
    for step in 1..=STEPS {
        let farthest = near.iter().map(|(_, w, _)| (dot(*w, axis), *w)).min_by(|a, b| a.0.total_cmp(&b.0))?;
        if best.is_none_or(|best| farthest.0 > best.cosine) {
            best = Some(Cone { axis, cosine: farthest.0.min(1.0) });
        }
        let part = 1.0 / (step + 1) as f64;
        axis = unit(std::array::from_fn(|c| axis[c] + part * (farthest.1[c] - axis[c])))?;
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Directions come in single precision; the walk ends within a hundredth of the radius.
    const NEAR: f64 = 0.01;

    /// A direction so many degrees from the normal.
    fn at(tilt: f64, pan: f64) -> [f32; 2] {
        let (sin, pan) = (tilt.to_radians().sin(), pan.to_radians());
        [(sin * pan.cos()) as f32, (sin * pan.sin()) as f32]
    }

    #[test]
    fn one_direction_is_a_cone_without_width() {
        let directions = Directions::new(&[at(40.0, 70.0); 5], &[0.5; 5]);
        let cone = directions.all.unwrap();
        assert!(cone.degrees() < NEAR && (cone.tilt() - 40.0).abs() < NEAR, "{cone:?}");
        assert!((cone.tilt() - 40.1).abs() > NEAR);
        assert_eq!(directions.disc.queries.iter().sum::<u64>(), 5);
        let moved = Directions::new(&[at(40.0, 70.0), at(41.0, 70.0)], &[0.5; 2]);
        assert!(moved.all.unwrap().degrees() > NEAR);
    }

    #[test]
    fn a_cone_is_as_narrow_as_what_it_holds_however_that_is_spread() {
        // An arc from the normal to 60 degrees, almost all of it at the normal: the mean is far from its middle.
        let mut arc = vec![at(0.0, 0.0); 50];
        arc.extend((0..=60).map(|k| at(f64::from(k), 30.0)));
        let cone = Directions::new(&arc, &vec![1.0; arc.len()]).all.unwrap();
        let apart = |degrees: f64| (cone.degrees() / degrees - 1.0).abs();
        assert!(apart(30.0) < NEAR, "{cone:?}");
        assert!(apart(29.0) > NEAR);
        // Nothing is outside.
        let unit = |w: [f32; 2]| {
            let [x, y] = w.map(f64::from);
            [x, y, (1.0 - x * x - y * y).sqrt()]
        };
        assert!(arc.iter().all(|w| dot(unit(*w), cone.axis) >= cone.cosine - 1e-12));
    }

    #[test]
    fn few_far_directions_widen_only_the_cone_of_all() {
        let mut w: Vec<[f32; 2]> = (0..1000).map(|k| at(10.0, f64::from(k))).collect();
        w.extend([at(80.0, 0.0), at(85.0, 90.0)]);
        let mut weight = vec![1.0; w.len()];
        let directions = Directions::new(&w, &weight);
        assert!((directions.most.unwrap().degrees() - 10.0).abs() < 0.1);
        assert!(directions.all.unwrap().degrees() > 40.0);
        assert_eq!(directions.grazing, 1.0 / 1002.0);
        // By weight they may be most.
        weight[1000] = 1e5;
        weight[1001] = 1e5;
        assert!(Directions::new(&w, &weight).most_of_weight.unwrap().degrees() > 30.0);
    }

    #[test]
    fn what_is_below_the_horizon_is_counted_apart() {
        let directions = Directions::new(&[[0.0, 0.0], [1.5, 0.0], [0.0, -1.0]], &[1.0; 3]);
        assert_eq!(directions.below, 2.0 / 3.0);
        assert_eq!(directions.disc.queries.iter().sum::<u64>(), 1);
        let none = Directions::new(&[[2.0, 0.0]], &[1.0]);
        assert_eq!((none.all, none.most_of_weight, none.cells), (None, None, 0.0));
        // The cells in the corners are not of the disc; those that it touches are.
        assert!(!in_disc(0) && in_disc(16) && in_disc(16 * CELLS + 16) && !in_disc(CELLS * CELLS - 1));
        let area = (0..CELLS * CELLS).filter(|k| in_disc(*k)).count() as f64 / (CELLS * CELLS) as f64;
        assert!(area > std::f64::consts::FRAC_PI_4 && area < 0.9, "{area}");
    }
}
