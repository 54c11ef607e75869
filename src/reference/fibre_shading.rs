//! How a fibre scatters light: the near-field model of Chiang, Bitterli, Tappan and Burley, "A Practical and
//! Controllable Hair and Fur Model for Production Path Tracing" (2016), for a dielectric cylinder with rough walls.
//!
//! S(wi, wo) cos(theta_i) = sum over p of M_p(theta_i, theta_o) A_p(h, theta_o) N_p(phi_i - phi_o - Phi_p(h, theta_o))
//!
//! with p = 0 reflection (R), 1 transmission (TT), 2 one reflection inside (TRT), 3 all that follow; M_p the
//! longitudinal lobe of d'Eon et al. (2011), N_p a logistic trimmed to one turn (uniform for p = 3), A_p the light
//! that is left by Fresnel's equations and absorption, Phi_p the azimuth that an ideal cylinder gives. The fibre is so
//! thin that light leaves it where it came in: there is no other side to be hit.
//!
//! Directions are in the fibre's frame: x along the tangent, z the normal of the point that is seen. theta is the
//! angle out of the plane x = 0, phi turns in it from y to z. h in \[-1, 1\] is where in the fibre's width the viewer
//! looks: the sine of the angle from the normal to `wo` about the tangent, see [`offset`].
//!
//! The cosine is in the formula: the integrals of M_p cos(theta) d(theta) and of N_p d(phi) are 1, and so is the sum
//! of A_p without absorption. So for every h and wo a fibre that absorbs nothing returns exactly what a white sky
//! sends, and no other fibre returns more. This holds for paths that start at the viewer. The model is not
//! reciprocal: A_p knows wo alone, and M_p is symmetric where M_p / cos(theta_i) should be. The means over h of
//! cos(theta_o) S(wi, wo) cos(theta_i) for (wi, wo) and for (wo, wi) should be equal; they differ on average by 3, 10,
//! 17 and 36 % of their mean at longitudinal roughness 0.1, 0.3, 0.5 and 1 (azimuthal 0.3, no tilt).

use super::shading::Sampled;
use crate::error::{Error, Result};
use std::f32::consts::{PI, TAU};
use std::ops::RangeInclusive;

/// Roughnesses. Below the least, a distant light's highlight is narrower than half a degree, and no affordable number
/// of samples finds it.
pub const ROUGHNESSES: RangeInclusive<f32> = 0.02..=1.0;

/// Indices of refraction. At 1 there is no fibre, and a ray along it divides 0 by 0; diamond has 2.4.
pub const IORS: RangeInclusive<f32> = 1.05..=3.0;

/// Angles of the scales in degrees. Hair has 2 to 4; the third lobe turns by four times as much.
pub const TILTS: RangeInclusive<f32> = -15.0..=15.0;

/// Least colour. Absorption goes to infinity as the colour goes to 0; here less than 1e-4 passes through the middle of
/// a fibre.
const MIN_COLOUR: f32 = 1e-6;

/// Below exp(-DARK) a lobe is 0: numbers near the least of f32 are slow, and nothing shows there.
const DARK: f32 = 80.0;

/// R, TT, TRT and the rest.
const LOBES: usize = 4;

/// What a fibre is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FibreLook {
    /// Linear RGB in \[0, 1\]: the colour that a mass of such fibres takes under many bounces. 1 absorbs nothing.
    pub colour: [f32; 3],
    /// Roughness along the fibre, in [`ROUGHNESSES`].
    pub longitudinal_roughness: f32,
    /// Roughness around the fibre, in [`ROUGHNESSES`].
    pub azimuthal_roughness: f32,
    /// Index of refraction over that of the air, in [`IORS`].
    pub ior: f32,
    /// Angle of the scales in degrees, in [`TILTS`]; positive turns R by twice as much to +x. 0 for textile fibres.
    pub tilt: f32,
}

/// What one lobe does along the fibre.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Lobe {
    /// 1 / v.
    sharpness: f32,
    /// 1 / (v (1 - exp(-2 / v))).
    peak: f32,
    /// Sine and cosine by which the scales turn theta_o.
    turn: [f32; 2],
}

/// A fibre that scatters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FibreBsdf {
    ior: f32,
    absorption: [f32; 3],
    lobes: [Lobe; LOBES],
    /// s of the logistic.
    spread: f32,
    /// 1 / (s times the logistic's share within one turn).
    height: f32,
}

/// A point of a fibre that is seen from a direction.
#[derive(Clone, Copy, Debug)]
pub struct FibrePoint<'a> {
    bsdf: &'a FibreBsdf,
    /// Unit vector (y, z) of the azimuth of wo.
    azimuth: [f32; 2],
    /// Sine and cosine of theta_o, turned by the scales, a lobe.
    theta: [[f32; 2]; LOBES],
    /// A_p.
    attenuation: [[f32; 3]; LOBES],
    /// Probability of drawing from the lobe.
    share: [f32; LOBES],
    /// Phi_p within half a turn of 0.
    centre: [f32; LOBES - 1],
}

/// h of a point of a round fibre whose normal is z: minus the y of `wo` as seen along the fibre; 0 if `wo` runs along
/// it.
pub fn offset(wo: [f32; 3]) -> f32 {
    let across = hypot(wo[1], wo[2]);
    if across > 0.0 { -wo[1] / across } else { 0.0 }
}

impl FibreBsdf {
    /// Prepares a look.
    ///
    /// # Errors
    /// `Config`, naming the field that is not finite or out of its range.
    pub fn new(look: &FibreLook) -> Result<Self> {
        let [along, around] = [look.longitudinal_roughness, look.azimuthal_roughness];
        within("longitudinal_roughness", along, &ROUGHNESSES)?;
        within("azimuthal_roughness", around, &ROUGHNESSES)?;
        within("ior", look.ior, &IORS)?;
        within("tilt", look.tilt, &TILTS)?;
        for (k, colour) in look.colour.into_iter().enumerate() {
            within(&format!("colour[{k}]"), colour, &(0.0..=1.0))?;
        }
        let tilt = look.tilt.to_radians();
        let v = (0.726 * along + 0.812 * along.powi(2) + 3.7 * along.powi(20)).powi(2);
        let spread = (PI / 8.0).sqrt() * (0.265 * around + 1.194 * around.powi(2) + 5.372 * around.powi(22));
        let lobe = |v: f32, turn: f32| Lobe {
            sharpness: 1.0 / v,
            peak: -1.0 / (v * (-2.0 / v).exp_m1()),
            turn: turn.sin_cos().into(),
        };
        Ok(Self {
            ior: look.ior,
            absorption: look.colour.map(|colour| absorption(colour, around)),
            lobes: [
                lobe(v, -2.0 * tilt),
                lobe(0.25 * v, tilt),
                lobe(4.0 * v, 4.0 * tilt),
                lobe(4.0 * v, 0.0),
            ],
            spread,
            height: 1.0 / (spread * (0.5 * PI / spread).tanh()),
        })
    }

    /// Absorption per fibre radius, RGB.
    pub fn absorption(&self) -> [f32; 3] {
        self.absorption
    }

    /// What does not depend on the light: for the point at `h` seen from the unit vector `wo`.
    pub fn at(&self, h: f32, wo: [f32; 3]) -> FibrePoint<'_> {
        let h = h.clamp(-1.0, 1.0);
        let (sin_o, cos_o) = (wo[0], hypot(wo[1], wo[2]).min(1.0));
        // Bravais: in the plane across the fibre a slanted ray sees a greater index of refraction.
        let slant = (self.ior * self.ior - sin_o * sin_o).sqrt();
        let sin_gamma_t = h * cos_o / slant;
        let cos_gamma_t = (1.0 - sin_gamma_t * sin_gamma_t).max(0.0).sqrt();
        let [gamma_o, gamma_t] = [h.asin(), sin_gamma_t.clamp(-1.0, 1.0).asin()];
        let centre =
            std::array::from_fn(|p| within_half_turn(p as f32 * (2.0 * gamma_t + PI) - 2.0 * gamma_o));

        let chord = 2.0 * cos_gamma_t * self.ior / slant;
        let reflected = fresnel(cos_o * ((1.0 - h) * (1.0 + h)).sqrt(), self.ior);
        let mut attenuation = [[0.0; 3]; LOBES];
        for (c, absorption) in self.absorption.into_iter().enumerate() {
            let left = (-absorption * chord).exp();
            let inside = left * reflected;
            let tt = (1.0 - reflected) * (1.0 - reflected) * left;
            // The geometric series of all that follows; (1 - F) / (1 - F T) stays 1 where both are 0.
            let series = if inside < 1.0 { (1.0 - reflected) / (1.0 - inside) } else { 1.0 };
            let rest = (1.0 - reflected) * left * inside * inside * series;
            for (p, a) in [reflected, tt, tt * inside, rest].into_iter().enumerate() {
                attenuation[p][c] = a;
            }
        }
        let mean = attenuation.map(|a| (a[0] + a[1] + a[2]) / 3.0);
        let scale = 1.0 / mean.iter().sum::<f32>();

        let theta = self.lobes.map(|Lobe { turn: [sin, cos], .. }| {
            [sin_o * cos + cos_o * sin, (cos_o * cos - sin_o * sin).abs()]
        });
        let azimuth = if cos_o > 0.0 { [wo[1] / cos_o, wo[2] / cos_o] } else { [0.0, 1.0] };
        FibrePoint { bsdf: self, azimuth, theta, attenuation, share: mean.map(|m| m * scale), centre }
    }

    /// [`FibrePoint::eval`] for one light.
    pub fn eval(&self, h: f32, wi: [f32; 3], wo: [f32; 3]) -> [f32; 3] {
        self.at(h, wo).eval(wi)
    }

    /// [`FibrePoint::pdf`] for one light.
    pub fn pdf(&self, h: f32, wi: [f32; 3], wo: [f32; 3]) -> f32 {
        self.at(h, wo).pdf(wi)
    }

    /// [`FibrePoint::sample`] for one draw.
    pub fn sample(&self, h: f32, wo: [f32; 3], random: [f32; 4]) -> Option<Sampled> {
        self.at(h, wo).sample(random)
    }
}

impl FibrePoint<'_> {
    /// S(wi, wo) cos(theta_i) per steradian, RGB, for any unit vector `wi`: the radiance towards wo under a distant
    /// light from `wi` with irradiance 1 on a plane facing it. No further cosine belongs to it.
    pub fn eval(&self, wi: [f32; 3]) -> [f32; 3] {
        let lobes = self.lobes(wi);
        std::array::from_fn(|c| (0..LOBES).map(|p| self.attenuation[p][c] * lobes[p]).sum())
    }

    /// Density per solid angle with which [`FibrePoint::sample`] draws `wi`.
    pub fn pdf(&self, wi: [f32; 3]) -> f32 {
        let lobes = self.lobes(wi);
        (0..LOBES).map(|p| self.share[p] * lobes[p]).sum()
    }

    /// Draws a light direction from four uniform numbers: a lobe by the light that is left in it, then M_p (as d'Eon
    /// et al. 2013, "Importance Sampling for Physically-Based Hair Fiber Models") and N_p. None where
    /// rounding leaves no density: that path ends.
    pub fn sample(&self, random: [f32; 4]) -> Option<Sampled> {
        let (mut p, mut left) = (0, random[0]);
        while p + 1 < LOBES && left >= self.share[p] {
            left -= self.share[p];
            p += 1;
        }
        // A direction of the von Mises-Fisher lobe around the mirrored wo, of which M_p is the mean around the fibre.
        // It is drawn by 1 - cos, which keeps its digits in a narrow lobe.
        let sharpness = self.bsdf.lobes[p].sharpness;
        let drop = -(random[1] + (1.0 - random[1]) * (-2.0 * sharpness).exp()).ln() / sharpness;
        let drop = drop.clamp(0.0, 2.0);
        let (cos, sin) = (1.0 - drop, (drop * (2.0 - drop)).sqrt());
        let (sin_psi, cos_psi) = (TAU * random[2]).sin_cos();
        let [sin_o, cos_o] = self.theta[p];
        let sin_i = sin * cos_psi * cos_o - cos * sin_o;
        let cos_i = hypot(cos * cos_o + sin * cos_psi * sin_o, sin * sin_psi);

        let turn = match self.centre.get(p) {
            Some(centre) => centre + self.bsdf.logistic_quantile(random[3]),
            None => TAU * random[3],
        };
        let (sin_turn, cos_turn) = turn.sin_cos();
        let [y, z] = self.azimuth;
        let direction = [sin_i, cos_i * (y * cos_turn - z * sin_turn), cos_i * (z * cos_turn + y * sin_turn)];

        let lobes = self.lobes(direction);
        let pdf: f32 = (0..LOBES).map(|p| self.share[p] * lobes[p]).sum();
        if pdf <= 0.0 || !pdf.is_finite() {
            return None;
        }
        let weight =
            std::array::from_fn(|c| (0..LOBES).map(|p| self.attenuation[p][c] * lobes[p]).sum::<f32>() / pdf);
        Some(Sampled { direction, weight, pdf })
    }

    /// M_p N_p.
    fn lobes(&self, wi: [f32; 3]) -> [f32; LOBES] {
        let (sin_i, cos_i) = (wi[0], hypot(wi[1], wi[2]));
        let [y, z] = self.azimuth;
        let turn = (y * wi[2] - z * wi[1]).atan2(y * wi[1] + z * wi[2]);
        std::array::from_fn(|p| {
            let along = self.bsdf.lobes[p].longitudinal([sin_i, cos_i], self.theta[p]);
            match self.centre.get(p) {
                _ if along == 0.0 => 0.0,
                Some(centre) => along * self.bsdf.logistic(within_half_turn(turn - centre)),
                None => along / TAU,
            }
        })
    }
}

impl Lobe {
    /// M = exp(-(1 + sin_i sin_o) / v) I0(cos_i cos_o / v) / (v (1 - exp(-2 / v))), of which the exponents are
    /// gathered so that neither overflows nor cancels:
    /// 1 + sin_i sin_o - cos_i cos_o = ((cos_i - cos_o)^2 + (sin_i + sin_o)^2) / 2.
    fn longitudinal(&self, [sin_i, cos_i]: [f32; 2], [sin_o, cos_o]: [f32; 2]) -> f32 {
        let (across, along) = (cos_i - cos_o, sin_i + sin_o);
        let gap = 0.5 * (across * across + along * along) * self.sharpness;
        let x = cos_i * cos_o * self.sharpness;
        let (factor, exponent) = bessel(x);
        let exponent = gap + exponent;
        if exponent > DARK { 0.0 } else { self.peak * factor * (-exponent).exp() }
    }
}

impl FibreBsdf {
    /// N at `x` within half a turn.
    fn logistic(&self, x: f32) -> f32 {
        let e = (-x.abs() / self.spread).exp();
        self.height * e / ((1.0 + e) * (1.0 + e))
    }

    /// Where the integral of N from minus half a turn reaches `share`.
    fn logistic_quantile(&self, share: f32) -> f32 {
        let least = 1.0 / (1.0 + (PI / self.spread).exp());
        let level = least + share * (1.0 - 2.0 * least);
        (self.spread * (level / (1.0 - level)).ln()).clamp(-PI, PI)
    }
}

/// I0(x) exp(-x) for x >= 0, as (a, b) with a exp(-b): Abramowitz and Stegun 9.8.1 and 9.8.2, within 2e-7.
fn bessel(x: f32) -> (f32, f32) {
    const SMALL: [f32; 7] =
        [1.0, 3.515_622_9, 3.089_942_4, 1.206_749_2, 0.265_973_2, 0.036_076_8, 0.004_581_3];
    const LARGE: [f32; 9] = [
        0.398_942_3,
        0.013_285_92,
        0.002_253_19,
        -0.001_575_65,
        0.009_162_81,
        -0.020_577_06,
        0.026_355_37,
        -0.016_476_33,
        0.003_923_77,
    ];
    const SEAM: f32 = 3.75;
    let horner = |terms: &[f32], t: f32| terms.iter().rev().fold(0.0, |sum, term| sum * t + term);
    if x < SEAM {
        let t = x / SEAM;
        (horner(&SMALL, t * t), x)
    } else {
        (horner(&LARGE, SEAM / x) / x.sqrt(), 0.0)
    }
}

/// Absorption per fibre radius that gives a mass of fibres a colour: the paper's fit, for its index of refraction 1.55.
fn absorption(colour: f32, azimuthal_roughness: f32) -> f32 {
    const FIT: [f32; 6] = [5.969, -0.215, 2.532, -10.73, 5.574, 0.245];
    let scale = FIT.iter().rev().fold(0.0, |sum, term| sum * azimuthal_roughness + term);
    (colour.max(MIN_COLOUR).ln() / scale).powi(2)
}

/// Share that a dielectric of relative index `ior` > 1 reflects of unpolarised light.
fn fresnel(cos: f32, ior: f32) -> f32 {
    let cos_t = (ior * ior - 1.0 + cos * cos).sqrt() / ior;
    let s = (cos - ior * cos_t) / (cos + ior * cos_t);
    let p = (ior * cos - cos_t) / (ior * cos + cos_t);
    0.5 * (s * s + p * p)
}

/// An angle of at most three half turns, less a whole turn where that brings it nearer to 0.
fn within_half_turn(angle: f32) -> f32 {
    if angle.abs() <= PI { angle } else { angle - TAU.copysign(angle) }
}

fn hypot(a: f32, b: f32) -> f32 {
    (a * a + b * b).sqrt()
}

fn within(field: &str, value: f32, range: &RangeInclusive<f32>) -> Result<()> {
    // Written so that NaN is refused.
    if range.contains(&value) {
        return Ok(());
    }
    Err(Error::config(field, format!("{value} is outside {} to {}", range.start(), range.end())))
}

#[cfg(test)]
mod tests;
