//! The results as a folder hands them out: `RESULTS.md` and one self-contained page with pictures.

use super::folder::Folder;
use super::study::Study;
use super::tables::{Table, markdown, tables};
use crate::error::Result;
use crate::report::{STYLE, escaped, picture};
use crate::results::Results;

/// What is said above the tables.
pub struct Heading {
    /// The command that does it again.
    pub command: String,
    /// Trainings that gave no numbers, and why.
    pub failures: Vec<String>,
    /// How many of the command's trainings are not there yet, and how many there are to be.
    pub missing: [usize; 2],
}

impl Heading {
    /// What is not there, a line each.
    fn gaps(&self) -> Vec<String> {
        let [missing, all] = self.missing;
        let missing =
            (missing > 0).then(|| format!("{missing} of the command's {all} trainings are not run yet."));
        missing.into_iter().chain(self.failures.iter().map(|f| format!("No result: {f}"))).collect()
    }
}

/// What every cell shares, as name and value.
fn facts(study: &Study, results: &Results) -> Vec<(String, String)> {
    let seeds: std::collections::BTreeSet<u64> =
        results.cells.iter().map(|c| c.seed).filter(|s| *s > 0).collect();
    let side = study.resolution;
    vec![
        ("Tile".into(), format!("{side} x {side} texels")),
        ("Budget".into(), format!("{} samples presented a texel", study.budget)),
        (
            "Training data".into(),
            format!("about {} unique samples a texel, {} rays each", study.unique, study.spp),
        ),
        (
            "Held-out data".into(),
            format!(
                "{} rays a sample, {} pairs of directions at level 0, views of {} pixels a side",
                study.held_out_spp, study.test_pairs, study.view_size
            ),
        ),
        ("Bounces".into(), study.bounces.to_string()),
        ("Batch".into(), study.batch.to_string()),
        (
            "Tuning".into(),
            format!(
                "{} trials a preset and regime on {}, {} of the budget each",
                study.trials,
                study.tuned_on.join(", "),
                study.trial_share
            ),
        ),
        ("Seeds".into(), seeds.iter().map(u64::to_string).collect::<Vec<_>>().join(", ")),
        ("Made on".into(), results.machines.join("; ")),
    ]
}

/// `RESULTS.md`.
pub fn results_markdown(study: &Study, results: &Results, heading: &Heading) -> String {
    let mut out = String::from("# Results\n\nGenerated from `results.json` by\n\n```sh\n");
    out += &format!("{}\n```\n\n| | |\n| --- | --- |\n", heading.command);
    for (name, value) in facts(study, results) {
        out += &format!("| {name} | {} |\n", value.replace('|', "\\|"));
    }
    out += "\nErrors are on held-out directions unless a table says otherwise. The paper presents about 120,000 samples a texel: \
            these tables answer its questions at this budget, not at its own.\n\n";
    for gap in heading.gaps() {
        out += &format!("- {gap}\n");
    }
    for table in tables(results, study) {
        out += &format!("\n{}", markdown(&table));
    }
    out
}

/// The page; pictures are taken from the folder where it has them.
///
/// # Errors
/// `File` if a picture cannot be read.
pub fn results_html(folder: &Folder, study: &Study, results: &Results, heading: &Heading) -> Result<String> {
    let mut page = String::from("<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n");
    page += "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n";
    page += &format!("<title>neumip: results</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n");
    page += "<h1>Results</h1>\n<dl>\n";
    for (name, value) in facts(study, results) {
        page += &format!("<div><dt>{}</dt><dd>{}</dd></div>\n", escaped(&name), escaped(&value));
    }
    page += &format!("</dl>\n<pre>{}</pre>\n", escaped(&heading.command));
    for gap in heading.gaps() {
        page += &format!("<p class=\"note\">{}</p>\n", escaped(&gap));
    }
    page += &pictures(folder, results)?;
    for table in tables(results, study) {
        page += &html_table(&table);
    }
    page += "</body>\n</html>\n";
    Ok(page)
}

/// Name of a picture of a view: of the reference where there is no variant.
pub fn picture_name(material: &str, variant: Option<(&str, &str)>, view: &str) -> String {
    match variant {
        Some((regime, label)) => format!("{material}.{view}.{regime}.{label}"),
        None => format!("{material}.{view}.reference"),
    }
}

/// A row a material and view: the reference, then every variant that was pictured, with its errors.
fn pictures(folder: &Folder, results: &Results) -> Result<String> {
    let mut out = String::new();
    let mut rows: Vec<(&str, &str)> = Vec::new();
    for cell in &results.cells {
        if let Some(view) = cell.split.strip_prefix("views/")
            && !rows.contains(&(&cell.material, view))
        {
            rows.push((&cell.material, view));
        }
    }
    for (material, view) in rows {
        let Some(reference) = figure(folder, &picture_name(material, None, view), "reference", "")? else {
            continue;
        };
        let mut row = reference;
        for cell in results.cells.iter().filter(|c| c.material == material && c.seed <= 1) {
            if cell.split.strip_prefix("views/") != Some(view) {
                continue;
            }
            let regime = cell.regime.split('-').next().unwrap_or_default();
            let name = picture_name(material, Some((regime, &cell.preset)), view);
            let number = |v: Option<f64>, scale: f64, digits: usize| {
                v.map_or("-".into(), |v| format!("{:.digits$}", v * scale))
            };
            let (mse, flip) = (number(cell.metrics.mse, 1e3, 2), number(cell.metrics.flip, 1.0, 3));
            let caption = format!("mse {mse} x 10^3, FLIP {flip}");
            row +=
                &figure(folder, &name, &format!("{} ({regime})", cell.preset), &caption)?.unwrap_or_default();
        }
        out += &format!(
            "<h3>{} from view {}</h3>\n<div class=\"row\">\n{row}</div>\n",
            escaped(material),
            escaped(view)
        );
    }
    Ok(if out.is_empty() { out } else { format!("<h2>Pictures</h2>\n{out}") })
}

fn figure(folder: &Folder, name: &str, title: &str, caption: &str) -> Result<Option<String>> {
    let path = folder.picture(name);
    if !path.is_file() {
        return Ok(None);
    }
    let png = std::fs::read(&path).map_err(|e| crate::Error::file(&path, format!("cannot be read: {e}")))?;
    Ok(Some(format!(
        "<figure><img alt=\"{0}\" src=\"{1}\"><figcaption>{0}<span>{2}</span></figcaption></figure>\n",
        escaped(title),
        picture::data_uri(&png),
        escaped(caption)
    )))
}

fn html_table(table: &Table) -> String {
    let mut out =
        format!("<h2>{}</h2>\n<p class=\"note\">{}</p>\n", escaped(&table.title), escaped(&table.note));
    out += "<div class=\"scroll\"><table>\n<thead><tr>";
    table.head.iter().for_each(|cell| out += &format!("<th>{}</th>", escaped(cell)));
    out += "</tr></thead>\n<tbody class=\"rows\">\n";
    for row in &table.rows {
        out += "<tr>";
        for cell in row {
            let words = cell.len() > 40;
            let class = if words { " class=\"words\"" } else { "" };
            out += &format!("<td{class}>{}</td>", escaped(cell));
        }
        out += "</tr>\n";
    }
    out + "</tbody>\n</table></div>\n"
}
