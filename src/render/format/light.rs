//! Lights as they are written.

use super::value::Rgb;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;
use std::path::PathBuf;

/// A light. `name` is what a path calls it; by default its kind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LightSpec {
    /// A distant light.
    Directional(DirectionalSpec),
    /// A point.
    Point(PointSpec),
    /// Light from everywhere.
    Environment(EnvironmentSpec),
}

/// A distant light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DirectionalSpec {
    /// Its name.
    #[serde(default = "directional")]
    pub name: String,
    /// From the scene to the light; any length.
    pub direction: [f64; 3],
    /// Irradiance on a plane that faces it; pi by default, under which a white matt plane is 1.
    #[serde(default = "white_is_white")]
    pub irradiance: Rgb,
}

/// A point light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointSpec {
    /// Its name.
    #[serde(default = "point")]
    pub name: String,
    /// Where it is.
    pub position: [f64; 3],
    /// Power a steradian: a plane at distance d that faces it gets `intensity` / d^2.
    pub intensity: Rgb,
}

/// Light from everywhere: exactly one of an image, a constant and a sky.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnvironmentSpec {
    /// Its name.
    #[serde(default = "environment")]
    pub name: String,
    /// An equirectangular EXR or PNG: the top row is +z, the left border +y, a quarter to the right +x.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image: Option<PathBuf>,
    /// One radiance for all directions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub constant: Option<Rgb>,
    /// A clear sky with a sun.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sky: Option<SkySpec>,
    /// Turn about z, counter-clockwise seen from above, in degrees.
    #[serde(default)]
    pub rotate: f64,
    /// Factor of its radiance.
    #[serde(default = "one")]
    pub scale: f64,
}

/// A sky that fades from the zenith to the horizon over a ground of one colour, and a sun with a soft edge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SkySpec {
    /// Radiance at the zenith.
    pub zenith: Rgb,
    /// Radiance at the horizon.
    pub horizon: Rgb,
    /// Radiance from below.
    pub ground: Rgb,
    /// Direction to the sun.
    pub sun: [f64; 3],
    /// Irradiance of the sun on a plane that faces it; 0 leaves it out.
    pub sun_irradiance: Rgb,
    /// Radius of the sun in degrees.
    pub sun_radius: f64,
}

impl Default for SkySpec {
    fn default() -> Self {
        Self {
            zenith: Rgb([0.12, 0.24, 0.55]),
            horizon: Rgb([0.55, 0.65, 0.8]),
            ground: Rgb([0.16, 0.14, 0.12]),
            sun: [0.6, 0.35, 0.7],
            sun_irradiance: Rgb([2.6, 2.4, 2.1]),
            sun_radius: 3.0,
        }
    }
}

fn directional() -> String {
    "directional".into()
}

fn point() -> String {
    "point".into()
}

fn environment() -> String {
    "environment".into()
}

fn white_is_white() -> Rgb {
    Rgb([PI as f32; 3])
}

fn one() -> f64 {
    1.0
}

/// NeuMIP's tilted light.
pub(super) fn one_light() -> Vec<LightSpec> {
    let (tilt, pan) = (45f64.to_radians(), 30f64.to_radians());
    let direction = [tilt.sin() * pan.cos(), tilt.sin() * pan.sin(), tilt.cos()];
    let irradiance = white_is_white();
    vec![LightSpec::Directional(DirectionalSpec { name: directional(), direction, irradiance })]
}

impl LightSpec {
    /// What a path calls it.
    pub fn name(&self) -> &str {
        match self {
            Self::Directional(DirectionalSpec { name, .. })
            | Self::Point(PointSpec { name, .. })
            | Self::Environment(EnvironmentSpec { name, .. }) => name,
        }
    }
}
