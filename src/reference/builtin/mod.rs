//! Built-in materials by name. Those of surfaces are functions of position that repeat over the tile; cloth is made of
//! fibres by [`super::cloth`].

mod insulation_foam;
mod leather;
mod metal_rings;
mod noise;
mod rocks;
mod turtle_shell;

use super::cloth::{self, Cloth};
use super::heightfield::{HeightMap, SIDES};
use super::material::{Layer, Material, Paint, Part};
use super::texture::Texture;
use crate::error::{Error, Result};
use rayon::prelude::*;

/// The built-in materials.
pub const NAMES: [&str; 8] = [
    "basket-cloth",
    "turtle-shell",
    "victorian-fabric",
    "rocks",
    "metal-rings",
    "insulation-foam",
    "leather",
    "twill",
];

/// F0 of the built-in dielectrics: refractive index 1.5.
const SPECULAR: f32 = 0.04;

/// What a procedural material says about a position.
struct Spot {
    /// Height over the reference plane in tile widths.
    height: f64,
    base_colour: [f64; 3],
    roughness: f64,
    metalness: f64,
}

/// The built-in material `name` on `side` x `side` texels; equal seeds give equal materials.
///
/// # Errors
/// `Usage` for an unknown name, `Config` for a side outside [`SIDES`].
pub fn make(name: &str, side: usize, seed: u64) -> Result<Material> {
    if !SIDES.contains(&side) {
        let (least, most) = (SIDES.start(), SIDES.end());
        return Err(Error::config("field_side", format!("{side} is outside {least} to {most}")));
    }
    let solid = |layer| Ok(vec![Part::Solid(layer)]);
    let parts = match name {
        "metal-rings" => {
            let rings = metal_rings::MetalRings::new(seed);
            solid(paint(side, |x, y| rings.spot(x, y)))
        }
        "rocks" => {
            let rocks = rocks::Rocks::new(seed);
            solid(paint(side, |x, y| rocks.spot(x, y)))
        }
        "turtle-shell" => {
            let shell = turtle_shell::TurtleShell::new(seed);
            solid(paint(side, |x, y| shell.spot(x, y)))
        }
        "leather" => {
            let leather = leather::Leather::new(seed);
            solid(paint(side, |x, y| leather.spot(x, y)))
        }
        "insulation-foam" => {
            let foam = insulation_foam::InsulationFoam::new(seed);
            let (skin, opacity): (Vec<Spot>, Vec<f64>) =
                sampled(side, |x, y| foam.sheet(x, y)).into_iter().unzip();
            let opacity = texture(side, opacity.into_iter().map(|v| [v as f32]).collect());
            let base = paint(side, |x, y| foam.spot(x, y));
            Ok(vec![Part::Solid(base), Part::Sheet(layer(side, &skin), opacity)])
        }
        "basket-cloth" | "twill" | "victorian-fabric" => Ok(woven(cloth::make(name, seed)?)),
        _ => Err(Error::usage(format!("{name}: built-in materials are {}", NAMES.join(", ")))),
    }?;
    Ok(Material { name: name.into(), parts, height_range: None, notes: Vec::new() })
}

/// Fibres over their lining.
fn woven(cloth: Cloth) -> Vec<Part> {
    let height = HeightMap { height: 2, width: 2, values: vec![cloth.base_height as f32; 4] };
    let lining = Paint::plain(cloth.base_colour, cloth.base_roughness, SPECULAR);
    vec![Part::Fibres(cloth.curves, cloth.looks), Part::Solid(Layer { height, paint: lining })]
}

/// What a function says at every texel's centre, row by row.
fn sampled<T: Send>(side: usize, spot: impl Fn(f64, f64) -> T + Sync) -> Vec<T> {
    let centre = |index: usize| (index as f64 + 0.5) / side as f64;
    (0..side * side).into_par_iter().map(|k| spot(centre(k % side), centre(k / side))).collect()
}

/// A layer that says everywhere what `spot` says.
fn paint(side: usize, spot: impl Fn(f64, f64) -> Spot + Sync) -> Layer {
    layer(side, &sampled(side, spot))
}

fn layer(side: usize, spots: &[Spot]) -> Layer {
    let channel = |value: fn(&Spot) -> f64| texture(side, spots.iter().map(|s| [value(s) as f32]).collect());
    let height =
        HeightMap { height: side, width: side, values: spots.iter().map(|s| s.height as f32).collect() };
    let paint = Paint {
        base_colour: texture(side, spots.iter().map(|s| s.base_colour.map(|c| c as f32)).collect()),
        roughness: channel(|s| s.roughness),
        metalness: channel(|s| s.metalness),
        specular: Texture::constant([SPECULAR]),
        normal: None,
    };
    Layer { height, paint }
}

/// One texel for each position of the tile, clamped to what shading allows.
fn texture<const N: usize>(side: usize, texels: Vec<[f32; N]>) -> Texture<N> {
    let texels = texels.into_iter().map(|t| t.map(|v| v.clamp(0.0, 1.0))).collect();
    Texture::new(side, texels).unwrap_or_else(|| Texture::constant([0.0; N]))
}

/// a + (b - a) t.
fn mix(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * t
}

fn mix_rgb(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    std::array::from_fn(|c| mix(a[c], b[c], t))
}

/// Smooth step from 0 at `low` to 1 at `high`.
fn smooth_step(low: f64, high: f64, x: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bits of the first part's geometry.
    fn shape(material: &Material) -> Vec<u64> {
        match &material.parts[0] {
            Part::Fibres(curves, _) => {
                curves.iter().flat_map(|c| &c.points).flatten().map(|v| v.to_bits()).collect()
            }
            Part::Solid(layer) | Part::Sheet(layer, _) => {
                layer.height.values.iter().map(|v| u64::from(v.to_bits())).collect()
            }
            Part::Mesh(mesh, _) => mesh.positions.iter().flatten().map(|v| v.to_bits()).collect(),
        }
    }

    #[test]
    fn every_name_makes_a_material_that_seeds_vary() {
        for name in NAMES {
            let a = make(name, 32, 1).unwrap();
            assert_eq!(shape(&a), shape(&make(name, 32, 1).unwrap()), "{name}");
            assert_ne!(shape(&a), shape(&make(name, 32, 2).unwrap()), "{name}");
            for part in &a.parts {
                let Part::Solid(Layer { height, .. }) = part else { continue };
                let low = height.values.iter().fold(f32::INFINITY, |a, &b| a.min(b));
                let high = height.values.iter().fold(f32::NEG_INFINITY, |a, &b| a.max(b));
                assert!(low < -0.02 && high - low < 0.2, "{name} {low} {high}");
            }
        }
        assert!(make("sand", 32, 0).unwrap_err().to_string().contains("rocks"));
        assert!(make("rocks", 1, 0).is_err());
    }

    #[test]
    fn the_functions_have_the_period_of_the_tile() {
        let (rings, rocks) = (metal_rings::MetalRings::new(3), rocks::Rocks::new(3));
        // Rounding of x + 1 moves positions by 1e-16; the steepest function is a ring's rim, a square root.
        const ROUNDING: f64 = 1e-6;
        for k in 0..200 {
            let (x, y) = (k as f64 * 0.754_877 % 1.0, k as f64 * 0.569_840 % 1.0);
            for (here, there) in [
                (rings.spot(x, y), rings.spot(x + 1.0, y - 2.0)),
                (rocks.spot(x, y), rocks.spot(x + 1.0, y - 2.0)),
            ] {
                assert!((here.height - there.height).abs() < ROUNDING);
                assert!((here.roughness - there.roughness).abs() < ROUNDING);
            }
            let moved = rocks.spot(x + 0.5, y);
            assert!((rocks.spot(x, y).height - moved.height).abs() > ROUNDING, "half a tile is no period");
        }
    }
}
