//! The importance sampler of a material: a mixture of lobes over wi that a tiny network chooses for each (u, level, wo),
//! fitted after training. One safetensors file; the one metadata key, `neumip-sampler`, holds a [`SamplerHeader`].
//!
//! Every lobe is a cosine lobe whose slopes were moved by an affine map, so that it fills the upper hemisphere exactly,
//! is sampled in closed form and has an exact density (the GGX distribution of slopes is the same family). With
//! wi = (x, y, z), slope s = (x, y) / z, matrix A (2 x 2) and centre b:
//!
//! - sample: t is the slope of a cosine-distributed direction; s = A t + b; wi = normalize(s, 1);
//! - density over solid angle: z / (pi |det A| (z^2 + |v|^2)^2), v = A^-1 ((x, y) - b z); 0 where z <= 0.
//!
//! A = identity and b = 0 is the cosine lobe, z / pi. The network reads \[features, wo.x, wo.y\], where features are the
//! texture pyramid's at the position after parallax, and gives [`OUTPUTS_PER_LOBE`] values for each lobe: logit, c.x, c.y,
//! p, r, q, clamped to [`LOGITS`], [`CENTRES`], [`LOG_SCALES`] (p and q) and [`SHEARS`] (r). They mean
//! L = \[\[e^p, 0\], \[r e^p, e^q\]\] and, by the lobe's [`Frame`],
//!
//! - `surface`: A = L, b = c; det A = e^(p + q);
//! - `mirror`: m = -wo.xy / max(wo.z, min_z), T = I + m m^T, A = T L, b = m + T c; det A = (1 + |m|^2) e^(p + q). To first
//!   order 2 T h + m is the slope of the light that a facet of slope h reflects to wo; T^-1 = I - m m^T / (1 + |m|^2).
//!
//! The weights of the lobes and of a plain cosine lobe, which comes first, are the softmax of (0, logits...), then
//! w_k (1 - cosine_floor), and cosine_floor more for the cosine: a value is at most 1 / cosine_floor times as noisy as by
//! cosine sampling.
//!
//! Two numbers xi in \[0, 1) choose a direction. The first chooses the lobe: rest = xi.x; while rest >= w_k and there is a lobe
//! after k, rest -= w_k and k is the next. What is left is the angle of t, phi = 2 pi min(rest / w_k, 1), and the second its
//! length: t = sqrt(xi.y / (1 - xi.y)) (cos phi, sin phi), xi.y at most 1 - 2^-24. (The second, which nothing was taken from,
//! keeps all its bits where a length is far out.) The density that goes with the direction is the mixture's, not the lobe's.
//! A direction is three numbers: z = sqrt(1 - x^2 - y^2) loses what matters near the horizon.

use crate::config::MAX_CHANNELS;
use crate::error::{Error, Result};
use crate::tensors::{Tensor, TensorReader, encode};
use crate::whole_file::write_whole;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Version of the sampler's format.
pub const FORMAT: u32 = 1;
/// The metadata key.
pub const METADATA_KEY: &str = "neumip-sampler";
/// Prefix of the network's layers.
pub const SAMPLER_MLP: &str = "sampler.mlp";
/// Values that the network gives for a lobe.
pub const OUTPUTS_PER_LOBE: usize = 6;
/// Bounds of a lobe's logit.
pub const LOGITS: [f32; 2] = [-20.0, 20.0];
/// Bounds of both components of a centre.
pub const CENTRES: [f32; 2] = [-8.0, 8.0];
/// Bounds of the logarithms of a lobe's widths: of one narrower than 0.007 32-bit floats do not give the density to a
/// thousandth.
pub const LOG_SCALES: [f32; 2] = [-5.0, 2.0];
/// Bounds of a lobe's shear.
pub const SHEARS: [f32; 2] = [-4.0, 4.0];
/// Most lobes besides the cosine.
pub const MAX_LOBES: usize = 4;
const MAX_HIDDEN: usize = 64;
const MAX_DEPTH: usize = 4;

/// Where a lobe is at rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Frame {
    /// Around the normal.
    Surface,
    /// Around the mirror direction of wo, stretched as what facets around the normal reflect.
    Mirror,
}

/// The mixture and its network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SamplerConfig {
    /// Texture channels that the network reads.
    pub features: usize,
    /// Widths of the hidden layers, ReLU after each.
    pub hidden: Vec<usize>,
    /// The lobes besides the cosine.
    pub lobes: Vec<Frame>,
    /// Least weight of the cosine lobe.
    pub cosine_floor: f32,
    /// Least wo.z that divides.
    pub min_z: f32,
}

/// The JSON of the metadata key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SamplerHeader {
    /// Version of the format: [`FORMAT`].
    pub format: u32,
    /// Shapes follow from it.
    pub config: SamplerConfig,
    /// How it was fitted and what it gains.
    pub provenance: serde_json::Value,
}

/// A sampler in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Sampler {
    /// What it is.
    pub header: SamplerHeader,
    /// Weights \[out, in\] and biases \[out\], by name.
    pub tensors: BTreeMap<String, Tensor>,
}

impl SamplerConfig {
    /// Checks every bound.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn validate(&self) -> Result<()> {
        if !(1..=MAX_CHANNELS).contains(&self.features) {
            let problem = format!("{} is outside 1 to {MAX_CHANNELS}", self.features);
            return Err(Error::config("sampler.features", problem));
        }
        let widths = self.hidden.iter().all(|w| (1..=MAX_HIDDEN).contains(w));
        if !widths || !(1..=MAX_DEPTH).contains(&self.hidden.len()) {
            let problem =
                format!("{:?}: 1 to {MAX_DEPTH} layers of 1 to {MAX_HIDDEN} outputs work", self.hidden);
            return Err(Error::config("sampler.hidden", problem));
        }
        if !(1..=MAX_LOBES).contains(&self.lobes.len()) {
            let problem = format!("{} lobes; 1 to {MAX_LOBES} work", self.lobes.len());
            return Err(Error::config("sampler.lobes", problem));
        }
        for (field, value) in [("cosine_floor", self.cosine_floor), ("min_z", self.min_z)] {
            if !(value > 0.0 && value <= 1.0) {
                let problem = format!("{value} must be above 0 and at most 1");
                return Err(Error::config(format!("sampler.{field}"), problem));
            }
        }
        Ok(())
    }

    /// Layer widths of the network, inputs and outputs included.
    pub fn widths(&self) -> Vec<usize> {
        let mut widths = vec![self.features + 2];
        widths.extend_from_slice(&self.hidden);
        widths.push(OUTPUTS_PER_LOBE * self.lobes.len());
        widths
    }

    /// Names and shapes of all tensors: weights \[out, in\], biases \[out\].
    pub fn tensors(&self) -> Vec<(String, Vec<usize>)> {
        let layers = self.widths();
        let named = layers.windows(2).enumerate().flat_map(|(layer, pair)| {
            [
                (crate::config::weight_name(SAMPLER_MLP, layer), vec![pair[1], pair[0]]),
                (crate::config::bias_name(SAMPLER_MLP, layer), vec![pair[1]]),
            ]
        });
        named.collect()
    }
}

impl Sampler {
    /// Reads and validates a file.
    ///
    /// # Errors
    /// `File`, naming the path, and the tensor or field at fault.
    pub fn read(path: &Path) -> Result<Self> {
        #[derive(Deserialize)]
        struct Version {
            format: u32,
        }
        let reader = TensorReader::open(path, METADATA_KEY)?;
        let broken = |e: serde_json::Error| Error::file(path, format!("{METADATA_KEY}: {e}"));
        let Version { format } = serde_json::from_str(&reader.json).map_err(broken)?;
        if format != FORMAT {
            let problem = format!("format: version {format}; this program reads {FORMAT}");
            return Err(Error::file(path, problem));
        }
        let header = serde_json::from_str(&reader.json).map_err(broken)?;
        let sampler = Self { header, tensors: reader.read()? };
        sampler.validate().map_err(|e| Error::file(path, e))?;
        Ok(sampler)
    }

    /// Writes the file whole or not at all; the same content gives the same bytes.
    ///
    /// # Errors
    /// `File`, naming the path, and the tensor or field at fault.
    pub fn write(&self, path: &Path) -> Result<()> {
        write_whole(path, &self.to_bytes().map_err(|e| Error::file(path, e))?)
    }

    /// The bytes of the file.
    ///
    /// # Errors
    /// `Config`, naming the tensor or field at fault.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        self.validate()?;
        let json = serde_json::to_string(&self.header).map_err(|e| Error::config(METADATA_KEY, e))?;
        encode(METADATA_KEY, &json, &self.tensors)
    }

    /// Checks bounds, and names, shapes and values of all tensors.
    ///
    /// # Errors
    /// `Config`, naming the tensor or field at fault.
    pub fn validate(&self) -> Result<()> {
        self.header.config.validate()?;
        let expected: BTreeMap<String, Vec<usize>> = self.header.config.tensors().into_iter().collect();
        for (name, shape) in &expected {
            let problem = match self.tensors.get(name) {
                None => Some("is missing".to_string()),
                Some(tensor) if tensor.shape != *shape => {
                    Some(format!("has shape {:?} where the sampler has {shape:?}", tensor.shape))
                }
                Some(tensor) => tensor.problem(),
            };
            if let Some(problem) = problem {
                return Err(Error::config(format!("tensor {name}"), problem));
            }
        }
        match self.tensors.keys().find(|name| !expected.contains_key(*name)) {
            Some(name) => Err(Error::config(format!("tensor {name}"), "is not part of the sampler")),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sampler() -> Sampler {
        let config = SamplerConfig {
            features: 7,
            hidden: vec![16, 16],
            lobes: vec![Frame::Surface, Frame::Mirror],
            cosine_floor: 0.1,
            min_z: 0.2,
        };
        let filled = |shape: Vec<usize>| Tensor { data: vec![0.25; shape.iter().product()], shape };
        let tensors = config.tensors().into_iter().map(|(name, shape)| (name, filled(shape))).collect();
        let header = SamplerHeader { format: FORMAT, config, provenance: serde_json::json!({"seed": 1}) };
        Sampler { header, tensors }
    }

    #[test]
    fn a_sampler_comes_back_from_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sampler.safetensors");
        sampler().write(&path).unwrap();
        assert_eq!(Sampler::read(&path).unwrap(), sampler());
        assert_eq!(sampler().header.config.widths(), [9, 16, 16, 12]);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let refused = |change: fn(&mut Sampler), names: &str| {
            let mut sampler = sampler();
            change(&mut sampler);
            let problem = sampler.to_bytes().unwrap_err().to_string();
            assert!(problem.contains(names), "{problem}");
        };
        refused(|s| s.header.config.hidden.clear(), "sampler.hidden");
        refused(|s| s.header.config.cosine_floor = 0.0, "sampler.cosine_floor");
        refused(|s| s.header.config.min_z = f32::NAN, "sampler.min_z");
        refused(|s| s.header.config.lobes.clear(), "sampler.lobes");
        refused(|s| s.header.config.features = 0, "sampler.features");
        refused(|s| s.header.config.features = 3, "sampler.mlp.0.weight");
        refused(|s| drop(s.tensors.remove("sampler.mlp.1.bias")), "sampler.mlp.1.bias: is missing");
        refused(|s| s.tensors.get_mut("sampler.mlp.2.bias").unwrap().data[3] = f32::NAN, "value 3 is NaN");
    }
}
