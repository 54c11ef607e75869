//! What is said about maps that work but may surprise.

use crate::reference::heightfield::HeightMap;
use crate::reference::shading::MIN_ALPHA;
use crate::reference::texture::Texture;

/// Degrees from which a slope counts as steep, and the share of the surface above which nobody can have meant it: a
/// surface of noise, or one displaced by a unit of its own.
const STEEP: f64 = 80.0;
const MOST_STEEP: f64 = 0.95;

/// Roughness that the shading raises.
pub(super) fn raised_roughness(roughness: &Texture<1>) -> Option<String> {
    let least = MIN_ALPHA.sqrt();
    let below = roughness.texels().iter().filter(|[r]| *r < least).count();
    let share = percent(below, roughness.texels().len());
    (below > 0).then(|| format!("roughness: {share} of it lies below {least:.3} and is shaded as {least:.3}"))
}

/// Slopes that are hardly meant.
pub(super) fn steep(field: &HeightMap) -> Option<String> {
    let HeightMap { height, width, values } = field;
    let least = STEEP.to_radians().tan().powi(2);
    let is_steep = |k: &usize| {
        let (i, j) = (k / width, k % width);
        let rise = |at: usize, side: usize| (f64::from(values[at]) - f64::from(values[*k])) * side as f64;
        let x = rise(i * width + (j + 1) % width, *width);
        let y = rise((i + 1) % height * width + j, *height);
        x * x + y * y > least
    };
    let steep = (0..values.len()).filter(is_steep).count();
    (steep as f64 > MOST_STEEP * values.len() as f64).then(|| {
        let share = percent(steep, values.len());
        format!(
            "height: {share} of the surface is steeper than {STEEP} degrees; is displacement in tile widths?"
        )
    })
}

/// Sheets of which nothing, or everything, is a hole.
pub(super) fn holes(opacity: &Texture<1>) -> Option<String> {
    let open = opacity.texels().iter().filter(|[o]| *o < 0.5).count();
    match open {
        0 => Some("opacity: it is nowhere below one half, so the sheet has no holes".into()),
        all if all == opacity.texels().len() => {
            Some("opacity: it is everywhere below one half, so the sheet is not there".into())
        }
        _ => None,
    }
}

/// A share in words; a small one is not rounded to none, nor a large one to all.
fn percent(part: usize, whole: usize) -> String {
    let share = 100.0 * part as f64 / whole.max(1) as f64;
    match share {
        _ if part == whole => "all".into(),
        s if s < 0.1 => "less than 0.1 %".into(),
        s if s > 99.9 => "more than 99.9 %".into(),
        s => format!("{s:.1} %"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(values: impl IntoIterator<Item = f32>) -> Texture<1> {
        let texels: Vec<_> = values.into_iter().map(|v| [v]).collect();
        Texture::new(texels.len().isqrt(), texels).unwrap()
    }

    #[test]
    fn raised_roughness_is_counted() {
        assert_eq!(raised_roughness(&grey([0.045, 0.2, 0.5, 1.0])), None);
        assert!(
            raised_roughness(&grey([0.044, 0.2, 0.5, 1.0]))
                .unwrap()
                .contains("25.0 % of it lies below 0.045")
        );
        assert!(raised_roughness(&Texture::constant([0.0])).unwrap().contains("all of it"));
        let one = (0..64 * 64).map(|k| if k == 9 { 0.0 } else { 0.3 });
        assert!(raised_roughness(&grey(one)).unwrap().contains("less than 0.1 %"));
    }

    #[test]
    fn steps_of_noise_are_steep() {
        let checks = |depth: f32| {
            let values = (0..16 * 16).map(|k| if (k / 16 + k % 16) % 2 == 0 { 0.0 } else { depth }).collect();
            steep(&HeightMap { height: 16, width: 16, values })
        };
        // Both slopes are 16 times the depth: 80 degrees are reached at 0.2506.
        assert!(checks(0.251).unwrap().contains("all of the surface"));
        assert_eq!(checks(0.250), None);
    }

    #[test]
    fn sheets_without_and_of_holes_are_named() {
        assert_eq!(holes(&grey([0.5, 0.0, 1.0, 1.0])), None);
        assert!(holes(&grey([0.5; 4])).unwrap().contains("no holes"));
        assert!(holes(&grey([0.49; 4])).unwrap().contains("not there"));
    }
}
