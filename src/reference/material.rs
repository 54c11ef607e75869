//! What a surface is made of, wherever it came from.

use super::heightfield::HeightMap;
use super::shading::Brdf;
use super::texture::Texture;

/// A tile's heights and shading maps. Maps may differ in size; all cover the tile.
#[derive(Clone, Debug)]
pub struct Material {
    /// What it is called.
    pub name: String,
    /// Heights over the reference plane, in tile widths.
    pub height: HeightMap,
    /// Linear RGB in \[0, 1\]: diffuse albedo of the dielectric, F0 of the metal.
    pub base_colour: Texture<3>,
    /// Roughness in \[0, 1\]; GGX alpha is its square.
    pub roughness: Texture<1>,
    /// Share of the metal.
    pub metalness: Texture<1>,
    /// F0 of the dielectric.
    pub specular: Texture<1>,
    /// What was done to the maps and should be said, a line each.
    pub notes: Vec<String>,
}

impl Material {
    /// The reflectance at (x, y), any finite position in tile widths.
    pub fn brdf(&self, x: f64, y: f64) -> Brdf {
        Brdf {
            base_colour: self.base_colour.at(x, y),
            roughness: self.roughness.at(x, y)[0],
            metalness: self.metalness.at(x, y)[0],
            specular: self.specular.at(x, y)[0],
        }
    }
}
