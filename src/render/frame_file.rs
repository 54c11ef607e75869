//! Files of a frame: linear EXR that carries what it is a picture of, PNG, contact sheets, animations.

use crate::error::{Error, Result};
use crate::query::RgbImage;
use crate::report::picture::{self, Picture};
use exr::prelude::*;
use neumip_export::whole_file::write_whole;
use serde::{Deserialize, Serialize};
use std::io::Cursor;
use std::path::Path;

/// The attribute of a [`Label`] as JSON. There is one: several would be written in the order of a hash.
const LABEL: &str = "neumip";
/// Longest side of a picture in a contact sheet.
const SHEET_SIDE: u32 = 256;
/// Pictures of a contact sheet, at most, and in a row.
const SHEET_PICTURES: usize = 24;
const SHEET_COLUMNS: usize = 6;
/// Longest side of a frame that is read.
const MAX_SIDE: usize = 16_384;

/// What a frame's file says beside its pixels.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Label {
    /// The identity of the scene.
    pub identity: String,
    /// Mean variance of the pixels by the noise of measured answers.
    pub variance: Option<f32>,
}

/// Writes a frame, in half floats or single ones.
///
/// # Errors
/// `File` if it cannot be written.
pub fn write(path: &Path, image: &RgbImage, half: bool, label: &Label) -> Result<()> {
    let channel = |name: &str, c: usize| {
        let values = image.pixels.iter().map(|p| p[c]);
        let bounded = |v: f32| f16::from_f32(v.clamp(-f16::MAX.to_f32(), f16::MAX.to_f32()));
        let samples = match half {
            true => FlatSamples::F16(values.map(bounded).collect()),
            false => FlatSamples::F32(values.collect()),
        };
        AnyChannel::new(name, samples)
    };
    let channels = ["R", "G", "B"].into_iter().enumerate().map(|(c, name)| channel(name, c)).collect();
    let mut attributes = LayerAttributes::default();
    let json = serde_json::to_string(label).map_err(|e| Error::file(path, e))?;
    attributes.other.insert(text(LABEL), AttributeValue::Text(text(&json)));
    let encoding = Encoding {
        compression: Compression::ZIP16,
        line_order: LineOrder::Increasing,
        blocks: Blocks::ScanLines,
    };
    let layer = Layer::new((image.width, image.height), attributes, encoding, AnyChannels::sort(channels));
    let mut bytes = Cursor::new(Vec::new());
    let image = Image::from_layer(layer);
    let written = image.write().non_parallel().to_buffered(&mut bytes);
    written.map_err(|e| Error::file(path, format!("cannot be encoded: {e}")))?;
    Ok(write_whole(path, bytes.get_ref())?)
}

fn text(text: &str) -> Text {
    Text::new_or_panic(text)
}

/// What a frame's file says; None if it is no readable frame.
pub fn label(path: &Path) -> Option<Label> {
    let meta = MetaData::read_from_file(path, false).ok()?;
    let other = &meta.headers.first()?.own_attributes.other;
    let AttributeValue::Text(json) = other.get(&text(LABEL))? else { return None };
    serde_json::from_str(&json.to_string()).ok()
}

/// Reads a frame's pixels.
///
/// # Errors
/// `File` if it is no such frame.
pub fn read(path: &Path) -> Result<RgbImage> {
    let failed = |e: exr::error::Error| Error::file(path, format!("is not a whole, readable frame: {e}"));
    let meta = MetaData::read_from_file(path, false).map_err(failed)?;
    let sizes = || meta.headers.iter().map(|header| header.layer_size);
    if sizes().any(|size| size.width().max(size.height()) > MAX_SIDE) {
        return Err(Error::file(path, format!("has a side beyond {MAX_SIDE}")));
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size, _| (size.width(), vec![[0.0f32; 3]; size.width() * size.height()]),
            |(width, pixels): &mut (usize, Vec<[f32; 3]>), at, (r, g, b): (f32, f32, f32)| {
                pixels[at.y() * *width + at.x()] = [r, g, b];
            },
        )
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_file(path)
        .map_err(failed)?;
    let (width, height) = (image.layer_data.size.width(), image.layer_data.size.height());
    Ok(RgbImage { height, width, pixels: image.layer_data.channel_data.pixels.1 })
}

/// The frames, of so many, that a contact sheet shows.
pub fn shown(frames: usize) -> Vec<usize> {
    let shown = frames.min(SHEET_PICTURES);
    (0..shown).map(|k| k * frames.saturating_sub(1) / shown.saturating_sub(1).max(1)).collect()
}

/// Pictures in rows, made smaller where they are large.
///
/// # Errors
/// `Config` if there are none or they differ in size.
pub fn sheet(pictures: &[Picture]) -> Result<Picture> {
    let small: Vec<Picture> = pictures.iter().map(reduced).collect();
    let rows: Vec<Vec<Picture>> = small.chunks(SHEET_COLUMNS).map(<[Picture]>::to_vec).collect();
    picture::sheet(&rows)
}

/// The picture with sides of at most [`SHEET_SIDE`].
fn reduced(picture: &Picture) -> Picture {
    let (width, height) = picture.dimensions();
    let longest = width.max(height);
    if longest <= SHEET_SIDE {
        return picture.clone();
    }
    let side = |side: u32| (side * SHEET_SIDE).div_ceil(longest).max(1);
    image::imageops::thumbnail(picture, side(width), side(height))
}

/// Frames of one size, one after the other, as an animated PNG that repeats; programs that know no animation show the
/// first.
///
/// # Errors
/// `Config` if there are none, they differ in size, or the encoder refuses them; whatever keeps a frame from being there.
pub fn animation(frames: usize, fps: u16, frame: impl Fn(usize) -> Result<Picture>) -> Result<Vec<u8>> {
    let refuse = |e: &dyn std::fmt::Display| Error::config("animation", e);
    if frames == 0 {
        return Err(refuse(&"needs a frame"));
    }
    let first = frame(0)?;
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, first.width(), first.height());
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let animated = encoder.set_animated(frames as u32, 0);
    animated.and_then(|()| encoder.set_frame_delay(1, fps)).map_err(|e| refuse(&e))?;
    let mut writer = encoder.write_header().map_err(|e| refuse(&e))?;
    for index in 0..frames {
        let picture = frame(index)?;
        if picture.dimensions() != first.dimensions() {
            return Err(refuse(&"its frames differ in size"));
        }
        writer.write_image_data(picture.as_raw()).map_err(|e| refuse(&e))?;
    }
    writer.finish().map_err(|e| refuse(&e))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image() -> RgbImage {
        RgbImage { height: 2, width: 3, pixels: (0..6).map(|k| [k as f32 / 3.0, 1e5, 0.1]).collect() }
    }

    #[test]
    fn a_frame_comes_back_with_its_label() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frame.exr");
        let said = Label { identity: "abc".into(), variance: Some(0.25) };
        write(&path, &image(), false, &said).unwrap();
        assert_eq!((read(&path).unwrap(), label(&path)), (image(), Some(said)));
        let said = Label { identity: "abc".into(), variance: None };
        write(&path, &image(), true, &said).unwrap();
        let half = read(&path).unwrap();
        assert_eq!((half.pixels[1][1], label(&path)), (65504.0, Some(said)));
        std::fs::write(&path, b"no frame").unwrap();
        assert!(label(&path).is_none() && read(&path).is_err());
    }

    #[test]
    fn animations_and_sheets_hold_their_frames() {
        let frames: Vec<Picture> = (0..5).map(|k| Picture::from_pixel(300, 20, image::Rgb([k; 3]))).collect();
        let bytes = animation(5, 12, |k| Ok(frames[k].clone())).unwrap();
        let mut reader = png::Decoder::new(Cursor::new(&bytes)).read_info().unwrap();
        assert_eq!(reader.info().animation_control().unwrap().num_frames, 5);
        let mut pixels = vec![0; 300 * 20 * 3];
        for k in 0..5 {
            reader.next_frame(&mut pixels).unwrap();
            assert!(pixels.iter().all(|v| *v == k));
        }
        assert!(animation(0, 12, |k| Ok(frames[k].clone())).is_err());
        assert_eq!((shown(3), shown(47).len(), shown(47)[23]), (vec![0, 1, 2], 24, 46));
        let sheet = sheet(&frames).unwrap();
        assert_eq!(sheet.height(), 18);
        assert_eq!((sheet.get_pixel(0, 0).0, sheet.get_pixel(4 * 260, 0).0), ([0; 3], [4; 3]));
    }
}
