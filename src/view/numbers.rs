//! The page's numbers as one text: weights, textures, golden answers and a reference frame, as the page's script reads them.

use super::Reference;
use crate::error::{Error, Result};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use half::f16;
use neumip_export::config::{OFFSET_TEXTURE, ParallaxConfig, texture_name};
use neumip_export::weights::Layout;
use neumip_export::{Bundle, Checkpoint, Golden, Tensor};
use serde::Serialize;
use std::collections::BTreeMap;

/// Channels of a texel in WebGL.
const PLANE: usize = 4;
/// Most bytes of numbers: a third more as text, which browsers still take as one script element.
const MOST_BYTES: usize = 256 << 20;

/// Where an array is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Place {
    /// First byte.
    at: usize,
    /// Values.
    count: usize,
    /// Of 16 bits, not 32.
    half: bool,
}

/// A mip level of a texture array: \[layers, height, width, 4\].
#[derive(Clone, Debug, Serialize)]
pub(super) struct Level {
    #[serde(flatten)]
    place: Place,
    layers: usize,
    height: usize,
    width: usize,
}

/// Where everything is.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Places {
    weights: Place,
    /// By the name that the shader has for them.
    textures: BTreeMap<&'static str, Vec<Level>>,
    golden: Queries,
    reference: Option<Queries>,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct Queries {
    u: Place,
    wi: Place,
    wo: Place,
    level: Place,
    rgb: Place,
}

/// Everything that the page reads, and its bytes in base 64.
///
/// # Errors
/// `Config`, naming the tensor that is missing, or saying that a page cannot hold all of it.
pub(super) fn pack(bundle: &Bundle, reference: Option<&Reference>) -> Result<(Places, String)> {
    let mut bytes = Bytes::default();
    let checkpoint = &bundle.checkpoint;
    let layout = Layout::new(&checkpoint.header.architecture, None);
    let weights = bytes.single(&layout.fill(checkpoint, None)?);
    let textures = textures(&mut bytes, checkpoint)?;
    let Golden { u, wi, wo, level, rgb, .. } = &bundle.golden;
    let mut queries = |[u, wi, wo]: [&[[f32; 2]]; 3], level: &[f32], rgb: &[[f32; 3]]| Queries {
        u: bytes.single(u.as_flattened()),
        wi: bytes.single(wi.as_flattened()),
        wo: bytes.single(wo.as_flattened()),
        level: bytes.single(level),
        rgb: bytes.shortest(rgb.as_flattened()),
    };
    let golden = queries([u, wi, wo], level, rgb);
    let reference = reference
        .map(|Reference { queries: q, rgb, .. }| queries([&q.u, &q.wi, &q.wo], &q.level, &rgb.pixels));
    if bytes.0.len() > MOST_BYTES {
        let problem = format!(
            "textures and reference take {} MB, more than the {} MB that one page can hold",
            bytes.0.len() >> 20,
            MOST_BYTES >> 20
        );
        return Err(Error::config("page", problem));
    }
    Ok((Places { weights, textures, golden, reference }, STANDARD.encode(bytes.0)))
}

fn textures(bytes: &mut Bytes, checkpoint: &Checkpoint) -> Result<BTreeMap<&'static str, Vec<Level>>> {
    let architecture = &checkpoint.header.architecture;
    let pyramid: Vec<String> = (0..architecture.levels()).map(texture_name).collect();
    let mut made = BTreeMap::from([("neumip_texture", levels(bytes, checkpoint, &pyramid)?)]);
    if let ParallaxConfig::Offset(_) = architecture.model.parallax {
        made.insert("neumip_offset", levels(bytes, checkpoint, &[OFFSET_TEXTURE.into()])?);
    }
    Ok(made)
}

fn levels(bytes: &mut Bytes, checkpoint: &Checkpoint, names: &[String]) -> Result<Vec<Level>> {
    let level = |name: &String| {
        let Tensor { shape, data } = checkpoint.tensor(name)?;
        let [height, width, channels] = [shape[0], shape[1], shape[2]];
        let layers = channels.div_ceil(PLANE);
        let mut planes = vec![0.0; layers * height * width * PLANE];
        for (texel, values) in data.chunks_exact(channels).enumerate() {
            for (channel, value) in values.iter().enumerate() {
                planes[((channel / PLANE) * height * width + texel) * PLANE + channel % PLANE] = *value;
            }
        }
        Ok(Level { place: bytes.shortest(&planes), layers, height, width })
    };
    names.iter().map(level).collect()
}

/// Little-endian values; every array begins at a multiple of four bytes, as a browser's views of them ask.
#[derive(Default)]
struct Bytes(Vec<u8>);

impl Bytes {
    fn single(&mut self, values: &[f32]) -> Place {
        let place = Place { at: self.0.len(), count: values.len(), half: false };
        self.0.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        place
    }

    /// In 16 bits where that loses nothing: the textures of a bundle in half precision, the colours of a frame.
    fn shortest(&mut self, values: &[f32]) -> Place {
        let exact = |v: &f32| f16::from_f32(*v).to_f32().to_bits() == v.to_bits();
        if !values.iter().all(exact) {
            return self.single(values);
        }
        let place = Place { at: self.0.len(), count: values.len(), half: true };
        self.0.extend(values.iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()));
        self.0.resize(self.0.len().next_multiple_of(PLANE), 0);
        place
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_stand_where_they_are_said_to_be() {
        let mut bytes = Bytes::default();
        let [half, single, third] =
            [bytes.shortest(&[0.5, -2.0, 65504.0]), bytes.shortest(&[0.1, 1e-30]), bytes.single(&[1.0])];
        assert_eq!(half, Place { at: 0, count: 3, half: true });
        assert_eq!(single, Place { at: 8, count: 2, half: false });
        assert_eq!(third, Place { at: 16, count: 1, half: false });
        assert_eq!(bytes.0[8..12], 0.1f32.to_le_bytes());
        assert_eq!(bytes.0[2..4], f16::from_f32(-2.0).to_le_bytes());
        // Beyond half floats nothing is rounded.
        assert!(!bytes.shortest(&[65536.0]).half);
    }
}
