//! Which sizes get a trial: those that are expected to be the best for what they cost.

use super::goal::{Goal, Prefer};
use super::need::Need;
use super::prior::Prior;
use super::shape::Shape;
use crate::error::{Error, Result};
use neumip_export::Storage;
use neumip_export::config::{DecoderConfig, ModelConfig, ParallaxConfig};

/// Hidden layers that are tried, besides the full model's; blocks of twelve outputs, as 12 and 24 make, are slower than two of eight
/// or ten.
const HIDDEN: [&[usize]; 7] = [&[8], &[16], &[8, 8], &[10, 10], &[16, 16], &[20, 20], &[16, 16, 16]];
/// Texture channels that are tried, besides the full model's.
const CHANNELS: [usize; 4] = [2, 3, 4, 6];
/// Offsets that are tried, besides none and the full model's: channels and hidden layers.
const OFFSETS: [(usize, &[usize]); 2] = [(3, &[8]), (4, &[8, 8])];
/// Levels beyond the finest asked one that may be left out too: what remains is interpolated.
const COARSER: usize = 2;

/// A size with what it costs.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// The size.
    pub shape: Shape,
    /// Bytes in half precision.
    pub bytes: usize,
    /// Expected nanoseconds a query.
    pub ns: f64,
    /// Expected error over the full model's.
    pub error: f64,
}

impl Candidate {
    fn new(shape: Shape, full: &ModelConfig, need: &Need, prior: &Prior) -> Result<Self> {
        let architecture = shape.model(full, need)?;
        Ok(Self {
            bytes: architecture.bytes_as(Storage::HALF),
            ns: prior.ns(&shape, need),
            error: prior.error(&shape, need),
            shape,
        })
    }

    /// What it costs: lower is cheaper.
    pub fn cost(&self, prefer: Prefer) -> f64 {
        self.ns.ln() + prefer.bytes() * (self.bytes as f64).ln()
    }
}

/// All sizes that are no larger than the full model.
fn all(full: &ModelConfig, need: &Need, prior: &Prior) -> Result<Vec<Candidate>> {
    let Some(whole) = Shape::of(full) else {
        let problem = "is no fully connected decoder: only those can be fitted";
        return Err(Error::config("model.decoder", problem));
    };
    let DecoderConfig::Mlp { hidden: widest } = &full.decoder else { return Ok(Vec::new()) };
    let mut hidden: Vec<Vec<usize>> = HIDDEN.iter().map(|widths| widths.to_vec()).collect();
    hidden.push(widest.clone());
    hidden.retain(|widths| widths.len() <= widest.len() && widths.iter().zip(widest).all(|(a, b)| a <= b));
    let mut channels = CHANNELS.to_vec();
    channels.push(whole.channels);
    channels.retain(|count| *count <= whole.channels);
    let mut offsets = vec![None];
    if let ParallaxConfig::Offset(wide) = &full.parallax {
        let slim = OFFSETS.iter().map(|(channels, widths)| (*channels, widths.to_vec()));
        let fits = |(channels, widths): &(usize, Vec<usize>)| {
            *channels <= wide.channels
                && widths.len() <= wide.hidden.len()
                && widths.iter().zip(&wide.hidden).all(|(a, b)| a <= b)
        };
        offsets.extend(slim.filter(fits).map(Some));
        offsets.push(whole.offset.clone());
    }
    let first = need.finest().max(whole.finest);
    let last = (first + COARSER).min(need.coarsest().max(first));
    let mut out = Vec::new();
    for finest in first..=last {
        for hidden in &hidden {
            for &channels in &channels {
                for offset in &offsets {
                    for bands in [0, whole.bands] {
                        let shape =
                            Shape { finest, channels, hidden: hidden.clone(), offset: offset.clone(), bands };
                        if out.iter().all(|known: &Candidate| known.shape != shape) {
                            out.push(Candidate::new(shape, full, need, prior)?);
                        }
                    }
                }
            }
        }
    }
    Ok(out)
}

/// At most `count` candidates within the budgets of `goal`: of those that nothing cheaper is expected to beat, evenly from the
/// cheapest to the most accurate.
///
/// # Errors
/// `Usage` for budgets that no model holds, saying the least that can be asked; `Config` for a full model that cannot be
/// narrowed.
pub fn candidates(
    full: &ModelConfig,
    need: &Need,
    prior: &Prior,
    goal: &Goal,
    count: usize,
) -> Result<Vec<Candidate>> {
    let mut all = all(full, need, prior)?;
    let least_bytes = all.iter().map(|c| c.bytes).min().unwrap_or(0);
    let least_ns = all.iter().map(|c| c.ns).fold(f64::INFINITY, f64::min);
    if goal.bytes.is_some_and(|most| most < least_bytes) {
        let problem = format!("the smallest model for this scene has {least_bytes} bytes in half precision");
        return Err(Error::usage(format!("--budget-bytes {}: {problem}", goal.bytes.unwrap_or(0))));
    }
    if goal.ns.is_some_and(|most| most < least_ns) {
        let problem =
            format!("the fastest model for this scene is expected to take {least_ns:.0} ns a query");
        return Err(Error::usage(format!("--budget-ns {}: {problem}", goal.ns.unwrap_or(0.0))));
    }
    all.retain(|c| goal.bytes.is_none_or(|most| c.bytes <= most) && goal.ns.is_none_or(|most| c.ns <= most));
    if all.is_empty() {
        let problem = "no model holds both; each alone can be held, so raise one of them";
        return Err(Error::usage(format!("--budget-bytes, --budget-ns: {problem}")));
    }
    let cost = |c: &Candidate| c.cost(goal.prefer);
    all.sort_by(|a, b| cost(a).total_cmp(&cost(b)).then(a.shape.cmp(&b.shape)));
    let mut front: Vec<Candidate> = Vec::new();
    for candidate in all {
        if front.last().is_none_or(|best| candidate.error < best.error) {
            front.push(candidate);
        }
    }
    Ok(spread(front, count.max(1), goal.prefer))
}

/// `count` of a front whose costs are as evenly spaced as it allows, its ends among them.
fn spread(front: Vec<Candidate>, count: usize, prefer: Prefer) -> Vec<Candidate> {
    if front.len() <= count {
        return front;
    }
    let (low, high) = (front[0].cost(prefer), front[front.len() - 1].cost(prefer));
    let mut chosen: Vec<usize> = Vec::new();
    for k in 0..count {
        let wanted = low + (high - low) * k as f64 / (count - 1).max(1) as f64;
        let free = (0..front.len()).filter(|i| !chosen.contains(i));
        let near = |i: &usize| (front[*i].cost(prefer) - wanted).abs();
        chosen.extend(free.min_by(|a, b| near(a).total_cmp(&near(b))));
    }
    chosen.sort_unstable();
    chosen.into_iter().map(|i| front[i].clone()).collect()
}

#[cfg(test)]
mod tests {
    use super::super::need::tests::whole;
    use super::*;
    use crate::config::Config;

    fn found(goal: &Goal, levels: [f32; 2], count: usize) -> Result<Vec<Candidate>> {
        let full = Config::preset("improved").unwrap().model;
        candidates(&full, &whole(levels), &Prior::new().unwrap(), goal, count)
    }

    const FREE: Goal = Goal::FREE;

    #[test]
    fn candidates_go_from_the_cheapest_to_the_best() {
        let all = found(&FREE, [0.0, 6.0], 12).unwrap();
        assert_eq!(all.len(), 12);
        assert!(
            all.windows(2).all(|pair| pair[0].cost(Prefer::Both) < pair[1].cost(Prefer::Both)
                && pair[0].error > pair[1].error)
        );
        assert!(all[0].bytes * 50 < all[11].bytes && all[0].ns * 2.0 < all[11].ns, "{all:?}");
        assert_eq!(all, found(&FREE, [0.0, 6.0], 12).unwrap());
    }

    #[test]
    fn levels_that_nobody_asks_are_in_none() {
        let far = found(&FREE, [3.2, 4.5], 8).unwrap();
        assert!(far.iter().all(|c| c.shape.finest >= 3 && c.bytes < 40_000), "{far:?}");
    }

    #[test]
    fn budgets_that_contradict_anything_are_refused() {
        let refused = |goal: Goal| found(&goal, [0.0, 6.0], 8).unwrap_err().to_string();
        assert!(refused(Goal { bytes: Some(100), ..FREE }).contains("the smallest model"));
        assert!(refused(Goal { ns: Some(1.0), ..FREE }).contains("the fastest model"));
        let goal = Goal { bytes: Some(60_000), ns: Some(60.0), ..FREE };
        let held = found(&goal, [0.0, 6.0], 8).unwrap();
        assert!(!held.is_empty() && held.iter().all(|c| c.bytes <= 60_000 && c.ns <= 60.0));
    }
}
