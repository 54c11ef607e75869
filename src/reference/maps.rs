//! Materials as texture sites hand them out: `material.json` beside its maps.
//!
//! ```json
//! {"version": 1, "name": "bricks", "height": "height.png", "displacement": 0.08, "midlevel": 0.5,
//!  "base_colour": "colour.png", "roughness": "roughness.png", "metalness": 0, "specular": 0.04}
//! ```
//! Paths are relative to the file. Every property is a map or a constant. A height value v lies at
//! z = displacement (v - midlevel) tile widths. Colours in PNG are sRGB; all other maps, and all EXR, are linear.

use super::heightfield::{HeightMap, MAX_DEPTH};
use super::map_file::{self, MapImage};
use super::material::Material;
use super::resample::{nearest_side, resample};
use super::texture::Texture;
use crate::error::{Error, Result};
use serde::Deserialize;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Largest material.json that is read, in bytes.
const MAX_JSON_BYTES: u64 = 1 << 20;
/// Longest name, which is carried into every file that is made of the material.
const MAX_NAME_BYTES: usize = 256;

/// material.json.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct MaterialFile {
    version: u32,
    name: String,
    height: Scalar,
    // As f64, so that a number too large for f32 is refused by its field's name.
    displacement: f64,
    #[serde(default = "half")]
    midlevel: f64,
    base_colour: Colour,
    roughness: Scalar,
    #[serde(default = "zero")]
    metalness: Scalar,
    #[serde(default = "glass")]
    specular: Scalar,
}

#[derive(Debug, Deserialize)]
#[serde(untagged, expecting = "expected a number or the name of a map")]
enum Scalar {
    Constant(f32),
    Map(PathBuf),
}

#[derive(Debug, Deserialize)]
#[serde(untagged, expecting = "expected [r, g, b] or the name of a map")]
enum Colour {
    Constant([f32; 3]),
    Map(PathBuf),
}

fn half() -> f64 {
    0.5
}

fn zero() -> Scalar {
    Scalar::Constant(0.0)
}

fn glass() -> Scalar {
    Scalar::Constant(0.04)
}

/// Reads a material from its `material.json`.
///
/// # Errors
/// `File`, naming the map or the json and the field: unreadable or unknown content, a value that is out of range or
/// not finite, a data map whose channels differ, or a displacement that leaves [`MAX_DEPTH`].
pub fn read(path: &Path) -> Result<Material> {
    let mut text = String::new();
    let unreadable = |e: std::io::Error| Error::file(path, format!("cannot be read as a material: {e}"));
    let file = std::fs::File::open(path).map_err(unreadable)?;
    file.take(MAX_JSON_BYTES + 1).read_to_string(&mut text).map_err(unreadable)?;
    if text.len() as u64 > MAX_JSON_BYTES {
        return Err(Error::file(
            path,
            format!("is longer than the {MAX_JSON_BYTES} bytes of a material.json"),
        ));
    }
    let file: MaterialFile =
        serde_json::from_str(&text).map_err(|e| Error::file(path, format!("is not a material: {e}")))?;
    if file.version != 1 {
        return Err(Error::file(path, format!("version is {}; this program reads version 1", file.version)));
    }
    let mut reader = Reader { path, notes: Vec::new() };
    if file.name.is_empty() || file.name.len() > MAX_NAME_BYTES || file.name.chars().any(char::is_control) {
        return Err(reader.refuse("name", format!("must be one line of 1 to {MAX_NAME_BYTES} bytes")));
    }
    let height = reader.height(&file)?;
    let base_colour = reader.colour("base_colour", &file.base_colour)?;
    let roughness = reader.share("roughness", &file.roughness)?;
    let metalness = reader.share("metalness", &file.metalness)?;
    let specular = reader.share("specular", &file.specular)?;
    Ok(Material { name: file.name, height, base_colour, roughness, metalness, specular, notes: reader.notes })
}

/// Reads the maps of one material and collects what is to be said about them.
struct Reader<'a> {
    path: &'a Path,
    notes: Vec<String>,
}

impl Reader<'_> {
    fn height(&mut self, file: &MaterialFile) -> Result<HeightMap> {
        let (scale, midlevel) = (file.displacement, file.midlevel);
        let most = 2.0 * f64::from(MAX_DEPTH);
        if !(0.0..=most).contains(&scale) {
            return Err(self.refuse("displacement", format!("is {scale}; 0 to {most} tile widths work")));
        }
        if !(0.0..=1.0).contains(&midlevel) {
            return Err(self.refuse("midlevel", format!("is {midlevel}; 0 to 1 work")));
        }
        let (scale, midlevel) = (scale as f32, midlevel as f32);
        let (side, values) = match &file.height {
            Scalar::Constant(value) => (2, vec![[*value]; 4]),
            Scalar::Map(map) => self.grey_map("height", map)?,
        };
        if let Some([v]) = values.iter().find(|[v]| !v.is_finite() || *v < 0.0) {
            return Err(self.refuse("height", format!("holds {v}; heights are finite and not negative")));
        }
        let values: Vec<f32> = values
            .iter()
            .map(|[v]| (f64::from(scale) * (f64::from(*v) - f64::from(midlevel))) as f32)
            .collect();
        if let Some(z) = values.iter().find(|z| z.abs() > MAX_DEPTH) {
            let problem =
                format!("puts the surface at {z} tile widths; at most {MAX_DEPTH} from the plane works");
            return Err(self.refuse("displacement", problem));
        }
        Ok(HeightMap { height: side, width: side, values })
    }

    fn colour(&mut self, field: &str, colour: &Colour) -> Result<Texture<3>> {
        let texture = match colour {
            Colour::Constant(value) => Texture::constant(*value),
            Colour::Map(map) => {
                let path = self.resolve(map);
                let mut image = map_file::read(&path)?;
                if image.is_png {
                    image.texels.iter_mut().for_each(|t| *t = t.map(srgb_to_linear));
                }
                let (side, texels) = self.square(field, map, image.width, image.height, image.texels);
                self.texture(field, side, texels)?
            }
        };
        self.check_shares(field, texture)
    }

    fn share(&mut self, field: &str, scalar: &Scalar) -> Result<Texture<1>> {
        let texture = match scalar {
            Scalar::Constant(value) => Texture::constant([*value]),
            Scalar::Map(map) => {
                let (side, texels) = self.grey_map(field, map)?;
                self.texture(field, side, texels)?
            }
        };
        self.check_shares(field, texture)
    }

    fn texture<const N: usize>(&self, field: &str, side: usize, texels: Vec<[f32; N]>) -> Result<Texture<N>> {
        Texture::new(side, texels).ok_or_else(|| self.refuse(field, "has no texels"))
    }

    fn check_shares<const N: usize>(&self, field: &str, texture: Texture<N>) -> Result<Texture<N>> {
        match texture.texels().iter().flatten().find(|v| !(0.0..=1.0).contains(*v)) {
            Some(v) => Err(self.refuse(field, format!("holds {v}; 0 to 1 work"))),
            None => Ok(texture),
        }
    }

    /// A map of one quantity: grey, or RGB with three equal channels.
    fn grey_map(&mut self, field: &str, map: &Path) -> Result<(usize, Vec<[f32; 1]>)> {
        let path = self.resolve(map);
        let MapImage { width, height, texels, .. } = map_file::read(&path)?;
        if texels.iter().any(|t| t[0] != t[1] || t[0] != t[2]) {
            let problem = format!("has three different channels where {field} needs one; save it as grey");
            return Err(Error::file(&path, problem));
        }
        let grey = texels.iter().map(|t| [t[0]]).collect();
        Ok(self.square(field, map, width, height, grey))
    }

    fn square<const N: usize>(
        &mut self,
        field: &str,
        map: &Path,
        width: usize,
        height: usize,
        texels: Vec<[f32; N]>,
    ) -> (usize, Vec<[f32; N]>) {
        if width == height && width.is_power_of_two() {
            return (width, texels);
        }
        let side = nearest_side(width, height);
        let reason = if width == height { "not a power of two" } else { "not square" };
        let map = map.display();
        self.notes
            .push(format!("{field}: {map} is {width} x {height}, {reason}; resampled to {side} x {side}"));
        (side, resample(&texels, width, height, side))
    }

    fn resolve(&self, map: &Path) -> PathBuf {
        self.path.parent().unwrap_or(Path::new("")).join(map)
    }

    fn refuse(&self, field: &str, problem: impl std::fmt::Display) -> Error {
        Error::file(self.path, format!("{field} {problem}"))
    }
}

/// The sRGB transfer function of IEC 61966-2-1, from \[0, 1\] to linear.
fn srgb_to_linear(v: f32) -> f32 {
    let v = f64::from(v);
    (if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_meets_its_published_values() {
        assert_eq!(srgb_to_linear(0.0), 0.0);
        assert_eq!(srgb_to_linear(1.0), 1.0);
        // Mid grey 188 / 255 is half the light, to the three digits in which it is usually quoted.
        assert!((srgb_to_linear(188.0 / 255.0) - 0.5029).abs() < 1e-4);
    }
}
