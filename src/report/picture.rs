//! Linear images as pictures: sRGB, enlargement, false-colour differences, strips, PNG.

use super::colour;
use crate::error::{Error, Result};
use crate::query::RgbImage;
use crate::srgb;
use base64::Engine;
use image::{ImageFormat, Rgba, RgbaImage};
use std::io::Cursor;

/// 8 bits a channel, sRGB.
pub type Picture = image::RgbImage;

/// Longest side of a picture.
pub const MAX_SIDE: usize = 16_384;
/// Transparent pixels between the pictures of a strip.
const GAP: u32 = 4;

/// (height, width) of an image that can be shown.
///
/// # Errors
/// `Config` if it has no pixels, not `height * width` of them, or a side beyond [`MAX_SIDE`].
pub fn shape(image: &RgbImage) -> Result<(u32, u32)> {
    let (height, width, pixels) = (image.height, image.width, image.pixels.len());
    if height == 0 || width == 0 || height > MAX_SIDE || width > MAX_SIDE {
        return Err(Error::config("image", format!("{height} x {width}: sides must be 1 to {MAX_SIDE}")));
    }
    if pixels != height * width {
        return Err(Error::config("image", format!("has {pixels} pixels, not {height} x {width}")));
    }
    Ok((height as u32, width as u32))
}

/// Linear RGB times 2^`stops`, clamped to \[0, 1\], as sRGB. A pixel that is not finite is cyan.
///
/// # Errors
/// As [`shape`].
pub fn srgb(image: &RgbImage, stops: f32) -> Result<Picture> {
    let scale = stops.exp2();
    from_pixels(image, |i| {
        let pixel = image.pixels[i];
        let finite = pixel.iter().all(|v| v.is_finite());
        if finite { pixel.map(|v| srgb::encode(v * scale)) } else { colour::INVALID }
    })
}

/// Mean over the channels of |a - b|, both clamped to \[0, 1\] as in `mse`.
pub fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    let channel = |c: usize| (a[c].clamp(0.0, 1.0) - b[c].clamp(0.0, 1.0)).abs();
    (channel(0) + channel(1) + channel(2)) / 3.0
}

/// [`distance`] of each pixel as a colour: dark violet at 0, pale yellow from `maximum` on, cyan if not a
/// number.
///
/// # Errors
/// `Config` if the shapes differ, as [`shape`], or if `maximum` is not positive.
pub fn difference(a: &RgbImage, b: &RgbImage, maximum: f32) -> Result<Picture> {
    if shape(a)? != shape(b)? {
        return Err(Error::config("image", "the two images of a difference have different shapes"));
    }
    if !(maximum.is_finite() && maximum > 0.0) {
        return Err(Error::config("maximum", format!("{maximum} is not positive")));
    }
    let map = colour::map();
    from_pixels(a, |i| colour::look_up(&map, distance(a.pixels[i], b.pixels[i]) / maximum))
}

fn from_pixels(image: &RgbImage, pixel: impl Fn(usize) -> [u8; 3]) -> Result<Picture> {
    let (height, width) = shape(image)?;
    Ok(Picture::from_fn(width, height, |x, y| image::Rgb(pixel(y as usize * image.width + x as usize))))
}

/// Every pixel as a square of `factor` pixels.
///
/// # Errors
/// `Config` if `factor` is 0 or a side would pass [`MAX_SIDE`].
pub fn enlarged(picture: &Picture, factor: u32) -> Result<Picture> {
    let side = u64::from(picture.width().max(picture.height())) * u64::from(factor);
    if factor == 0 || side > MAX_SIDE as u64 {
        return Err(Error::config("factor", format!("{factor}: sides must stay within 1 to {MAX_SIDE}")));
    }
    let (width, height) = (picture.width() * factor, picture.height() * factor);
    Ok(Picture::from_fn(width, height, |x, y| *picture.get_pixel(x / factor, y / factor)))
}

/// The picture as a PNG file.
///
/// # Errors
/// `Config` if the encoder refuses it.
pub fn png(picture: &Picture) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, ImageFormat::Png).map_err(|e| Error::config("image", e))?;
    Ok(bytes.into_inner())
}

/// A PNG file as the address of an `<img>`.
pub fn data_uri(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", base64::engine::general_purpose::STANDARD.encode(png))
}

/// Linear images side by side, 2^`stops` times brighter, as a PNG file: [`strip_of`] their pictures.
///
/// # Errors
/// As [`srgb()`] and [`strip_of`].
pub fn strip(images: &[&RgbImage], stops: f32) -> Result<Vec<u8>> {
    let pictures = images.iter().map(|image| srgb(image, stops)).collect::<Result<Vec<_>>>()?;
    strip_of(&pictures)
}

/// Pictures side by side with a thin transparent gap, as a PNG file. Lower ones are enlarged by the largest
/// whole factor that fits the highest and stand at the top.
///
/// # Errors
/// `Config` if there is no picture or the strip is wider than [`MAX_SIDE`].
pub fn strip_of(pictures: &[Picture]) -> Result<Vec<u8>> {
    let height = pictures.iter().map(|p| p.height()).max().unwrap_or(0);
    if pictures.iter().any(|p| p.width() == 0 || p.height() == 0) || height == 0 {
        return Err(Error::config("strip", "needs pictures that have pixels"));
    }
    let pictures =
        pictures.iter().map(|p| enlarged(p, height / p.height())).collect::<Result<Vec<Picture>>>()?;
    let width = pictures.iter().map(|p| u64::from(p.width() + GAP)).sum::<u64>() - u64::from(GAP);
    if width > MAX_SIDE as u64 {
        return Err(Error::config("strip", format!("{width} pixels wide: {MAX_SIDE} is the most")));
    }
    let mut strip = RgbaImage::new(width as u32, height);
    let mut left = 0;
    for picture in &pictures {
        for (x, y, pixel) in picture.enumerate_pixels() {
            let [r, g, b] = pixel.0;
            strip.put_pixel(left + x, y, Rgba([r, g, b, 255]));
        }
        left += picture.width() + GAP;
    }
    let mut bytes = Cursor::new(Vec::new());
    strip.write_to(&mut bytes, ImageFormat::Png).map_err(|e| Error::config("strip", e))?;
    Ok(bytes.into_inner())
}

/// Rows of pictures with thin dark gaps, as one picture; all pictures have the size of the first.
///
/// # Errors
/// `Config` if there is no picture, one has another size, or a side would pass [`MAX_SIDE`].
pub fn sheet(rows: &[Vec<Picture>]) -> Result<Picture> {
    let first = rows.iter().flatten().next().ok_or_else(|| Error::config("sheet", "needs a picture"))?;
    let (width, height) = first.dimensions();
    if rows.iter().flatten().any(|picture| picture.dimensions() != (width, height)) {
        return Err(Error::config("sheet", "its pictures differ in size"));
    }
    let side = |count: usize, each: u32| count as u64 * u64::from(each + GAP) - u64::from(GAP);
    let columns = rows.iter().map(Vec::len).max().unwrap_or(1);
    let (across, down) = (side(columns, width), side(rows.len(), height));
    if across.max(down) > MAX_SIDE as u64 {
        return Err(Error::config("sheet", format!("{across} x {down} pixels: {MAX_SIDE} is the most")));
    }
    let mut sheet = Picture::new(across as u32, down as u32);
    for (i, row) in rows.iter().enumerate() {
        for (j, picture) in row.iter().enumerate() {
            let (left, top) = (j as i64 * i64::from(width + GAP), i as i64 * i64::from(height + GAP));
            image::imageops::replace(&mut sheet, picture, left, top);
        }
    }
    Ok(sheet)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(height: usize, width: usize, value: impl Fn(usize) -> [f32; 3]) -> RgbImage {
        RgbImage { height, width, pixels: (0..height * width).map(value).collect() }
    }

    #[test]
    fn png_round_trips() {
        let picture = srgb(&image(3, 5, |i| [i as f32 / 15.0, 0.5, 2.0]), 0.0).unwrap();
        let decoded = image::load_from_memory(&png(&picture).unwrap()).unwrap().to_rgb8();
        assert_eq!(decoded, picture);
        assert_eq!(decoded.dimensions(), (5, 3));
        assert_eq!(decoded.get_pixel(4, 2).0, [crate::srgb::encode(14.0 / 15.0), 188, 255]);
        let uri = data_uri(&png(&picture).unwrap());
        let text = uri.strip_prefix("data:image/png;base64,").unwrap();
        assert_eq!(base64::engine::general_purpose::STANDARD.decode(text).unwrap(), png(&picture).unwrap());
    }

    #[test]
    fn a_stop_doubles() {
        let dim = image(2, 2, |_| [0.1; 3]);
        let bright = image(2, 2, |_| [0.2; 3]);
        assert_eq!(srgb(&dim, 1.0).unwrap(), srgb(&bright, 0.0).unwrap());
        assert_ne!(srgb(&dim, 0.0).unwrap(), srgb(&bright, 0.0).unwrap());
    }

    #[test]
    fn equal_images_differ_nowhere_and_others_where_they_do() {
        let a = image(4, 4, |i| [i as f32, 0.3, -0.2]);
        let same = difference(&a, &a, 0.1).unwrap();
        assert!(same.pixels().all(|p| p == same.get_pixel(0, 0)));
        let mut b = a.clone();
        b.pixels[5][1] += 0.3;
        let other = difference(&a, &b, 0.1).unwrap();
        let changed: Vec<_> =
            other.enumerate_pixels().filter(|(x, y, p)| *p != same.get_pixel(*x, *y)).collect();
        assert_eq!(changed.len(), 1);
        assert_eq!((changed[0].0, changed[0].1, changed[0].2.0), (1, 1, colour::map()[255]));
    }

    #[test]
    fn what_is_not_finite_stands_out() {
        let a = image(1, 2, |i| [if i == 0 { f32::NAN } else { 0.5 }; 3]);
        assert_eq!(srgb(&a, 0.0).unwrap().get_pixel(0, 0).0, colour::INVALID);
        assert_eq!(difference(&a, &a, 1.0).unwrap().get_pixel(0, 0).0, colour::INVALID);
        assert_eq!(difference(&a, &a, 1.0).unwrap().get_pixel(1, 0).0, colour::map()[0]);
    }

    #[test]
    fn enlarging_repeats_pixels() {
        let small = srgb(&image(2, 3, |i| [i as f32 / 6.0; 3]), 0.0).unwrap();
        let large = enlarged(&small, 7).unwrap();
        assert_eq!(large.dimensions(), (21, 14));
        assert!(large.enumerate_pixels().all(|(x, y, p)| p == small.get_pixel(x / 7, y / 7)));
        assert!(enlarged(&small, 0).is_err());
        assert!(enlarged(&small, u32::MAX).is_err());
    }

    #[test]
    fn a_strip_is_as_high_as_its_highest_picture() {
        let (a, b) = (image(8, 8, |_| [1.0; 3]), image(2, 2, |_| [0.0; 3]));
        let decoded = image::load_from_memory(&strip(&[&a, &b], 0.0).unwrap()).unwrap().to_rgba8();
        assert_eq!(decoded.dimensions(), (8 + GAP + 8, 8));
        assert_eq!(decoded.get_pixel(7, 7).0, [255; 4]);
        assert_eq!(decoded.get_pixel(8, 0).0[3], 0);
        assert_eq!(decoded.get_pixel(8 + GAP, 7).0, [0, 0, 0, 255]);
        assert!(strip(&[], 0.0).is_err());
    }

    #[test]
    fn shapes_are_checked() {
        let good = image(2, 2, |_| [0.5; 3]);
        let mut short = good.clone();
        short.pixels.pop();
        assert!(srgb(&RgbImage::default(), 0.0).is_err());
        assert!(srgb(&short, 0.0).is_err());
        assert!(difference(&good, &image(1, 4, |_| [0.5; 3]), 1.0).is_err());
        assert!(difference(&good, &good, 0.0).is_err());
        assert!(difference(&good, &good, f32::NAN).is_err());
    }
}
