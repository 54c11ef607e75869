//! A budget of bytes divided among the materials of a scene by what each contributes to the error of its pictures.
//!
//! The error of a picture is a mean over its pixels, and materials mostly have pixels of their own: what each adds is measured
//! with all others as their full models are, and sums are compared.

use super::candidates::Candidate;
use super::goal::Goal;
use super::job::{Fitted, Job, Prepared, Watch};
use super::search::{Found, SHARES, Tried, trial_of};
use crate::error::{Error, Result};
use crate::render::Scene;

/// The rung of the trials by which the budget is divided.
const RUNG: usize = 1;

/// What a size of one material costs, and what error it leaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offer {
    /// Bytes in half precision.
    pub bytes: usize,
    /// Error of the scene's pictures by this material alone.
    pub error: f64,
}

/// For each material the place of the offer that it takes: those whose errors add up to the least, of those whose bytes add up
/// to no more than `total`.
///
/// # Errors
/// `Usage` for a total that the smallest offers pass, saying what they need.
pub fn divide(offers: &[Vec<Offer>], total: usize) -> Result<Vec<usize>> {
    // All sums that nothing smaller beats, with the choices that make them.
    let mut sums: Vec<(usize, f64, Vec<usize>)> = vec![(0, 0.0, Vec::new())];
    for of_material in offers {
        let mut longer: Vec<(usize, f64, Vec<usize>)> = Vec::new();
        for (bytes, error, choices) in &sums {
            for (place, offer) in of_material.iter().enumerate() {
                let mut choices = choices.clone();
                choices.push(place);
                longer.push((bytes + offer.bytes, error + offer.error, choices));
            }
        }
        longer.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        let mut least = f64::INFINITY;
        longer.retain(|(_, error, _)| {
            let better = *error < least;
            least = least.min(*error);
            better
        });
        sums = longer;
    }
    let smallest = sums.first().map_or(0, |sum| sum.0);
    match sums.into_iter().rfind(|sum| sum.0 <= total) {
        Some((_, _, choices)) => Ok(choices),
        None => Err(Error::usage(format!(
            "--total-bytes {total}: the smallest models of the scene's materials have {smallest} bytes together"
        ))),
    }
}

/// A material on its way: its candidates and what their trials gave.
struct Trying {
    prepared: Prepared,
    tried: Vec<(Candidate, Tried)>,
    trials: Vec<super::search::Trial>,
}

/// Fits every job's material so that all of them have at most `total` bytes in half precision. Each job has the folder and the
/// seed of its own material, and their goals' metrics are one.
///
/// # Errors
/// As [`Job::run`], and as [`divide`].
pub fn fit_all(jobs: &[Job], scene: &mut Scene, total: usize, watch: &Watch) -> Result<Vec<Fitted>> {
    let mut all = Vec::new();
    for job in jobs {
        let prepared = job.prepare(scene, watch)?;
        let (mut tried, mut trials) = (Vec::new(), Vec::new());
        for candidate in job.candidates(&prepared, &Goal { bytes: Some(total), ..job.goal })? {
            let mut start = None;
            for (rung, share) in SHARES.iter().enumerate().take(RUNG + 1) {
                let presented = job.presented(*share);
                let attempt = job.attempt(&prepared, &candidate, (rung, presented), tensors(&start), watch);
                match attempt {
                    Ok(tried) => {
                        trials.push(trial_of(&candidate, rung, presented, &tried));
                        start = Some(tried);
                    }
                    Err(Error::Diverged(_)) => {
                        start = None;
                        break;
                    }
                    Err(other) => return Err(other),
                }
            }
            tried.extend(start.map(|start| (candidate, start)));
        }
        all.push(Trying { prepared, tried, trials });
    }
    let metric = jobs.first().map(|job| job.goal.metric());
    let offers = all
        .iter()
        .map(|trying| {
            let each = trying.tried.iter().map(|(candidate, tried)| {
                let error = metric.map_or(Ok(0.0), |metric| metric.of(&tried.errors))?;
                Ok(Offer { bytes: candidate.bytes, error })
            });
            each.collect::<Result<Vec<_>>>()
        })
        .collect::<Result<Vec<_>>>()?;
    let chosen = divide(&offers, total)?;
    let last = SHARES.len() - 1;
    let mut out = Vec::new();
    for ((job, trying), place) in jobs.iter().zip(all).zip(chosen) {
        let Trying { prepared, mut tried, mut trials } = trying;
        let (candidate, start) = tried.swap_remove(place);
        let presented = job.presented(SHARES[last]);
        let done = job.attempt(&prepared, &candidate, (last, presented), Some(&start.tensors), watch)?;
        trials.push(trial_of(&candidate, last, presented, &done));
        let found = Found { candidate, tensors: done.tensors, errors: done.errors, trials, holds: true };
        out.push(job.finish(scene, prepared, found, watch)?);
    }
    Ok(out)
}

fn tensors(tried: &Option<Tried>) -> Option<&super::search::Tensors> {
    tried.as_ref().map(|tried| &tried.tensors)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offers(all: &[(usize, f64)]) -> Vec<Offer> {
        all.iter().map(|&(bytes, error)| Offer { bytes, error }).collect()
    }

    #[test]
    fn bytes_go_where_they_take_most_error_away() {
        let seen = offers(&[(100, 0.5), (400, 0.1)]);
        let hidden = offers(&[(100, 0.02), (400, 0.01)]);
        assert_eq!(divide(&[seen.clone(), hidden.clone()], 500).unwrap(), [1, 0]);
        assert_eq!(divide(&[hidden.clone(), seen.clone()], 500).unwrap(), [0, 1]);
        assert_eq!(divide(&[seen.clone(), hidden.clone()], 800).unwrap(), [1, 1]);
        assert_eq!(divide(&[seen, hidden], 499).unwrap(), [0, 0]);
    }

    #[test]
    fn the_division_is_the_best_of_all() {
        let all = [
            offers(&[(10, 0.9), (25, 0.5), (60, 0.2)]),
            offers(&[(15, 0.7), (30, 0.45), (45, 0.4)]),
            offers(&[(5, 0.3), (50, 0.05)]),
        ];
        for total in [30, 55, 70, 85, 120, 155] {
            let chosen = divide(&all, total).unwrap();
            let sum = |places: &[usize]| {
                let picked = || all.iter().zip(places).map(|(offers, place)| offers[*place]);
                (picked().map(|o| o.bytes).sum::<usize>(), picked().map(|o| o.error).sum::<f64>())
            };
            let (bytes, error) = sum(&chosen);
            assert!(bytes <= total);
            for a in 0..3 {
                for b in 0..3 {
                    for c in 0..2 {
                        let (other, worse) = sum(&[a, b, c]);
                        assert!(other > total || worse >= error - 1e-12, "{total}: {chosen:?} {a}{b}{c}");
                    }
                }
            }
        }
        assert!(divide(&all, 29).unwrap_err().to_string().contains("30 bytes together"));
    }
}
