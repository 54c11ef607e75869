//! A picture as PNG: every outline is filled by its coverage of the pixels, in a font that is part of the program.

use super::WIDTH;
use super::scene::{Anchor, Colour, GROUND, Item, Scene, Text};
use crate::error::{Error, Result};
use ab_glyph::{Font, FontRef, OutlineCurve};
use ab_glyph_rasterizer::{Point, Rasterizer, point};
use image::{ImageFormat, Rgb, RgbImage};
use std::io::Cursor;
use std::sync::LazyLock;

/// Highest picture in pixels; a browser shows no larger one.
const HIGHEST: f64 = 16_384.0;
/// The font is a light one: its outlines are filled twice, this part of an em apart.
const BOLDER: f64 = 0.022;

static FONT: LazyLock<Option<FontRef<'static>>> =
    LazyLock::new(|| FontRef::try_from_slice(epaint_default_fonts::UBUNTU_LIGHT).ok());

/// Width of a text in units, about: browsers use other fonts of much the same width.
pub(crate) fn text_width(text: &str, size: f64) -> f64 {
    let Some(font) = FONT.as_ref() else { return 0.55 * size * text.chars().count() as f64 };
    let em = f64::from(font.units_per_em().unwrap_or(1000.0));
    let sum: f64 = text.chars().map(|c| f64::from(font.h_advance_unscaled(font.glyph_id(c)))).sum();
    sum * size / em
}

/// The picture, `width` pixels wide.
///
/// # Errors
/// `Usage` if it would be higher than pictures can be; `Config` if it cannot be encoded.
pub(crate) fn png(scene: &Scene, width: u32) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    drawn(scene, width)?
        .write_to(&mut Cursor::new(&mut bytes), ImageFormat::Png)
        .map_err(|e| Error::config("picture", format!("cannot be encoded: {e}")))?;
    Ok(bytes)
}

/// The picture before it is a file.
///
/// # Errors
/// `Usage` if it would be higher than pictures can be.
pub(crate) fn drawn(scene: &Scene, width: u32) -> Result<RgbImage> {
    let scale = f64::from(width) / f64::from(WIDTH);
    let height = (scene.height * scale).ceil();
    if height > HIGHEST {
        let problem = format!("the picture would be {height} pixels high; {HIGHEST} work");
        return Err(Error::usage(format!("{problem}: use fewer --materials, or a smaller --width")));
    }
    let mut canvas = Canvas { image: RgbImage::from_pixel(width, height as u32, Rgb(GROUND)), scale };
    scene.items.iter().for_each(|item| canvas.draw(item));
    Ok(canvas.image)
}

struct Canvas {
    image: RgbImage,
    scale: f64,
}

/// Closed curves in pixels; every point lies between the first and the last one's bounds.
#[derive(Default)]
struct Curves {
    curves: Vec<OutlineCurve>,
}

impl Curves {
    fn polygon(&mut self, corners: &[[f64; 2]]) {
        let corners: Vec<Point> = corners.iter().map(|c| point(c[0] as f32, c[1] as f32)).collect();
        for (i, corner) in corners.iter().enumerate() {
            self.curves.push(OutlineCurve::Line(*corner, corners[(i + 1) % corners.len()]));
        }
    }

    fn points(&self) -> impl Iterator<Item = &Point> {
        self.curves.iter().flat_map(|curve| match curve {
            OutlineCurve::Line(a, b) => vec![a, b],
            OutlineCurve::Quad(a, b, c) => vec![a, b, c],
            OutlineCurve::Cubic(a, b, c, d) => vec![a, b, c, d],
        })
    }
}

impl Canvas {
    fn draw(&mut self, item: &Item) {
        match item {
            Item::Line { points, width, colour } => self.stroke(points, false, *width, *colour),
            Item::Shape { outline, fill, line, width } => {
                let mut curves = Curves::default();
                curves.polygon(&self.pixels(outline));
                self.fill(&curves, *fill);
                self.stroke(outline, true, *width, *line);
            }
            Item::Text(text) => self.text(text),
            Item::Mark { items, .. } => items.iter().for_each(|item| self.draw(item)),
        }
    }

    fn pixels(&self, points: &[[f64; 2]]) -> Vec<[f64; 2]> {
        points.iter().map(|p| p.map(|v| v * self.scale)).collect()
    }

    /// Each piece is a rectangle that reaches half a width beyond its ends, so that corners are filled. All turn the
    /// same way round: where they overlap their coverage adds up and is cut at 1.
    fn stroke(&mut self, points: &[[f64; 2]], closed: bool, width: f64, colour: Colour) {
        let points = self.pixels(points);
        let half = width * self.scale / 2.0;
        let mut curves = Curves::default();
        let pieces = if closed { points.len() } else { points.len().saturating_sub(1) };
        for i in 0..pieces {
            let ([ax, ay], [bx, by]) = (points[i], points[(i + 1) % points.len()]);
            let length = (bx - ax).hypot(by - ay);
            if length > 0.0 {
                let (dx, dy) = ((bx - ax) / length * half, (by - ay) / length * half);
                curves.polygon(&[
                    [ax - dx - dy, ay - dy + dx],
                    [bx + dx - dy, by + dy + dx],
                    [bx + dx + dy, by + dy - dx],
                    [ax - dx + dy, ay - dy - dx],
                ]);
            }
        }
        self.fill(&curves, colour);
    }

    fn text(&mut self, text: &Text) {
        let Some(font) = FONT.as_ref() else { return };
        let em = f64::from(font.units_per_em().unwrap_or(1000.0));
        let size = text.size * self.scale;
        let start = match text.anchor {
            Anchor::Start => 0.0,
            Anchor::Middle => -text_width(&text.text, size) / 2.0,
            Anchor::End => -text_width(&text.text, size),
        };
        let [x, y] = text.at.map(|v| v * self.scale);
        for shift in [0.0, BOLDER * size] {
            let mut curves = Curves::default();
            let mut pen = start + shift - BOLDER * size / 2.0;
            for c in text.text.chars() {
                let glyph = font.glyph_id(c);
                let place = |p: Point| {
                    let (right, up) = (pen + f64::from(p.x) * size / em, f64::from(p.y) * size / em);
                    let (dx, dy) = if text.upright { (-up, -right) } else { (right, -up) };
                    point((x + dx) as f32, (y + dy) as f32)
                };
                let outline = font.outline(glyph).map(|o| o.curves).unwrap_or_default();
                curves.curves.extend(outline.into_iter().map(|curve| match curve {
                    OutlineCurve::Line(a, b) => OutlineCurve::Line(place(a), place(b)),
                    OutlineCurve::Quad(a, b, c) => OutlineCurve::Quad(place(a), place(b), place(c)),
                    OutlineCurve::Cubic(a, b, c, d) => {
                        OutlineCurve::Cubic(place(a), place(b), place(c), place(d))
                    }
                }));
                pen += f64::from(font.h_advance_unscaled(glyph)) * size / em;
            }
            self.fill(&curves, text.colour);
        }
    }

    /// Fills what the curves go round, mixed with what is there by its coverage of each pixel.
    fn fill(&mut self, curves: &Curves, colour: Colour) {
        let [mut low, mut high] = [[f32::INFINITY; 2], [f32::NEG_INFINITY; 2]];
        for p in curves.points() {
            low = [low[0].min(p.x), low[1].min(p.y)];
            high = [high[0].max(p.x), high[1].max(p.y)];
        }
        // What lies outside the picture is left out as a whole; layout keeps everything inside.
        let bounds = [self.image.width() as f32, self.image.height() as f32];
        let corner = low.map(|v| v.floor() - 1.0);
        let size: [usize; 2] = std::array::from_fn(|k| (high[k].ceil() + 2.0 - corner[k]) as usize);
        if !(0..2).all(|k| low[k] > -bounds[k] && high[k] < 2.0 * bounds[k] && low[k] <= high[k]) {
            return;
        }
        let mut raster = Rasterizer::new(size[0], size[1]);
        let moved = |p: Point| point(p.x - corner[0], p.y - corner[1]);
        for curve in &curves.curves {
            match *curve {
                OutlineCurve::Line(a, b) => raster.draw_line(moved(a), moved(b)),
                OutlineCurve::Quad(a, b, c) => raster.draw_quad(moved(a), moved(b), moved(c)),
                OutlineCurve::Cubic(a, b, c, d) => {
                    raster.draw_cubic(moved(a), moved(b), moved(c), moved(d));
                }
            }
        }
        raster.for_each_pixel_2d(|x, y, coverage| {
            let at = [x as f32 + corner[0], y as f32 + corner[1]];
            if coverage <= 0.0 || at[0] < 0.0 || at[1] < 0.0 {
                return;
            }
            if let Some(pixel) = self.image.get_pixel_mut_checked(at[0] as u32, at[1] as u32) {
                let part = coverage.min(1.0);
                for (old, new) in pixel.0.iter_mut().zip(colour) {
                    *old = (f32::from(*old) * (1.0 - part) + f32::from(new) * part).round() as u8;
                }
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::scene::{INK, Item};

    /// A pixel half covered by black on white, to rounding.
    const HALF: u8 = 128;

    fn decoded(items: Vec<Item>, width: u32) -> RgbImage {
        let scene = Scene { height: 40.0, says: String::new(), items };
        image::load_from_memory(&png(&scene, width).unwrap()).unwrap().to_rgb8()
    }

    #[test]
    fn fills_by_coverage() {
        let line = |y| Item::Line { points: vec![[10.0, y], [30.0, y]], width: 2.0, colour: [0; 3] };
        let image = decoded(vec![line(20.0)], WIDTH);
        assert_eq!((image.width(), image.height()), (WIDTH, 40));
        assert_eq!([18, 19, 20, 21].map(|y| image.get_pixel(20, y).0[0]), [255, 0, 0, 255]);
        // Half a pixel lower, half of it shows in one more row.
        let image = decoded(vec![line(20.5)], WIDTH);
        assert_eq!([19, 20, 21].map(|y| image.get_pixel(20, y).0[0]), [HALF, 0, HALF]);
        let image = decoded(vec![line(20.0)], 2 * WIDTH);
        assert_eq!((image.width(), image.height()), (2 * WIDTH, 80));
        assert_eq!([37, 38, 41, 42].map(|y| image.get_pixel(40, y).0[0]), [255, 0, 0, 255]);
    }

    #[test]
    fn texts_stand_where_they_are_anchored() {
        let text = |anchor, upright| {
            let text = "error".to_string();
            Item::Text(Text { at: [300.0, 30.0], text, size: 12.0, colour: INK, anchor, upright })
        };
        let dark = |image: &RgbImage, left: u32, right: u32| {
            (left..right).any(|x| (0..image.height()).any(|y| image.get_pixel(x, y).0[0] < 128))
        };
        let [start, middle, end] = [Anchor::Start, Anchor::Middle, Anchor::End]
            .map(|anchor| decoded(vec![text(anchor, false)], WIDTH));
        assert!(!dark(&start, 0, 299) && dark(&start, 300, 340));
        assert!(dark(&middle, 280, 300) && dark(&middle, 300, 320));
        assert!(dark(&end, 260, 300) && !dark(&end, 302, 1200));
        let upright = decoded(vec![text(Anchor::Start, true)], WIDTH);
        assert!(dark(&upright, 285, 301) && !dark(&upright, 302, 1200));
    }

    #[test]
    fn pictures_that_are_too_high_are_refused() {
        let scene = Scene { height: 1e6, says: String::new(), items: Vec::new() };
        assert!(png(&scene, WIDTH).unwrap_err().to_string().contains("--materials"));
    }
}
