//! All findings together: the verdict in plain words, the page, the folder.

use super::finding::{Finding, Place, Verdict};
use super::subject::{Extent, Subject};
use crate::error::{Error, Result};
use crate::stability::page::number;
use crate::stability::workshop::made;
use neumip_export::whole_file::{write_json, write_whole};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// File of the findings, in a folder of their own or in a run's.
pub const JSON: &str = "stability.json";
const PAGE: &str = "STABILITY.md";
const PICTURES: &str = "pictures";
/// What `stability.json` says that it is.
const KIND: &str = "examination";

/// A check that was not made.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LeftOut {
    /// Its name.
    pub name: &'static str,
    /// Why.
    pub why: &'static str,
}

/// What was found on a material.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Examination {
    /// Always `examination`.
    pub kind: &'static str,
    /// The material's name.
    pub material: String,
    /// `quick` or `whole`.
    pub extent: &'static str,
    /// The findings.
    pub findings: Vec<Finding>,
    /// What was not looked at.
    pub left_out: Vec<LeftOut>,
}

impl Examination {
    pub(super) fn new(subject: &Subject) -> Self {
        let name = subject.checkpoint.map(|checkpoint| checkpoint.header.material.clone());
        Self {
            kind: KIND,
            material: name.unwrap_or_else(|| "material".into()),
            extent: if subject.extent == Extent::Quick { "quick" } else { "whole" },
            findings: Vec::new(),
            left_out: Vec::new(),
        }
    }

    /// The worst verdict of all.
    pub fn verdict(&self) -> Verdict {
        self.findings.iter().map(|finding| finding.verdict).max().unwrap_or(Verdict::Fine)
    }

    /// What is not fine, what is wrong first.
    pub fn troubles(&self) -> Vec<&Finding> {
        let of = |verdict| self.findings.iter().filter(move |finding| finding.verdict == verdict);
        of(Verdict::Wrong).chain(of(Verdict::Watch)).collect()
    }

    /// Can it ship, and what to change first.
    pub fn conclusion(&self) -> String {
        let troubles = self.troubles();
        let count = |verdict| troubles.iter().filter(|finding| finding.verdict == verdict).count();
        let (wrong, watch) = (count(Verdict::Wrong), count(Verdict::Watch));
        let first = troubles.first().and_then(|finding| Some((finding, finding.change.as_ref()?)));
        let first =
            first.map(|(finding, change)| format!(" {}: {}. First: {change}.", finding.name, finding.says));
        let head = match (wrong, watch) {
            (0, 0) => "It can ship: nothing was found.".to_string(),
            (0, n) => format!("It can ship; look at {n} first."),
            (n, _) => format!("It should not ship: {n} of {} findings are wrong.", self.findings.len()),
        };
        head + &first.unwrap_or_default()
    }

    /// A line a finding, what is left out, and the conclusion.
    pub fn table(&self) -> String {
        let wide = self.findings.iter().map(|finding| finding.name.len()).max().unwrap_or(0);
        let mut lines: Vec<String> = Vec::new();
        for finding in &self.findings {
            let verdict = finding.verdict.word();
            lines.push(format!(
                "{:wide$}  {verdict:5}  {:>9}  {}",
                finding.name,
                figure(finding),
                finding.says
            ));
        }
        for out in &self.left_out {
            lines.push(format!("{:wide$}  -      {:>9}  left out: {}", out.name, "", out.why));
        }
        lines.push(self.conclusion());
        lines.join("\n")
    }

    /// The page.
    pub fn markdown(&self) -> String {
        let mut out = format!(
            "# Stability of {}\n\n{}\n\nMade by `neumip stability RUN`, {} form. `fine`: nothing to do; `watch`: it may show; `wrong`: it \
             will.\n\n| finding | | figure | fine to | wrong from |\n| --- | --- | ---: | ---: | ---: |\n",
            self.material,
            self.conclusion(),
            self.extent
        );
        for f in &self.findings {
            let wrong = f.bounds.wrong.map_or("-".into(), number);
            let fine = number(f.bounds.watch);
            out += &format!(
                "| [{0}](#{0}) | {1} | {2} | {fine} | {wrong} |\n",
                f.name,
                f.verdict.word(),
                figure(f)
            );
        }
        self.findings.iter().for_each(|finding| out += &section(finding));
        if !self.left_out.is_empty() {
            out += "\n## Left out\n\n";
            self.left_out.iter().for_each(|left| out += &format!("- {}: {}\n", left.name, left.why));
        }
        out
    }

    /// Writes `stability.json`, `STABILITY.md` and the pictures into a folder of their own.
    ///
    /// # Errors
    /// `File` if the folder holds something else, holds an examination and `force` is not set, or cannot be written.
    pub fn write(&self, folder: &Path, force: bool) -> Result<()> {
        free(folder, force)?;
        let pictures = folder.join(PICTURES);
        made(Some(&pictures))?;
        // The record goes first: what holds one can be replaced, also when the rest was not finished.
        write_json(&folder.join(JSON), self)?;
        for name in names(&pictures)? {
            remove(&pictures.join(name))?;
        }
        for finding in &self.findings {
            if let Some(png) = &finding.picture {
                write_whole(&pictures.join(format!("{}.png", finding.name)), png)?;
            }
        }
        Ok(write_whole(&folder.join(PAGE), self.markdown().as_bytes())?)
    }
}

/// Whether an examination may be written to a folder.
///
/// # Errors
/// `File` if it holds something else, or holds an examination and `force` is not set.
pub fn free(folder: &Path, force: bool) -> Result<()> {
    if !folder.exists() {
        return Ok(());
    }
    if !folder.is_dir() {
        return Err(Error::file(folder, "is a file; choose another --out"));
    }
    let there = names(folder)?;
    if there.is_empty() {
        return Ok(());
    }
    let ours = |name: &String| [JSON, PAGE, PICTURES].contains(&name.as_str());
    #[derive(Deserialize)]
    struct Record {
        kind: String,
    }
    let record = std::fs::read(folder.join(JSON)).ok();
    let record: Option<Record> = record.and_then(|bytes| serde_json::from_slice(&bytes).ok());
    if record.is_none_or(|record| record.kind != KIND) || !there.iter().all(ours) {
        return Err(Error::file(folder, "exists and is no examination's folder; choose another --out"));
    }
    let pictures = folder.join(PICTURES);
    let foreign = if pictures.is_dir() { names(&pictures)? } else { Vec::new() };
    if let Some(name) = foreign.iter().find(|name| !name.ends_with(".png")) {
        return Err(Error::file(
            pictures,
            format!("holds {name}, which is none of ours; choose another --out"),
        ));
    }
    if !force {
        return Err(Error::file(
            folder,
            "holds an examination; choose another --out, or replace it with --force",
        ));
    }
    Ok(())
}

fn names(folder: &Path) -> Result<Vec<String>> {
    let entries =
        std::fs::read_dir(folder).map_err(|e| Error::file(folder, format!("cannot be read: {e}")))?;
    Ok(entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect())
}

fn remove(path: &Path) -> Result<()> {
    std::fs::remove_file(path).map_err(|e| Error::file(path, format!("cannot be removed: {e}")))
}

fn figure(finding: &Finding) -> String {
    finding.figure.map_or("no number".into(), number)
}

fn section(finding: &Finding) -> String {
    let mut out = format!("\n## {}\n\n**{}**: {}.\n\n", finding.name, finding.verdict.word(), finding.says);
    if let Some(change) = &finding.change {
        out += &format!("- To change: {change}.\n");
    }
    let wrong =
        finding.bounds.wrong.map_or(String::new(), |wrong| format!(", wrong above {}", number(wrong)));
    out += &format!(
        "- Figure: {}: **{}**; fine to {}{wrong}: {}.\n",
        finding.measures,
        figure(finding),
        number(finding.bounds.watch),
        finding.bounds.reason
    );
    if !finding.values.is_empty() {
        let values = finding.values.iter().map(|(name, value)| format!("{name} {}", number(*value)));
        out += &format!("- Also: {}.\n", values.collect::<Vec<_>>().join("; "));
    }
    if !finding.places.is_empty() {
        let places: Vec<String> = finding.places.iter().map(place).collect();
        out += &format!("- Worst places: {}.\n", places.join("; "));
    }
    if let Some(caption) = &finding.caption {
        out += &format!("\n![{0}]({PICTURES}/{0}.png)\n\n*{caption}*\n", finding.name);
    }
    out
}

fn place(place: &Place) -> String {
    let pair = |v: [f32; 2]| format!("({:.3}, {:.3})", v[0], v[1]);
    let value = place.value.map_or("no number".into(), number);
    format!(
        "u {} wi {} wo {} level {:.2}: {value}",
        pair(place.u),
        pair(place.wi),
        pair(place.wo),
        place.level
    )
}
