//! An analysis as text and as a page.

use super::meaning::percent;
use super::{Analysis, Asked, QUANTILES};
use crate::report::numbers::{count, short};
use crate::report::{STYLE, escaped};

/// What the tables have: a name and a value at each quantile.
fn rows(asked: &Asked) -> Vec<(&'static str, [String; QUANTILES.len()])> {
    let levels = &asked.levels;
    let number = |v: f32| short(f64::from(v));
    let level = |v: f32| format!("{v:.2}");
    let mut rows = vec![("level, by queries", levels.quantiles.queries.map(level))];
    rows.extend(levels.quantiles.weight.map(|weight| ("level, by weight", weight.map(level))));
    if asked.resolution != [1, 1] {
        rows.push(("texels a pixel", levels.texels_a_pixel.map(number)));
        rows.push(("pixels a tile", levels.pixels_a_tile.map(|[_, across]| number(across))));
    }
    rows
}

fn shares() -> [String; QUANTILES.len()] {
    QUANTILES.map(|share| format!("{:.0} %", 100.0 * share))
}

fn heading(asked: &Asked) -> String {
    format!(
        "{}; {} queries of {} camera rays, light for {} of the pixels",
        asked.described,
        count(asked.asked),
        count(asked.rays),
        percent(asked.pixels)
    )
}

/// A material as a short table.
pub(super) fn text(asked: &Asked) -> String {
    let mut out = format!("{}: {}\n", asked.material, heading(asked));
    let row = |name: &str, values: &[String]| {
        let values: String = values.iter().map(|value| format!(" {value:>7}")).collect();
        format!("  {name:<17}{values}\n")
    };
    out += &row("", &shares());
    rows(asked).iter().for_each(|(name, values)| out += &row(name, values));
    let lines: Vec<String> = asked.meaning.iter().map(|line| format!("  - {line}")).collect();
    out + &lines.join("\n")
}

/// The page.
pub(super) fn html(analysis: &Analysis) -> String {
    let title = escaped(&format!("What {} asks of its materials", analysis.scene));
    let mut page = String::from("<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n");
    page += "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n";
    page +=
        &format!("<title>{title}</title>\n<style>\n{STYLE}img {{ max-width: 100%; }}\n</style>\n</head>\n");
    page += &format!("<body>\n<h1>{title}</h1>\n<dl>\n");
    let Analysis { width, height, samples, frames, seed, .. } = analysis;
    let facts = [
        ("Frame", format!("{width} x {height} pixels, {samples} samples each")),
        ("Frames", frames.to_string()),
        ("Seed", seed.to_string()),
        ("Queries kept", format!("at most {} a material", count(analysis.most as u64))),
    ];
    for (name, value) in facts {
        page += &format!("<div><dt>{name}</dt><dd>{value}</dd></div>\n");
    }
    page += "</dl>\n<p class=\"note\">By queries: what answering costs. By weight: what an error costs the picture. Levels \
             are log2 of the texels a pixel; the tile has its first row at the top, directions have x to the right and y \
             up. Colours are logarithmic, grey is never asked.</p>\n";
    analysis.materials.iter().for_each(|asked| page += &section(asked));
    page + "</body>\n</html>\n"
}

fn section(asked: &Asked) -> String {
    let mut out = format!(
        "<h2>{}</h2>\n<p class=\"note\">{}</p>\n",
        escaped(&asked.material),
        escaped(&heading(asked))
    );
    let cells = |values: &[String]| -> String {
        values.iter().map(|value| format!("<td class=\"number\">{value}</td>")).collect()
    };
    out += "<ul>\n";
    asked.meaning.iter().for_each(|line| out += &format!("<li>{}</li>\n", escaped(line)));
    out += "</ul>\n<div class=\"scroll\"><table>\n<thead><tr><th></th>";
    shares().iter().for_each(|share| out += &format!("<th class=\"number\">{share}</th>"));
    out += "</tr></thead>\n<tbody class=\"rows\">\n";
    for (name, values) in rows(asked) {
        out += &format!("<tr><td>{name}</td>{}</tr>\n", cells(&values));
    }
    let name = escaped(&asked.material);
    out + &format!(
        "</tbody>\n</table></div>\n<p><img src=\"{}\" alt=\"What is asked of {name}\"></p>\n",
        asked.picture
    )
}
