//! Two kinds of chart as inline SVG: curves over steps, and error against time. Errors are on log axes.
//!
//! Ink is `currentColor` and the ground is transparent, so that a page's light or dark scheme carries over;
//! [`as_file`] makes a picture file of one. Text is set by the browser in its sans-serif font.

use super::numbers::short;
use crate::error::{Error, Result};
use plotters::coord::combinators::{BindKeyPoints, IntoLogRange};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::ops::Range;

/// Plotters places on whole pixels; drawing larger and showing smaller keeps lines smooth.
const SCALE: i32 = 4;
/// Size of a chart in CSS pixels.
const SIZE: (i32, i32) = (496, 300);
/// Text height in CSS pixels.
const FONT: i32 = 12;
/// What to ask of plotters for that height: its SVG writer divides by 1.24.
const FONT_SIZE: f64 = 1.24 * (FONT * SCALE) as f64;
/// Width of a character of that height, about; only room for labels depends on it.
const CHARACTER: i32 = 7;
/// Names longer than this many characters are cut.
const LONGEST_NAME: usize = 18;
/// Largest x that is drawn, and shortest x axis: well inside what axes can be divided for.
const FARTHEST: f64 = 1e12;
const SHORTEST: f64 = 1e-3;
/// Stands for ink until it becomes `currentColor`; no series has this colour.
const INK: RGBColor = RGBColor(1, 2, 3);
const INK_TEXT: &str = "#010203";
/// One colour a series, each with a contrast of 3 or more to white and to near black.
const SERIES: [RGBColor; 6] = [
    RGBColor(0x7d, 0x84, 0x8f),
    RGBColor(0xd0, 0x6a, 0x1c),
    RGBColor(0x2f, 0x7f, 0xd6),
    RGBColor(0x2b, 0x97, 0x5c),
    RGBColor(0xb5, 0x54, 0xa0),
    RGBColor(0x9a, 0x7a, 0x1d),
];

/// A named line.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Written at its end.
    pub name: String,
    /// (x, y), by x. Points that are not finite or have no positive y are left out.
    pub points: Vec<(f64, f64)>,
}

/// A named point.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// Written beside it.
    pub name: String,
    /// Linear axis from 0.
    pub x: f64,
    /// Ends of the error bar along x.
    pub spread: Option<(f64, f64)>,
    /// Log axis.
    pub y: f64,
}

/// Lines over a linear x and a log y; the n-th series has the n-th colour. None if no point can be drawn.
///
/// # Errors
/// `Config` if the chart cannot be laid out.
pub fn curves(series: &[Series], x_label: &str, y_label: &str) -> Result<Option<String>> {
    let drawn: Vec<Vec<(f64, f64)>> =
        series.iter().map(|s| s.points.iter().copied().filter(drawable).collect()).collect();
    let all: Vec<(f64, f64)> = drawn.iter().flatten().copied().collect();
    let Some(y) = log_range(all.iter().map(|p| p.1)) else { return Ok(None) };
    let start = all.iter().fold(0.0f64, |start, p| start.min(p.0));
    let x = start..axis_end(start, all.iter().fold(start, |end, p| end.max(p.0)));
    let longest = series.iter().map(|s| shortened(&s.name).chars().count()).max().unwrap_or(0);
    let frame = Frame { x, y, x_label, y_label, right: 14 + CHARACTER * longest as i32 };
    draw(&frame, |area| {
        let mut labels = Vec::new();
        for (i, points) in drawn.iter().enumerate() {
            let colour = SERIES[i % SERIES.len()];
            let stroke = colour.stroke_width(2 * SCALE as u32);
            area.draw(&PathElement::new(points.clone(), stroke))?;
            if let Some(last) = points.last() {
                area.draw(&Circle::new(*last, 3 * SCALE, colour.filled()))?;
                labels.push((i, area.map_coordinate(last)));
            }
        }
        let mut heights: Vec<i32> = labels.iter().map(|(_, pixel)| pixel.1).collect();
        spread_apart(&mut heights, (FONT + 2) * SCALE);
        for ((i, (left, _)), height) in labels.into_iter().zip(heights) {
            let style = text(SERIES[i % SERIES.len()], HPos::Left);
            write(area, &shortened(&series[i].name), &style, (left + 7 * SCALE, height))?;
        }
        Ok(())
    })
    .map(Some)
}

/// Points over a linear x from 0 and a log y; the n-th mark has the n-th colour. None if no point can be
/// drawn.
///
/// # Errors
/// `Config` if the chart cannot be laid out.
pub fn scatter(marks: &[Mark], x_label: &str, y_label: &str) -> Result<Option<String>> {
    let drawn: Vec<(usize, &Mark)> =
        marks.iter().enumerate().filter(|(_, m)| drawable(&(m.x, m.y)) && m.x >= 0.0).collect();
    let Some(y) = log_range(drawn.iter().map(|(_, m)| m.y)) else { return Ok(None) };
    let bar =
        |m: &Mark| m.spread.filter(|s| s.0.abs() <= FARTHEST && s.1.abs() <= FARTHEST).unwrap_or((m.x, m.x));
    let right = drawn.iter().fold(0.0f64, |r, (_, m)| r.max(m.x).max(bar(m).1));
    let frame = Frame { x: 0.0..axis_end(0.0, right * 1.08), y, x_label, y_label, right: 16 };
    draw(&frame, |area| {
        let mut labels = Vec::new();
        for (i, mark) in &drawn {
            let colour = SERIES[i % SERIES.len()];
            let (low, high) = bar(mark);
            let line = PathElement::new(
                vec![(low.max(0.0), mark.y), (high, mark.y)],
                colour.stroke_width(SCALE as u32),
            );
            area.draw(&line)?;
            area.draw(&Circle::new((mark.x, mark.y), 5 * SCALE, colour.filled()))?;
            labels.push((*i, area.map_coordinate(&(mark.x, mark.y))));
        }
        // Names stand above their points, moved left where they would pass the chart's edge.
        let mut heights: Vec<i32> = labels.iter().map(|(_, pixel)| pixel.1 - 13 * SCALE).collect();
        spread_apart(&mut heights, (FONT + 2) * SCALE);
        for ((i, (centre, _)), height) in labels.into_iter().zip(heights) {
            let name = shortened(&marks[i].name);
            let half = name.chars().count() as i32 * CHARACTER * SCALE / 2;
            let right = (SIZE.0 - 4) * SCALE - half;
            write(area, &name, &text(SERIES[i % SERIES.len()], HPos::Center), (centre.min(right), height))?;
        }
        Ok(())
    })
    .map(Some)
}

/// A chart as an SVG file of its own: dark ink on white.
pub fn as_file(svg: &str) -> String {
    let head = "<svg xmlns=\"http://www.w3.org/2000/svg\" style=\"color:#1c2127;background:#ffffff\" ";
    svg.replacen("<svg ", head, 1)
}

fn drawable(point: &(f64, f64)) -> bool {
    point.0.abs() <= FARTHEST && point.1.is_finite() && point.1 > 0.0
}

/// `end` where an axis from `start` to there can be divided, otherwise one further than `start`.
fn axis_end(start: f64, end: f64) -> f64 {
    if end - start > SHORTEST { end } else { start + 1.0 }
}

fn shortened(name: &str) -> String {
    if name.chars().count() <= LONGEST_NAME {
        return name.into();
    }
    name.chars().take(LONGEST_NAME - 1).chain(['\u{2026}']).collect()
}

/// From a little under the least to a little over the largest value, at least a factor of 2 apart.
fn log_range(values: impl Iterator<Item = f64>) -> Option<Range<f64>> {
    let (low, high) = values.fold((f64::INFINITY, 0.0f64), |(l, h), v| (l.min(v), h.max(v)));
    // Far beyond any error; logarithms of such limits would leave the finite numbers.
    if !(low <= high && low > 1e-200 && high < 1e200) {
        return None;
    }
    let widen = (2.0 / (high / low)).max(1.0).sqrt();
    let margin = (high / low).powf(0.08).max(1.1);
    Some(low / (widen * margin)..high * widen * margin)
}

/// Round numbers of a log axis: whole decades, or the coarsest division of them that gives at least three.
fn log_ticks(range: &Range<f64>) -> Vec<f64> {
    let decades = range.start.log10().floor() as i32..=range.end.log10().ceil() as i32;
    let step = (decades.clone().count() / 8).max(1);
    let of = |mantissas: &[f64]| -> Vec<f64> {
        let all =
            decades.clone().step_by(step).flat_map(|d| mantissas.iter().map(move |m| m * 10f64.powi(d)));
        all.filter(|v| range.contains(v)).collect()
    };
    let divisions: [&[f64]; 4] =
        [&[1.0], &[1.0, 3.0], &[1.0, 2.0, 5.0], &[1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0]];
    let finest = [1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0];
    divisions.into_iter().map(of).find(|ticks| ticks.len() >= 3).unwrap_or_else(|| of(&finest))
}

/// Moves pixel heights apart until neighbours have `gap` between them, keeping their order and their centre.
fn spread_apart(heights: &mut [i32], gap: i32) {
    let mut order: Vec<usize> = (0..heights.len()).collect();
    order.sort_by_key(|&i| heights[i]);
    let before: i64 = heights.iter().map(|&h| i64::from(h)).sum();
    for pair in order.windows(2) {
        heights[pair[1]] = heights[pair[1]].max(heights[pair[0]] + gap);
    }
    let after: i64 = heights.iter().map(|&h| i64::from(h)).sum();
    let shift = if heights.is_empty() { 0 } else { (after - before) / heights.len() as i64 };
    heights.iter_mut().for_each(|h| *h -= shift as i32);
}

fn text(colour: RGBColor, anchor: HPos) -> TextStyle<'static> {
    ("sans-serif", FONT_SIZE).into_font().color(&colour).pos(Pos::new(anchor, VPos::Center))
}

struct Frame<'a> {
    x: Range<f64>,
    y: Range<f64>,
    x_label: &'a str,
    y_label: &'a str,
    /// CSS pixels kept free on the right.
    right: i32,
}

type Failure = DrawingAreaErrorKind<std::io::Error>;
type Coordinates = Cartesian2d<
    plotters::coord::types::RangedCoordf64,
    plotters::coord::combinators::WithKeyPoints<plotters::coord::combinators::LogCoord<f64>>,
>;
type Area<'a, 'b> = DrawingArea<SVGBackend<'a>, Coordinates>;

/// Text at a pixel of the whole chart; plotters counts from the area's corner.
fn write(area: &Area, name: &str, style: &TextStyle, at: (i32, i32)) -> std::result::Result<(), Failure> {
    let (left, top) = area.get_base_pixel();
    area.strip_coord_spec().draw_text(name, style, (at.0 - left, at.1 - top))
}

/// Axes and grid, then what `content` draws between them.
fn draw(frame: &Frame, content: impl FnOnce(&Area) -> std::result::Result<(), Failure>) -> Result<String> {
    let mut svg = String::new();
    let size = ((SIZE.0 * SCALE) as u32, (SIZE.1 * SCALE) as u32);
    let drawing = || -> std::result::Result<(), Failure> {
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        let y = frame.y.clone().log_scale().with_key_points(log_ticks(&frame.y));
        let mut chart = ChartBuilder::on(&root)
            .margin_top(10 * SCALE)
            .margin_right(frame.right * SCALE)
            .margin_left(4 * SCALE)
            .set_label_area_size(LabelAreaPosition::Left, 56 * SCALE)
            .set_label_area_size(LabelAreaPosition::Bottom, 38 * SCALE)
            .build_cartesian_2d(frame.x.clone(), y)?;
        let thousands = frame.x.end >= 10_000.0;
        chart
            .configure_mesh()
            .x_labels(6)
            .disable_x_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(INK.mix(0.15).stroke_width(SCALE as u32))
            .axis_style(INK.mix(0.5).stroke_width(SCALE as u32))
            .set_all_tick_mark_size(4 * SCALE)
            .label_style(("sans-serif", FONT_SIZE).into_font().color(&INK.mix(0.8)))
            .axis_desc_style(("sans-serif", FONT_SIZE).into_font().color(&INK))
            .x_desc(frame.x_label)
            .y_desc(frame.y_label)
            .x_label_formatter(&|x| if thousands { format!("{}k", x / 1e3) } else { format!("{x}") })
            .y_label_formatter(&|y| short(*y))
            .draw()?;
        content(chart.plotting_area())?;
        root.present()
    };
    drawing().map_err(|e| Error::config("figure", e))?;
    let shown = format!("<svg width=\"{}\" height=\"{}\"", size.0, size.1);
    let wanted = format!("<svg width=\"{}\" height=\"{}\"", SIZE.0, SIZE.1);
    Ok(svg
        .replacen(&shown, &wanted, 1)
        .replacen(" xmlns=\"http://www.w3.org/2000/svg\"", "", 1)
        .replace(INK_TEXT, "currentColor"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(name: &str, points: &[(f64, f64)]) -> Series {
        Series { name: name.into(), points: points.to_vec() }
    }

    #[test]
    fn charts_name_their_series_and_leave_out_what_has_no_logarithm() {
        let bad = [(0.0, f64::NAN), (1.0, 0.0), (f64::INFINITY, 1.0), (2.0, -1.0)];
        assert_eq!(curves(&[line("a", &bad)], "x", "y").unwrap(), None);
        assert_eq!(curves(&[], "x", "y").unwrap(), None);
        let series =
            [line("first <1>", &[(0.0, 1.0), (5.0, 0.1)]), line("bad", &bad), line("one", &[(3.0, 0.5)])];
        let svg = curves(&series, "steps", "mse").unwrap().unwrap();
        for name in ["first &lt;1&gt;", "one", "steps", "mse", "currentColor"] {
            assert!(svg.contains(name), "{name}");
        }
        for absent in ["NaN", "inf", "http", INK_TEXT, "<1>"] {
            assert!(!svg.contains(absent), "{absent}");
        }
        assert!(as_file(&svg).contains("xmlns"));
    }

    /// Left and top of every text.
    fn text_positions(svg: &str) -> Vec<(i32, i32)> {
        let value = |tag: &str, name: &str| -> i32 {
            tag.split_once(name).unwrap().1.split('"').next().unwrap().parse().unwrap()
        };
        let tags = svg.split("<text ").skip(1);
        tags.map(|tag| (value(tag, "x=\""), value(tag, "y=\""))).collect()
    }

    #[test]
    fn names_stand_on_the_chart() {
        let far =
            Mark { name: "the-longest-of-all-names".into(), x: 99.0, spread: Some((90.0, 100.0)), y: 1.0 };
        let near = Mark { name: "b".into(), x: 0.0, spread: None, y: 1.01 };
        let line = line("the-longest-of-all-names", &[(0.0, 1.0), (9.0, 2.0)]);
        let charts = [scatter(&[far, near], "x", "y").unwrap(), curves(&[line], "x", "y").unwrap()];
        for svg in charts.into_iter().flatten() {
            assert!(svg.contains("the-longest-of-al\u{2026}"));
            for (x, y) in text_positions(&svg) {
                assert!((0..SIZE.0 * SCALE).contains(&x) && (0..=SIZE.1 * SCALE).contains(&y), "{x} {y}");
            }
        }
    }

    #[test]
    fn marks_that_cannot_be_placed_are_left_out() {
        let mark = |name: &str, x, y| Mark { name: name.into(), x, spread: Some((x * 0.9, f64::NAN)), y };
        assert_eq!(scatter(&[mark("a", f64::NAN, 1.0), mark("b", 1.0, 0.0)], "x", "y").unwrap(), None);
        let svg =
            scatter(&[mark("good", 120.0, 1e-3), mark("bad", 1.0, -1.0)], "ns", "mse").unwrap().unwrap();
        assert!(svg.contains("good") && !svg.contains("bad"));
        assert!(scatter(&[mark("zero", 0.0, 1.0)], "ns", "mse").unwrap().is_some());
        assert_eq!(scatter(&[mark("a", 1.0, 1e300)], "ns", "mse").unwrap(), None);
        assert_eq!(scatter(&[mark("a", 1e300, 1.0)], "ns", "mse").unwrap(), None);
        assert!(scatter(&[mark("tiny", 1e-310, 1.0)], "ns", "mse").unwrap().is_some());
    }

    #[test]
    fn ticks_are_round_few_and_inside() {
        assert_eq!(log_ticks(&(0.9..1100.0)), [1.0, 10.0, 100.0, 1000.0]);
        assert_eq!(log_ticks(&(2.7..9.5)), [3.0, 4.0, 5.0, 6.0, 8.0]);
        for i in 0..200 {
            let low = 1.03f64.powi(i - 100);
            let range = log_range([low, low * 1.01f64.powi(i)].into_iter()).unwrap();
            let ticks = log_ticks(&range);
            assert!(ticks.iter().all(|t| range.contains(t)));
            assert!((3..=8).contains(&ticks.len()), "{range:?}: {ticks:?}");
        }
        assert!(log_ticks(&(1e-60..1e60)).len() <= 20);
    }

    #[test]
    fn labels_keep_their_distance() {
        let mut heights = [100, 102, 40, 101];
        spread_apart(&mut heights, 14);
        let mut sorted = heights;
        sorted.sort_unstable();
        assert!(sorted.windows(2).all(|w| w[1] - w[0] >= 14), "{heights:?}");
        assert!(heights[2] < heights[0]);
        spread_apart(&mut [], 14);
    }
}
