//! A picture that shows at a glance what a dataset holds: views, test slices, coarser levels, training patches.
//!
//! It reads what it shows from the dataset's files.

use super::{
    block::Block,
    format::{MANIFEST, SplitName},
    read::{Dataset, Split},
};
use crate::{
    error::{Error, Result},
    query::RgbImage,
    srgb,
};
use image::{
    ExtendedColorType, ImageEncoder, Rgb,
    codecs::png::{CompressionType, FilterType, PngEncoder},
};

/// Pictures of a row, and small ones of a row.
const COLUMNS: usize = 6;
const SMALL_COLUMNS: usize = 2 * COLUMNS;
/// Sides of a picture in pixels: the largest with which the sheet is not too large.
const SIDES: [usize; 6] = [256, 208, 160, 128, 96, 64];
/// The sheet has no more bytes where that can be had.
const MAX_BYTES: usize = 1 << 20;
/// Pixels between pictures.
const GAP: usize = 4;
/// Colour between pictures.
const GROUND: [u8; 3] = [32; 3];
/// The share of values that are not brighter than white.
const WHITE: f64 = 0.99;

/// Pictures of one size.
struct Row {
    small: bool,
    images: Vec<RgbImage>,
}

/// The contact sheet of a dataset as a PNG in sRGB, of about a megabyte at most.
///
/// Rows: the views; six test slices at level 0; a patch of each coarser level of the test split, enlarged; training
/// patches. The exposure is one for all of them: 99 % of the values are at most white.
///
/// # Errors
/// `File` if a file of the dataset cannot be read, or if there is nothing to show.
pub fn contact_sheet(data: &Dataset) -> Result<Vec<u8>> {
    let rows = rows(data)?;
    let scale = exposure(&rows);
    let path = data.root().join(MANIFEST);
    if rows.is_empty() {
        return Err(Error::file(path, "describes no data"));
    }
    let mut sheet = Vec::new();
    for side in SIDES {
        sheet.clear();
        let picture = draw(&rows, side, scale);
        let encoder =
            PngEncoder::new_with_quality(&mut sheet, CompressionType::Default, FilterType::Adaptive);
        encoder
            .write_image(picture.as_raw(), picture.width(), picture.height(), ExtendedColorType::Rgb8)
            .map_err(|e| Error::file(&path, format!("contact sheet cannot be encoded: {e}")))?;
        if sheet.len() <= MAX_BYTES {
            break;
        }
    }
    Ok(sheet)
}

fn rows(data: &Dataset) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    let views = data.manifest().views.iter().take(2 * COLUMNS);
    let views = views.map(|view| Ok(data.read_view(&view.name)?.1)).collect::<Result<Vec<_>>>()?;
    for images in views.chunks(COLUMNS) {
        rows.push(Row { small: false, images: images.to_vec() });
    }
    let held = |name| data.split_names().contains(&name).then(|| data.split(name)).transpose();
    if let Some(test) = held(SplitName::Test)? {
        rows.push(Row { small: false, images: patches(&test, COLUMNS, |level| level == 0)? });
        let mut seen = Vec::new();
        let coarser = patches(&test, SMALL_COLUMNS, |level| {
            let new = level > 0 && !seen.contains(&level);
            seen.push(level);
            new
        })?;
        rows.push(Row { small: true, images: coarser });
    }
    if let Some(train) = held(SplitName::Train)? {
        rows.push(Row { small: true, images: patches(&train, SMALL_COLUMNS, |_| true)? });
    }
    rows.retain(|row| !row.images.is_empty());
    Ok(rows)
}

/// The first patch of each of the first blocks that are wanted by their rounded level.
fn patches(split: &Split, most: usize, mut wanted: impl FnMut(usize) -> bool) -> Result<Vec<RgbImage>> {
    let mut images = Vec::new();
    for file in 0..split.files() {
        let rows = split.read_rows(file)?;
        let mut chosen: Vec<usize> = Vec::new();
        for (k, row) in rows.iter().enumerate() {
            if images.len() + chosen.len() < most && wanted(row.layout.level().round() as usize) {
                chosen.push(k);
            }
        }
        if !chosen.is_empty() {
            let blocks = split.read_file(file)?;
            images.extend(chosen.iter().filter_map(|k| blocks.get(*k)).map(first_patch));
        }
        if images.len() == most {
            break;
        }
    }
    Ok(images)
}

fn first_patch(block: &Block) -> RgbImage {
    let (side, target) = (block.patch(), block.target());
    let pixels = (0..side * side).map(|k| target[k / side * block.side() + k % side]).collect();
    RgbImage { height: side, width: side, pixels }
}

/// The factor that makes the quantile [`WHITE`] of all values 1.
fn exposure(rows: &[Row]) -> f32 {
    let mut values: Vec<f32> = rows
        .iter()
        .flat_map(|row| &row.images)
        .flat_map(|image| image.pixels.as_flattened().iter().copied())
        .collect();
    if values.is_empty() {
        return 1.0;
    }
    let at = ((values.len() - 1) as f64 * WHITE).ceil() as usize;
    let (_, white, _) = values.select_nth_unstable_by(at, f32::total_cmp);
    if *white > 0.0 { 1.0 / *white } else { 1.0 }
}

fn draw(rows: &[Row], side: usize, scale: f32) -> image::RgbImage {
    let of = |row: &Row| if row.small { (side - GAP) / 2 } else { side };
    let height: usize = rows.iter().map(|row| of(row) + GAP).sum();
    let (width, height) = (COLUMNS * (side + GAP) + GAP, height + GAP);
    let mut sheet = image::RgbImage::from_pixel(width as u32, height as u32, Rgb(GROUND));
    let mut top = GAP;
    for row in rows {
        let side = of(row);
        for (k, image) in row.images.iter().enumerate() {
            for (at, value) in fit(image, side).into_iter().enumerate() {
                let (x, y) = (GAP + k * (side + GAP) + at % side, top + at / side);
                sheet.put_pixel(x as u32, y as u32, Rgb(value.map(|v| srgb::encode(v * scale))));
            }
        }
        top += side + GAP;
    }
    sheet
}

/// An image as a square of side `side`: every pixel is the mean over its part of the image.
fn fit(image: &RgbImage, side: usize) -> Vec<[f32; 3]> {
    // Pixels of the image that a pixel covers along an axis, with their parts.
    let parts = |k: usize, length: usize| {
        let (start, end) =
            (k as f64 * length as f64 / side as f64, (k + 1) as f64 * length as f64 / side as f64);
        let last = (end.ceil() as usize).min(length);
        (start.floor() as usize..last).map(move |i| {
            let part = (end.min((i + 1) as f64) - start.max(i as f64)).max(0.0);
            (i, part / (end - start))
        })
    };
    let mut out = Vec::with_capacity(side * side);
    for y in 0..side {
        for x in 0..side {
            let mut sum = [0.0f64; 3];
            for (i, part_y) in parts(y, image.height) {
                for (j, part_x) in parts(x, image.width) {
                    let pixel = image.pixels[i * image.width + j];
                    (0..3).for_each(|c| sum[c] += part_x * part_y * f64::from(pixel[c]));
                }
            }
            out.push(sum.map(|v| v as f32));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(height: usize, width: usize) -> RgbImage {
        let pixels = (0..height * width).map(|k| [k as f32, 1.0, (k % width) as f32]).collect();
        RgbImage { height, width, pixels }
    }

    #[test]
    fn fitting_keeps_means() {
        /// Sums of a few hundred products in double precision, stored in single.
        const ROUNDED: f64 = 1e-5;
        for (height, width, side) in [(7, 5, 16), (64, 48, 10), (8, 8, 8), (1, 1, 3)] {
            let image = image(height, width);
            let mean = |pixels: &[[f32; 3]], c: usize| {
                pixels.iter().map(|p| f64::from(p[c])).sum::<f64>() / pixels.len() as f64
            };
            let mut fitted = fit(&image, side);
            let off = |pixels: &[[f32; 3]]| {
                let each = (0..3).map(|c| {
                    (mean(pixels, c) - mean(&image.pixels, c)).abs() / mean(&image.pixels, c).max(1.0)
                });
                each.fold(0.0, f64::max)
            };
            assert!(off(&fitted) < ROUNDED);
            fitted[0][1] += 0.1;
            assert!(off(&fitted) > ROUNDED);
        }
        assert_eq!(fit(&image(6, 6), 6), image(6, 6).pixels);
    }

    #[test]
    fn nearly_all_values_fit_under_white() {
        let image = image(100, 100);
        let values = image.pixels.as_flattened().to_vec();
        let scale = exposure(&[Row { small: false, images: vec![image] }]);
        let above = values.iter().filter(|v| **v * scale > 1.0).count();
        assert!(above <= values.len() / 100 && above > values.len() / 120, "{above}");
        assert_eq!(exposure(&[]), 1.0);
    }
}
