//! OpenEXR frames of named planes, bounded when read.

use super::folder::write_whole;
use crate::error::{Error, Result};
use exr::{
    block::UncompressedBlock,
    meta::attribute::SampleType,
    prelude::{
        AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes,
        LineOrder, Vec2, WritableImage,
    },
};
use half::f16;
use std::{
    fs::File,
    io::{BufReader, Cursor},
    path::Path,
};

/// Most pixels of a frame: bounds what a header can allocate.
pub(crate) const MAX_PIXELS: usize = 1 << 26;
/// No EXR compression shrinks further than this (deflate's own limit is 1032).
const MAX_RATIO: u64 = 2048;

/// One channel, row by row.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Plane {
    /// Half floats.
    Half(Vec<f16>),
    /// Single floats.
    Float(Vec<f32>),
}

impl Plane {
    /// The values in single precision.
    pub(crate) fn into_f32(self) -> Vec<f32> {
        match self {
            Self::Half(values) => values.into_iter().map(f16::to_f32).collect(),
            Self::Float(values) => values,
        }
    }

    fn copy_line(&mut self, start: usize, bytes: &[u8]) -> Option<()> {
        match self {
            Self::Half(values) => {
                let line = values.get_mut(start..start.checked_add(bytes.len() / 2)?)?;
                for (value, b) in line.iter_mut().zip(bytes.chunks_exact(2)) {
                    *value = f16::from_ne_bytes([b[0], b[1]]);
                }
            }
            Self::Float(values) => {
                let line = values.get_mut(start..start.checked_add(bytes.len() / 4)?)?;
                for (value, b) in line.iter_mut().zip(bytes.chunks_exact(4)) {
                    *value = f32::from_ne_bytes([b[0], b[1], b[2], b[3]]);
                }
            }
        }
        Some(())
    }
}

/// Writes planes of `height` x `width` values as ZIP-compressed scan lines; returns the bytes written.
pub(crate) fn write_frame(path: &Path, size: [usize; 2], planes: Vec<(&str, Plane)>) -> Result<u64> {
    let channels = planes
        .into_iter()
        .map(|(name, plane)| {
            let samples = match plane {
                Plane::Half(values) => FlatSamples::F16(values),
                Plane::Float(values) => FlatSamples::F32(values),
            };
            AnyChannel::new(name, samples)
        })
        .collect();
    let encoding = Encoding {
        compression: Compression::ZIP16,
        line_order: LineOrder::Increasing,
        blocks: Blocks::ScanLines,
    };
    let layer =
        Layer::new((size[1], size[0]), LayerAttributes::default(), encoding, AnyChannels::sort(channels));
    let image = Image::from_layer(layer);
    let writer = image.write();
    let writer = if rayon::current_num_threads() > 1 { writer } else { writer.non_parallel() };
    let mut bytes = Cursor::new(Vec::new());
    writer.to_buffered(&mut bytes).map_err(|e| Error::file(path, format!("cannot be encoded: {e}")))?;
    write_whole(path, bytes.get_ref())
}

/// Reads the named channels of the first layer, in the order of `names`, and its \[height, width\], which
/// must be `size` where that is given.
///
/// # Errors
/// `File` if it is not an EXR of that size with those channels, all of it.
pub(crate) fn read_frame(
    path: &Path,
    size: Option<[usize; 2]>,
    names: &[&str],
) -> Result<([usize; 2], Vec<Plane>)> {
    let failed = |e: exr::error::Error| Error::file(path, format!("is not a whole, readable EXR: {e}"));
    let wrong = |problem: String| Error::file(path, problem);
    let file = File::open(path).map_err(|e| wrong(format!("cannot be read: {e}")))?;
    let bytes = file.metadata().map_err(|e| wrong(format!("cannot be read: {e}")))?.len();
    let reader = exr::block::read(BufReader::new(file), false).map_err(failed)?;

    // Check the header before anything is allocated by its word.
    let header = reader.headers().first().ok_or_else(|| wrong("has no layer".into()))?;
    let (width, height) = (header.layer_size.width(), header.layer_size.height());
    if let Some(expected) = size
        && expected != [height, width]
    {
        return Err(wrong(format!("is {height} x {width} where {} x {} is due", expected[0], expected[1])));
    }
    let pixels = width.checked_mul(height).filter(|p| (1..=MAX_PIXELS).contains(p));
    let pixels =
        pixels.ok_or_else(|| wrong(format!("{height} x {width} is outside 1 to {MAX_PIXELS} pixels")))?;
    let raw = pixels as u64 * header.channels.bytes_per_pixel as u64;
    if raw / MAX_RATIO > bytes {
        return Err(wrong(format!("declares {raw} bytes of pixels in {bytes} bytes of file")));
    }
    if header.deep || header.channels.list.iter().any(|c| c.sampling != Vec2(1, 1)) {
        return Err(wrong("is deep or subsampled: flat scan lines or tiles are needed".into()));
    }

    // Match the file's channels to the planes that are wanted.
    let mut planes = Vec::with_capacity(names.len());
    let mut plane_of = vec![None; header.channels.list.len()];
    for name in names {
        let Some(index) = header.channels.list.iter().position(|c| c.name == **name) else {
            return Err(wrong(format!("has no channel {name}; it needs {}", names.join(", "))));
        };
        plane_of[index] = Some(planes.len());
        planes.push(match header.channels.list[index].sample_type {
            SampleType::F16 => Plane::Half(vec![f16::ZERO; pixels]),
            SampleType::F32 => Plane::Float(vec![0.0; pixels]),
            SampleType::U32 => return Err(wrong(format!("channel {name} holds integers"))),
        });
    }

    let mut filled = 0;
    let meta = reader.meta_data().clone();
    for chunk in reader.all_chunks(false).map_err(failed)? {
        let block =
            UncompressedBlock::decompress_chunk(chunk.map_err(failed)?, &meta, false).map_err(failed)?;
        if block.index.layer != 0 || block.index.level != Vec2(0, 0) {
            continue;
        }
        for line in block.lines(&meta.headers[0].channels) {
            if let Some(plane) = plane_of[line.location.channel] {
                let start = line.location.position.y() * width + line.location.position.x();
                planes[plane]
                    .copy_line(start, line.value)
                    .ok_or_else(|| wrong("has a chunk outside its window".into()))?;
                filled += line.location.sample_count;
            }
        }
    }
    if filled != pixels * names.len() {
        return Err(wrong(format!("holds {filled} of {} values: it is truncated", pixels * names.len())));
    }
    Ok(([height, width], planes))
}
