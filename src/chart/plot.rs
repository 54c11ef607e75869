//! Panels as a scene: headings, axes, bars, the front, marks, names.

use super::axes::{Axis, tick_text};
use super::family::{Family, Shape};
use super::labels::{Obstacles, places};
use super::metric::{Metric, Unit};
use super::panel::{Mark, Panel, panels};
use super::raster::text_width;
use super::scene::{Anchor, Colour, GRID, GROUND, INK, Item, SOFT, Scene, Text, cut, wrapped};
use super::{Chart, Labels, WIDTH, caption};
use crate::error::{Error, Result};

const PAGE: f64 = WIDTH as f64;
/// Around everything, and between two columns.
const MARGIN: f64 = 28.0;
const GAP: f64 = 36.0;
/// Heights of texts.
const TITLE: f64 = 23.0;
const HEADING: f64 = 16.0;
const BODY: f64 = 13.0;
const SMALL: f64 = 12.0;
/// Line height over text height.
const LEADING: f64 = 1.45;
/// Room around a plot: numbers and name of y; heading; numbers and name of x and what was left out.
const LEFT: f64 = 74.0;
const ABOVE: f64 = 30.0;
const BELOW: f64 = 64.0;
/// Height of a plot, one in a column of its own and one of several.
const ALONE: f64 = 460.0;
const PLOT: f64 = 300.0;
/// Radius of a marker.
const RADIUS: f64 = 4.6;
/// Names are cut to this width, and only the first ones of very many are placed: each is compared with all others.
const NAME_WIDTH: f64 = 220.0;
const MOST_NAMES: usize = 300;
/// Panels of one picture.
const MOST_PANELS: usize = 48;

/// The whole picture.
///
/// # Errors
/// As [`panels`]; `Usage` for more panels than a picture has room for.
pub(super) fn scene(chart: &Chart) -> Result<Scene> {
    let panels = panels(chart)?;
    if panels.len() > MOST_PANELS {
        let problem = format!("{} panels; a picture has room for {MOST_PANELS}", panels.len());
        return Err(Error::usage(format!("--materials: {problem}: name fewer, or use --panels mean")));
    }
    let mut pen = Pen { items: Vec::new(), y: MARGIN };
    let title = caption::title(chart);
    pen.lines(std::slice::from_ref(&title), TITLE, INK);
    pen.y += 4.0;
    let subtitle = caption::subtitle(chart);
    pen.lines(&subtitle, BODY, SOFT);
    pen.y += 8.0;
    let families = chart.families();
    let used = |i: &usize| panels.iter().any(|p| p.marks.iter().any(|m| m.family == *i));
    pen.legend((0..families.len()).filter(used).map(|i| &families[i]));
    let columns = panels.len().min(2);
    let width = (PAGE - 2.0 * MARGIN - GAP * (columns - 1) as f64) / columns as f64;
    let height = if columns == 1 { ALONE } else { PLOT };
    let metric = chart.metric();
    for row in panels.chunks(columns) {
        let top = pen.y + ABOVE;
        for (k, panel) in row.iter().enumerate() {
            let left = MARGIN + k as f64 * (width + GAP);
            let frame = [left + LEFT, top, left + width, top + height];
            let plot = Plot { panel, metric: &metric, families: &families, frame };
            plot.draw(chart.settings.labels, &mut pen.items);
        }
        pen.y = top + height + BELOW;
    }
    pen.y += 6.0;
    pen.lines(&caption::notes(chart, &panels), SMALL, SOFT);
    let says = format!("{title}. {}", subtitle.join(" "));
    Ok(Scene { height: (pen.y + MARGIN / 2.0).ceil(), says, items: pen.items })
}

/// Where the next line goes.
struct Pen {
    items: Vec<Item>,
    y: f64,
}

fn text(at: [f64; 2], text: impl Into<String>, size: f64, colour: Colour, anchor: Anchor) -> Item {
    Item::Text(Text { at, text: text.into(), size, colour, anchor, upright: false })
}

impl Pen {
    fn lines(&mut self, texts: &[String], size: f64, colour: Colour) {
        for line in texts.iter().flat_map(|text| wrapped(text, size, PAGE - 2.0 * MARGIN)) {
            let line = cut(&line, size, PAGE - 2.0 * MARGIN);
            self.items.push(text([MARGIN, self.y + size], line, size, colour, Anchor::Start));
            self.y += LEADING * size;
        }
    }

    fn legend<'a>(&mut self, families: impl Iterator<Item = &'a Family>) {
        let mut x = MARGIN;
        for family in families {
            let name = cut(&family.name, BODY, NAME_WIDTH);
            let width = 18.0 + text_width(&name, BODY) * 1.05;
            if x > MARGIN && x + width > PAGE - MARGIN {
                (x, self.y) = (MARGIN, self.y + LEADING * BODY);
            }
            self.items.extend(marker([x + 6.0, self.y + 8.0], family, true, &[]));
            self.items.push(text([x + 18.0, self.y + 12.5], name, BODY, INK, Anchor::Start));
            x += width + 22.0;
        }
        self.y += LEADING * BODY + 6.0;
    }
}

fn colour(family: &Family) -> Colour {
    family.colour.unwrap_or(INK)
}

/// The colour half way to the ground.
fn pale(colour: Colour) -> Colour {
    std::array::from_fn(|k| ((u16::from(colour[k]) + u16::from(GROUND[k])) / 2) as u8)
}

/// A marker with a rim of ground, so that marks on each other stay apart, and bars of seeds between rim and shape.
fn marker([x, y]: [f64; 2], family: &Family, filled: bool, bars: &[[[f64; 2]; 2]]) -> Vec<Item> {
    let outline: Vec<[f64; 2]> =
        family.shape.outline(RADIUS).into_iter().map(|[dx, dy]| [x + dx, y + dy]).collect();
    let line = colour(family);
    let fill = if filled || family.shape == Shape::Star { line } else { GROUND };
    let mut items = vec![Item::Shape { outline: outline.clone(), fill: GROUND, line: GROUND, width: 4.0 }];
    items.extend(bars.iter().map(|bar| Item::Line { points: bar.to_vec(), width: 1.3, colour: line }));
    items.push(Item::Shape { outline, fill, line, width: 1.7 });
    items
}

/// From the least to the most over seeds, where there are several values.
fn bars(mark: &Mark, at: [f64; 2], x: &Axis, y: &Axis) -> Vec<[[f64; 2]; 2]> {
    let [cost, error] = mark.spreads;
    let along_x = [[x.place(cost.low), at[1]], [x.place(cost.high), at[1]]];
    let along_y = [[at[0], y.place(error.low)], [at[0], y.place(error.high)]];
    let both = [(cost, along_x), (error, along_y)];
    both.into_iter().filter(|(spread, _)| spread.low < spread.high).map(|(_, bar)| bar).collect()
}

struct Plot<'a> {
    panel: &'a Panel,
    metric: &'a Metric,
    families: &'a [Family],
    frame: [f64; 4],
}

impl Plot<'_> {
    fn draw(&self, labels: Labels, items: &mut Vec<Item>) {
        let [left, top, right, bottom] = self.frame;
        self.heading(items);
        let marks = &self.panel.marks;
        if marks.is_empty() {
            let middle = [(left + right) / 2.0, (top + bottom) / 2.0];
            items.push(text(middle, "nothing to show", BODY, SOFT, Anchor::Middle));
            return;
        }
        let log = !self.metric.higher;
        let ends = |k: usize| marks.iter().flat_map(move |m| [m.spreads[k].low, m.spreads[k].high]);
        let x = Axis::around(ends(0), true, [left, right]);
        let y = Axis::around(ends(1), log, [bottom, top]);
        self.axes(&x, &y, items);
        let places: Vec<[f64; 2]> =
            marks.iter().map(|m| [x.place(m.spreads[0].mean), y.place(m.spreads[1].mean)]).collect();
        let mut lines = self.front(&places, items);
        // Members of the front on top of the others.
        for on in [false, true] {
            for (mark, at) in marks.iter().zip(&places).filter(|(m, _)| m.front == on) {
                let bars = bars(mark, *at, &x, &y);
                let drawn = marker(*at, &self.families[mark.family], on, &bars);
                items.push(Item::Mark { says: mark.says.clone(), items: drawn });
                lines.extend(bars);
            }
        }
        self.names(labels, &places, &lines, items);
    }

    fn heading(&self, items: &mut Vec<Item>) {
        let [left, top, right, bottom] = self.frame;
        let reasons: Vec<String> = self.panel.left_out.iter().map(|(why, n)| format!("{n} {why}")).collect();
        if !reasons.is_empty() {
            let note = cut(&format!("left out: {}", reasons.join(", ")), SMALL, right - left);
            items.push(text([left, bottom + 55.0], note, SMALL, SOFT, Anchor::Start));
        }
        let title = cut(&self.panel.title, HEADING, right - left);
        items.push(text([left, top - 10.0], title, HEADING, INK, Anchor::Start));
    }

    fn axes(&self, x: &Axis, y: &Axis, items: &mut Vec<Item>) {
        let [left, top, right, bottom] = self.frame;
        let line = |points: [[f64; 2]; 2], colour| Item::Line { points: points.to_vec(), width: 1.0, colour };
        let mut last = f64::NEG_INFINITY;
        for tick in x.ticks() {
            let (at, name) = (x.place(tick), tick_text(tick, self.panel.cost.unit));
            items.push(line([[at, top], [at, bottom]], GRID));
            let half = text_width(&name, SMALL) * 0.55;
            if at - half > last + 6.0 {
                items.push(text([at, bottom + 17.0], name, SMALL, SOFT, Anchor::Middle));
                last = at + half;
            }
        }
        for tick in y.ticks() {
            let at = y.place(tick);
            items.push(line([[left, at], [right, at]], GRID));
            let name = tick_text(tick, Unit::Plain);
            items.push(text([left - 8.0, at + 4.0], name, SMALL, SOFT, Anchor::End));
        }
        items.push(line([[left, bottom], [right, bottom]], SOFT));
        items.push(line([[left, top], [left, bottom]], SOFT));
        let middle = [(left + right) / 2.0, (top + bottom) / 2.0];
        let cost = self.panel.cost.words;
        items.push(text([middle[0], bottom + 37.0], cost, BODY, INK, Anchor::Middle));
        let name = cut(&self.metric.name, BODY, bottom - top);
        let at = [left - LEFT + 12.0, middle[1]];
        items.push(Item::Text(Text {
            at,
            text: name,
            size: BODY,
            colour: INK,
            anchor: Anchor::Middle,
            upright: true,
        }));
    }

    /// The stepped line through the front; returns its pieces.
    fn front(&self, places: &[[f64; 2]], items: &mut Vec<Item>) -> Vec<[[f64; 2]; 2]> {
        let [_, top, right, bottom] = self.frame;
        // Up is worse, as the steps want it, only where less is better.
        let turn = |[x, y]: [f64; 2]| if self.metric.higher { [x, y] } else { [x, -y] };
        let on = self.panel.marks.iter().zip(places).filter(|(m, _)| m.front);
        let members: Vec<[f64; 2]> = on.map(|(_, at)| turn(*at)).collect();
        let worst = if self.metric.higher { bottom } else { -top };
        let line: Vec<[f64; 2]> = super::front::steps(&members, worst, right).into_iter().map(turn).collect();
        let pieces = line.windows(2).map(|pair| [pair[0], pair[1]]).collect();
        items.push(Item::Line { points: line, width: 1.3, colour: [0x8b, 0x93, 0x9e] });
        pieces
    }

    fn names(&self, labels: Labels, places_of: &[[f64; 2]], lines: &[[[f64; 2]; 2]], items: &mut Vec<Item>) {
        let named = |mark: &Mark| match labels {
            Labels::None => false,
            Labels::Front => mark.front,
            Labels::All => true,
        };
        let mut wanted: Vec<usize> = (0..places_of.len()).filter(|i| named(&self.panel.marks[*i])).collect();
        // The front first: where room is short, others stay without a name.
        let left = |i: usize| places_of[i][0];
        wanted.sort_by(|&a, &b| {
            let front = |i: usize| !self.panel.marks[i].front;
            front(a).cmp(&front(b)).then(left(a).total_cmp(&left(b)))
        });
        wanted.truncate(MOST_NAMES);
        let names: Vec<String> =
            wanted.iter().map(|i| cut(&self.panel.marks[*i].label, SMALL, NAME_WIDTH)).collect();
        let size = |name: &String| [text_width(name, SMALL) * 1.06, SMALL * 1.15];
        let boxes: Vec<_> = wanted.iter().zip(&names).map(|(i, name)| (places_of[*i], size(name))).collect();
        // Nothing is cheaper and better than the front: towards there is room.
        let towards = if self.metric.higher { 1.25 } else { 0.75 } * std::f64::consts::PI;
        let around = Obstacles { frame: self.frame, marks: places_of, lines, towards };
        for ((i, name), place) in wanted.iter().zip(names).zip(places(&boxes, &around)) {
            let Some(place) = place else { continue };
            let family = &self.families[self.panel.marks[*i].family];
            if let Some(leader) = place.leader {
                items.push(Item::Line { points: leader.to_vec(), width: 0.8, colour: pale(SOFT) });
            }
            let base = place.covers[3] - 0.28 * SMALL;
            let middle = (place.covers[0] + place.covers[2]) / 2.0;
            items.push(text([middle, base], name, SMALL, dark(colour(family)), Anchor::Middle));
        }
    }
}

/// Text needs more contrast than marks.
fn dark(colour: Colour) -> Colour {
    colour.map(|c| (u16::from(c) * 7 / 10) as u8)
}
