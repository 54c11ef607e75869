//! Losses over a run: stages of weighted terms on remapped images.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Losses over the run: a named schedule or a list of stages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum StagePlan {
    /// `s1`, `s2` or `s3` of the authors' code.
    Named(String),
    /// In order.
    List(Vec<Stage>),
}

/// One stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// Share of the run after which the next stage begins; the last stage lasts to the end.
    pub share: f64,
    /// Ends the stage earlier, when validation stops improving.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plateau: Option<Plateau>,
    /// Terms that are added up.
    pub terms: Vec<Term>,
}

/// The adaptive criterion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plateau {
    /// Validations without improvement that end the stage.
    pub patience: usize,
    /// Relative improvement that counts.
    pub improvement: f64,
}

/// One weighted term of the loss.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Term {
    /// What is compared.
    pub kind: TermKind,
    /// Applied to prediction and target first.
    pub remap: Remap,
    /// Factor.
    pub weight: f64,
}

/// What a term compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TermKind {
    /// Mean absolute difference.
    L1,
    /// Mean squared difference; with remap `log` NeuMIP's MSE of log1p.
    L2,
    /// Squared linear difference times the remap's slope at the prediction, the slope held constant: weighted as `l2` is to
    /// first order, but least at the mean of noisy targets, where `l2` of remapped values is least at a biased one and `l1`
    /// at their median (Lehtinen et al. 2018, Noise2Noise, section 3.3: slope 1 / (x + 0.01)).
    L2Mean,
    /// Squared difference of Sobel-x and Sobel-y responses, RGB (paper, equation 1).
    Gradient,
    /// Absolute difference of half-strength Sobel responses of luma (authors' code).
    GradientLuma,
}

/// Output remapping (paper, section 3.2).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Remap {
    /// x.
    Linear,
    /// x^(1/4) as printed: not a number below 0, infinite slope at 0.
    Root4Literal,
    /// max(x, 1e-7)^(1/4) (authors' code).
    Root4Guarded,
    /// sign(x) ((|x| + epsilon)^(1/4) - epsilon^(1/4)).
    Root4Signed(f64),
    /// sign(x) ((|x| + epsilon)^(1/2) - epsilon^(1/2)).
    Sqrt(f64),
    /// ln(1 + max(x, -0.1)).
    Log,
}

/// epsilon of the square root in the named schedules: the slope at 0 stays under 16.
const NAMED_SQRT_EPSILON: f64 = 1e-3;

impl StagePlan {
    /// The list of stages.
    ///
    /// # Errors
    /// `Config` if the name is unknown.
    pub fn resolve(&self) -> Result<Vec<Stage>> {
        let name = match self {
            Self::List(list) => return Ok(list.clone()),
            Self::Named(name) => name.as_str(),
        };
        use Remap::{Linear, Root4Guarded, Sqrt};
        let l1 = |remap| Term { kind: TermKind::L1, remap, weight: 1.0 };
        let gradient = |remap| Term { kind: TermKind::GradientLuma, remap, weight: 1.0 };
        let stage = |share, terms| Stage { share, plateau: None, terms };
        let both = |remap| vec![l1(remap), gradient(remap)];
        let root = Sqrt(NAMED_SQRT_EPSILON);
        match name {
            "s1" => Ok(vec![
                stage(0.25, vec![l1(Root4Guarded)]),
                stage(0.5, both(Linear)),
                stage(0.25, both(root)),
            ]),
            "s2" => Ok(vec![stage(0.5, vec![l1(Root4Guarded)]), stage(0.5, both(Linear))]),
            "s3" => Ok(vec![stage(0.25, vec![l1(Root4Guarded)]), stage(0.75, both(Root4Guarded))]),
            _ => Err(Error::config(
                "train.stages",
                format!("{name:?} is no schedule: use s1, s2, s3 or a list"),
            )),
        }
    }
}

impl Stage {
    /// Checks every bound; `name` is the stage's field.
    pub(super) fn validate(&self, name: &str) -> Result<()> {
        let fail = |field: String, problem: String| Err(Error::config(format!("{name}.{field}"), problem));
        if !(self.share > 0.0 && self.share <= 1.0) {
            return fail("share".into(), format!("{} is not in (0, 1]", self.share));
        }
        if self.terms.is_empty() {
            return fail("terms".into(), "at least one term is needed".into());
        }
        let positive = |value: f64| value.is_finite() && value > 0.0;
        for (j, term) in self.terms.iter().enumerate() {
            if !positive(term.weight) {
                return fail(format!("terms[{j}].weight"), format!("{} is not positive", term.weight));
            }
            if let Remap::Root4Signed(e) | Remap::Sqrt(e) = term.remap
                && !positive(e)
            {
                return fail(format!("terms[{j}].remap"), format!("epsilon {e} is not positive"));
            }
            if let (TermKind::L2Mean, Remap::Root4Literal | Remap::Root4Guarded) = (term.kind, term.remap) {
                let problem = "l2-mean weighs by the remap's slope, which is 0 below 0 or without bound at it here; use \
                               root4-signed, sqrt, log or linear";
                return fail(format!("terms[{j}].remap"), problem.into());
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn l2_mean_is_written_so_and_refused_where_the_slope_means_nothing() {
        let stage = |remap: &str| -> Stage {
            let term = format!("{{\"kind\":\"l2-mean\",\"remap\":{remap},\"weight\":1.0}}");
            serde_json::from_str(&format!("{{\"share\":1.0,\"terms\":[{term}]}}")).unwrap()
        };
        for good in ["\"linear\"", "\"log\"", "{\"sqrt\":0.01}", "{\"root4-signed\":0.001}"] {
            stage(good).validate("stage").unwrap();
        }
        for bad in ["\"root4-literal\"", "\"root4-guarded\""] {
            let mut stage = stage(bad);
            let problem = stage.validate("stage").unwrap_err().to_string();
            assert!(problem.contains("stage.terms[0].remap") && problem.contains("l2-mean"), "{problem}");
            stage.terms[0].kind = TermKind::L2;
            stage.validate("stage").unwrap();
        }
    }
}
