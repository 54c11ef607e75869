//! Why a loss is not finite, in one line.

use super::candle_engine::Job;
use crate::config::Remap;
use crate::error::Result;
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
    let chunk = job.chunk(pieces, job.means())?;
    let prediction = job.networks.forward(&chunk.inputs, job.tables)?.detach();
    let values: Vec<f32> = prediction.flatten_all()?.to_vec1()?;
    if values.iter().any(|v| !v.is_finite()) {
        return Ok("predictions are not finite although the weights are; lower the learning rate".into());
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
            return Ok(format!("term {:?} of {:?} gives {value}, {range}; {remedy}", term.kind, term.remap));
        }
    }
    let remedy = if job.step.terms.iter().any(|t| t.remap == Remap::Root4Literal) {
        "the literal 4th root has infinite slope at 0; use root4-guarded or root4-signed"
    } else {
        "lower the learning rate"
    };
    Ok(format!("every term is finite but a slope is not, {range}; {remedy}"))
}
