//! Against ground truth: means by level, errors by level and angle, off the grid, in motion.

use super::finding::{Bounds, Place, Seen};
use super::numbers::worst;
use super::pictures::{Panel, cut, strip};
use super::subject::{Splits, Subject, energy, grey, minus};
use super::{Check, Needs, advice};
use crate::dataset::{Block, Dataset, SplitName};
use crate::error::{Error, Result};
use crate::evaluate::{motion_table, refusal, split_table};
use crate::query::RgbImage;
use std::collections::BTreeMap;

/// Cosine of 62 degrees, beyond which a direction grazes, as in the grazing split.
const GRAZING: f32 = 0.469;
/// Standard errors of the truth that are not held against the material.
const DOUBT: f64 = 2.0;
/// Fewer patches say nothing about a level.
const LEAST_PATCHES: u64 = 16;

pub(super) fn checks() -> Vec<Check> {
    vec![
        Check {
            name: "truth-means",
            measures: "stops between the mean of a level and the reference's, less twice what the data's scatter explains, worst level",
            bounds: Bounds {
                watch: 0.03,
                wrong: Some(0.5),
                reason: "0.03 stops are 2 %, which nobody sees; half a stop is seen by anyone beside another object",
            },
            needs: Needs::Data,
            run: |subject| Ok(Table::of(subject)?.means(subject)),
        },
        Check {
            name: "truth-levels",
            measures: "relative squared error of the worst level over that of the finest",
            bounds: Bounds {
                watch: 2.0,
                wrong: Some(10.0),
                reason: "coarse levels are smoother, so that they should be easier; ten times worse is a level that was not learned",
            },
            needs: Needs::Data,
            run: |subject| Table::of(subject)?.levels(),
        },
        Check {
            name: "truth-grazing",
            measures: "relative squared error with light or view beyond 62 degrees over that elsewhere",
            bounds: Bounds {
                watch: 5.0,
                wrong: Some(20.0),
                reason: "answers are darker and harder there; good trainings of the built-in materials have 1.6 to 4",
            },
            needs: Needs::Data,
            run: |subject| Table::of(subject)?.grazing(),
        },
        Check {
            name: "truth-off-grid",
            measures: "squared error between texels and levels over that at texel centres of the same level, mean over levels",
            bounds: Bounds { watch: 1.1, wrong: Some(2.0), reason: "a renderer asks nowhere else" },
            needs: Needs::AllData,
            run: off_grid,
        },
        Check {
            name: "flicker",
            measures: "error of the change from frame to frame over the energy of the true change, worst sequence",
            bounds: Bounds {
                watch: 1.0,
                wrong: Some(2.0),
                reason: "at 1 a still picture would have been as good",
            },
            needs: Needs::AllData,
            run: flicker,
        },
    ]
}

fn data<'a>(subject: &Subject<'a>) -> Result<(&'a Dataset, Splits)> {
    subject.data.ok_or_else(|| Error::usage("--data is needed"))
}

/// Sums over patches.
#[derive(Clone, Copy, Default)]
struct Sums {
    patches: u64,
    answer: f64,
    truth: f64,
    /// Of squares of the differences of patches' sums.
    scatter: f64,
    error: f64,
    energy: f64,
    noise: f64,
}

impl Sums {
    fn add(&mut self, other: Self) {
        self.patches += other.patches;
        self.answer += other.answer;
        self.truth += other.truth;
        self.scatter += other.scatter;
        self.error += other.error;
        self.energy += other.energy;
        self.noise += other.noise;
    }

    /// Squared error over energy, without the reference's own noise; not below 0.
    fn relative(&self) -> f64 {
        if self.energy > 0.0 { ((self.error - self.noise) / self.energy).max(0.0) } else { 0.0 }
    }

    /// Mean of the answers over the truth's, and the standard error of that.
    fn ratio(&self) -> Option<(f64, f64)> {
        let known = self.patches >= LEAST_PATCHES && self.truth > 0.0;
        known.then(|| (self.answer / self.truth, self.scatter.sqrt() / self.truth))
    }
}

/// Stops between a ratio and 1 that two standard errors do not explain.
fn stops(ratio: f64, doubt: f64) -> f64 {
    let most = if ratio < 1.0 { (ratio + DOUBT * doubt).min(1.0) } else { (ratio - DOUBT * doubt).max(1.0) };
    most.log2().abs()
}

/// A patch that is far from the truth.
struct Bad {
    error: f64,
    place: Place,
    truth: RgbImage,
    answer: RgbImage,
}

/// What the validation split says.
#[derive(Default)]
struct Table {
    levels: BTreeMap<usize, Sums>,
    grazing: [Sums; 2],
    worst: Vec<Bad>,
}

impl Table {
    fn of(subject: &Subject) -> Result<Self> {
        let (data, _) = data(subject)?;
        if let Some(problem) = refusal(subject.material, data, SplitName::Validation)? {
            return Err(Error::config("data", problem));
        }
        let split = data.split(SplitName::Validation)?;
        let mut table = Self::default();
        for file in 0..split.files() {
            for block in split.read_file(file)? {
                let answer = subject.material.evaluate(&block.queries(data.resolution()))?;
                table.add(&block, &answer);
            }
        }
        Ok(table)
    }

    fn add(&mut self, block: &Block, answer: &RgbImage) {
        let (side, patch) = (block.side(), block.patch());
        let truth = RgbImage { height: side, width: side, pixels: block.target() };
        let across = side / patch;
        for (k, about) in block.patches().iter().enumerate() {
            let corner = [k / across * patch, k % across * patch];
            let (a, t) = (cut(answer, corner, patch), cut(&truth, corner, patch));
            let sum = |image: &RgbImage| image.pixels.iter().map(|p| grey(*p)).sum::<f64>();
            let (own, right) = (sum(&a), sum(&t));
            let error = a.pixels.iter().zip(&t.pixels).map(|(a, t)| energy(minus(*a, *t))).sum();
            let sums = Sums {
                patches: 1,
                answer: own,
                truth: right,
                scatter: (own - right).powi(2),
                error,
                energy: t.pixels.iter().map(|p| energy(*p)).sum(),
                noise: 3.0 * f64::from(block.noise()) * (patch * patch) as f64,
            };
            self.levels.entry(block.level().floor() as usize).or_default().add(sums);
            let cosine = |w: [f32; 2]| crate::query::unit(w)[2];
            self.grazing[usize::from(cosine(about.wi).min(cosine(about.wo)) < GRAZING)].add(sums);
            // Small patches of coarse levels show nothing.
            if patch >= 8 && self.worst.last().is_none_or(|last| last.error < error || self.worst.len() < 3) {
                let u = about.corner;
                let place = Place { u, wi: about.wi, wo: about.wo, level: block.level(), value: Some(error) };
                self.worst.push(Bad { error, place, truth: t, answer: a });
                self.worst.sort_by(|a, b| b.error.total_cmp(&a.error));
                self.worst.truncate(3);
            }
        }
    }

    fn places(&self) -> Vec<Place> {
        self.worst.iter().map(|bad| bad.place).collect()
    }

    fn picture(&self) -> Result<Option<(String, Vec<u8>)>> {
        let Some(bad) = self.worst.first() else { return Ok(None) };
        let png = strip(&[
            Panel::Light(&bad.truth),
            Panel::Light(&bad.answer),
            Panel::Apart(&bad.truth, &bad.answer),
        ])?;
        let caption =
            format!("The worst patch, level {:.1}: reference, answer, difference.", bad.place.level);
        Ok(Some((caption, png)))
    }

    fn means(&self, subject: &Subject) -> Seen {
        let ratios: Vec<(usize, f64, f64)> = self
            .levels
            .iter()
            .filter_map(|(l, sums)| sums.ratio().map(|(r, doubt)| (*l, r, doubt)))
            .collect();
        let off: Vec<f64> = ratios.iter().map(|(_, r, doubt)| stops(*r, *doubt)).collect();
        let Some((at, figure)) = worst(&off).first().copied() else {
            return Seen::left_out("the data has too few patches to say");
        };
        let (level, ratio, doubt) = ratios[at];
        let of_level = |(l, r, _): &(usize, f64, f64)| (format!("level {l} over the reference"), *r);
        Seen {
            figure,
            says: format!(
                "the mean of level {level} is {:.1} % of the reference's, give or take {:.1}",
                100.0 * ratio,
                100.0 * DOUBT * doubt
            ),
            change: advice::means(subject.checkpoint),
            values: ratios.iter().map(of_level).collect(),
            ..Seen::default()
        }
    }

    fn levels(&self) -> Result<Seen> {
        let errors: Vec<(usize, f64)> = self.levels.iter().map(|(l, sums)| (*l, sums.relative())).collect();
        let Some((_, finest)) = errors.first().copied() else {
            return Ok(Seen::left_out("the data has no levels"));
        };
        let over: Vec<f64> = errors.iter().map(|(_, e)| e / finest.max(1e-6)).collect();
        let Some((at, figure)) = worst(&over).first().copied() else { return Ok(Seen::nothing()) };
        Ok(Seen {
            figure,
            says: format!(
                "level {} has a squared error of {:.3} of its energy, the finest {finest:.3}",
                errors[at].0, errors[at].1
            ),
            change: "train longer, on more samples (neumip generate --samples)".into(),
            values: errors.iter().map(|(l, e)| (format!("level {l}"), *e)).collect(),
            places: self.places(),
            picture: self.picture()?,
            ..Seen::default()
        })
    }

    fn grazing(&self) -> Result<Seen> {
        let [elsewhere, grazing] = [self.grazing[0].relative(), self.grazing[1].relative()];
        Ok(Seen {
            figure: grazing / elsewhere.max(1e-6),
            says: format!(
                "beyond 62 degrees the squared error is {grazing:.3} of the energy, elsewhere {elsewhere:.3}"
            ),
            change: "train on data with more grazing pairs (neumip generate --grazing-floor), or longer"
                .into(),
            values: [("beyond 62 degrees".to_string(), grazing), ("elsewhere".to_string(), elsewhere)].into(),
            ..Seen::default()
        })
    }
}

fn off_grid(subject: &Subject) -> Result<Seen> {
    let (data, _) = data(subject)?;
    if [SplitName::Test, SplitName::Offgrid].iter().any(|name| !data.split_names().contains(name)) {
        return Ok(Seen::left_out("the data has not both splits test and offgrid"));
    }
    let table = |name| split_table(subject.material, data, name, u64::MAX, None);
    let (on, off) = (table(SplitName::Test)?, table(SplitName::Offgrid)?);
    let mut ratios = Vec::new();
    for row in &off {
        let same = on.iter().find(|other| row.level.is_some() && other.level == row.level);
        if let (Some(level), Some(same)) = (row.level, same) {
            ratios.push((level, row.errors.mse, same.errors.mse));
        }
    }
    if ratios.is_empty() {
        return Ok(Seen {
            says: "the data has no splits test and offgrid with levels in common".into(),
            ..Seen::default()
        });
    }
    let log = |(_, off, on): &(usize, f64, f64)| (off.max(1e-12) / on.max(1e-12)).ln();
    let figure = (ratios.iter().map(log).sum::<f64>() / ratios.len() as f64).exp();
    Ok(Seen {
        figure,
        says: format!(
            "between texels and levels the squared error is {figure:.2} times that at texel centres"
        ),
        change: advice::between(subject.checkpoint),
        values: ratios.iter().map(|r| (format!("level {}", r.0), log(r).exp())).collect(),
        ..Seen::default()
    })
}

fn flicker(subject: &Subject) -> Result<Seen> {
    let (data, _) = data(subject)?;
    let rows = motion_table(subject.material, data, None)?;
    let found: Vec<(String, f64)> =
        rows.iter().filter_map(|row| Some((row.split.clone(), row.flicker?))).collect();
    let Some((at, figure)) = worst(&found.iter().map(|f| f.1).collect::<Vec<_>>()).first().copied() else {
        return Ok(Seen::left_out("the data has no motion (generate --motion)"));
    };
    Ok(Seen {
        figure,
        says: format!("{}: the error of motion has {figure:.2} of the true motion's energy", found[at].0),
        change: "train longer; for gloss take fewer octaves of directions".into(),
        values: found.into_iter().collect(),
        ..Seen::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of sums.
    const ROUNDING: f64 = 1e-9;

    fn sums(ratio: f64) -> Sums {
        let mut all = Sums::default();
        for k in 0..LEAST_PATCHES {
            let truth = 1.0 + k as f64;
            let answer = ratio * truth;
            all.add(Sums {
                patches: 1,
                answer,
                truth,
                scatter: (answer - truth).powi(2),
                error: 2.0,
                energy: 10.0,
                noise: 1.0,
            });
        }
        all
    }

    #[test]
    fn noise_is_taken_off_errors_and_means_have_a_scatter() {
        let all = sums(0.8);
        assert!((all.relative() - 0.1).abs() < ROUNDING);
        assert!((Sums { noise: 0.0, ..all }.relative() - 0.2).abs() < ROUNDING);
        let (ratio, doubt) = all.ratio().unwrap();
        assert!((ratio - 0.8).abs() < ROUNDING && doubt > 0.0 && doubt < 0.2, "{ratio} {doubt}");
        assert!(stops(0.8, 0.0) > 0.3 && stops(0.8, 0.1) == 0.0 && stops(1.5, 0.2) > 0.1);
        assert_eq!(sums(1.0).ratio(), Some((1.0, 0.0)));
        assert_eq!(Sums { patches: 1, ..all }.ratio(), None);
        assert_eq!(Sums::default().relative(), 0.0);
    }
}
