//! How a point of the surface reflects: a diffuse base under a GGX layer, blended with a GGX metal.
//!
//! f = (1 - m) \[base / pi (1 - F_d(cos_i)) (1 - F_d(cos_o)) + D V F_d(cos_d)\] + m D V F_m(cos_d)
//!
//! with D the GGX distribution, V the height-correlated Smith masking-shadowing divided by 4 cos_i cos_o, and
//! Schlick's F = F0 + (F90 - F0) (1 - cos)^5, F90 = min(1, 50 F0); F0 is `specular` for F_d and `base_colour` for F_m.
//! The coupling of the diffuse part is symmetric, so f is reciprocal, and it gives away what the layer reflects
//! towards either direction, so no direction reflects more than it gets. With F0 = 0 the dielectric is
//! exactly Lambert. Light that bounces between microfacets is lost (no multiple-scattering term): of a white metal at
//! alpha 0.1 there return 0.988, 0.986, 0.982, 0.969 and 0.947 at 0, 30, 45, 60 and 70 degrees; at alpha 1 and 0 degrees
//! 1 - ln 2 = 0.307.

use std::f32::consts::{FRAC_1_PI, PI, TAU};

/// Least alpha = roughness^2: below it a distant light's highlight is narrower than f32 half vectors resolve and
/// than any affordable number of samples finds. It is roughness 0.045.
pub const MIN_ALPHA: f32 = 0.002;

/// Reflectance of one point; directions are in its own frame, z along the normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Brdf {
    /// Diffuse albedo of the dielectric, F0 of the metal; linear RGB in \[0, 1\].
    pub base_colour: [f32; 3],
    /// GGX alpha is roughness^2, at least [`MIN_ALPHA`].
    pub roughness: f32,
    /// Share of the metal, in \[0, 1\].
    pub metalness: f32,
    /// F0 of the dielectric, in \[0, 1\].
    pub specular: f32,
}

/// A direction drawn for a path.
#[derive(Clone, Copy, Debug)]
pub struct Sampled {
    /// Unit vector in the point's frame; above the surface, or anywhere around a fibre.
    pub direction: [f32; 3],
    /// f cos / pdf.
    pub weight: [f32; 3],
    /// Density per solid angle.
    pub pdf: f32,
}

impl Brdf {
    /// f(wi, wo) per steradian, RGB; 0 unless both directions are above the surface.
    pub fn eval(&self, wi: [f32; 3], wo: [f32; 3]) -> [f32; 3] {
        if wi[2] <= 0.0 || wo[2] <= 0.0 {
            return [0.0; 3];
        }
        let sum = [wi[0] + wo[0], wi[1] + wo[1], wi[2] + wo[2]];
        let half = normalize(sum);
        // Half the length of wi + wo is the cosine of either with the half vector, rounded alike for both.
        let cos_d = (0.5 * dot(sum, sum).sqrt()).min(1.0);
        let alpha = self.alpha();
        let lobe = distribution(alpha, half) * visibility(alpha, wi[2], wo[2]);
        let bend = schlick(cos_d);
        let m = self.metalness;
        let through =
            (1.0 - fresnel(self.specular, schlick(wi[2]))) * (1.0 - fresnel(self.specular, schlick(wo[2])));
        let layer = fresnel(self.specular, bend);
        std::array::from_fn(|c| {
            let base = self.base_colour[c];
            let dielectric = base * FRAC_1_PI * through + lobe * layer;
            (1.0 - m) * dielectric + m * lobe * fresnel(base, bend)
        })
    }

    /// Density per solid angle with which [`Brdf::sample`] draws wi.
    pub fn pdf(&self, wi: [f32; 3], wo: [f32; 3]) -> f32 {
        if wi[2] <= 0.0 || wo[2] <= 0.0 {
            return 0.0;
        }
        let gloss = self.gloss_share(wo[2]);
        let half = normalize([wi[0] + wo[0], wi[1] + wo[1], wi[2] + wo[2]]);
        let alpha = self.alpha();
        // D G1 / (4 cos_o), with G1 = 2 cos_o / (cos_o + sqrt(alpha^2 + (1 - alpha^2) cos_o^2)).
        let lobe = distribution(alpha, half) / (2.0 * (wo[2] + slant(alpha, wo[2])));
        gloss * lobe + (1.0 - gloss) * wi[2] * FRAC_1_PI
    }

    /// Draws a light direction from three uniform numbers: the lobe's visible normals (by spherical caps, Dupuy and
    /// Benyoub 2023) or the cosine. None where the drawn direction points into the surface: that path ends.
    pub fn sample(&self, wo: [f32; 3], random: [f32; 3]) -> Option<Sampled> {
        if wo[2] <= 0.0 {
            return None;
        }
        let (sin_phi, cos_phi) = (TAU * random[1]).sin_cos();
        let direction = if random[0] < self.gloss_share(wo[2]) {
            let alpha = self.alpha();
            let stretched = normalize([alpha * wo[0], alpha * wo[1], wo[2]]);
            let z = (1.0 - random[2]) * (1.0 + stretched[2]) - stretched[2];
            let radius = (1.0 - z * z).max(0.0).sqrt();
            let [x, y] = [radius * cos_phi + stretched[0], radius * sin_phi + stretched[1]];
            let normal = normalize([alpha * x, alpha * y, z + stretched[2]]);
            let twice = 2.0 * dot(wo, normal);
            normalize(std::array::from_fn(|c| twice * normal[c] - wo[c]))
        } else {
            let radius = random[2].sqrt();
            [radius * cos_phi, radius * sin_phi, (1.0 - random[2]).sqrt()]
        };
        let pdf = self.pdf(direction, wo);
        if pdf <= 0.0 || !pdf.is_finite() {
            return None;
        }
        let f = self.eval(direction, wo);
        Some(Sampled { direction, weight: f.map(|f| f * direction[2] / pdf), pdf })
    }

    fn alpha(&self) -> f32 {
        (self.roughness * self.roughness).max(MIN_ALPHA)
    }

    /// Probability of drawing from the lobe: its share of what is reflected towards wo, estimated at the normal.
    fn gloss_share(&self, cos_o: f32) -> f32 {
        let (m, bend) = (self.metalness, schlick(cos_o));
        let layer = fresnel(self.specular, bend);
        let mean = |v: [f32; 3]| (v[0] + v[1] + v[2]) / 3.0;
        let lobe = (1.0 - m) * layer + m * mean(self.base_colour.map(|base| fresnel(base, bend)));
        let diffuse = (1.0 - m) * (1.0 - layer) * mean(self.base_colour);
        if lobe + diffuse > 0.0 { lobe / (lobe + diffuse) } else { 0.0 }
    }
}

/// (1 - cos)^5.
fn schlick(cos: f32) -> f32 {
    let x = (1.0 - cos).max(0.0);
    let x2 = x * x;
    x2 * x2 * x
}

fn fresnel(f0: f32, bend: f32) -> f32 {
    f0 + ((50.0 * f0).min(1.0) - f0) * bend
}

/// GGX. The squared sine comes from the half vector's x and y: 1 - cos^2 would lose it for narrow lobes.
fn distribution(alpha: f32, half: [f32; 3]) -> f32 {
    let a2 = alpha * alpha;
    let sin2 = half[0] * half[0] + half[1] * half[1];
    let d = a2 * half[2] * half[2] + sin2;
    a2 / (PI * d * d)
}

/// sqrt(alpha^2 + (1 - alpha^2) cos^2).
fn slant(alpha: f32, cos: f32) -> f32 {
    let a2 = alpha * alpha;
    (a2 + (1.0 - a2) * cos * cos).sqrt()
}

/// Height-correlated Smith G2 / (4 cos_i cos_o).
fn visibility(alpha: f32, cos_i: f32, cos_o: f32) -> f32 {
    0.5 / (cos_o * slant(alpha, cos_i) + cos_i * slant(alpha, cos_o))
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn normalize(v: [f32; 3]) -> [f32; 3] {
    let scale = 1.0 / dot(v, v).sqrt();
    v.map(|c| c * scale)
}
