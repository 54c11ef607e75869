//! The report as Markdown.

use super::folder::Folder;
use super::price;
use super::probe::{Figure, Group, Verdict};
use super::suite::{Report, Row};

/// Groups in the order of the page, with their headings.
const HEADINGS: [(Group, &str); 7] = [
    (Group::Training, "Training"),
    (Group::Position, "Position"),
    (Group::Level, "Level"),
    (Group::Direction, "Direction"),
    (Group::Motion, "Motion"),
    (Group::Numbers, "Numbers"),
    (Group::Inception, "Inception"),
];

/// Figures that are read in a line; more are folded away.
const MOST_VALUES: usize = 8;

/// A row in a line of text.
pub(super) fn line(row: &Row) -> String {
    format!(
        "{}: naive {}, cured {}, at most {}: {} ({:.0} s)",
        row.probe,
        shown(row.found.naive),
        shown(row.found.cured),
        number(row.bound),
        row.verdict.word(),
        row.found.seconds
    )
}

/// The whole page; pictures that are there are shown.
pub fn markdown(report: &Report, folder: &Folder) -> String {
    let scale = &report.scale;
    let mut out = String::from("# Stability where methods fail\n\n");
    out += &format!(
        "Made by `neumip stability --{}`: {} x {} texels, {} unique samples a texel of {} rays, {} presented, batches of {}, \
         {} indirect bounces. Every probe provokes a known failure and measures one figure on the naive variant, which has to \
         break the bound, and on the cured one, which has to hold it. `safe`: the naive variant holds it too, and the probe \
         says why.\n\n",
        scale.name,
        scale.resolution,
        scale.resolution,
        scale.unique,
        scale.spp,
        scale.budget,
        scale.batch,
        scale.bounces
    );
    let count = |verdict: Verdict| report.probes.iter().filter(|row| row.verdict == verdict).count();
    out += &format!(
        "{} probes: {} cured, {} safe, {} broken, {} idle.\n\n",
        report.probes.len(),
        count(Verdict::Cured),
        count(Verdict::Safe),
        count(Verdict::Broken),
        count(Verdict::Idle)
    );
    out += "| probe | naive | cured | at most | |\n| --- | ---: | ---: | ---: | --- |\n";
    for row in &report.probes {
        out += &format!(
            "| [{0}](#{0}) | {1} | {2} | {3} | {4} |\n",
            row.probe,
            shown(row.found.naive),
            shown(row.found.cured),
            number(row.bound),
            row.verdict.word()
        );
    }
    for (group, heading) in HEADINGS {
        let rows: Vec<&Row> = report.probes.iter().filter(|row| row.group == group).collect();
        if !rows.is_empty() {
            out += &format!("\n## {heading}\n");
        }
        rows.iter().for_each(|row| out += &section(row, folder));
    }
    if !report.prices.is_empty() {
        out += &price::table(&report.prices);
    }
    out
}

fn section(row: &Row, folder: &Folder) -> String {
    let found = &row.found;
    let mut out = format!("\n### {}\n\n{}\n\n", row.probe, row.provokes);
    out += &format!("- Naive: {}: **{}**\n", row.variants[0], shown(found.naive));
    out += &format!("- Cured: {}: **{}**\n", row.variants[1], shown(found.cured));
    out += &format!("- Figure: {}; at most {}: {}\n", row.figure, number(row.bound), row.reason);
    if let Some(why) = &found.safe {
        out += &format!("- Safe: {why}\n");
    }
    found.notes.iter().for_each(|note| out += &format!("- {note}\n"));
    if !found.values.is_empty() {
        let values = found.values.iter().map(|(name, value)| format!("{name} {}", shown(*value)));
        let values = values.collect::<Vec<_>>().join("; ");
        out += &match found.values.len() > MOST_VALUES {
            true => format!("\n<details><summary>Other figures</summary>\n\n{values}\n\n</details>\n"),
            false => format!("- Also: {values}\n"),
        };
    }
    if found.curve && folder.has(&format!("pictures/{}.svg", row.probe)) {
        out += &format!("\n![{0}: curve](pictures/{0}.svg)\n", row.probe);
    }
    if let Some(caption) = &found.picture {
        out += &format!("\n![{0}](pictures/{0}.png)\n\n*{caption}*\n", row.probe);
    }
    out
}

fn shown(figure: Figure) -> String {
    figure.value().map_or("no number".into(), number)
}

/// Three significant digits.
pub(super) fn number(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 {
        return "0".into();
    }
    if !(1e-3..1e5).contains(&size) {
        return format!("{value:.2e}");
    }
    let digits = (2 - size.log10().floor() as i32).max(0) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_digits() {
        let texts = [0.0, 1.0, 1.2345, 0.012345, 1234.5, 1e-5, 2.5e7].map(number);
        assert_eq!(texts, ["0", "1", "1.23", "0.0123", "1234", "1.00e-5", "2.50e7"]);
        assert_eq!(shown(Figure::new(f64::NAN)), "no number");
    }
}
