//! Stability where methods fail: every known failure of these methods as a probe that shows it, cures it and guards the cure.
//!
//! ```text
//! workshop ── datasets and trainings, made once and kept ──▶ probes: training, position, level, direction, motion,
//!                                                                    numbers, Inception
//!                                                               │  naive and cured figure, bound, curve, picture
//! suite ── runs what is not there yet, keeps each outcome ──────┘──▶ stability.json, STABILITY.md
//! ```
//! A probe says what it provokes, and measures one figure twice: on the naive variant, which has to break the bound, or the
//! probe says why the method is safer than believed, and on the cured one, which has to hold it.

mod direction;
mod folder;
mod inception;
mod level;
mod motion;
mod numbers;
pub mod own;
mod page;
mod places;
mod position;
mod price;
mod probe;
mod suite;
mod training;
mod variants;
mod workshop;

pub use folder::Folder;
pub use page::markdown;
pub use price::Price;
pub use probe::{Bound, Figure, Group, Outcome, Plot, Probe, Verdict};
pub use suite::{Finished, Report, Row, run};
pub use workshop::{Scale, Trained, Watch, Workshop};

use crate::error::{Error, Result};

/// All probes, in the order of the report.
pub fn probes() -> Vec<Probe> {
    let groups = [
        training::probes(),
        position::probes(),
        level::probes(),
        direction::probes(),
        motion::probes(),
        numbers::probes(),
        inception::probes(),
    ];
    groups.into_iter().flatten().collect()
}

/// The probes of these names, all where none is named.
///
/// # Errors
/// `Usage` for a name that no probe has.
pub fn named(names: &[String]) -> Result<Vec<Probe>> {
    let all = probes();
    if let Some(name) = names.iter().find(|name| !all.iter().any(|p| p.name == **name)) {
        let known: Vec<&str> = all.iter().map(|p| p.name).collect();
        return Err(Error::usage(format!("--probe {name}: no such probe; there are {}", known.join(", "))));
    }
    Ok(all.into_iter().filter(|p| names.is_empty() || names.iter().any(|name| name == p.name)).collect())
}
