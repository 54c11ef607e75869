//! The page: every section in its own function, in the order in which they are read.

use super::numbers::{bytes, count, optional, short, significant};
use super::{CostRow, Panel, Report, TableRow, colour, figures, picture};
use crate::error::{Error, Result};
use crate::metrics::Errors;

/// Width of a picture in CSS pixels, a multiple of every power of two up to 64; `style.css` has it too.
const SHOWN: u32 = 192;
/// Errors are written times this.
const MILLI: f64 = 1e3;

pub(super) fn html(report: &Report) -> Result<String> {
    let mut page = String::from("<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n");
    page += "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n";
    page += &format!("<title>{}</title>\n", escaped(&report.title));
    page += &format!("<style>\n{}</style>\n</head>\n<body>\n", super::STYLE);
    page += &head(report);
    page += &panels(&report.panels)?;
    page += &training(report)?;
    page += &errors(&report.table);
    page += &costs(report)?;
    page += &exports(report);
    page += &commands(&report.commands);
    page += "</body>\n</html>\n";
    Ok(page)
}

/// Text as it may stand between tags and inside quoted attributes.
pub fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '"' => out += "&quot;",
            '\'' => out += "&#39;",
            _ => out.push(c),
        }
    }
    out
}

/// JSON as it may stand in a script element: nothing in it ends the element or begins a comment.
pub fn inert(json: &str) -> String {
    json.replace('<', "\\u003c").replace('>', "\\u003e").replace('&', "\\u0026")
}

/// A template with each `{{NAME}}` replaced by its part, in one pass: what is put in for one name is not searched for the
/// next one. A name without a part becomes nothing.
pub fn filled(template: &str, parts: &[(&str, &str)]) -> String {
    let mut out = String::new();
    let mut pieces = template.split("{{");
    out += pieces.next().unwrap_or_default();
    for piece in pieces {
        let (name, rest) = piece.split_once("}}").unwrap_or(("", piece));
        out += parts.iter().find(|(known, _)| *known == name).map_or("", |(_, text)| text);
        out += rest;
    }
    out
}

fn head(report: &Report) -> String {
    let mut out = format!("<h1>{}</h1>\n", escaped(&report.title));
    if !report.verdict.is_empty() {
        out += &format!("<p class=\"verdict\">{}</p>\n", escaped(&report.verdict));
    }
    if !report.facts.is_empty() {
        out += "<dl>\n";
        for (name, value) in &report.facts {
            out += &format!("<div><dt>{}</dt><dd>{}</dd></div>\n", escaped(name), escaped(value));
        }
        out += "</dl>\n";
    }
    out
}

fn panels(panels: &[Panel]) -> Result<String> {
    if panels.is_empty() {
        return Ok(String::new());
    }
    let mut out = String::from("<h2>Pictures on held-out directions</h2>\n");
    out += "<p class=\"note\">Differences are means over red, green and blue of linear values clamped to \
            [0, 1]; mse is of the same values, \u{d7} 10\u{207b}\u{b3}. Cyan marks pixels that \
            are not finite.</p>\n";
    for (i, panel) in panels.iter().enumerate() {
        out += &row(panel).map_err(|e| Error::config(format!("report.panels[{i}]"), e))?;
    }
    Ok(out)
}

fn row(panel: &Panel) -> Result<String> {
    panel.checked()?;
    let (stops, maximum, errors) = (panel.exposure(), panel.maximum(), panel.errors());
    let mut out = format!("<h3>{}</h3>\n<p class=\"note\">", escaped(&panel.title));
    if !panel.caption.is_empty() {
        out += &format!("{} \u{b7} ", escaped(&panel.caption));
    }
    if stops > 0.0 {
        out += &format!("pictures {} times brighter \u{b7} ", stops.exp2());
    }
    out += &format!("differences 0 {}{}</p>\n<div class=\"row\">\n", ramp(), short(maximum));
    out += &shown(&picture::srgb(&panel.reference, stops)?, "reference", "")?;
    for (model, answer) in &panel.answers {
        out += &shown(&picture::srgb(answer, stops)?, model, "")?;
    }
    let best = least(errors.iter().map(|e| e.mse));
    for ((model, answer), errors) in panel.answers.iter().zip(&errors) {
        let difference = picture::difference(answer, &panel.reference, maximum as f32)?;
        let score =
            format!("<span>mse {}</span>", scored(errors, errors.mse == best && panel.answers.len() > 1));
        out += &shown(&difference, &format!("|{model} \u{2212} reference|"), &score)?;
    }
    out += "</div>\n";
    Ok(out)
}

fn scored(errors: &Errors, best: bool) -> String {
    let mse = bold_if(best, &significant(errors.mse * MILLI));
    match errors.psnr() {
        Some(psnr) => format!("{mse} \u{b7} {psnr:.1} dB"),
        None => mse,
    }
}

/// The scale of the differences.
fn ramp() -> String {
    let map = colour::map();
    let stops: Vec<String> =
        map.iter().step_by(17).map(|c| format!("#{:02x}{:02x}{:02x}", c[0], c[1], c[2])).collect();
    format!("<span class=\"ramp\" style=\"background:linear-gradient(to right,{})\"></span>", stops.join(","))
}

/// A picture with its name; `extra` is markup below it.
fn shown(picture: &picture::Picture, name: &str, extra: &str) -> Result<String> {
    let enlarged = picture::enlarged(picture, SHOWN.div_ceil(picture.width().max(picture.height())).max(1))?;
    // Only whole factors keep square pixels square; everything else is scaled smoothly.
    let class = if enlarged.width() == SHOWN { " class=\"exact\"" } else { "" };
    let uri = picture::data_uri(&picture::png(&enlarged)?);
    let name = escaped(name);
    Ok(format!(
        "<figure><img{class} src=\"{uri}\" alt=\"{name}\"><figcaption>{name}{extra}</figcaption></figure>\n"
    ))
}

fn training(report: &Report) -> Result<String> {
    let series = |points: &dyn Fn(&super::Curve) -> Vec<(f64, f64)>| -> Vec<figures::Series> {
        report.curves.iter().map(|c| figures::Series { name: c.name.clone(), points: points(c) }).collect()
    };
    let losses = series(&|c| c.training.clone());
    let errors = series(&|c| c.validation.iter().map(|(x, y)| (*x, y * MILLI)).collect());
    let error = figures::curves(&errors, "steps", "held-out mse \u{d7} 10\u{207b}\u{b3}")?;
    let loss = figures::curves(&losses, "steps", "training loss")?;
    let charts = chart(error, "Error on held-out directions") + &chart(loss, "Training loss");
    if charts.is_empty() {
        return Ok(String::new());
    }
    let note = "Each model is trained on its own loss: compare the shapes of the losses, not their heights.";
    Ok(format!("<h2>Training</h2>\n<p class=\"note\">{note}</p>\n<div class=\"charts\">\n{charts}</div>\n"))
}

fn chart(svg: Option<String>, name: &str) -> String {
    let Some(svg) = svg else { return String::new() };
    let svg = svg.replacen("<svg ", &format!("<svg role=\"img\" aria-label=\"{}\" ", escaped(name)), 1);
    format!("<figure>\n{svg}<figcaption>{}</figcaption></figure>\n", escaped(name))
}

/// The column heads of a table; those beginning with `#` are of numbers.
fn table_head(columns: &[&str]) -> String {
    let cell = |name: &&str| match name.strip_prefix('#') {
        Some(name) => format!("<th class=\"number\">{name}</th>"),
        None => format!("<th>{name}</th>"),
    };
    let cells: String = columns.iter().map(cell).collect();
    format!("<div class=\"scroll\"><table>\n<thead><tr>{cells}</tr></thead>\n")
}

fn number(text: &str) -> String {
    format!("<td class=\"number\">{text}</td>")
}

fn bold_if(best: bool, text: &str) -> String {
    if best { format!("<b>{text}</b>") } else { text.into() }
}

/// The least of the finite values; NaN, which equals nothing, where there is none.
fn least(values: impl Iterator<Item = f64>) -> f64 {
    values.filter(|v| v.is_finite()).fold(f64::NAN, f64::min)
}

const ERROR_COLUMNS: [&str; 11] = [
    "split",
    "level",
    "model",
    "#queries",
    "#mse",
    "#flip",
    "#mse_linear",
    "#mse_log1p",
    "#psnr, dB",
    "#ssim",
    "#noise",
];

/// Rows of the same split and level, groups in order of their first row.
fn groups(table: &[TableRow]) -> Vec<Vec<&TableRow>> {
    let mut groups: Vec<Vec<&TableRow>> = Vec::new();
    for row in table {
        match groups.iter_mut().find(|g| g[0].split == row.split && g[0].level == row.level) {
            Some(group) => group.push(row),
            None => groups.push(vec![row]),
        }
    }
    groups
}

fn errors(table: &[TableRow]) -> String {
    if table.is_empty() {
        return String::new();
    }
    let mut out = String::from("<h2>Held-out errors</h2>\n<p class=\"note\">");
    out += "mse: linear RGB, both clamped to [0, 1]. mse_linear: not clamped. mse_log1p: of ln(1 + x). \
            All three and the noise \u{d7} 10\u{207b}\u{b3}. flip: what is seen when answer and reference \
            alternate, from 0 to 1. Noise is the mse that the reference's own \
            sampling noise amounts to: no model can be seen to go below it. The best of each group \
            is marked.</p>\n";
    out += &table_head(&ERROR_COLUMNS);
    for group in groups(table) {
        out += "<tbody>\n";
        for (i, row) in group.iter().enumerate() {
            out += "<tr>";
            if i == 0 {
                let (span, split, level) = (group.len(), escaped(&row.split), escaped(&row.level));
                out += &format!("<th rowspan=\"{span}\">{split}</th><th rowspan=\"{span}\">{level}</th>");
            }
            out += &error_cells(row, &group);
            out += "</tr>\n";
        }
        out += "</tbody>\n";
    }
    out + "</table></div>\n"
}

fn error_cells(row: &TableRow, group: &[&TableRow]) -> String {
    let rivals = group.len() > 1;
    let mut out = format!("<td>{}</td>{}", escaped(&row.model), number(&count(row.samples)));
    let error = |of: fn(&TableRow) -> f64| {
        let best = rivals && of(row) == least(group.iter().map(|r| of(r)));
        number(&bold_if(best, &significant(of(row) * MILLI)))
    };
    out += &error(|r| r.mse);
    // The headline beside `mse`.
    let flip = row.flip.filter(|v| v.is_finite());
    let best = rivals && flip.is_some() && flip == Some(least(group.iter().filter_map(|r| r.flip)));
    out += &number(&bold_if(best, &optional(flip, |v| format!("{v:.3}"))));
    out += &(error(|r| r.mse_linear) + &error(|r| r.mse_log1p));
    let higher_is_better: [fn(&TableRow) -> Option<f64>; 2] = [|r| r.psnr, |r| r.ssim];
    for (of, digits) in higher_is_better.into_iter().zip([2, 3]) {
        let most = -least(group.iter().filter_map(|r| of(r)).map(|v| -v));
        let text = optional(of(row).filter(|v| v.is_finite()), |v| format!("{v:.digits$}"));
        out += &number(&bold_if(rivals && of(row) == Some(most), &text));
    }
    out + &number(&optional(row.noise, |v| significant(v * MILLI)))
}

fn costs(report: &Report) -> Result<String> {
    if report.costs.is_empty() {
        return Ok(String::new());
    }
    let mark = |row: &CostRow| figures::Mark {
        name: row.model.clone(),
        x: row.ns,
        spread: Some((row.ns_low, row.ns_high)),
        y: row.mse * MILLI,
    };
    let marks: Vec<figures::Mark> = report.costs.iter().map(mark).collect();
    let svg = figures::scatter(&marks, "nanoseconds a query", "held-out mse \u{d7} 10\u{207b}\u{b3}")?;
    let mut out = String::from("<h2>Error against time</h2>\n<p class=\"note\">");
    out += "Time of the whole material, one thread: the median over the runs, bars and brackets from the \
            fastest to the slowest. Lower left is better.</p>\n<div class=\"charts\">\n";
    out += &chart(svg, "Error against nanoseconds a query");
    out += &table_head(&["model", "#ns a query", "#mse", "#weights", "#FLOP a query", "#size"]);
    out += "<tbody class=\"rows\">\n";
    for row in &report.costs {
        let (low, high) = (significant(row.ns_low), significant(row.ns_high));
        out += &format!("<tr><td>{}</td>", escaped(&row.model));
        out += &number(&format!("{} ({low}\u{2013}{high})", significant(row.ns)));
        out += &number(&significant(row.mse * MILLI));
        out += &number(&count(row.weights));
        out += &number(&count(row.flops));
        out += &number(&bytes(row.bytes));
        out += "</tr>\n";
    }
    Ok(out + "</tbody>\n</table></div>\n</div>\n")
}

fn exports(report: &Report) -> String {
    if report.exports.is_empty() {
        return String::new();
    }
    let mut out = String::from("<h2>What was exported</h2>\n");
    out += &table_head(&["model", "file", "#size", "what"]);
    out += "<tbody class=\"rows\">\n";
    for row in &report.exports {
        let (model, file) = (escaped(&row.model), escaped(&row.file));
        out += &format!("<tr><td>{model}</td><td><code>{file}</code></td>{}", number(&bytes(row.bytes)));
        out += &format!("<td class=\"words\">{}</td></tr>\n", escaped(&row.what));
    }
    out + "</tbody>\n</table></div>\n"
}

fn commands(commands: &[String]) -> String {
    if commands.is_empty() {
        return String::new();
    }
    format!("<h2>The same again</h2>\n<pre>{}</pre>\n", escaped(&commands.join("\n")))
}
