//! Neural textures as half-float EXR files with mip levels, four channels a file.
//!
//! File k of a texture holds its channels 4 k to 4 k + 3 as R, G, B, A (0 where there are no more). The mip
//! chain goes down to one texel, as EXR asks; where the model has fewer levels, the rest are box averages of
//! the level before and belong to no model ([`TextureFile::levels`] says how many do).

use crate::checkpoint::Checkpoint;
use crate::config::{OFFSET_TEXTURE, ParallaxConfig, texture_name};
use crate::error::{Error, Result};
use crate::tensors::Tensor;
use exr::math::RoundingMode;
use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes,
    Levels, LineOrder, Text, Vec2, WritableImage, f16,
};
use serde::{Deserialize, Serialize};
use std::io::Cursor;

const PLANE: usize = 4;
const NAMES: [&str; PLANE] = ["R", "G", "B", "A"];
/// Side of an EXR tile; mip levels need tiles.
const TILE: usize = 64;

/// One EXR file of a neural texture.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextureFile {
    /// File name.
    pub file: String,
    /// Texture: `texture` or `offset.texture`.
    pub texture: String,
    /// First channel of the texture in it.
    pub first_channel: usize,
    /// Channels in it, 1 to 4; the rest are 0.
    pub channels: usize,
    /// Height and width of the finest level.
    pub size: [usize; 2],
    /// Mip levels, the finest first, that are the model's.
    pub levels: usize,
    /// Mip levels of the file.
    pub mip_levels: usize,
}

/// The files of a checkpoint's textures with their bytes, `texture-0.exr` first.
///
/// # Errors
/// `Config`, naming the tensor with a value that half floats cannot hold, or that is not valid.
pub fn texture_files(checkpoint: &Checkpoint) -> Result<Vec<(TextureFile, Vec<u8>)>> {
    checkpoint.validate()?;
    let architecture = &checkpoint.header.architecture;
    let names: Vec<String> = (0..architecture.levels()).map(texture_name).collect();
    let mut files = encode(checkpoint, "texture", "texture", &names)?;
    if let ParallaxConfig::Offset(_) = architecture.model.parallax {
        files.extend(encode(checkpoint, "offset", OFFSET_TEXTURE, &[OFFSET_TEXTURE.into()])?);
    }
    Ok(files)
}

fn encode(
    checkpoint: &Checkpoint,
    stem: &str,
    texture: &str,
    names: &[String],
) -> Result<Vec<(TextureFile, Vec<u8>)>> {
    let mut levels = Vec::with_capacity(names.len());
    for name in names {
        let tensor = checkpoint.tensor(name)?;
        match tensor.data.iter().find(|v| f16::from_f32(**v).is_infinite()) {
            Some(v) => {
                return Err(Error::config(format!("tensor {name}"), format!("{v} exceeds half floats")));
            }
            None => levels.push(tensor.clone()),
        }
    }
    let [height, width] = checkpoint.header.architecture.finest_size();
    let mip_levels = height.max(width).ilog2() as usize + 1;
    while levels.len() < mip_levels {
        levels.push(half_size(&levels[levels.len() - 1]));
    }
    let channels = levels[0].shape[2];
    (0..channels.div_ceil(PLANE))
        .map(|plane| {
            let file = TextureFile {
                file: format!("{stem}-{plane}.exr"),
                texture: texture.into(),
                first_channel: PLANE * plane,
                channels: (channels - PLANE * plane).min(PLANE),
                size: [height, width],
                levels: names.len(),
                mip_levels,
            };
            let bytes = exr_bytes(&file, &levels)?;
            Ok((file, bytes))
        })
        .collect()
}

/// The next mip level: each texel is the mean of the texels that it touches.
fn half_size(fine: &Tensor) -> Tensor {
    let [height, width, channels] = [fine.shape[0], fine.shape[1], fine.shape[2]];
    let shape = vec![(height / 2).max(1), (width / 2).max(1), channels];
    let mut data = Vec::with_capacity(shape.iter().product());
    let span = |i: usize, coarse: usize, fine: usize| i * fine / coarse..((i + 1) * fine).div_ceil(coarse);
    for row in 0..shape[0] {
        for column in 0..shape[1] {
            let (rows, columns) = (span(row, shape[0], height), span(column, shape[1], width));
            let share = 1.0 / (rows.len() * columns.len()) as f64;
            data.extend((0..channels).map(|c| {
                let value = |i: usize, j: usize| f64::from(fine.data[(i * width + j) * channels + c]);
                let sum: f64 = rows
                    .clone()
                    .flat_map(|i| columns.clone().map(move |j| (i, j)))
                    .map(|(i, j)| value(i, j))
                    .sum();
                (sum * share) as f32
            }));
        }
    }
    Tensor { shape, data }
}

fn exr_bytes(file: &TextureFile, levels: &[Tensor]) -> Result<Vec<u8>> {
    let [height, width] = file.size;
    let samples = |level: &Tensor, lane: usize| -> Vec<f16> {
        let channel = |texel: &[f32]| texel.get(file.first_channel + lane).copied().unwrap_or(0.0);
        level.data.chunks(level.shape[2]).map(|texel| f16::from_f32(channel(texel))).collect()
    };
    let list = (0..PLANE).map(|lane| {
        let level_data = levels.iter().map(|level| FlatSamples::F16(samples(level, lane))).collect();
        AnyChannel::new(NAMES[lane], Levels::Mip { rounding_mode: RoundingMode::Down, level_data })
    });
    let text = |s: &str| Text::new_or_none(s);
    let last = file.first_channel + file.channels - 1;
    let attributes = LayerAttributes {
        comments: text(&format!(
            "channels {} to {last} of {} in R, G, B, A; the first {} of {} mip levels are the model's",
            file.first_channel, file.texture, file.levels, file.mip_levels
        )),
        wrap_mode_name: text("periodic"),
        ..LayerAttributes::default()
    };
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: Blocks::Tiles(Vec2(TILE, TILE)),
        line_order: LineOrder::Increasing,
    };
    let channels = AnyChannels::sort(list.collect());
    let image = Image::from_layer(Layer::new((width, height), attributes, encoding, channels));
    let mut bytes = Cursor::new(Vec::new());
    // One thread: blocks come in file order, so that the same texture gives the same bytes.
    image.write().non_parallel().to_buffered(&mut bytes).map_err(|e| Error::config(&file.texture, e))?;
    Ok(bytes.into_inner())
}
