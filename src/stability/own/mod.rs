//! A user's own material put to the probes that need no training.
//!
//! ```text
//! subject ── pairs, positions, levels ──▶ checks: numbers, position, levels, directions, light, storage
//!    │                                            truth, where there is data
//!    │                                      │  figure, worst places, picture
//! examination ── bounds judge each ─────────┘──▶ stability.json, STABILITY.md, a sentence or two
//! ```

mod advice;
mod directions;
mod examination;
mod finding;
mod levels;
mod light;
mod numbers;
mod pictures;
mod position;
mod storage;
mod subject;
#[cfg(test)]
mod tests;
mod truth;

pub use examination::{Examination, JSON, LeftOut, free};
pub use finding::{Bounds, Finding, Place, Seen, Verdict};
pub use subject::{Extent, Splits, Subject};

use super::workshop::Watch;
use crate::error::{Error, Result};
use std::ops::ControlFlow;

/// What a check cannot do without.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Needs {
    Anything,
    /// Answers to single queries.
    Pointwise,
    /// What it was made from, and answers to single queries.
    Checkpoint,
    /// Held-out data.
    Data,
    /// Held-out data that no choice may see.
    AllData,
}

/// One measurement.
struct Check {
    name: &'static str,
    measures: &'static str,
    bounds: Bounds,
    needs: Needs,
    run: fn(&Subject) -> Result<Seen>,
}

fn checks() -> Vec<Check> {
    let groups = [
        numbers::checks(),
        position::checks(),
        levels::checks(),
        directions::checks(),
        light::checks(),
        storage::checks(),
        truth::checks(),
    ];
    groups.into_iter().flatten().collect()
}

/// Refuses names that no check has.
///
/// # Errors
/// `Usage`, listing the names that there are.
pub fn known(names: &[String]) -> Result<()> {
    let all = checks();
    match names.iter().find(|name| !all.iter().any(|check| check.name == **name)) {
        None => Ok(()),
        Some(name) => {
            let all: Vec<&str> = all.iter().map(|check| check.name).collect();
            Err(Error::usage(format!(
                "--probe {name}: no such probe of a material; there are {}",
                all.join(", ")
            )))
        }
    }
}

/// Examines a material by the checks of these names, by all where none is named.
///
/// # Errors
/// `Usage` for an unknown name, `Interrupted`; what a check meets becomes its finding.
pub fn check(subject: &Subject, names: &[String], watch: &dyn Watch) -> Result<Examination> {
    known(names)?;
    let mut examination = Examination::new(subject);
    for check in checks() {
        if !names.is_empty() && !names.iter().any(|name| name == check.name) {
            continue;
        }
        if let Some(why) = missing(subject, check.needs) {
            examination.left_out.push(LeftOut { name: check.name, why });
            continue;
        }
        if watch.flow() == ControlFlow::Break(()) {
            return Err(Error::Interrupted("nothing was written".into()));
        }
        let seen = (check.run)(subject);
        if let Ok(Seen { left_out: Some(why), .. }) = seen {
            examination.left_out.push(LeftOut { name: check.name, why });
            continue;
        }
        examination.findings.push(Finding::new(check.name, check.measures, check.bounds, seen)?);
    }
    Ok(examination)
}

/// Why a check has to be left out, if it has to.
fn missing(subject: &Subject, needs: Needs) -> Option<&'static str> {
    const NEIGHBOURS: &str = "this decoder reads neighbours and answers whole images only";
    const HELD_OUT: &str = "it reports on held-out data, which no choice may see";
    let pointwise = subject.is_pointwise();
    match (needs, subject.data) {
        (Needs::Pointwise | Needs::Checkpoint, _) if !pointwise => Some(NEIGHBOURS),
        (Needs::Checkpoint, _) if subject.checkpoint.is_none() => Some("needs the checkpoint"),
        (Needs::Data | Needs::AllData, None) => Some("needs --data"),
        (Needs::AllData, Some((_, Splits::Validation))) => Some(HELD_OUT),
        (Needs::AllData, _) if !pointwise => Some(NEIGHBOURS),
        _ => None,
    }
}
