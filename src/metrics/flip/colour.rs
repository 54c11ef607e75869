//! The colour spaces of FLIP: linear RGB, the opponent space YCxCz that contrast sensitivity is known in, and L*a*b*
//! with Hunt's effect.

/// Linear sRGB to XYZ under D65, from the primaries' chromaticities.
const XYZ_OF_RGB: [[f32; 3]; 3] = [
    [0.412_386_56, 0.357_591_5, 0.180_450_49],
    [0.212_636_82, 0.715_183, 0.072_180_2],
    [0.019_330_62, 0.119_197_16, 0.950_372_6],
];
/// Its inverse.
const RGB_OF_XYZ: [[f32; 3]; 3] = [
    [3.241_003_2, -1.537_399, -0.498_615_9],
    [-0.969_224_3, 1.875_93, 0.041_554_226],
    [0.055_639_42, -0.204_011_2, 1.057_149],
];
/// XYZ of white: the row sums of [`XYZ_OF_RGB`].
const WHITE: [f32; 3] = [0.950_428_55, 1.0, 1.088_900_4];
/// Where L*a*b* goes from a cube root to a line.
const KNEE: f32 = 6.0 / 29.0;
/// a* and b* for every unit of lightness: colours look more vivid in bright light.
const HUNT: f32 = 0.01;

fn times(matrix: &[[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// XYZ over that of white, from linear RGB clamped to \[0, 1\].
fn relative(rgb: [f32; 3]) -> [f32; 3] {
    let xyz = times(&XYZ_OF_RGB, rgb.map(|v| v.clamp(0.0, 1.0)));
    [0, 1, 2].map(|c| xyz[c] / WHITE[c])
}

/// YCxCz of linear RGB, which is clamped to \[0, 1\].
pub fn ycxcz(rgb: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = relative(rgb);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Relative luminance from the first channel of YCxCz.
pub fn luminance(y: f32) -> f32 {
    (y + 16.0) / 116.0
}

/// L*a*b* with Hunt's effect of a filtered YCxCz, brought back into the colours that a display has.
pub fn lab(ycxcz: [f32; 3]) -> [f32; 3] {
    let y = luminance(ycxcz[0]);
    let xyz = [(y + ycxcz[1] / 500.0) * WHITE[0], y * WHITE[1], (y - ycxcz[2] / 200.0) * WHITE[2]];
    let [x, y, z] = relative(times(&RGB_OF_XYZ, xyz)).map(|t| {
        let line = t / (3.0 * KNEE * KNEE) + 4.0 / 29.0;
        if t > KNEE.powi(3) { t.cbrt() } else { line }
    });
    let lightness = 116.0 * y - 16.0;
    [lightness, HUNT * lightness * 500.0 * (x - y), HUNT * lightness * 200.0 * (y - z)]
}

/// Distance of two colours: city blocks between lightness and the rest (Abasi et al. 2020).
pub fn hyab(a: [f32; 3], b: [f32; 3]) -> f32 {
    (a[0] - b[0]).abs() + ((a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of f32 in values up to 100.
    const ROUNDING: f32 = 2e-4;

    #[test]
    fn white_and_black_are_where_they_belong() {
        for (rgb, lightness) in [([1.0; 3], 100.0), ([0.0; 3], 0.0), ([7.0; 3], 100.0)] {
            let found = lab(ycxcz(rgb));
            assert!((found[0] - lightness).abs() < ROUNDING, "{found:?}");
            // Hunt's factor is 1 at most.
            assert!(found[1].abs() < ROUNDING && found[2].abs() < ROUNDING, "{found:?}");
        }
        // Grey of a relative luminance of 0.5 has L* = 76.07.
        assert!((lab(ycxcz([0.5; 3]))[0] - 76.069).abs() < 1e-2);
    }

    #[test]
    fn the_way_there_and_back_is_the_identity() {
        for row in 0..3 {
            for column in 0..3 {
                let unit = [0, 1, 2].map(|c| if c == column { 1.0 } else { 0.0 });
                let found = times(&RGB_OF_XYZ, times(&XYZ_OF_RGB, unit))[row];
                assert!((found - unit[row]).abs() < 1e-6, "{row} {column}: {found}");
            }
            assert!((XYZ_OF_RGB[row].iter().sum::<f32>() - WHITE[row]).abs() < 1e-6);
        }
    }
}
