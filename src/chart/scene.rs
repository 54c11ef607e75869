//! A picture as a list of lines, shapes and texts, and that list as SVG.

use super::WIDTH;
use super::raster::text_width;
use crate::report;

/// sRGB.
pub(crate) type Colour = [u8; 3];
pub(crate) const GROUND: Colour = [255, 255, 255];
pub(crate) const INK: Colour = [0x1c, 0x21, 0x27];
pub(crate) const SOFT: Colour = [0x59, 0x62, 0x6e];
pub(crate) const GRID: Colour = [0xe6, 0xe9, 0xed];
/// Metric neighbours of the font that PNG files are written in, so that both kinds of file are laid out alike.
const FONTS: &str = "Arial, Helvetica, 'Liberation Sans', sans-serif";

/// Which point of a text stands at its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

/// A text; `at` is on its base line.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Text {
    pub(crate) at: [f64; 2],
    pub(crate) text: String,
    pub(crate) size: f64,
    pub(crate) colour: Colour,
    pub(crate) anchor: Anchor,
    /// True if it is read from below upwards.
    pub(crate) upright: bool,
}

/// One thing of a picture; places in units from the upper left corner, later ones above earlier ones.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Item {
    Line {
        points: Vec<[f64; 2]>,
        width: f64,
        colour: Colour,
    },
    Shape {
        outline: Vec<[f64; 2]>,
        fill: Colour,
        line: Colour,
        width: f64,
    },
    Text(Text),
    /// A marker with what a browser says of it.
    Mark {
        says: String,
        items: Vec<Item>,
    },
}

/// A picture.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Scene {
    pub(crate) height: f64,
    /// What it shows, for readers who do not see it.
    pub(crate) says: String,
    pub(crate) items: Vec<Item>,
}

/// Text as it may stand between tags and in quoted attributes. Characters that XML has no place for are replaced.
pub(crate) fn escaped(text: &str) -> String {
    let placed = |c| match c {
        '\n' => c,
        '\u{0}'..='\u{1f}' | '\u{7f}' | '\u{fffe}' | '\u{ffff}' => '\u{fffd}',
        _ => c,
    };
    report::escaped(&text.chars().map(placed).collect::<String>())
}

/// Lines of at most `width` units; a word that is longer stands alone.
pub(crate) fn wrapped(text: &str, size: f64, width: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ').filter(|w| !w.is_empty()) {
        match lines.last_mut() {
            Some(line) if text_width(&format!("{line} {word}"), size) <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.into()),
        }
    }
    lines
}

/// The text, cut so that it is no wider than `width` units.
pub(crate) fn cut(text: &str, size: f64, width: f64) -> String {
    if text_width(text, size) <= width {
        return text.into();
    }
    let mut kept = String::new();
    for c in text.chars() {
        let longer = format!("{kept}{c}");
        if text_width(&longer, size) + text_width("\u{2026}", size) > width {
            break;
        }
        kept = longer;
    }
    kept + "\u{2026}"
}

fn number(value: f64) -> String {
    // A negative zero and a zero are the same place.
    let text = format!("{:.2}", value + 0.0);
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.into() }
}

fn hex(colour: Colour) -> String {
    format!("#{:02x}{:02x}{:02x}", colour[0], colour[1], colour[2])
}

fn path(points: &[[f64; 2]]) -> String {
    let place = |p: &[f64; 2]| format!("{} {}", number(p[0]), number(p[1]));
    format!("M{}", points.iter().map(place).collect::<Vec<_>>().join("L"))
}

fn write(item: &Item, out: &mut String) {
    match item {
        Item::Line { points, width, colour } => {
            let (d, stroke, width) = (path(points), hex(*colour), number(*width));
            *out +=
                &format!("<path d=\"{d}\" fill=\"none\" stroke=\"{stroke}\" stroke-width=\"{width}\"/>\n");
        }
        Item::Shape { outline, fill, line, width } => {
            let (d, fill, stroke, width) = (path(outline), hex(*fill), hex(*line), number(*width));
            *out +=
                &format!("<path d=\"{d}Z\" fill=\"{fill}\" stroke=\"{stroke}\" stroke-width=\"{width}\"/>\n");
        }
        Item::Text(text) => {
            let [x, y] = text.at.map(number);
            let anchor = match text.anchor {
                Anchor::Start => "",
                Anchor::Middle => " text-anchor=\"middle\"",
                Anchor::End => " text-anchor=\"end\"",
            };
            let turn =
                if text.upright { format!(" transform=\"rotate(-90 {x} {y})\"") } else { String::new() };
            let (size, fill, words) = (number(text.size), hex(text.colour), escaped(&text.text));
            *out += &format!(
                "<text x=\"{x}\" y=\"{y}\" font-size=\"{size}\" fill=\"{fill}\"{anchor}{turn}>{words}</text>\n"
            );
        }
        Item::Mark { says, items } => {
            *out += &format!("<g class=\"mark\"><title>{}</title>\n", escaped(says));
            items.iter().for_each(|item| write(item, out));
            *out += "</g>\n";
        }
    }
}

/// The picture as an SVG file: dark ink on white, no script, no other file.
pub(crate) fn svg(scene: &Scene) -> String {
    let height = number(scene.height);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{height}\" \
         viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" font-family=\"{FONTS}\">\n<title>{}</title>\n",
        escaped(&scene.says)
    );
    out += &format!("<rect width=\"{WIDTH}\" height=\"{height}\" fill=\"{}\"/>\n", hex(GROUND));
    scene.items.iter().for_each(|item| write(item, &mut out));
    out + "</svg>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_escaped_and_numbers_short() {
        assert_eq!(escaped("a<b> & \"c\" 'd'\u{1}"), "a&lt;b&gt; &amp; &quot;c&quot; &#39;d&#39;\u{fffd}");
        assert_eq!([1.0, 0.125, -0.001, 2.5].map(number), ["1", "0.12", "0", "2.5"]);
    }

    #[test]
    fn long_texts_are_wrapped_or_cut() {
        let lines = wrapped("one two three four five", 12.0, 70.0);
        assert!(lines.len() > 1 && lines.iter().all(|l| text_width(l, 12.0) <= 70.0), "{lines:?}");
        assert_eq!(lines.join(" "), "one two three four five");
        let short = cut("a label of many words", 12.0, 60.0);
        assert!(short.ends_with('\u{2026}') && text_width(&short, 12.0) <= 60.0, "{short}");
        assert_eq!(cut("short", 12.0, 60.0), "short");
    }
}
