//! Losses of training on patches, value and gradient in one pass (paper, equations 1 and 2).
//!
//! Terms that share a remap are evaluated together. A plane is flat: the neighbours of sample i are i - 1, i + 1, i - side
//! and i + side, and a mask keeps the Sobel windows that lie inside one patch, so vectors need not care where a row ends.

mod curve;
#[cfg(test)]
mod tests;

use super::simd::{Isa, Simd, Work, dispatch};
use curve::{Curve, absolute, sign};

/// Rec. 601 luma.
const LUMA: [f32; 3] = [0.299, 0.587, 0.114];
/// Lanes of the widest instruction set; planes are padded to a multiple of it.
const WIDEST: usize = 16;
/// Samples whose errors are summed in f32 lanes; from there on sums are in f64.
const BLOCK: usize = 1024;

/// What a term compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Absolute difference.
    L1,
    /// Squared difference.
    L2,
    /// Squared linear difference times the slope of the remap at the prediction, which is held constant.
    L2Mean,
    /// Squared difference of Sobel-x and Sobel-y responses, RGB (paper, equation 1).
    Gradient,
    /// Absolute difference of half-strength Sobel responses of luma (authors' code).
    GradientLuma,
}

/// Output remapping (paper, section 3.2).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Remap {
    /// x.
    Linear,
    /// x^(1/4) as printed: not a number below 0, infinite slope at 0.
    Root4Literal,
    /// max(x, 1e-7)^(1/4) (authors' code).
    Root4Guarded,
    /// sign(x) ((|x| + epsilon)^(1/4) - epsilon^(1/4)).
    Root4Signed(f32),
    /// sign(x) ((|x| + epsilon)^(1/2) - epsilon^(1/2)).
    Sqrt(f32),
    /// ln(1 + max(x, -0.1)).
    Log,
}

/// One term of the loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Term {
    /// What is compared.
    pub kind: Kind,
    /// Applied to prediction and target first.
    pub remap: Remap,
    /// The term's weight over the batch's count: 3 a pixel for L1, L2 and L2Mean, 3 an interior pixel for Gradient, 1 an interior
    /// pixel for GradientLuma. Not looked at where a piece has no interior pixel.
    pub scale: f32,
}

/// Buffers that calls share; what they hold between calls does not matter.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    side: usize,
    patch: usize,
    /// Elements before and after the samples of a plane, as far as a window reaches.
    margin: usize,
    /// 1 at the interior samples of patches, without margins.
    interior: Vec<f32>,
    /// Differences of the remapped planes.
    difference: [Vec<f32>; 3],
    /// Slopes of the remap at the prediction.
    slope: [Vec<f32>; 3],
    luma: Vec<f32>,
    /// d loss / d Sobel-x and Sobel-y response, 0 but at the interior samples.
    response: [Vec<f32>; 2],
}

impl Scratch {
    /// Buffers for pieces of `side` x `side` samples; a piece of another side allocates anew.
    pub fn new(side: usize) -> Self {
        let mut scratch = Self::default();
        scratch.prepare(side, side);
        scratch
    }

    fn prepare(&mut self, side: usize, patch: usize) {
        if (side, patch) == (self.side, self.patch) {
            return;
        }
        let padded = (side * side).next_multiple_of(WIDEST);
        if side != self.side {
            // Margins are read but never written: zeros once and for all.
            self.margin = (side + 1).next_multiple_of(WIDEST);
            let planes = self.difference.iter_mut().chain(&mut self.slope).chain(&mut self.response);
            for plane in planes.chain([&mut self.luma]) {
                plane.clear();
                plane.resize(padded + 2 * self.margin, 0.0);
            }
        }
        self.interior.clear();
        self.interior.resize(padded, 0.0);
        if patch > 2 {
            let inside = |x: usize| (1..patch - 1).contains(&(x % patch));
            let line: Vec<f32> = (0..side).map(|x| f32::from(inside(x))).collect();
            for (y, row) in self.interior[..side * side].chunks_exact_mut(side).enumerate() {
                if inside(y) {
                    row.copy_from_slice(&line);
                }
            }
        }
        (self.side, self.patch) = (side, patch);
    }
}

/// The terms of one remap, their factors added up by kind.
#[derive(Clone, Copy)]
struct Group {
    remap: Remap,
    l1: f32,
    l2: f32,
    l2_mean: f32,
    gradient: f32,
    luma: f32,
}

impl Group {
    /// The terms that have the remap of `terms[0]`, for a piece of the given weight.
    #[inline(always)]
    fn new(terms: &[Term], weight: f32, has_interior: bool) -> Self {
        let mut group =
            Self { remap: terms[0].remap, l1: 0.0, l2: 0.0, l2_mean: 0.0, gradient: 0.0, luma: 0.0 };
        for term in terms {
            if term.remap == group.remap {
                match term.kind {
                    Kind::L1 => group.l1 += term.scale * weight,
                    Kind::L2 => group.l2 += term.scale * weight,
                    Kind::L2Mean => group.l2_mean += term.scale * weight,
                    Kind::Gradient if has_interior => group.gradient += term.scale * weight,
                    Kind::GradientLuma if has_interior => group.luma += term.scale * weight,
                    Kind::Gradient | Kind::GradientLuma => {}
                }
            }
        }
        group
    }

    fn has_windows(self) -> bool {
        self.gradient != 0.0 || self.luma != 0.0
    }
}

/// The loss of one piece of `side` x `side` samples in patches of side `patch`, and its gradient.
///
/// Planes are R, G and B, row by row, linear and not clamped; each must hold `side * side` values, and `patch` must divide
/// `side`. Writes d loss / d prediction to `gradient` and returns the piece's share of the loss: the sum over terms of
/// scale * weight * errors. Without a weight both are 0, whatever the planes hold. A value that is no number makes the loss
/// none, and so does an infinite one unless a guard bounds it. The order of all sums is fixed for each instruction set.
#[expect(clippy::too_many_arguments, reason = "what a piece is made of, held by the caller in parts")]
#[inline(always)]
pub fn piece<S: Simd>(
    s: S,
    terms: &[Term],
    side: usize,
    patch: usize,
    weight: f32,
    prediction: [&[f32]; 3],
    target: [&[f32]; 3],
    mut gradient: [&mut [f32]; 3],
    scratch: &mut Scratch,
) -> f64 {
    let n = side * side;
    for plane in &mut gradient {
        plane[..n].fill(0.0);
    }
    if weight == 0.0 || n == 0 {
        return 0.0;
    }
    scratch.prepare(side, patch);
    let samples = scratch.margin..scratch.margin + n.next_multiple_of(WIDEST);
    let mut loss = 0.0;
    for first in 0..terms.len() {
        let remap = terms[first].remap;
        if terms[..first].iter().any(|term| term.remap == remap) {
            continue;
        }
        let group = Group::new(&terms[first..], weight, patch > 2);
        for c in 0..3 {
            let (difference, slope) = (&mut scratch.difference[c], &mut scratch.slope[c]);
            let (difference, slope) = (&mut difference[samples.clone()], &mut slope[samples.clone()]);
            loss += pointwise(
                s,
                group,
                [&prediction[c][..n], &target[c][..n]],
                &mut gradient[c][..n],
                [difference, slope],
            );
        }
        if group.gradient != 0.0 {
            for c in 0..3 {
                let Scratch { side, interior, difference, slope, response, .. } = scratch;
                loss += responses::<S, true>(s, &difference[c], interior, *side, group.gradient, response);
                for at in (0..n).step_by(S::LANES) {
                    let back = adjoint(s, response, *side, samples.start + at);
                    let step = s.mul(back, s.load(&slope[c][samples.start + at..]));
                    add(s, gradient[c], at, n, step);
                }
            }
        }
        if group.luma != 0.0 {
            let Scratch { side, interior, difference, slope, luma, response, .. } = scratch;
            for at in samples.clone().step_by(S::LANES) {
                let mut sum = s.mul(s.load(&difference[0][at..]), s.splat(LUMA[0]));
                for c in 1..3 {
                    sum = s.fma(s.load(&difference[c][at..]), s.splat(LUMA[c]), sum);
                }
                s.store(&mut luma[at..], sum);
            }
            loss += responses::<S, false>(s, luma, interior, *side, group.luma, response);
            for at in (0..n).step_by(S::LANES) {
                let back = adjoint(s, response, *side, samples.start + at);
                for c in 0..3 {
                    let slope = s.load(&slope[c][samples.start + at..]);
                    add(s, gradient[c], at, n, s.mul(s.mul(back, s.splat(LUMA[c])), slope));
                }
            }
        }
    }
    loss
}

/// L1, L2 and L2Mean of one channel: adds the gradient, returns the loss, and leaves differences and slopes for windows.
#[inline(always)]
fn pointwise<S: Simd>(
    s: S,
    group: Group,
    [prediction, target]: [&[f32]; 2],
    gradient: &mut [f32],
    [differences, slopes]: [&mut [f32]; 2],
) -> f64 {
    let n = prediction.len();
    let curve = Curve::new(s, group.remap);
    let (keep, remapped) = (group.has_windows(), group.l1 != 0.0 || group.l2 != 0.0);
    let (zero, l1, l2, mean) = (s.splat(0.0), s.splat(group.l1), s.splat(group.l2), s.splat(group.l2_mean));
    let (twice, twice_mean) = (s.add(l2, l2), s.add(mean, mean));
    let mut loss = 0.0;
    for start in (0..n).step_by(BLOCK) {
        let mut sum = zero;
        for at in (start..n.min(start + BLOCK)).step_by(S::LANES) {
            let (p, t) = (read(s, prediction, at), read(s, target, at));
            let (value, held) = curve.at(s, p);
            // Each only where it is asked for: 0 times an infinite error is no number.
            if keep || remapped {
                let slope = curve.cut(s, p, held);
                let difference = s.sub(value, curve.at(s, t).0);
                if keep {
                    s.store(&mut differences[at..], difference);
                    s.store(&mut slopes[at..], slope);
                }
                let mut step = zero;
                if group.l1 != 0.0 {
                    sum = s.fma(absolute(s, difference), l1, sum);
                    step = s.mul(sign(s, difference), l1);
                }
                if group.l2 != 0.0 {
                    sum = s.fma(s.mul(difference, difference), l2, sum);
                    step = s.fma(difference, twice, step);
                }
                if remapped {
                    add(s, gradient, at, n, s.mul(step, slope));
                }
            }
            if group.l2_mean != 0.0 {
                let residual = s.mul(s.sub(p, t), held);
                sum = s.fma(s.mul(residual, residual), mean, sum);
                add(s, gradient, at, n, s.mul(s.mul(residual, held), twice_mean));
            }
        }
        loss += total(s, sum);
    }
    loss
}

/// Sobel responses of a plane at its interior samples: returns `factor` times their errors, squared or of half strength
/// and absolute, and leaves its derivative by each response.
#[inline(always)]
fn responses<S: Simd, const SQUARED: bool>(
    s: S,
    plane: &[f32],
    interior: &[f32],
    side: usize,
    factor: f32,
    [to_x, to_y]: &mut [Vec<f32>; 2],
) -> f64 {
    let (zero, two) = (s.splat(0.0), s.splat(2.0));
    let margin = (plane.len() - interior.len()) / 2;
    let factor = s.splat(if SQUARED { factor } else { 0.5 * factor });
    let mut loss = 0.0;
    for start in (0..interior.len()).step_by(BLOCK) {
        let mut sum = zero;
        for at in (start..interior.len().min(start + BLOCK)).step_by(S::LANES) {
            let here = margin + at;
            let (up, down) = (&plane[here - side - 1..], &plane[here + side - 1..]);
            let falling = s.sub(s.load(up), s.load(&down[2..]));
            let rising = s.sub(s.load(&up[2..]), s.load(down));
            let across = s.sub(s.load(&plane[here - 1..]), s.load(&plane[here + 1..]));
            let along = s.sub(s.load(&up[1..]), s.load(&down[1..]));
            // A window that is cut by a border is left out, not weighted by 0: what it holds may be no number.
            let inside = s.greater(s.load(&interior[at..]), zero);
            let x = s.select(inside, s.fma(across, two, s.sub(falling, rising)), zero);
            let y = s.select(inside, s.fma(along, two, s.add(falling, rising)), zero);
            if SQUARED {
                sum = s.fma(s.fma(x, x, s.mul(y, y)), factor, sum);
                s.store(&mut to_x[here..], s.mul(s.add(x, x), factor));
                s.store(&mut to_y[here..], s.mul(s.add(y, y), factor));
            } else {
                sum = s.fma(s.add(absolute(s, x), absolute(s, y)), factor, sum);
                s.store(&mut to_x[here..], s.mul(sign(s, x), factor));
                s.store(&mut to_y[here..], s.mul(sign(s, y), factor));
            }
        }
        loss += total(s, sum);
    }
    loss
}

/// d loss / d plane at element `here`, from the derivatives by the responses: the windows' adjoint.
#[inline(always)]
fn adjoint<S: Simd>(s: S, [x, y]: &[Vec<f32>; 2], side: usize, here: usize) -> S::F {
    let (x_up, x_down) = (&x[here - side - 1..], &x[here + side - 1..]);
    let (y_up, y_down) = (&y[here - side - 1..], &y[here + side - 1..]);
    let falling = s.sub(s.add(s.load(&x_down[2..]), s.load(&y_down[2..])), s.add(s.load(x_up), s.load(y_up)));
    let rising = s.sub(s.sub(s.load(&x_up[2..]), s.load(&y_up[2..])), s.sub(s.load(x_down), s.load(y_down)));
    let across = s.sub(s.load(&x[here + 1..]), s.load(&x[here - 1..]));
    let along = s.sub(s.load(&y_down[1..]), s.load(&y_up[1..]));
    s.fma(s.add(across, along), s.splat(2.0), s.add(falling, rising))
}

/// A vector from element `at` on; past the end 1, where every remap and slope is finite.
#[inline(always)]
fn read<S: Simd>(s: S, from: &[f32], at: usize) -> S::F {
    if let Some(whole) = from.get(at..at + S::LANES) {
        return s.load(whole);
    }
    let mut lanes = [1.0; WIDEST];
    let rest = &from[at..];
    lanes[..rest.len()].copy_from_slice(rest);
    s.load(&lanes)
}

/// Adds a vector from element `at` on, up to element `n`.
#[inline(always)]
fn add<S: Simd>(s: S, to: &mut [f32], at: usize, n: usize, x: S::F) {
    if at + S::LANES <= n {
        let whole = &mut to[at..at + S::LANES];
        let sum = s.add(s.load(whole), x);
        return s.store(whole, sum);
    }
    let mut lanes = [0.0; WIDEST];
    s.store(&mut lanes, x);
    for (to, x) in to[at..n].iter_mut().zip(&lanes) {
        *to += x;
    }
}

/// The sum of all lanes, first to last.
#[inline(always)]
fn total<S: Simd>(s: S, x: S::F) -> f64 {
    let mut lanes = [0.0; WIDEST];
    s.store(&mut lanes, x);
    let mut sum = 0.0;
    for lane in lanes {
        sum += f64::from(lane);
    }
    sum
}

struct Piece<'a> {
    terms: &'a [Term],
    side: usize,
    patch: usize,
    weight: f32,
    prediction: [&'a [f32]; 3],
    target: [&'a [f32]; 3],
    gradient: [&'a mut [f32]; 3],
    scratch: &'a mut Scratch,
}

impl Work for Piece<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> f64 {
        let Self { terms, side, patch, weight, prediction, target, gradient, scratch } = self;
        piece(s, terms, side, patch, weight, prediction, target, gradient, scratch)
    }
}

/// [`piece`] with the given instruction set.
#[expect(clippy::too_many_arguments, reason = "those of `piece`")]
pub fn run(
    isa: Isa,
    terms: &[Term],
    side: usize,
    patch: usize,
    weight: f32,
    prediction: [&[f32]; 3],
    target: [&[f32]; 3],
    gradient: [&mut [f32]; 3],
    scratch: &mut Scratch,
) -> f64 {
    dispatch(isa, Piece { terms, side, patch, weight, prediction, target, gradient, scratch })
}
