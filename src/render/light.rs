//! Lights at a time.

use super::environment::Environment;
use super::format::LightSpec;
use super::shape::Ray;
use super::world::Spot;
use glam::{DMat3, DVec3};
use std::sync::Arc;

/// Irradiance beyond which a point light lies in the surface: sums of it would leave single precision.
const BRIGHTEST: f32 = 1e30;

/// What lights a frame.
#[derive(Clone, Debug)]
pub struct Lights {
    /// Lights that are seen in one direction from each point.
    pub distinct: Vec<Distinct>,
    /// Light from everywhere.
    pub environment: Option<Surroundings>,
}

/// A light that is seen in one direction from each point.
#[derive(Clone, Copy, Debug)]
pub enum Distinct {
    /// Far away.
    Directional {
        /// Unit vector to it.
        wi: DVec3,
        /// On a plane that faces it.
        irradiance: [f32; 3],
    },
    /// A point.
    Point {
        /// Where it is.
        position: DVec3,
        /// Irradiance at distance 1 on a plane that faces it.
        intensity: [f32; 3],
    },
}

/// An environment, turned and scaled.
#[derive(Clone, Debug)]
pub struct Surroundings {
    map: Arc<Environment>,
    /// From the environment's directions to the world's.
    turn: DMat3,
    scale: f32,
}

impl Lights {
    /// The lights of checked specs over the environment's picture.
    pub fn new(specs: &[LightSpec], map: Option<&Arc<Environment>>) -> Self {
        let mut lights = Self { distinct: Vec::new(), environment: None };
        for spec in specs {
            match spec {
                LightSpec::Directional(light) => lights.distinct.push(Distinct::Directional {
                    wi: DVec3::from(light.direction).normalize_or(DVec3::Z),
                    irradiance: light.irradiance.0,
                }),
                LightSpec::Point(light) => lights
                    .distinct
                    .push(Distinct::Point { position: light.position.into(), intensity: light.intensity.0 }),
                LightSpec::Environment(light) => {
                    lights.environment = map.map(|map| Surroundings {
                        map: map.clone(),
                        turn: DMat3::from_rotation_z(light.rotate.to_radians()),
                        scale: light.scale as f32,
                    });
                }
            }
        }
        lights
    }
}

impl Distinct {
    /// The unit direction to the light from a spot, the irradiance on a plane there that faces it, and the ray that must be
    /// free up to the distance beside it; None if the surface turns its back on it.
    pub fn seen_from(&self, spot: &Spot) -> Option<(DVec3, [f32; 3], Ray, f64)> {
        match *self {
            Self::Directional { wi, irradiance } => Some((wi, irradiance, spot.leave(wi)?, f64::INFINITY)),
            Self::Point { position, intensity } => {
                let way = position - spot.position;
                let squared = way.length_squared();
                let wi = way.try_normalize()?;
                let irradiance = intensity.map(|v| v * (1.0 / squared) as f32);
                let ray = spot.leave(wi)?;
                irradiance.iter().all(|v| *v < BRIGHTEST).then(|| (wi, irradiance, ray, squared.sqrt()))
            }
        }
    }
}

impl Surroundings {
    /// Radiance from a unit direction.
    pub fn radiance(&self, direction: DVec3) -> [f32; 3] {
        self.map.radiance(self.turn.transpose() * direction).map(|v| v * self.scale)
    }

    /// Radiance from a unit direction, and the density over solid angle with which [`Surroundings::sample`] draws it.
    pub fn look(&self, direction: DVec3) -> ([f32; 3], f64) {
        let (radiance, pdf) = self.map.look(self.turn.transpose() * direction);
        (radiance.map(|v| v * self.scale), pdf)
    }

    /// A unit direction for two numbers in \[0, 1), the radiance from there, and its density over solid angle.
    pub fn sample(&self, xi: [f32; 2]) -> (DVec3, [f32; 3], f64) {
        let (direction, radiance, pdf) = self.map.sample(xi.map(f64::from));
        (self.turn * direction, radiance.map(|v| v * self.scale), pdf)
    }
}
