//! Which directions to the light a material asks for: what a fitted sampler implements.

use crate::error::Result;
use std::f32::consts::{FRAC_1_PI, TAU};

/// A query without its light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Position on the tile, wrapped.
    pub u: [f32; 2],
    /// Level.
    pub level: f32,
    /// Direction to the viewer, above the horizon.
    pub wo: [f32; 2],
}

/// Draws directions to the light.
pub trait Directions: Send + Sync {
    /// What is drawn for each of many views: all the work that they share.
    ///
    /// # Errors
    /// Whatever keeps it from answering.
    fn lobes<'a>(&'a self, views: &[View]) -> Result<Box<dyn Lobes + 'a>>;
}

/// Densities over the upper hemisphere, one a view.
pub trait Lobes {
    /// A unit direction of view `k` for two numbers in \[0, 1), with its density over solid angle; None where nothing is
    /// drawn, which counts as no light.
    fn sample(&self, k: usize, xi: [f32; 2]) -> Option<([f32; 3], f32)>;

    /// The density over solid angle with which [`Lobes::sample`] draws a unit direction of view `k`.
    fn pdf(&self, k: usize, wi: [f32; 3]) -> f32;
}

/// Directions by their cosine, whatever the material.
#[derive(Clone, Copy, Debug)]
pub struct Cosine;

impl Directions for Cosine {
    fn lobes<'a>(&'a self, _: &[View]) -> Result<Box<dyn Lobes + 'a>> {
        Ok(Box::new(Self))
    }
}

impl Lobes for Cosine {
    fn sample(&self, _: usize, [x, y]: [f32; 2]) -> Option<([f32; 3], f32)> {
        let (sin, cos) = (TAU * x).sin_cos();
        let (radius, z) = (y.sqrt(), (1.0 - y).sqrt());
        (z > 0.0).then_some(([radius * cos, radius * sin, z], z * FRAC_1_PI))
    }

    fn pdf(&self, _: usize, wi: [f32; 3]) -> f32 {
        wi[2].max(0.0) * FRAC_1_PI
    }
}
