//! Structural similarity (Wang et al. 2004) of sRGB-encoded luma, by `image-compare`: windows of 8 x 8.

use crate::srgb;
use image::{GrayImage, Luma};
use image_compare::{Algorithm, gray_similarity_structure};

/// Side of a window; smaller images have no value.
pub const WINDOW: usize = 8;

/// Mean structural similarity of two images of the same shape (row by row), 1 for equal ones.
pub fn ssim(height: usize, width: usize, answer: &[[f32; 3]], reference: &[[f32; 3]]) -> Option<f64> {
    if height < WINDOW || width < WINDOW || answer.len() != height * width || reference.len() != answer.len()
    {
        return None;
    }
    let gray = |pixels: &[[f32; 3]]| {
        GrayImage::from_fn(width as u32, height as u32, |x, y| {
            Luma([luma(pixels[y as usize * width + x as usize])])
        })
    };
    gray_similarity_structure(&Algorithm::MSSIMSimple, &gray(answer), &gray(reference)).ok().map(|s| s.score)
}

fn luma(rgb: [f32; 3]) -> u8 {
    srgb::encode(0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_is_one_different_is_less_small_is_none() {
        let a: Vec<[f32; 3]> = (0..256).map(|k| [(k % 7) as f32 / 7.0; 3]).collect();
        let b: Vec<[f32; 3]> = (0..256).map(|k| [(k % 5) as f32 / 5.0; 3]).collect();
        assert!((ssim(16, 16, &a, &a).unwrap() - 1.0).abs() < 1e-6);
        assert!(ssim(16, 16, &a, &b).unwrap() < 0.9);
        assert_eq!(ssim(4, 4, &a[..16], &a[..16]), None);
    }
}
