//! Values by direct sums over patches and gradients by scattering windows, in float64; the latter by central differences.

use super::curve::{GUARD, LOG_FLOOR};
use super::*;
use crate::random::{Random, Stream};

/// Error of the kernel, of the value relative to itself and of gradients relative to the largest: differences of about
/// 0.05 of roots and logarithms near 1, each rounded to a few 1e-7.
const TOLERANCE: f64 = 1e-5;
/// What the perturbed twin adds to one sample of the prediction.
const NUDGE: f32 = 0.1;
/// The same for absolute responses: a smaller one may take from one response what it adds to another.
const PUSH: f32 = 4.0;
/// Error of central differences, relative to the largest gradient: third derivatives of roots near their guard.
const CENTRAL: f64 = 1e-6;
/// Step of the central differences; images are kept this far from every kink.
const STEP: f64 = 1e-6;
/// Largest piece whose gradient is checked by central differences, samples.
const SMALL: usize = 144;

const KINDS: [Kind; 5] = [Kind::L1, Kind::L2, Kind::L2Mean, Kind::Gradient, Kind::GradientLuma];
const REMAPS: [Remap; 6] = [
    Remap::Linear,
    Remap::Root4Literal,
    Remap::Root4Guarded,
    Remap::Root4Signed(1e-3),
    Remap::Sqrt(1e-3),
    Remap::Log,
];
/// Side and patch: windows or none, rows shorter and longer than vectors, tails, more than one block of sums.
const SHAPES: [(usize, usize); 12] =
    [(1, 1), (2, 1), (2, 2), (3, 3), (4, 2), (5, 5), (8, 8), (12, 6), (16, 4), (16, 16), (32, 32), (48, 16)];

type Planes = [Vec<f32>; 3];
type Planes64 = [Vec<f64>; 3];

#[derive(Clone)]
struct Case {
    terms: Vec<Term>,
    side: usize,
    patch: usize,
    weight: f32,
    prediction: Planes,
    target: Planes,
}

fn views(planes: &Planes) -> [&[f32]; 3] {
    [&planes[0], &planes[1], &planes[2]]
}

fn wide(planes: &Planes) -> Planes64 {
    planes.clone().map(|plane| plane.into_iter().map(f64::from).collect())
}

impl Case {
    /// Images away from every kink: 0, the guards, and each other.
    fn new(terms: Vec<Term>, side: usize, patch: usize) -> Self {
        let literal = terms.iter().any(|term| term.remap == Remap::Root4Literal);
        let mut random = Random::new(5, Stream::Probe, 0);
        let (mut prediction, mut target) = (Planes::default(), Planes::default());
        for c in 0..3 {
            for _ in 0..side * side {
                let value = 0.1 + random.uniform();
                let sign = if random.uniform() < 0.5 { -1.0 } else { 1.0 };
                let moved = value + sign * (0.02 + 0.06 * random.uniform());
                let flip = random.uniform() < 0.3 && !literal;
                prediction[c].push(if flip { -0.5 * moved } else { moved });
                target[c].push(value);
            }
        }
        Self { terms, side, patch, weight: 0.5, prediction, target }
    }

    fn run(&self, isa: Isa, scratch: &mut Scratch) -> (f64, Planes) {
        let n = self.side * self.side;
        // What is there must be overwritten, and what lies beyond must not.
        let mut gradient: Planes = std::array::from_fn(|_| vec![f32::NAN; n + 1]);
        let [r, g, b] = &mut gradient;
        let (prediction, target) = (views(&self.prediction), views(&self.target));
        let (side, patch, weight) = (self.side, self.patch, self.weight);
        let loss = run(isa, &self.terms, side, patch, weight, prediction, target, [r, g, b], scratch);
        for plane in &mut gradient {
            assert!(plane.pop().unwrap().is_nan());
        }
        (loss, gradient)
    }

    /// Centres of the windows that lie inside one patch.
    fn windows(&self) -> Vec<(usize, usize)> {
        let inside = |x: &usize| (1..self.patch.max(2) - 1).contains(&(x % self.patch));
        let line: Vec<usize> = (0..self.side).filter(inside).collect();
        line.iter().flat_map(|&y| line.iter().map(move |&x| (y, x))).collect()
    }

    fn difference(&self, remap: Remap, prediction: &Planes64) -> Planes64 {
        let target = wide(&self.target);
        std::array::from_fn(|c| {
            prediction[c]
                .iter()
                .zip(&target[c])
                .map(|(p, t)| remap64(*p, remap) - remap64(*t, remap))
                .collect()
        })
    }

    /// The residuals of L2Mean, weighted by slopes at the case's own prediction wherever the residuals are taken.
    fn residuals(&self, remap: Remap, prediction: &Planes64) -> Planes64 {
        let (held, target) = (wide(&self.prediction), wide(&self.target));
        std::array::from_fn(|c| {
            let each = prediction[c].iter().zip(&target[c]).zip(&held[c]);
            each.map(|((p, t), held)| (p - t) * held64(*held, remap)).collect()
        })
    }

    fn value64(&self, prediction: &Planes64) -> f64 {
        let mut loss = 0.0;
        for term in &self.terms {
            let difference = match term.kind {
                Kind::L2Mean => self.residuals(term.remap, prediction),
                _ => self.difference(term.remap, prediction),
            };
            let pixelwise = |f: fn(f64) -> f64| difference.iter().flatten().map(|d| f(*d)).sum::<f64>();
            let errors: f64 = match term.kind {
                Kind::L1 => pixelwise(f64::abs),
                Kind::L2 | Kind::L2Mean => pixelwise(|d| d * d),
                Kind::Gradient => self
                    .windows()
                    .into_iter()
                    .flat_map(|at| difference.each_ref().map(|plane| sobel64(plane, self.side, at)))
                    .map(|[x, y]| x * x + y * y)
                    .sum(),
                Kind::GradientLuma => {
                    let luma = luma64(&difference);
                    let windows = self.windows().into_iter().map(|at| sobel64(&luma, self.side, at));
                    windows.map(|[x, y]| 0.5 * (x.abs() + y.abs())).sum()
                }
            };
            loss += f64::from(term.scale) * f64::from(self.weight) * errors;
        }
        loss
    }

    fn gradient64(&self, prediction: &Planes64) -> Planes64 {
        let mut gradient: Planes64 = prediction.each_ref().map(|plane| vec![0.0; plane.len()]);
        for term in &self.terms {
            let difference = match term.kind {
                Kind::L2Mean => self.residuals(term.remap, prediction),
                _ => self.difference(term.remap, prediction),
            };
            let mut of_difference: Planes64 = prediction.each_ref().map(|plane| vec![0.0; plane.len()]);
            for (c, to) in of_difference.iter_mut().enumerate() {
                let luma = [0.299, 0.587, 0.114][c];
                match term.kind {
                    Kind::L1 => *to = difference[c].iter().map(|d| d.signum()).collect(),
                    Kind::L2 | Kind::L2Mean => *to = difference[c].iter().map(|d| 2.0 * d).collect(),
                    Kind::Gradient => {
                        let back = |[x, y]: [f64; 2]| [2.0 * x, 2.0 * y];
                        self.scatter(&difference[c], back, to);
                    }
                    Kind::GradientLuma => {
                        let back = |[x, y]: [f64; 2]| [0.5 * luma * x.signum(), 0.5 * luma * y.signum()];
                        self.scatter(&luma64(&difference), back, to);
                    }
                }
                let factor = f64::from(term.scale) * f64::from(self.weight);
                let slope = match term.kind {
                    Kind::L2Mean => held64,
                    _ => slope64,
                };
                for k in 0..to.len() {
                    gradient[c][k] += factor * to[k] * slope(prediction[c][k], term.remap);
                }
            }
        }
        gradient
    }

    fn scatter(&self, plane: &[f64], back: impl Fn([f64; 2]) -> [f64; 2], to: &mut [f64]) {
        for at in self.windows() {
            let [x, y] = back(sobel64(plane, self.side, at));
            for (k, [of_x, of_y]) in window(self.side, at) {
                to[k] += of_x * x + of_y * y;
            }
        }
    }

    fn central64(&self) -> Planes64 {
        let mut x = wide(&self.prediction);
        let mut gradient = x.clone();
        for c in 0..3 {
            for k in 0..x[c].len() {
                let at = x[c][k];
                x[c][k] = at + STEP;
                let up = self.value64(&x);
                x[c][k] = at - STEP;
                gradient[c][k] = (up - self.value64(&x)) / (2.0 * STEP);
                x[c][k] = at;
            }
        }
        gradient
    }

    /// Largest error of value and gradient against float64 with `nudge` added to one sample of the prediction.
    fn worst(&self, isa: Isa, nudge: f32) -> f64 {
        let exact = wide(&self.prediction);
        let (value, gradient) = (self.value64(&exact), self.gradient64(&exact));
        let mut moved = self.clone();
        moved.prediction[0][1.min(self.side - 1)] += nudge;
        let (got, slopes) = moved.run(isa, &mut Scratch::new(self.side));
        far(&wide(&slopes), &gradient).max(((got - value) / value).abs())
    }
}

const SOBEL: [[f64; 3]; 3] = [[1.0, 0.0, -1.0], [2.0, 0.0, -2.0], [1.0, 0.0, -1.0]];

/// Elements of a window and their weights in Sobel-x and Sobel-y.
fn window(side: usize, (row, column): (usize, usize)) -> [(usize, [f64; 2]); 9] {
    std::array::from_fn(|k| {
        let (i, j) = (k / 3, k % 3);
        ((row + i - 1) * side + column + j - 1, [SOBEL[i][j], SOBEL[j][i]])
    })
}

fn sobel64(plane: &[f64], side: usize, at: (usize, usize)) -> [f64; 2] {
    let (mut x, mut y) = (0.0, 0.0);
    for (k, [of_x, of_y]) in window(side, at) {
        x += of_x * plane[k];
        y += of_y * plane[k];
    }
    [x, y]
}

fn luma64([r, g, b]: &Planes64) -> Vec<f64> {
    (0..r.len()).map(|k| 0.299 * r[k] + 0.587 * g[k] + 0.114 * b[k]).collect()
}

fn remap64(x: f64, remap: Remap) -> f64 {
    let signed = |e: f32, p: f64| x.signum() * ((x.abs() + f64::from(e)).powf(p) - f64::from(e).powf(p));
    match remap {
        Remap::Linear => x,
        Remap::Root4Literal => x.powf(0.25),
        Remap::Root4Guarded => x.max(1e-7).powf(0.25),
        Remap::Root4Signed(e) => signed(e, 0.25),
        Remap::Sqrt(e) => signed(e, 0.5),
        Remap::Log => (1.0 + x.max(-0.1)).ln(),
    }
}

fn slope64(x: f64, remap: Remap) -> f64 {
    match remap {
        Remap::Linear => 1.0,
        Remap::Root4Literal => 0.25 * x.powf(-0.75),
        Remap::Root4Guarded if x < f64::from(GUARD) => 0.0,
        Remap::Root4Guarded => 0.25 * x.powf(-0.75),
        Remap::Root4Signed(e) => 0.25 * (x.abs() + f64::from(e)).powf(-0.75),
        Remap::Sqrt(e) => 0.5 * (x.abs() + f64::from(e)).powf(-0.5),
        Remap::Log if x < f64::from(LOG_FLOOR) => 0.0,
        Remap::Log => 1.0 / (1.0 + x),
    }
}

/// The slope that L2Mean weighs by: past a guard, the slope at it.
fn held64(x: f64, remap: Remap) -> f64 {
    match remap {
        Remap::Root4Guarded => slope64(x.max(f64::from(GUARD)), remap),
        Remap::Log => slope64(x.max(f64::from(LOG_FLOOR)), remap),
        _ => slope64(x, remap),
    }
}

/// Largest difference, relative to the largest of `b`; NaN is far.
fn far(a: &Planes64, b: &Planes64) -> f64 {
    let largest = b.iter().flatten().fold(0.0f64, |m, x| m.max(x.abs()));
    let apart = a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (a - b).abs() / largest);
    apart.fold(0.0, |m, x| if x <= m { m } else { x })
}

fn each(mut check: impl FnMut(Case)) {
    for (side, patch) in SHAPES {
        for kind in KINDS {
            for remap in REMAPS {
                // A configuration cannot ask for it: the weight is up to 35,000.
                if kind == Kind::L2Mean && remap == Remap::Root4Guarded {
                    continue;
                }
                check(Case::new(vec![Term { kind, remap, scale: 0.7 / (side * side) as f32 }], side, patch));
            }
        }
    }
}

fn is_pointwise(kind: Kind) -> bool {
    matches!(kind, Kind::L1 | Kind::L2 | Kind::L2Mean)
}

/// Terms of all kinds, two of one kind, remaps that are shared and that differ by their epsilon.
fn mixture() -> Vec<Term> {
    let term = |kind, remap, scale| Term { kind, remap, scale };
    vec![
        term(Kind::L2, Remap::Root4Signed(1e-3), 1.0),
        term(Kind::L1, Remap::Linear, 0.1),
        term(Kind::Gradient, Remap::Root4Signed(1e-3), 0.03),
        term(Kind::GradientLuma, Remap::Linear, 0.2),
        term(Kind::L2, Remap::Root4Signed(1e-2), 0.5),
        term(Kind::L1, Remap::Root4Signed(1e-3), 0.3),
        term(Kind::L1, Remap::Linear, 0.4),
        term(Kind::GradientLuma, Remap::Root4Signed(1e-3), 0.1),
        term(Kind::L2, Remap::Log, 0.9),
        term(Kind::L2Mean, Remap::Root4Signed(1e-2), 0.05),
        term(Kind::L2Mean, Remap::Log, 0.4),
        term(Kind::L2Mean, Remap::Linear, 0.2),
    ]
}

#[test]
fn the_reference_gradient_agrees_with_central_differences_and_notices_a_nudge() {
    each(|case| {
        if case.side * case.side > SMALL || (case.windows().is_empty() && !is_pointwise(case.terms[0].kind)) {
            return;
        }
        let (mut exact, central) = (case.gradient64(&wide(&case.prediction)), case.central64());
        let found = far(&exact, &central);
        assert!(found < CENTRAL, "{:?} {} {found:e}", case.terms, case.side);
        exact[2][0] += 1e-3 * central[2].iter().fold(0.1, |m, x| x.abs().max(m));
        assert!(far(&exact, &central) > CENTRAL);
    });
}

#[test]
fn values_and_gradients_follow_float64_and_a_nudged_prediction_does_not() {
    each(|case| {
        for isa in Isa::all() {
            if case.windows().is_empty() && !is_pointwise(case.terms[0].kind) {
                let (loss, gradient) = case.run(isa, &mut Scratch::default());
                assert!(loss == 0.0 && gradient.iter().flatten().all(|g| *g == 0.0));
                continue;
            }
            let nudge = if case.terms[0].kind == Kind::GradientLuma { PUSH } else { NUDGE };
            let (error, nudged) = (case.worst(isa, 0.0), case.worst(isa, nudge));
            let what = format!("{} {:?} {} {}", isa.name(), case.terms, case.side, case.patch);
            assert!(error < TOLERANCE, "{what} {error:e}");
            assert!(nudged > TOLERANCE, "{what} {nudged:e}");
        }
    });
}

#[test]
fn terms_add_up_and_a_nudged_prediction_is_noticed() {
    for (side, patch) in SHAPES {
        for isa in Isa::all() {
            let case = Case::new(mixture(), side, patch);
            let error = case.worst(isa, 0.0);
            assert!(error < TOLERANCE, "{} {side} {patch} {error:e}", isa.name());
            assert!(case.worst(isa, NUDGE) > TOLERANCE, "{} {side} {patch}", isa.name());
        }
    }
}

#[test]
fn without_terms_or_weight_everything_is_zero() {
    for isa in Isa::all() {
        for (terms, weight) in [(vec![], 0.5), (mixture(), 0.0), (mixture(), -0.0)] {
            let mut case = Case { weight, ..Case::new(terms, 5, 5) };
            if weight == 0.0 {
                case.prediction[1][7] = f32::NAN;
            }
            let (loss, gradient) = case.run(isa, &mut Scratch::new(5));
            assert!(loss == 0.0 && gradient.iter().flatten().all(|g| *g == 0.0));
        }
        let empty = Case {
            side: 0,
            prediction: Planes::default(),
            target: Planes::default(),
            ..Case::new(mixture(), 5, 5)
        };
        assert_eq!(empty.run(isa, &mut Scratch::new(0)).0, 0.0);
    }
}

#[test]
fn a_scratch_keeps_nothing_of_earlier_calls() {
    for isa in Isa::all() {
        let mut scratch = Scratch::new(7);
        for (side, patch) in SHAPES.into_iter().chain(SHAPES.into_iter().rev()) {
            let case = Case::new(mixture(), side, patch);
            let mut poisoned = case.clone();
            poisoned.prediction.iter_mut().for_each(|plane| plane.fill(f32::NAN));
            assert!(poisoned.run(isa, &mut scratch).0.is_nan());
            assert_eq!(case.run(isa, &mut scratch), case.run(isa, &mut Scratch::new(side)));
        }
    }
}

#[test]
fn what_is_no_number_reaches_the_loss_and_stays_in_its_patch() {
    let scale = 1.0;
    for isa in Isa::all() {
        for (side, patch) in [(1, 1), (5, 5), (12, 6), (16, 16)] {
            for (kind, remap) in KINDS.into_iter().flat_map(|kind| REMAPS.map(|remap| (kind, remap))) {
                if patch < 3 && !is_pointwise(kind) {
                    continue;
                }
                let clean = Case::new(vec![Term { kind, remap, scale }], side, patch);
                let mut scratch = Scratch::new(side);
                for k in [0, side / 2 * side + side / 2, side * side - 1] {
                    let what = format!("{} {kind:?} {remap:?} {side} {patch} {k}", isa.name());
                    let mut case = clean.clone();
                    case.target[1][k] = f32::NAN;
                    assert!(case.run(isa, &mut scratch).0.is_nan(), "{what}");
                    let mut case = clean.clone();
                    case.prediction[1][k] = f32::NAN;
                    let (loss, gradient) = case.run(isa, &mut scratch);
                    assert!(loss.is_nan() && gradient[1][k].is_nan(), "{what}");
                    let of = |k: usize| (k / side / patch, k % side / patch);
                    let others = (0..side * side).filter(|other| of(*other) != of(k));
                    assert!(others.into_iter().all(|k| gradient[1][k].is_finite()), "{what}");
                    case.prediction[1][k] = f32::INFINITY;
                    assert!(!case.run(isa, &mut scratch).0.is_finite(), "{what}");
                }
            }
        }
    }
}

#[test]
fn kinks_and_guards() {
    for isa in Isa::all() {
        let run = |kind, remap, prediction: f32, target: f32| {
            let mut case = Case::new(vec![Term { kind, remap, scale: 1.0 }], 1, 1);
            case.prediction[0][0] = prediction;
            case.target[0][0] = target;
            case.weight = 1.0;
            let (loss, gradient) = case.run(isa, &mut Scratch::new(1));
            (loss, f64::from(gradient[0][0]))
        };
        let near = |a: f64, b: f64| (a / b - 1.0).abs() < TOLERANCE;
        for kind in [Kind::L1, Kind::L2] {
            // The paper's root as printed: the trainer is to see what it does to training.
            let (loss, slope) = run(kind, Remap::Root4Literal, -1e-3, 0.5);
            assert!(loss.is_nan() && slope.is_nan());
            assert!(!run(kind, Remap::Root4Literal, 0.0, 0.5).1.is_finite());
            for (remap, least) in [(Remap::Root4Guarded, GUARD), (Remap::Log, LOG_FLOOR)] {
                assert_eq!(run(kind, remap, least - 1e-3, 0.5).1, 0.0);
                let above = run(kind, remap, least + f32::EPSILON * least.abs(), 0.5).1;
                assert!(near(run(kind, remap, least, 0.5).1 * 2.0, above));
            }
        }
        for remap in REMAPS {
            assert_eq!(run(Kind::L1, remap, 0.5, 0.5).1, 0.0);
        }
        for remap in [Remap::Root4Signed(1e-3), Remap::Sqrt(1e-3)] {
            let (loss, slope) = run(Kind::L1, remap, 0.0, 0.5);
            assert!(near(-slope, slope64(0.0, remap)));
            assert!(!near(-slope, slope64(1e-4, remap)));
            // Odd, and 0 at 0: the same distance from 0 to either side.
            assert_eq!(loss, run(Kind::L1, remap, 0.0, -0.5).0);
            assert_eq!(loss, run(Kind::L1, remap, -0.0, 0.5).0);
        }
    }
}

/// The prediction of one sample under which noisy targets have the least loss, found by bisection on the gradient's sign.
fn least(isa: Isa, kind: Kind, remap: Remap, targets: &[f32]) -> f32 {
    let side = targets.len().isqrt();
    let mut case = Case::new(vec![Term { kind, remap, scale: 1.0 }], side, 1);
    case.target.iter_mut().for_each(|plane| plane.copy_from_slice(targets));
    let (mut low, mut high) = (0.0f32, 10.0f32);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        case.prediction.iter_mut().for_each(|plane| plane.fill(middle));
        let gradient: f32 = case.run(isa, &mut Scratch::new(side)).1[0].iter().sum();
        if gradient < 0.0 { low = middle } else { high = middle }
    }
    low
}

#[test]
fn l2_mean_is_least_at_the_mean_and_other_losses_of_remapped_values_are_not() {
    /// f32 sums of the gradients of 64 targets.
    const MEAN: f32 = 1e-4;
    let mut random = Random::new(6, Stream::Probe, 0);
    // Mostly small with a few large ones, as one light path a sample gives.
    let targets: Vec<f32> = (0..64).map(|_| random.uniform().powi(6) * 8.0).collect();
    let mean = targets.iter().sum::<f32>() / 64.0;
    for isa in Isa::all() {
        for remap in [Remap::Linear, Remap::Root4Signed(1e-3), Remap::Sqrt(1e-2), Remap::Log] {
            let off = |kind| (least(isa, kind, remap, &targets) / mean - 1.0).abs();
            assert!(off(Kind::L2Mean) < MEAN, "{} {remap:?} {}", isa.name(), off(Kind::L2Mean));
            assert!(remap == Remap::Linear || off(Kind::L2) > 100.0 * MEAN, "{remap:?}");
            assert!(off(Kind::L1) > 100.0 * MEAN, "{remap:?}");
        }
    }
}
