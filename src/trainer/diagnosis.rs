//! Why a loss is not finite, in one line.

use super::candle_engine::{Chunk, Job};
use crate::config::Remap;
use crate::error::{Error, Result};
use std::path::Path;

/// Says what is not finite at this step and what to do; `folder` keeps the last good state.
pub(super) fn explain(job: &Job, step: u64, folder: &Path) -> String {
    let cause = cause(job).unwrap_or_else(|e| format!("and it cannot be examined: {e}"));
    format!(
        "the loss or its gradient is not finite at step {step}: {cause}; the last good state is kept in {}",
        folder.display()
    )
}

fn cause(job: &Job) -> Result<String> {
    let pieces = job.step.pieces;
    for piece in pieces {
        if piece.target().iter().flatten().any(|v| !v.is_finite()) {
            return Ok(format!("a target of level {} is not finite; regenerate the data", piece.level()));
        }
    }
    let chunks = pieces.chunks(job.per_chunk()).map(|pieces| job.chunk(pieces, job.means()));
    let mut last = Err(Error::config("batch", "is empty"));
    for chunk in chunks {
        last = of_chunk(job, &chunk?);
        if let Ok((_, true)) | Err(_) = last {
            break;
        }
    }
    last.map(|(cause, _)| cause)
}

/// What is not finite in a chunk; false if it is only a slope, which may be another chunk's.
fn of_chunk(job: &Job, chunk: &Chunk) -> Result<(String, bool)> {
    let prediction = job.networks.forward(&chunk.inputs, job.tables)?.detach();
    let values: Vec<f32> = prediction.flatten_all()?.to_vec1()?;
    if values.iter().any(|v| !v.is_finite()) {
        let cause = "predictions are not finite although the weights are; lower the learning rate";
        return Ok((cause.into(), true));
    }
    let lowest = values.iter().copied().fold(f32::INFINITY, f32::min);
    let highest = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let range = format!("predictions lie in {lowest:.3} to {highest:.3}");
    for term in job.step.terms {
        let value: f32 = chunk.target.loss(&prediction, std::slice::from_ref(term))?.to_scalar()?;
        if !value.is_finite() {
            let remedy = match term.remap {
                Remap::Root4Literal => {
                    "the literal 4th root is no number below 0; use root4-guarded or root4-signed"
                }
                _ => "lower the learning rate",
            };
            let cause = format!("term {:?} of {:?} gives {value}, {range}; {remedy}", term.kind, term.remap);
            return Ok((cause, true));
        }
    }
    let remedy = if job.step.terms.iter().any(|t| t.remap == Remap::Root4Literal) {
        "the literal 4th root has infinite slope at 0; use root4-guarded or root4-signed"
    } else {
        "lower the learning rate"
    };
    Ok((format!("every term is finite but a slope is not, {range}; {remedy}"), false))
}
