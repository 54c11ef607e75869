//! Normal maps: from the texels of a file to unit normals over the plane, x right, y along the rows, z up.

use super::file::Convention;
use crate::reference::heightfield::HeightMap;
use crate::reference::texture::Texture;
use crate::reference::tiling::Grid;

/// Lowest z of a normal that still counts as level: one step of an 8-bit map below 0.
const LOWEST_Z: f32 = -1.01 / 127.0;

/// Least z of a normal that is kept: one step of an 8-bit map above 0, so that every normal looks up.
const LEAST_Z: f32 = 1.0 / 127.0;

/// Largest root mean square of length - 1. An 8-bit map rounds lengths by less than 0.01, and one that was scaled down
/// averages unlike normals; a picture of something else is off by 0.3 and more.
const MOST_RMS: f64 = 0.15;

/// Largest |length - 1| of any one texel: shorter or longer, its direction says nothing.
const MOST_OFF: f32 = 0.75;

/// Positions a side at which a normal map is compared with the height map.
const COMPARED: usize = 256;

/// Correlation with the height map's slopes from which a direction counts as meant.
const CLEAR: f64 = 0.3;

/// How a file holds its normals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Range {
    /// v -> 2 v - 1.
    Shifted,
    /// As they are.
    Signed,
}

/// Decodes texels; in PNG (`shifted_only`) they are shifted, in EXR their values tell.
///
/// # Errors
/// What is wrong with the normals: they point down, or their lengths are not 1.
pub(super) fn decode(
    grid: &mut Grid<3>,
    shifted_only: bool,
    convention: Convention,
) -> Result<Range, String> {
    let range = if shifted_only { Range::Shifted } else { range_of(&grid.texels) };
    for texel in &mut grid.texels {
        *texel = raw(*texel, range);
        if convention == Convention::OpenGl {
            texel[1] = -texel[1];
        }
    }
    check(grid)?;
    grid.texels.iter_mut().for_each(|n| *n = upward_unit(*n));
    Ok(range)
}

/// A vector that is not 0, as a unit vector that looks up.
pub(super) fn upward_unit(n: [f32; 3]) -> [f32; 3] {
    let unit = |n: [f32; 3]| {
        let length = length(n);
        n.map(|c| c / length)
    };
    let n = unit(n);
    if n[2] < LEAST_Z { unit([n[0], n[1], LEAST_Z]) } else { n }
}

fn raw(texel: [f32; 3], range: Range) -> [f32; 3] {
    match range {
        Range::Shifted => texel.map(|v| 2.0 * v - 1.0),
        Range::Signed => texel,
    }
}

fn length(n: [f32; 3]) -> f32 {
    (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt()
}

/// Values below 0 are signed. Without any, whichever reading has the lengths nearer to 1: a flat map may be either.
fn range_of(texels: &[[f32; 3]]) -> Range {
    if texels.iter().flatten().any(|v| *v < 0.0) {
        return Range::Signed;
    }
    if rms_off(texels, Range::Signed) < rms_off(texels, Range::Shifted) {
        Range::Signed
    } else {
        Range::Shifted
    }
}

/// Root mean square of length - 1.
fn rms_off(texels: &[[f32; 3]], range: Range) -> f64 {
    let sum: f64 = texels.iter().map(|t| (f64::from(length(raw(*t, range))) - 1.0).powi(2)).sum();
    (sum / texels.len().max(1) as f64).sqrt()
}

fn check(grid: &Grid<3>) -> Result<(), String> {
    let place = |k: usize| format!("row {}, column {}", k / grid.width, k % grid.width);
    let off = |n: &[f32; 3]| (length(*n) - 1.0).abs();
    let rms = rms_off(&grid.texels, Range::Signed);
    let worst = grid.texels.iter().enumerate().max_by(|a, b| off(a.1).total_cmp(&off(b.1)));
    if let Some((k, n)) = worst.filter(|(_, n)| rms > MOST_RMS || off(n) > MOST_OFF) {
        return Err(format!(
            "does not hold normals: their lengths differ from 1 by {rms:.2} (root mean square) and at {} by {:.2}",
            place(k),
            off(n)
        ));
    }
    match grid.texels.iter().position(|n| n[2] < LOWEST_Z) {
        Some(k) => {
            Err(format!("has a normal that points down at {} (z = {:.2})", place(k), grid.texels[k][2]))
        }
        None => Ok(()),
    }
}

/// Correlation of a map's x and y with those of the field's own normals: near 1 where they agree, negative where an axis
/// is turned round. 0 for a flat one.
pub(super) fn agreement(normal: &Texture<3>, height: &HeightMap) -> [f64; 2] {
    let HeightMap { height: rows, width: columns, values } = height;
    let mut sums = [[0.0; 3]; 2];
    let count = [*rows, *columns].map(|side| side.min(COMPARED));
    for i in (0..count[0]).map(|k| k * rows / count[0]) {
        for j in (0..count[1]).map(|k| k * columns / count[1]) {
            let at = |i: usize, j: usize| f64::from(values[i % rows * columns + j % columns]);
            let fall = [
                (at(i, j + columns - 1) - at(i, j + 1)) * *columns as f64,
                (at(i + rows - 1, j) - at(i + 1, j)) * *rows as f64,
            ];
            let n = normal.at((j as f64 + 0.5) / *columns as f64, (i as f64 + 0.5) / *rows as f64);
            for axis in 0..2 {
                let (a, b) = (f64::from(n[axis]), fall[axis]);
                for (sum, product) in sums[axis].iter_mut().zip([a * b, a * a, b * b]) {
                    *sum += product;
                }
            }
        }
    }
    sums.map(|[ab, aa, bb]| if aa * bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 })
}

/// A word if the green of the map clearly runs the other way than the heights do, while its red agrees.
pub(super) fn turned_green(agreement: [f64; 2], convention: Convention) -> Option<String> {
    let [red, green] = agreement;
    (red > CLEAR && green < -CLEAR).then(|| {
        format!(
            "its green runs against the heights (correlation {green:.2}), as if the map were made for the other \
             convention: try \"normal_convention\": \"{}\"",
            convention.other().name()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of f32 in a unit vector.
    const UNIT: f32 = 1e-6;
    /// Half a step of an 8-bit map, twice: the code, and its doubling.
    const EIGHT_BITS: f32 = 1.0 / 255.0 + 1e-6;

    fn grid(texels: Vec<[f32; 3]>) -> Grid<3> {
        Grid { width: texels.len(), height: 1, texels }
    }

    fn near(a: [f32; 3], b: [f32; 3], by: f32) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() <= by)
    }

    /// (0.48, 0.6, 0.64) as an 8-bit map holds it.
    fn eight_bits() -> [f32; 3] {
        [0.48_f32, 0.6, 0.64].map(|c| ((c * 0.5 + 0.5) * 255.0).round() / 255.0)
    }

    #[test]
    fn green_points_up_or_down_the_picture() {
        let decoded = |convention| {
            let mut grid = grid(vec![eight_bits()]);
            assert_eq!(decode(&mut grid, true, convention), Ok(Range::Shifted));
            grid.texels[0]
        };
        let close = |n: [f32; 3], want: [f32; 3]| near(n, want, 2.0 * EIGHT_BITS);
        assert!(close(decoded(Convention::DirectX), [0.48, 0.6, 0.64]));
        assert!(close(decoded(Convention::OpenGl), [0.48, -0.6, 0.64]));
        assert!(!close(decoded(Convention::OpenGl), [0.48, 0.6, 0.64]));
        assert!((length(decoded(Convention::OpenGl)) - 1.0).abs() < UNIT);
    }

    #[test]
    fn values_of_exr_tell_their_range() {
        let of = |texels: Vec<[f32; 3]>| decode(&mut grid(texels), false, Convention::DirectX);
        assert_eq!(of(vec![[0.6, 0.0, 0.8], [-0.6, 0.0, 0.8]]), Ok(Range::Signed));
        assert_eq!(of(vec![[0.8, 0.5, 0.9], [0.2, 0.5, 0.9]]), Ok(Range::Shifted));
        assert_eq!(of(vec![[0.0, 0.0, 1.0]]), Ok(Range::Signed));
        assert_eq!(of(vec![[0.5, 0.5, 1.0]]), Ok(Range::Shifted));
    }

    #[test]
    fn other_pictures_are_refused() {
        let problem =
            |texels: Vec<[f32; 3]>| decode(&mut grid(texels), true, Convention::OpenGl).unwrap_err();
        assert!(problem(vec![[0.5, 0.5, 1.0], [0.8, 0.5, 0.1]]).contains("points down at row 0, column 1"));
        assert!(problem(vec![[0.5; 3]; 4]).contains("by 1.00"), "a grey map");
        assert!(problem(vec![[1.0; 3]; 4]).contains("by 0.73"), "a white map");
        let mut one_bad = vec![[0.5, 0.5, 1.0]; 1000];
        one_bad[7] = [0.5; 3];
        assert!(problem(one_bad).contains("column 7 by 1.00"));
        // Slightly short and level ones are mended.
        let mut mended = grid(vec![[0.5, 0.5, 0.95], [1.0, 0.5, 0.499]]);
        decode(&mut mended, true, Convention::OpenGl).unwrap();
        assert!(mended.texels.iter().all(|n| (length(*n) - 1.0).abs() < UNIT && n[2] > 0.0));
    }

    #[test]
    fn wrong_convention_is_noticed() {
        let side = 16;
        let wave = |k: usize| (std::f64::consts::TAU * k as f64 / side as f64).sin();
        let values = (0..side * side).map(|k| (0.03 * (wave(k / side) + wave(k % side))) as f32).collect();
        let height = HeightMap { height: side, width: side, values };
        let slope =
            |k: usize| 0.03 * std::f64::consts::TAU * (std::f64::consts::TAU * k as f64 / side as f64).cos();
        let normals = |turn: f64| {
            let texels = (0..side * side)
                .map(|k| upward_unit([-slope(k % side) as f32, (-turn * slope(k / side)) as f32, 1.0]));
            Texture::new(side, texels.collect()).unwrap()
        };
        let word = |turn: f64| turned_green(agreement(&normals(turn), &height), Convention::OpenGl);
        assert_eq!(word(1.0), None);
        assert!(word(-1.0).unwrap().contains("\"directx\""));
        let flat = HeightMap { values: vec![0.0; side * side], ..height };
        assert_eq!(agreement(&normals(1.0), &flat), [0.0, 0.0]);
    }
}
