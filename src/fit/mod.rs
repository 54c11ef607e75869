//! A material that holds no more than a scene needs.
//!
//! ```text
//! need ─ levels, window, directions of a demand      goal ─ target and budgets      truth ─ who knows the answers
//!   │                                                  │
//! samples ─ training data around what is asked       prior ─ expected cost and error of a size (chart.json)
//!   │                                                  │
//! pictures ─ the scene's own, asked once             shape, candidates ─ sizes that are worth a trial
//!   │                                                  │
//! transfer ─ a smaller model of a larger one         trial ─ a short training
//!   └──────────────────── search ──────────────────────┘
//! ```

pub mod candidates;
pub mod folder;
pub mod goal;
pub mod job;
pub mod model;
pub mod need;
pub mod outcome;
pub mod page;
pub mod pictures;
pub mod prior;
pub mod samples;
pub mod search;
pub mod shape;
pub mod table;
pub mod transfer;
pub mod trial;
pub mod truth;
