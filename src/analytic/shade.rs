//! The texels of a query as reflected light.

use super::maps::{BOUNCED, CHANNELS, COLOUR, F0, LAYER, MEAN, ROUGH, SPREAD};
use super::march::elevation;
use super::{Rows, TILE};
use crate::kernels::simd::{Simd, Work};
use std::f32::consts::{FRAC_1_PI, FRAC_2_PI, PI};

/// Least cosine with the viewer: where the mean slopes look away, something still looks at it.
const LEAST_COSINE: f32 = 0.01;

/// By how much a variance of slopes within the texel widens alpha^2. A Gaussian's width would say 2, its peak under a narrow
/// lobe 2.5; relief's slopes are more peaked. Chosen by the error on rocks, metal-rings, turtle-shell and leather, where 1
/// to 2 differ by a few per cent.
const WIDENING: f32 = 1.5;
/// Share of the mean slope's turn towards the viewer that counts: the rest is hidden behind other relief.
const LEANING: f32 = 0.5;
/// Least share of the viewer's elevation that the mean slope leaves it.
const LEAST_VIEW: f32 = 0.2;

/// Adds what the texels reflect to the rows' answers.
pub(super) struct Shade<'a> {
    pub rows: &'a mut Rows,
    /// What it counts for among the query's rays.
    pub share: f32,
}

impl Work for Shade<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Self { rows, share } = self;
        for at in (0..TILE).step_by(S::LANES) {
            let mut texel = [s.splat(0.0); CHANNELS];
            for c in 0..CHANNELS {
                texel[c] = s.load(&rows.texels[c][at..]);
            }
            let (wi, wo) = (direction(s, &rows.wi, at), direction(s, &rows.wo, at));
            let rgb = reflected(s, &texel, wi, wo, s.load(&rows.lit[at..]));
            for c in 0..3 {
                let sum = s.fma(rgb[c], s.splat(share), s.load(&rows.rgb[c][at..]));
                s.store(&mut rows.rgb[c][at..], sum);
            }
        }
    }
}

#[inline(always)]
fn direction<S: Simd>(s: S, [x, y]: &[super::Row; 2], at: usize) -> [S::F; 3] {
    let (x, y) = (s.load(&x[at..]), s.load(&y[at..]));
    [x, y, elevation(s, x, y)]
}

#[inline(always)]
fn dot<S: Simd>(s: S, a: [S::F; 3], b: [S::F; 3]) -> S::F {
    s.fma(a[0], b[0], s.fma(a[1], b[1], s.mul(a[2], b[2])))
}

/// a^T M b of a symmetric matrix \[xx, yy, xy\].
#[inline(always)]
fn form<S: Simd>(s: S, [xx, yy, xy]: [S::F; 3], a: [S::F; 2], b: [S::F; 2]) -> S::F {
    let x = s.fma(xx, b[0], s.mul(xy, b[1]));
    let y = s.fma(xy, b[0], s.mul(yy, b[1]));
    s.fma(a[0], x, s.mul(a[1], y))
}

/// (1 - cos)^5.
#[inline(always)]
fn schlick<S: Simd>(s: S, cos: S::F) -> S::F {
    let x = s.max(s.sub(s.splat(1.0), cos), s.splat(0.0));
    let x2 = s.mul(x, x);
    s.mul(s.mul(x2, x2), x)
}

#[inline(always)]
fn fresnel<S: Simd>(s: S, f0: S::F, bend: S::F) -> S::F {
    let f90 = s.min(s.mul(s.splat(50.0), f0), s.splat(1.0));
    s.fma(s.sub(f90, f0), bend, f0)
}

/// A vector in a frame.
#[inline(always)]
fn local<S: Simd>(s: S, [x, y, z]: [[S::F; 3]; 3], w: [S::F; 3]) -> [S::F; 3] {
    [dot(s, x, w), dot(s, y, w), dot(s, z, w)]
}

/// sqrt(x^T A x + z^2): how far a lobe's slopes hide a direction.
#[inline(always)]
fn slant<S: Simd>(s: S, lobe: [S::F; 3], w: [S::F; 3]) -> S::F {
    let across = form(s, lobe, [w[0], w[1]], [w[0], w[1]]);
    s.sqrt(s.max(s.fma(w[2], w[2], across), s.splat(1e-12)))
}

/// Mean of what is positive of a number that spreads; `fuzz` is 2 / pi of its variance, exact for a Gaussian around 0.
#[inline(always)]
fn positive<S: Simd>(s: S, x: S::F, fuzz: S::F) -> S::F {
    s.mul(s.splat(0.5), s.add(x, s.sqrt(s.fma(x, x, fuzz))))
}

#[inline(always)]
fn reflected<S: Simd>(s: S, texel: &[S::F; CHANNELS], wi: [S::F; 3], wo: [S::F; 3], lit: S::F) -> [S::F; 3] {
    let (zero, one, half) = (s.splat(0.0), s.splat(1.0), s.splat(0.5));
    let mean = [texel[MEAN], texel[MEAN + 1]];
    let spread = [texel[SPREAD], texel[SPREAD + 1], texel[SPREAD + 2]];
    let (light, view) = ([wi[0], wi[1]], [wo[0], wo[1]]);

    // The frame around the mean normal (Duff et al. 2017; it never points down).
    let steep = s.fma(mean[0], mean[0], s.mul(mean[1], mean[1]));
    let nz = s.div(one, s.sqrt(s.add(one, steep)));
    let normal = [s.sub(zero, s.mul(mean[0], nz)), s.sub(zero, s.mul(mean[1], nz)), nz];
    let a = s.div(s.splat(-1.0), s.add(one, nz));
    let b = s.mul(s.mul(normal[0], normal[1]), a);
    let tangent = [s.fma(s.mul(normal[0], normal[0]), a, one), b, s.sub(zero, normal[0])];
    let bitangent = [b, s.fma(s.mul(normal[1], normal[1]), a, one), s.sub(zero, normal[1])];
    let frame = [tangent, bitangent, normal];
    let (li, lo) = (local(s, frame, wi), local(s, frame, wo));

    // The lobe: alpha^2 and the spread of the slopes, as seen in that frame.
    let alpha2 = s.mul(texel[ROUGH], texel[ROUGH]);
    let scale = s.mul(s.mul(nz, nz), s.splat(WIDENING));
    let (t, u) = ([tangent[0], tangent[1]], [bitangent[0], bitangent[1]]);
    let xx = s.fma(scale, form(s, spread, t, t), alpha2);
    let yy = s.fma(scale, form(s, spread, u, u), alpha2);
    let xy = s.mul(scale, form(s, spread, t, u));
    let determinant = s.max(s.sub(s.mul(xx, yy), s.mul(xy, xy)), s.mul(alpha2, alpha2));
    let root = s.sqrt(determinant);

    // What the viewer sees of a rough spot leans towards it; what is lit of it is more than its mean.
    let om =
        s.max(s.sub(wo[2], s.fma(mean[0], wo[0], s.mul(mean[1], wo[1]))), s.mul(wo[2], s.splat(LEAST_VIEW)));
    let lm = s.sub(wi[2], s.fma(mean[0], wi[0], s.mul(mean[1], wi[1])));
    let lean = s.div(form(s, spread, light, view), om);
    let towards = s.fma(s.splat(LEANING), lean, lm);
    let rough = s.div(one, s.sqrt(s.add(s.add(one, steep), s.add(spread[0], spread[1]))));
    let across = s.max(form(s, spread, light, light), zero);
    let fuzz = s.mul(s.splat(FRAC_2_PI), across);
    let diffuse_cos = s.mul(positive(s, towards, fuzz), rough);
    let gloss_cos = s.mul(positive(s, lm, fuzz), rough);

    let (cos_i, cos_o) = (s.min(gloss_cos, one), s.min(s.max(lo[2], s.splat(LEAST_COSINE)), one));
    let sum = [s.add(li[0], lo[0]), s.add(li[1], lo[1]), s.add(li[2], lo[2])];
    let length = s.max(s.sqrt(dot(s, sum, sum)), s.splat(1e-6));
    let inverse = s.div(one, length);
    let h = [s.mul(sum[0], inverse), s.mul(sum[1], inverse), s.mul(sum[2], inverse)];
    let cos_d = s.min(s.mul(half, length), one);
    let tilted = s.max(form(s, [yy, xx, s.sub(zero, xy)], [h[0], h[1]], [h[0], h[1]]), zero);
    let d = s.fma(h[2], h[2], s.div(tilted, determinant));
    let distribution = s.div(one, s.mul(s.mul(s.splat(PI), root), s.mul(d, d)));
    let (slant_i, slant_o) = (slant(s, [xx, yy, xy], li), slant(s, [xx, yy, xy], lo));
    let masked = s.fma(cos_o, slant_i, s.mul(cos_i, slant_o));
    let lobe = s.div(s.mul(s.mul(distribution, half), cos_i), s.max(masked, s.splat(1e-6)));

    let bend = schlick(s, cos_d);
    let through = s.mul(
        s.sub(one, fresnel(s, texel[LAYER], schlick(s, cos_i))),
        s.sub(one, fresnel(s, texel[LAYER], schlick(s, cos_o))),
    );
    let diffuse = s.mul(s.mul(s.splat(FRAC_1_PI), through), diffuse_cos);
    let mut rgb = [zero; 3];
    for c in 0..3 {
        let direct = s.fma(texel[COLOUR + c], diffuse, s.mul(lobe, fresnel(s, texel[F0 + c], bend)));
        rgb[c] = s.max(s.fma(direct, lit, s.mul(texel[BOUNCED + c], wi[2])), zero);
    }
    rgb
}
