//! The picture of a material: levels, tile, light and view, by number of queries above and by weight below.

use super::direction::{self, Cone, Directions, in_disc};
use super::levels::BINS;
use super::meaning::percent;
use super::position::{self, Window};
use super::{Asked, QUANTILES};
use crate::chart::WIDTH;
use crate::chart::raster;
use crate::chart::scene::{Anchor, Colour, GRID, GROUND, INK, Item, SOFT, Scene, Text, cut, wrapped};
use crate::error::{Error, Result};
use crate::report::colour;
use crate::report::numbers::{count, short};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};

/// Side of a panel; a multiple of the cells of the tile and of the disc.
const SIDE: f64 = 256.0;
/// Left sides of the panels.
const LEFT: [f64; 4] = [52.0, 344.0, 636.0, 928.0];
/// Upper sides of the panels of both rows.
const TOP: [f64; 2] = [112.0, 450.0];
/// Base line of the first line of meaning.
const WORDS: f64 = 772.0;
const LINE: f64 = 21.0;
const SMALL: f64 = 12.0;
const NORMAL: f64 = 14.0;
/// What is never asked.
const EMPTY: Colour = [0xf1, 0xf3, 0xf5];
const BAR: Colour = [0x59, 0x3a, 0x8f];
/// Stands out from all colours of the map.
const OUTLINE: Colour = [0x00, 0x9a, 0xa8];
/// Factor between the fullest cell and the darkest colour, at most.
const RANGE: f64 = 1e4;

/// The picture as a PNG file.
///
/// # Errors
/// `Config` if it cannot be encoded.
pub(super) fn png(asked: &Asked) -> Result<Vec<u8>> {
    let picture = raster::drawn(&scene(asked), WIDTH)?;
    let mut bytes = Vec::new();
    // Flat colours pack better as they are than as differences.
    let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Best, FilterType::NoFilter);
    picture.write_with_encoder(encoder).map_err(|e| Error::config("picture", e))?;
    Ok(bytes)
}

fn scene(asked: &Asked) -> Scene {
    let mut items = heading(asked);
    let (levels, position) = (&asked.levels, &asked.position);
    let mean = |values: Option<[f32; QUANTILES.len()]>| {
        values.map_or("without weight".into(), |v| {
            format!("median {:.2}, 1 to 99 % {:.2} to {:.2}", v[4], v[1], v[7])
        })
    };
    let rows = [
        ("by queries", levels.quantiles.queries.into(), false),
        ("by weight", levels.quantiles.weight, true),
    ];
    for ((words, quantiles, heavy), top) in rows.into_iter().zip(TOP) {
        let of = |h: &super::Histogram| if heavy { h.weight.clone() } else { h.shares() };
        let titles = ["Levels", "Tile", "Light wi", "View wo"];
        let disc = |d: &Directions| {
            let cone = if heavy { d.most_of_weight } else { d.most };
            cone.map_or("none above the horizon".into(), |c| {
                format!("outline holds 99 %: {} degrees wide", short(2.0 * c.degrees()))
            })
        };
        let window = format!("outline holds all: {} of the tile", percent(position.window.area()));
        let captions = [mean(quantiles), window, disc(&asked.wi), disc(&asked.wo)];
        for ((title, caption), left) in titles.into_iter().zip(captions).zip(LEFT) {
            items.push(text([left, top - 10.0], &format!("{title}, {words}"), NORMAL, INK, Anchor::Start));
            let caption = cut(&caption, SMALL, SIDE + 20.0);
            items.push(text([left, top + SIDE + 36.0], &caption, SMALL, SOFT, Anchor::Start));
        }
        bars(&mut items, [LEFT[0], top], &of(&levels.histogram));
        map(&mut items, [LEFT[1], top], &of(&position.map), &position.window);
        for (directions, left) in [(&asked.wi, LEFT[2]), (&asked.wo, LEFT[3])] {
            let cone = if heavy { directions.most_of_weight } else { directions.most };
            round(&mut items, [left, top], &of(&directions.disc), cone);
        }
    }
    let mut at = WORDS;
    for line in &asked.meaning {
        for (k, part) in wrapped(line, NORMAL, f64::from(WIDTH) - 100.0).iter().enumerate() {
            let mark = if k == 0 { "\u{2022} " } else { "   " };
            items.push(text([LEFT[0], at], &format!("{mark}{part}"), NORMAL, INK, Anchor::Start));
            at += LINE;
        }
    }
    Scene { height: at, says: format!("What is asked of {}", asked.material), items }
}

fn heading(asked: &Asked) -> Vec<Item> {
    let room = f64::from(WIDTH) - 2.0 * LEFT[0];
    let what = format!(
        "{}; {} queries of {} camera rays, light for {} of the pixels",
        asked.described,
        count(asked.asked),
        count(asked.rays),
        percent(asked.pixels)
    );
    vec![
        text([LEFT[0], 38.0], &cut(&asked.material, 22.0, room), 22.0, INK, Anchor::Start),
        text([LEFT[0], 64.0], &cut(&what, NORMAL, room), NORMAL, SOFT, Anchor::Start),
    ]
}

fn text(at: [f64; 2], text: &str, size: f64, colour: Colour, anchor: Anchor) -> Item {
    Item::Text(Text { at, text: text.into(), size, colour, anchor, upright: false })
}

fn rectangle([left, top]: [f64; 2], [width, height]: [f64; 2], fill: Colour) -> Item {
    let (right, bottom) = (left + width, top + height);
    let outline = vec![[left, top], [right, top], [right, bottom], [left, bottom]];
    Item::Shape { outline, fill, line: fill, width: 0.0 }
}

fn line(points: Vec<[f64; 2]>, width: f64, colour: Colour) -> Item {
    Item::Line { points, width, colour }
}

/// Shares by quarter of a level.
fn bars(items: &mut Vec<Item>, [left, top]: [f64; 2], shares: &[f64]) {
    let bottom = top + SIDE;
    items.push(rectangle([left, top], [SIDE, SIDE], EMPTY));
    let most = shares.iter().copied().fold(0.0, f64::max);
    let each = SIDE / shares.len() as f64;
    let height = |share: f64| if most > 0.0 { share / most * (SIDE - 12.0) } else { 0.0 };
    for part in [0.5, 1.0] {
        let y = bottom - height(part * most).floor();
        items.push(line(vec![[left, y], [left + SIDE, y]], 1.0, GRID));
        if most > 0.0 {
            items.push(text([left - 5.0, y + 4.0], &percent(part * most), SMALL - 1.0, SOFT, Anchor::End));
        }
    }
    for (k, share) in shares.iter().enumerate().filter(|(_, share)| **share > 0.0) {
        // What is there is seen, be it ever so little.
        let high = height(*share).max(1.0);
        let width = (each - 1.0).max(1.0);
        items.push(rectangle([left + k as f64 * each, bottom - high], [width, high], BAR));
    }
    for whole in (0..shares.len()).step_by(BINS) {
        let x = left + whole as f64 * each;
        items.push(line(vec![[x, bottom], [x, bottom + 4.0]], 1.0, SOFT));
        let name = (whole / BINS).to_string();
        items.push(text([x, bottom + 17.0], &name, SMALL, SOFT, Anchor::Middle));
    }
}

/// The colour of a share beside the fullest one, logarithmic; and the share that is darkest.
fn shade(shares: &[f64]) -> (impl Fn(f64) -> Colour, [f64; 2]) {
    let most = shares.iter().copied().fold(0.0, f64::max);
    let least = shares.iter().copied().filter(|share| *share > 0.0).fold(most, f64::min).max(most / RANGE);
    let map = colour::map();
    let shade = move |share: f64| {
        let full = if least < most { (share / least).ln() / (most / least).ln() } else { 1.0 };
        colour::look_up(&map, full as f32)
    };
    (shade, [least, most])
}

/// What the colours mean, below a panel.
fn ramp(items: &mut Vec<Item>, [left, top]: [f64; 2], shares: &[f64]) {
    let (shade, [least, most]) = shade(shares);
    if most <= 0.0 {
        return;
    }
    let (steps, width, begin) = (64, 128.0, left + 64.0);
    for k in 0..steps {
        let share = least * (most / least).powf(k as f64 / (steps - 1) as f64);
        let each = width / steps as f64;
        items.push(rectangle([begin + k as f64 * each, top + SIDE + 9.0], [each, 8.0], shade(share)));
    }
    let base = top + SIDE + 17.0;
    items.push(text([begin - 5.0, base], &percent(least), SMALL - 1.0, SOFT, Anchor::End));
    items.push(text([begin + width + 5.0, base], &percent(most), SMALL - 1.0, SOFT, Anchor::Start));
}

/// The tile, first row at the top, with the window around all that is asked.
fn map(items: &mut Vec<Item>, [left, top]: [f64; 2], shares: &[f64], window: &Window) {
    items.push(rectangle([left, top], [SIDE, SIDE], EMPTY));
    let each = SIDE / position::CELLS as f64;
    let (colour, _) = shade(shares);
    for (k, share) in shares.iter().enumerate().filter(|(_, share)| **share > 0.0) {
        let (row, column) = (k / position::CELLS, k % position::CELLS);
        let at = [left + column as f64 * each, top + row as f64 * each];
        items.push(rectangle(at, [each, each], colour(*share)));
    }
    for [[x0, x1], [y0, y1]] in sides(window) {
        let (x0, x1) = (left + x0 * SIDE, left + x1 * SIDE);
        let (y0, y1) = (top + y0 * SIDE, top + y1 * SIDE);
        items.push(line(vec![[x0, y0], [x1, y1]], 2.0, OUTLINE));
    }
    ramp(items, [left, top], shares);
}

/// The sides of a window as lines \[x, y\]\[from, to\] within the tile: what goes over its border comes in again.
fn sides(window: &Window) -> Vec<[[f64; 2]; 2]> {
    let spans = [1, 0].map(|axis| {
        let (start, end) = (window.start[axis], window.start[axis] + window.length[axis]);
        if end > 1.0 { vec![[start, 1.0], [0.0, end - 1.0]] } else { vec![[start, end]] }
    });
    let ends = [1, 0].map(|axis| {
        let (start, length) = (window.start[axis], window.length[axis]);
        let end = start + length;
        if length >= 1.0 { vec![0.0, 1.0] } else { vec![start, if end > 1.0 { end - 1.0 } else { end }] }
    });
    let across = spans[0].iter().flat_map(|x| ends[1].iter().map(|y| [*x, [*y; 2]]));
    let down = spans[1].iter().flat_map(|y| ends[0].iter().map(|x| [[*x; 2], *y]));
    across.chain(down).collect()
}

/// The disc of the hemisphere, x to the right and y up, with the cone around most of it.
fn round(items: &mut Vec<Item>, [left, top]: [f64; 2], shares: &[f64], cone: Option<Cone>) {
    let each = SIDE / direction::CELLS as f64;
    let (colour, _) = shade(shares);
    for k in (0..shares.len()).filter(|k| in_disc(*k)) {
        let (row, column) = (k / direction::CELLS, k % direction::CELLS);
        let at = [left + column as f64 * each, top + SIDE - (row + 1) as f64 * each];
        let fill = if shares[k] > 0.0 { colour(shares[k]) } else { EMPTY };
        items.push(rectangle(at, [each, each], fill));
    }
    let place = |x: f64, y: f64| [left + (1.0 + x) * SIDE / 2.0, top + (1.0 - y) * SIDE / 2.0];
    let circle = |radius: f64| {
        (0..=96).map(move |k| {
            let (sin, cos) = (f64::from(k) / 96.0 * std::f64::consts::TAU).sin_cos();
            place(radius * cos, radius * sin)
        })
    };
    // Cells at the rim end with the disc.
    let mut outside =
        vec![[left, top], [left + SIDE, top], [left + SIDE, top + SIDE], [left, top + SIDE], [left, top]];
    outside.extend(circle(1.0));
    items.push(Item::Shape { outline: outside, fill: GROUND, line: GROUND, width: 0.0 });
    items.push(line(circle(1.0).collect(), 1.5, SOFT));
    for points in cone.iter().flat_map(mantle) {
        items.push(line(points.iter().map(|p| place(p[0], p[1])).collect(), 2.0, OUTLINE));
    }
    ramp(items, [left, top], shares);
}

/// The circle of a cone's mantle on the sphere as pieces above the horizon.
fn mantle(cone: &Cone) -> Vec<Vec<[f64; 2]>> {
    // A narrower one would hide what it holds.
    let cosine = cone.cosine.min(3f64.to_radians().cos());
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    let [x, y, z] = cone.axis;
    let flat = x.hypot(y);
    let side = if flat > 1e-9 { [-y / flat, x / flat, 0.0] } else { [1.0, 0.0, 0.0] };
    let up = [y * side[2] - z * side[1], z * side[0] - x * side[2], x * side[1] - y * side[0]];
    let mut pieces = vec![Vec::new()];
    for k in 0..=180 {
        let (sin, cos) = (f64::from(k) / 180.0 * std::f64::consts::TAU).sin_cos();
        let at = |c: usize| cosine * cone.axis[c] + sine * (cos * side[c] + sin * up[c]);
        match pieces.last_mut() {
            Some(piece) if at(2) > 0.0 => piece.push([at(0), at(1)]),
            _ => pieces.push(Vec::new()),
        }
    }
    pieces.retain(|piece| piece.len() > 1);
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_over_the_border_is_drawn_in_parts() {
        let within = Window { start: [0.25, 0.5], length: [0.5, 0.25] };
        assert_eq!(sides(&within).len(), 4);
        let over = Window { start: [0.25, 0.75], length: [0.5, 0.5] };
        let drawn = sides(&over);
        // Both horizontal sides in two parts, both vertical ones whole.
        assert_eq!(drawn.len(), 6);
        assert!(drawn.contains(&[[0.75, 1.0], [0.25; 2]]) && drawn.contains(&[[0.25; 2], [0.25, 0.75]]));
        assert!(drawn.as_flattened().as_flattened().iter().all(|v| (0.0..=1.0).contains(v)));
    }

    #[test]
    fn colours_are_logarithmic() {
        let (colour, [least, most]) = shade(&[0.0, 1e-3, 1e-1, 1e-2]);
        assert_eq!([least, most], [1e-3, 1e-1]);
        let map = colour::map();
        assert_eq!([colour(1e-3), colour(1e-1)], [map[0], map[255]]);
        assert_eq!(colour(1e-2), map[128]);
        assert_ne!(colour(0.05), map[128]);
        // Alone, a cell is full.
        assert_eq!(shade(&[1.0]).0(1.0), map[255]);
    }

    #[test]
    fn a_cone_that_dips_below_the_horizon_is_open() {
        let tilted = |tilt: f64| Cone { axis: [tilt.sin(), 0.0, tilt.cos()], cosine: 0.9 };
        let closed = mantle(&tilted(0.2));
        assert_eq!((closed.len(), closed[0].len()), (1, 181));
        let open: usize = mantle(&tilted(1.3)).iter().map(Vec::len).sum();
        assert!(open > 20 && open < 181, "{open}");
    }
}
