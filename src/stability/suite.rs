//! Running probes: each that is not finished yet, then the report over all that are.

use super::folder::Folder;
use super::page;
use super::price::{self, Price};
use super::probe::{Figure, Group, Outcome, Probe, Verdict};
use super::workshop::{Scale, Workshop};
use crate::error::Result;
use neumip_export::whole_file::{write_json, write_whole};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Instant;

/// File of the figures.
const JSON: &str = "stability.json";
/// File of the page.
const MARKDOWN: &str = "STABILITY.md";

/// What a finished probe keeps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Finished {
    /// The naive variant's figure.
    pub naive: Figure,
    /// The cured variant's figure.
    pub cured: Figure,
    /// Why the naive variant holds the bound.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub safe: Option<String>,
    /// What else was seen.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// Other figures by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub values: BTreeMap<String, Figure>,
    /// What the picture shows, where there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub picture: Option<String>,
    /// True where there is a curve.
    pub curve: bool,
    /// Seconds that it took.
    pub seconds: f64,
}

impl Finished {
    /// What of an outcome is kept as text.
    pub fn new(outcome: &Outcome, seconds: f64) -> Self {
        Self {
            naive: outcome.naive.into(),
            cured: outcome.cured.into(),
            safe: outcome.safe.clone(),
            notes: outcome.notes.clone(),
            values: outcome.values.iter().map(|(name, value)| (name.clone(), (*value).into())).collect(),
            picture: outcome.picture.as_ref().map(|(caption, _)| caption.clone()),
            curve: outcome.plot.is_some(),
            seconds,
        }
    }
}

/// A line of the report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// The probe's name.
    pub probe: &'static str,
    /// Where it belongs.
    pub group: Group,
    /// What it provokes.
    pub provokes: &'static str,
    /// The two variants and the figure, in words.
    pub variants: [&'static str; 2],
    /// What is measured.
    pub figure: &'static str,
    /// The largest figure that is right.
    pub bound: f64,
    /// Why this one.
    pub reason: &'static str,
    /// What they mean together.
    pub verdict: Verdict,
    /// What was found.
    #[serde(flatten)]
    pub found: Finished,
}

/// The whole report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// How much was done.
    pub scale: Scale,
    /// A row a finished probe.
    pub probes: Vec<Row>,
    /// What the cures cost, once that is measured.
    pub prices: Vec<Price>,
}

impl Report {
    /// Names of the probes that are not right.
    pub fn wrong(&self) -> Vec<&'static str> {
        self.probes.iter().filter(|row| !row.verdict.is_right()).map(|row| row.probe).collect()
    }
}

/// Runs the probes that are not finished, and writes the report over all probes that are, these and `others`.
///
/// # Errors
/// `Interrupted`, or what a probe cannot do without; broken bounds are in the report.
pub fn run(workshop: &mut Workshop, asked: &[Probe], all: &[Probe]) -> Result<Report> {
    let folder = workshop.folder().clone();
    for (k, probe) in asked.iter().enumerate() {
        if folder.finished(probe)?.is_some() {
            continue;
        }
        workshop.check()?;
        let clock = Instant::now();
        let outcome = (probe.run)(workshop)?;
        let finished = Finished::new(&outcome, clock.elapsed().as_secs_f64());
        folder.save(probe, &outcome, &finished)?;
        let row = row(probe, finished, workshop.scale());
        workshop.say(&format!("[{}/{}] {}", k + 1, asked.len(), page::line(&row)));
        write(&folder, workshop.scale(), all)?;
    }
    if asked.len() == all.len() {
        price::prices(workshop)?;
    }
    let mut report = write(&folder, workshop.scale(), all)?;
    report.probes.retain(|row| asked.iter().any(|probe| probe.name == row.probe));
    Ok(report)
}

fn row(probe: &Probe, found: Finished, scale: &Scale) -> Row {
    let bound = probe.bound.at(scale);
    let verdict = Verdict::of(found.naive, found.cured, bound, found.safe.is_some());
    Row {
        probe: probe.name,
        group: probe.group,
        provokes: probe.provokes,
        variants: [probe.naive, probe.cured],
        figure: probe.figure,
        bound,
        reason: probe.bound.reason,
        verdict,
        found,
    }
}

/// Writes the report over everything that is finished.
fn write(folder: &Folder, scale: &Scale, all: &[Probe]) -> Result<Report> {
    let mut probes = Vec::new();
    for probe in all {
        probes.extend(folder.finished(probe)?.map(|found| row(probe, found, scale)));
    }
    let prices = folder.optional(price::JSON)?.unwrap_or_default();
    let report = Report { scale: scale.clone(), probes, prices };
    write_json(&folder.root().join(JSON), &report)?;
    write_whole(&folder.root().join(MARKDOWN), page::markdown(&report, folder).as_bytes())?;
    Ok(report)
}

#[cfg(test)]
mod tests {
    use super::super::probe::Bound;
    use super::super::workshop::Watch;
    use super::*;
    use std::ops::ControlFlow;

    struct Silent;

    impl Watch for Silent {
        fn say(&self, _: &str) {}

        fn flow(&self) -> ControlFlow<()> {
            ControlFlow::Continue(())
        }
    }

    fn probe(name: &'static str, run: fn(&mut Workshop) -> Result<Outcome>) -> Probe {
        Probe {
            name,
            group: Group::Numbers,
            provokes: "nothing",
            naive: "a",
            cured: "b",
            figure: "c",
            bound: Bound::new(1.0, "d"),
            run,
        }
    }

    fn suite(root: &std::path::Path, probes: &[Probe]) -> Report {
        let folder = Folder::open(root, &Scale::quick()).unwrap();
        // Prices train; they are there.
        write_json(&root.join(price::JSON), &Vec::<Price>::new()).unwrap();
        run(&mut Workshop::new(Scale::quick(), folder, &Silent), probes, probes).unwrap()
    }

    #[test]
    fn what_is_finished_is_kept_and_what_is_broken_is_named() {
        let there = tempfile::tempdir().unwrap();
        let root = there.path().join("suite");
        let good = probe("good", |_| Ok(Outcome::new(f64::NAN, 0.5)));
        let report = suite(&root, &[good]);
        assert!(report.wrong().is_empty());
        // Run again it would break its bound; it is not.
        let again = probe("good", |_| Ok(Outcome::new(2.0, 3.0)));
        let broken = probe("broken", |_| Ok(Outcome::new(2.0, 1.5)));
        let idle = probe("idle", |_| Ok(Outcome::new(0.0, 0.0)));
        let report = suite(&root, &[again, broken, idle]);
        assert_eq!(report.wrong(), ["broken", "idle"]);
        let page = std::fs::read_to_string(root.join(MARKDOWN)).unwrap();
        assert!(page.contains("| [good](#good) | no number | 0.5 | 1 | cured |"), "{page}");
        assert!(page.contains("BROKEN"));
        let other = Scale { budget: 7, ..Scale::quick() };
        assert!(Folder::open(&root, &other).unwrap_err().to_string().contains("another --out"));
        assert!(Folder::open(there.path(), &other).is_err());
    }
}
