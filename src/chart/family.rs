//! Families of variants: their colours and shapes.

use super::scene::Colour;

/// Rivals without a network have this at the beginning of their names.
const MAPS: &str = "maps";
/// One a family: distinct to eyes that lack a kind of cones, with a contrast of 3 or more to white and to near black.
pub(super) const COLOURS: [Colour; 6] = [
    [0x08, 0x7b, 0xeb],
    [0xbb, 0x25, 0x04],
    [0xb0, 0x8e, 0x38],
    [0x34, 0x6a, 0x60],
    [0xa7, 0x20, 0xb4],
    [0x88, 0x92, 0xa3],
];
/// Families beyond the colours share one colour but not the shape as well.
const SHAPES: [Shape; 6] =
    [Shape::Circle, Shape::Square, Shape::Triangle, Shape::Diamond, Shape::Wedge, Shape::Pentagon];

/// Outline of a marker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shape {
    Circle,
    Square,
    /// Point up.
    Triangle,
    Diamond,
    /// Point down.
    Wedge,
    Pentagon,
    /// Only what has no network.
    Star,
}

impl Shape {
    /// Corners around (0, 0), of about the same area at the same radius, y down.
    pub(super) fn outline(self, radius: f64) -> Vec<[f64; 2]> {
        let ring = |n: usize, start: f64, radius: f64| -> Vec<[f64; 2]> {
            let angle = |k: usize| (start + 360.0 * k as f64 / n as f64).to_radians();
            (0..n).map(|k| [radius * angle(k).cos(), radius * angle(k).sin()]).collect()
        };
        match self {
            Self::Circle => ring(24, 0.0, radius),
            Self::Square => ring(4, 45.0, 1.22 * radius),
            Self::Triangle => ring(3, -90.0, 1.45 * radius),
            Self::Diamond => ring(4, 0.0, 1.3 * radius),
            Self::Wedge => ring(3, 90.0, 1.45 * radius),
            Self::Pentagon => ring(5, -90.0, 1.15 * radius),
            Self::Star => {
                let (outer, inner) = (ring(5, -90.0, 1.7 * radius), ring(5, -54.0, 0.75 * radius));
                outer.into_iter().zip(inner).flat_map(|(a, b)| [a, b]).collect()
            }
        }
    }
}

/// A family's look; no colour for ink.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Family {
    pub(super) name: String,
    pub(super) colour: Option<Colour>,
    pub(super) shape: Shape,
}

/// The part of a label that names its family.
pub(super) fn name(label: &str) -> &str {
    label.split(['-', ' ']).next().unwrap_or(label)
}

/// The families of labels in the order of their names, rivals without a network last.
pub(super) fn families<'a>(labels: impl Iterator<Item = &'a str>) -> Vec<Family> {
    let names: std::collections::BTreeSet<&str> = labels.map(name).collect();
    let (maps, neural): (Vec<&str>, Vec<&str>) = names.into_iter().partition(|n| n.starts_with(MAPS));
    let neural = neural.into_iter().enumerate().map(|(i, name)| Family {
        name: name.into(),
        colour: Some(COLOURS[i % COLOURS.len()]),
        shape: SHAPES[(i + i / COLOURS.len()) % SHAPES.len()],
    });
    let maps = maps.into_iter().map(|name| Family { name: name.into(), colour: None, shape: Shape::Star });
    neural.chain(maps).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// WCAG 2's least contrast of graphics.
    const CONTRAST: f64 = 3.0;
    /// Least distance of two colours to eyes without red or green cones, in the unit cube of encoded RGB: small marks
    /// far from each other need much more than areas side by side.
    const APART: f64 = 0.3;
    /// The grounds of a page.
    const GROUNDS: [Colour; 2] = [[255, 255, 255], [0x14, 0x17, 0x1b]];
    /// Eyes without red and without green cones, on linear RGB (Machado et al. 2009, severity 1).
    const EYES: [[[f64; 3]; 3]; 2] = [
        [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
        [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    ];

    fn linear(colour: Colour) -> [f64; 3] {
        colour.map(|c| (f64::from(c) / 255.0).powf(2.2))
    }

    fn contrast(a: Colour, b: Colour) -> f64 {
        let luminance = |c| {
            let [r, g, b] = linear(c);
            0.2126 * r + 0.7152 * g + 0.0722 * b + 0.05
        };
        let (a, b) = (luminance(a), luminance(b));
        a.max(b) / a.min(b)
    }

    fn apart(eyes: &[[f64; 3]; 3], a: Colour, b: Colour) -> f64 {
        let channel = |row: [f64; 3], c| (0..3).map(|k| row[k] * linear(c)[k]).sum::<f64>();
        let seen = |c: Colour| eyes.map(|row| channel(row, c).clamp(0.0, 1.0).powf(1.0 / 2.2));
        let (a, b) = (seen(a), seen(b));
        (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
    }

    #[test]
    fn colours_stand_out_and_apart() {
        for (i, a) in COLOURS.into_iter().enumerate() {
            for ground in GROUNDS {
                assert!(contrast(a, ground) >= CONTRAST, "{a:x?} {}", contrast(a, ground));
            }
            for b in COLOURS.into_iter().skip(i + 1) {
                for eyes in &EYES {
                    assert!(apart(eyes, a, b) >= APART, "{a:x?} {b:x?} {}", apart(eyes, a, b));
                }
            }
        }
        // What the limits refuse: yellow on white, and a red beside the green that looks like it.
        assert!(contrast([0xe6, 0xc0, 0x00], GROUNDS[0]) < CONTRAST);
        assert!(apart(&EYES[1], [0xb0, 0x50, 0x30], [0x6c, 0x70, 0x30]) < APART);
    }

    #[test]
    fn families_are_beginnings_of_labels() {
        let labels = ["maps marched", "improved-w32", "neumip", "improved-w8", "maps", "a b"];
        let families = families(labels.into_iter());
        let names: Vec<&str> = families.iter().map(|f| f.name.as_str()).collect();
        assert_eq!(names, ["a", "improved", "neumip", "maps"]);
        assert_eq!((families[3].colour, families[3].shape), (None, Shape::Star));
        let many: Vec<String> = (10..46).map(|i| format!("f{i}")).collect();
        let many = super::families(many.iter().map(String::as_str));
        let distinct = many
            .iter()
            .enumerate()
            .all(|(i, a)| many[..i].iter().all(|b| a.colour != b.colour || a.shape != b.shape));
        assert!(distinct, "36 families have looks of their own");
    }
}
