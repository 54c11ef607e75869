//! Pictures of places: answers as bright as they can be shown, differences in false colour, side by side.

use crate::error::Result;
use crate::query::RgbImage;
use crate::report::picture::{self, Picture};

/// Height of a picture in pixels, about.
const HEIGHT: usize = 128;
/// Share of the values that a picture shows below white.
const SHOWN: f64 = 0.99;

/// A panel of a strip.
pub enum Panel<'a> {
    /// Answers.
    Light(&'a RgbImage),
    /// The difference of two images.
    Apart(&'a RgbImage, &'a RgbImage),
}

/// Panels side by side, all in one exposure, enlarged to about one height.
///
/// # Errors
/// As [`picture::strip_of`].
pub fn strip(panels: &[Panel]) -> Result<Vec<u8>> {
    let light = panels.iter().filter_map(|panel| match panel {
        Panel::Light(image) => Some(*image),
        Panel::Apart(..) => None,
    });
    let scale = 1.0 / quantile(light.flat_map(|image| image.pixels.as_flattened().iter().copied()));
    let exposed = |image: &RgbImage| RgbImage {
        pixels: image.pixels.iter().map(|p| p.map(|v| v * scale)).collect(),
        ..*image
    };
    let shown = panels.iter().map(|panel| {
        let shown = match panel {
            Panel::Light(image) => picture::srgb(&exposed(image), 0.0)?,
            Panel::Apart(a, b) => {
                let (a, b) = (exposed(a), exposed(b));
                let pairs = a.pixels.iter().zip(&b.pixels);
                let most = quantile(pairs.map(|(a, b)| picture::distance(*a, *b))).min(1.0);
                picture::difference(&a, &b, most)?
            }
        };
        let factor = (HEIGHT / (shown.height().max(1) as usize)).max(1);
        picture::enlarged(&shown, factor as u32)
    });
    picture::strip_of(&shown.collect::<Result<Vec<Picture>>>()?)
}

/// The value below which [`SHOWN`] of them are; a small positive one where there is nothing to see.
fn quantile(values: impl Iterator<Item = f32>) -> f32 {
    let mut values: Vec<f32> = values.filter(|v| v.is_finite()).collect();
    values.sort_by(f32::total_cmp);
    let at = (SHOWN * values.len().saturating_sub(1) as f64).round() as usize;
    values.get(at).copied().unwrap_or(1.0).max(1e-4)
}

/// A square part of a periodic image, from a row and a column on.
pub fn cut(image: &RgbImage, [row, column]: [usize; 2], side: usize) -> RgbImage {
    let (height, width) = (side.min(image.height), side.min(image.width));
    let at = |k: usize| {
        let (i, j) = ((row + k / width) % image.height, (column + k % width) % image.width);
        image.pixels[i * image.width + j]
    };
    RgbImage { height, width, pixels: (0..height * width).map(at).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_wraps() {
        let image = RgbImage { height: 2, width: 3, pixels: (0..6).map(|k| [k as f32; 3]).collect() };
        let part = cut(&image, [1, 2], 2);
        assert_eq!(part.pixels.iter().map(|p| p[0]).collect::<Vec<_>>(), [5.0, 3.0, 2.0, 0.0]);
        assert_eq!(cut(&image, [0, 0], 9).pixels.len(), 6);
    }

    #[test]
    fn darkness_and_what_is_no_number_can_be_shown() {
        let dark = RgbImage { height: 2, width: 2, pixels: vec![[0.0; 3]; 4] };
        let broken = RgbImage { pixels: vec![[f32::NAN; 3]; 4], ..dark };
        strip(&[Panel::Light(&dark), Panel::Light(&broken), Panel::Apart(&dark, &broken)]).unwrap();
        assert!(strip(&[]).is_err());
    }
}
