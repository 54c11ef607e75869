//! A material that holds no more than a scene needs.
//!
//! ```text
//! need ─ levels, window, directions of a demand      goal ─ target and budgets      truth ─ who knows the answers
//!   │                                                  │
//! samples ─ training data around what is asked       prior ─ expected cost and error of a size (chart.json, times.json)
//!   │                                                  │
//! pictures ─ the scene's own, asked once             shape, candidates ─ sizes that are worth a trial
//!   │                                                  │
//! transfer ─ a smaller model of a larger one         trial, model ─ a short training, and what answers after it
//!   └──────────────────── search ──────────────────────┘
//!                           │
//!     job ─ all of it for one material      divide ─ bytes among several
//!                           │
//!     outcome, page, folder ─ figures and pictures      table ─ kinds of scenes beside what was asked
//! ```

pub mod candidates;
pub mod divide;
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
