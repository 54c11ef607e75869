//! Map files: PNG (8 or 16 bit) and EXR, checked before anything is allocated by what their headers say.

use super::heightfield::SIDES;
use crate::error::{Error, Result};
use exr::prelude::*;
use image::{ColorType, DynamicImage, ImageReader, Limits};
use std::path::Path;

/// A decoded map: three channels a texel, row by row. Grey maps hold the same value three times.
pub struct MapImage {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Values as stored: \[0, 1\] for PNG, scene-linear for EXR.
    pub texels: Vec<[f32; 3]>,
    /// PNG, whose colours are sRGB; EXR is linear.
    pub is_png: bool,
}

/// Reads a map.
///
/// # Errors
/// `File` if it cannot be read, is neither PNG nor EXR, has a side outside [`SIDES`], or channels other than grey or
/// RGB, each with or without alpha (which is ignored), or a value that is not finite.
pub fn read(path: &Path) -> Result<MapImage> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    let map = match extension.as_str() {
        "png" => read_png(path)?,
        "exr" => read_exr(path)?,
        _ => return Err(Error::file(path, "is neither .png nor .exr; convert the map to one of them")),
    };
    match map.texels.iter().position(|t| t.iter().any(|v| !v.is_finite())) {
        Some(k) => {
            let (row, column) = (k / map.width, k % map.width);
            Err(Error::file(path, format!("has a value that is not finite at row {row}, column {column}")))
        }
        None => Ok(map),
    }
}

fn check_size(path: &Path, width: usize, height: usize) -> Result<()> {
    let (least, most) = (SIDES.start(), SIDES.end());
    if SIDES.contains(&width) && SIDES.contains(&height) {
        return Ok(());
    }
    Err(Error::file(
        path,
        format!("is {width} x {height} texels; sides of {least} to {most} work: scale the map"),
    ))
}

fn read_png(path: &Path) -> Result<MapImage> {
    let unreadable = |e: &dyn std::fmt::Display| Error::file(path, format!("cannot be read as PNG: {e}"));
    let open = || {
        let file = std::fs::File::open(path).map_err(|e| unreadable(&e))?;
        Ok::<_, Error>(ImageReader::with_format(std::io::BufReader::new(file), image::ImageFormat::Png))
    };
    let (width, height) = open()?.into_dimensions().map_err(|e| unreadable(&e))?;
    let (width, height) = (width as usize, height as usize);
    check_size(path, width, height)?;
    let mut reader = open()?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(*SIDES.end() as u32);
    limits.max_image_height = Some(*SIDES.end() as u32);
    reader.limits(limits);
    let image = reader.decode().map_err(|e| unreadable(&e))?;
    // 16 bits hold 8-bit values exactly (times 257), so one path serves both depths.
    let grey = matches!(image.color(), ColorType::L8 | ColorType::L16 | ColorType::La8 | ColorType::La16);
    let texels = if grey {
        grey_values(image).map(|v| [png_value(v); 3]).collect()
    } else {
        image.into_rgb16().pixels().map(|p| p.0.map(png_value)).collect()
    };
    Ok(MapImage { width, height, texels, is_png: true })
}

/// What a PNG's 16 bits stand for.
pub(super) fn png_value(v: u16) -> f32 {
    (f64::from(v) / 65535.0) as f32
}

fn grey_values(image: DynamicImage) -> impl Iterator<Item = u16> {
    image.into_luma16().into_raw().into_iter()
}

fn read_exr(path: &Path) -> Result<MapImage> {
    let unreadable = |e: exr::error::Error| Error::file(path, format!("cannot be read as EXR: {e}"));
    let meta = MetaData::read_from_file(path, false).map_err(unreadable)?;
    let Some(header) = meta.headers.first() else {
        return Err(Error::file(path, "has no layers"));
    };
    for header in &meta.headers {
        check_size(path, header.layer_size.width(), header.layer_size.height())?;
        if header.channels.list.iter().any(|c| c.sampling != Vec2(1, 1)) {
            return Err(Error::file(path, "has subsampled channels; save every channel at full size"));
        }
    }
    let names: Vec<_> = header.channels.list.iter().map(|c| c.name.to_string()).collect();
    let colours: Vec<_> = names.iter().filter(|name| *name != "A").collect();
    let rgb = ["R", "G", "B"].map(|want| names.iter().position(|name| name == want));
    let order = match (colours.len(), rgb) {
        (1, _) => [names.iter().position(|name| name != "A").unwrap_or(0); 3],
        (3, [Some(r), Some(g), Some(b)]) => [r, g, b],
        _ => {
            let found = names.join(", ");
            return Err(Error::file(
                path,
                format!("has the channels {found}; one channel, or R, G, B, works"),
            ));
        }
    };
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_file(path)
        .map_err(unreadable)?;
    let layer = &image.layer_data;
    let (width, height) = (layer.size.width(), layer.size.height());
    check_size(path, width, height)?;
    let mut planes = Vec::with_capacity(3);
    for k in order {
        let values: Vec<f32> = match layer.channel_data.list.get(k).map(|c| &c.sample_data) {
            Some(FlatSamples::F16(v)) => v.iter().map(|x| x.to_f32()).collect(),
            Some(FlatSamples::F32(v)) => v.clone(),
            _ => return Err(Error::file(path, "has integer channels; save half or float ones")),
        };
        planes.push(values);
    }
    if planes.iter().any(|plane| plane.len() != width * height) {
        return Err(Error::file(path, "has fewer samples than its size promises"));
    }
    let texels = (0..width * height).map(|k| std::array::from_fn(|c| planes[c][k])).collect();
    Ok(MapImage { width, height, texels, is_png: false })
}
