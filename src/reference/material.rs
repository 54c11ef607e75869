//! What a surface is made of, wherever it came from.

use super::fibre_shading::FibreLook;
use super::heightfield::HeightMap;
use super::primitives::{Curve, TriangleMesh};
use super::shading::Brdf;
use super::texture::Texture;

/// A tile: its parts, all seen together. A ray meets whichever part is nearest.
#[derive(Clone, Debug)]
pub struct Material {
    /// What it is called.
    pub name: String,
    /// The parts, at least one.
    pub parts: Vec<Part>,
    /// Lowest and highest point over the reference plane that are stated for it, in tile widths; None takes the parts'.
    pub height_range: Option<[f32; 2]>,
    /// What was done to its files and should be said, a line each.
    pub notes: Vec<String>,
}

/// One part of a tile.
#[derive(Clone, Debug)]
pub enum Part {
    /// A displaced surface, solid below.
    Solid(Layer),
    /// A thin displaced sheet with holes where the opacity is below one half; seen and lit from both sides.
    Sheet(Layer, Texture<1>),
    /// Triangles, seen and lit from both sides.
    Mesh(TriangleMesh, Paint),
    /// Fibres: curves, and the looks that they point into.
    Fibres(Vec<Curve>, Vec<FibreLook>),
}

/// A displaced surface and how it reflects.
#[derive(Clone, Debug)]
pub struct Layer {
    /// Heights over the reference plane, in tile widths.
    pub height: HeightMap,
    /// The shading maps.
    pub paint: Paint,
}

/// Shading maps. They may differ in size; all cover the tile.
#[derive(Clone, Debug)]
pub struct Paint {
    /// Linear RGB in \[0, 1\]: diffuse albedo of the dielectric, F0 of the metal.
    pub base_colour: Texture<3>,
    /// Roughness in \[0, 1\]; GGX alpha is its square.
    pub roughness: Texture<1>,
    /// Share of the metal.
    pub metalness: Texture<1>,
    /// F0 of the dielectric.
    pub specular: Texture<1>,
    /// Normals to shade with instead of the geometry's: x, y, z over the reference plane, y along the rows.
    pub normal: Option<Texture<3>>,
}

impl Material {
    /// A material of one solid layer.
    pub fn solid(name: impl Into<String>, height: HeightMap, paint: Paint) -> Self {
        Self {
            name: name.into(),
            parts: vec![Part::Solid(Layer { height, paint })],
            height_range: None,
            notes: Vec::new(),
        }
    }
}

impl Paint {
    /// The same everywhere: a dielectric.
    pub fn plain(base_colour: [f32; 3], roughness: f32, specular: f32) -> Self {
        Self {
            base_colour: Texture::constant(base_colour),
            roughness: Texture::constant([roughness]),
            metalness: Texture::constant([0.0]),
            specular: Texture::constant([specular]),
            normal: None,
        }
    }

    /// The reflectance at (x, y), any finite position in tile widths.
    pub fn brdf(&self, x: f64, y: f64) -> Brdf {
        Brdf {
            base_colour: self.base_colour.at(x, y),
            roughness: self.roughness.at(x, y)[0],
            metalness: self.metalness.at(x, y)[0],
            specular: self.specular.at(x, y)[0],
        }
    }

    /// The normal to shade with at (x, y), if it is not the geometry's.
    pub fn normal(&self, x: f64, y: f64) -> Option<[f64; 3]> {
        let n = self.normal.as_ref()?.at(x, y).map(f64::from);
        let length = n.iter().map(|c| c * c).sum::<f64>().sqrt();
        (length > 0.0).then(|| n.map(|c| c / length))
    }
}
