//! Colours by number: a map from \[0, 1\] to colours whose lightness grows evenly.

use crate::srgb;

/// Shown for values that are not finite; the map never comes near it.
pub(crate) const INVALID: [u8; 3] = [0, 255, 255];

/// Entries of the map.
const ENTRIES: usize = 256;
/// Oklab lightness at 0 and 1.
const LIGHTNESS: [f32; 2] = [0.14, 0.97];
/// Oklab hue at 0 and 1 in degrees: violet, over red, to yellow.
const HUE: [f32; 2] = [285.0, 465.0];
/// Highest chroma; lowered where sRGB does not reach it.
const CHROMA: f32 = 0.19;

/// Linear sRGB of Oklab (Ottosson 2020).
fn from_oklab(lightness: f32, a: f32, b: f32) -> [f32; 3] {
    let l = (lightness + 0.396_337_78 * a + 0.215_803_76 * b).powi(3);
    let m = (lightness - 0.105_561_346 * a - 0.063_854_17 * b).powi(3);
    let s = (lightness - 0.089_484_18 * a - 1.291_485_5 * b).powi(3);
    [
        4.076_741_7 * l - 3.307_711_6 * m + 0.230_969_94 * s,
        -1.268_438 * l + 2.609_757_4 * m - 0.341_319_4 * s,
        -0.004_196_086_3 * l - 0.703_418_6 * m + 1.707_614_7 * s,
    ]
}

fn at(t: f32) -> [u8; 3] {
    let mix = |ends: [f32; 2]| ends[0] + (ends[1] - ends[0]) * t;
    let (sin, cos) = mix(HUE).to_radians().sin_cos();
    // Chroma vanishes towards black and white, where there is none to be had.
    let mut chroma = CHROMA * (std::f32::consts::PI * (0.12 + 0.76 * t)).sin();
    loop {
        let rgb = from_oklab(mix(LIGHTNESS), chroma * cos, chroma * sin);
        if chroma < 1e-3 || rgb.iter().all(|v| (0.0..=1.0).contains(v)) {
            return rgb.map(srgb::encode);
        }
        chroma *= 0.98;
    }
}

/// The map, from dark (0) to bright (1).
pub(crate) fn map() -> Vec<[u8; 3]> {
    (0..ENTRIES).map(|i| at(i as f32 / (ENTRIES - 1) as f32)).collect()
}

/// The entry for a value in \[0, 1\]; values outside are clamped, others are [`INVALID`].
pub(crate) fn look_up(map: &[[u8; 3]], t: f32) -> [u8; 3] {
    if !t.is_finite() {
        return INVALID;
    }
    let last = map.len().saturating_sub(1);
    let index = (t.clamp(0.0, 1.0) * last as f32).round() as usize;
    map.get(index).copied().unwrap_or(INVALID)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_map_grows_lighter_and_has_an_entry_for_everything() {
        let map = map();
        let luma = |c: &[u8; 3]| 299 * u32::from(c[0]) + 587 * u32::from(c[1]) + 114 * u32::from(c[2]);
        // Steps of 8 entries: single ones are lost in the rounding to 8 bits.
        let lightness: Vec<u32> = map.iter().step_by(8).map(luma).collect();
        assert!(lightness.windows(2).all(|w| w[0] < w[1]), "{lightness:?}");
        assert_eq!(look_up(&map, -1.0), map[0]);
        assert_eq!(look_up(&map, 2.0), map[255]);
        assert_eq!(look_up(&map, f32::NAN), INVALID);
        assert!(!map.contains(&INVALID));
    }
}
