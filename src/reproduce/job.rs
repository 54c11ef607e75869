//! The jobs of a study: one training each, and the cells that it fills.

use super::study::{Directions, Question, Scope, Study};
use super::variant::{Variant, of_ablation, of_chart};
use std::collections::BTreeSet;

/// One training.
#[derive(Clone, Debug, PartialEq)]
pub struct Job {
    /// Material.
    pub material: String,
    /// Regime of the training data.
    pub directions: Directions,
    /// Model.
    pub variant: Variant,
    /// Seed.
    pub seed: u64,
}

impl Job {
    /// Name of its files: letters, digits, dots and dashes.
    pub fn name(&self) -> String {
        let name = format!("{}.{}.{}.s{}", self.material, self.directions, self.variant.label, self.seed);
        plain(&name)
    }
}

/// A name that is safe as that of a file.
pub fn plain(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() || "-.".contains(c) { c } else { '-' }).collect()
}

/// The jobs of the questions asked, each once, in an order in which early ones already show something: seed by seed.
pub fn jobs(study: &Study, scope: &Scope) -> Vec<Job> {
    let mut all: Vec<Job> = Vec::new();
    let mut add = |materials: &[String], regimes: &[Directions], variants: &[Variant], seed: u64| {
        for material in materials {
            for directions in regimes {
                for variant in variants {
                    let (material, variant) = (material.clone(), variant.clone());
                    all.push(Job { material, directions: *directions, variant, seed });
                }
            }
        }
    };
    let named = |names: &[String]| names.iter().map(|name| Variant::preset(name)).collect::<Vec<_>>();
    for seed in 1..=scope.seeds {
        if scope.questions.contains(&Question::Presets) {
            add(&scope.materials, &scope.regimes, &named(&scope.presets), seed);
        }
        if scope.questions.contains(&Question::Chart) {
            // Maps are not trained, so that one seed says all.
            let variants: Vec<_> = of_chart().into_iter().filter(|v| v.maps.is_none() || seed == 1).collect();
            add(&scope.chart_on, &[Directions::Scattered], &variants, seed);
        }
        if scope.questions.contains(&Question::Inception) {
            let rivals = ["neumip", "improved"].map(String::from);
            let decoders = [named(&rivals), named(&scope.decoders)].concat();
            add(&scope.inception_on, &[Directions::Slices], &decoders, seed);
        }
    }
    // One seed: the cells are compared by the dozen, and the spread over seeds is known from the tables.
    if scope.questions.contains(&Question::Ablation) {
        let variants = of_ablation(study);
        add(std::slice::from_ref(&scope.ablation_on), &[Directions::Scattered], &variants, 1);
    }
    // A variant of the chart that is also a preset of the tables is trained once, with all that either measures.
    let mut merged: Vec<Job> = Vec::new();
    let mut known = BTreeSet::new();
    for job in all {
        let name = job.name();
        if known.insert(name.clone()) {
            merged.push(job);
        } else if let Some(first) = merged.iter_mut().find(|j| j.name() == name) {
            first.variant.half |= job.variant.half;
        }
    }
    merged
}

#[cfg(test)]
mod tests {
    use super::super::study::tests::{scope, study};
    use super::*;

    #[test]
    fn a_job_is_there_once_and_keeps_what_either_question_measures() {
        let jobs = jobs(&study(), &scope());
        let names: BTreeSet<_> = jobs.iter().map(Job::name).collect();
        assert_eq!(names.len(), jobs.len());
        let improved = jobs.iter().find(|j| j.name() == "rocks.scattered.improved.s1").unwrap();
        assert!(improved.variant.half);
        let ablation = jobs.iter().filter(|j| j.variant.label.starts_with("ablation"));
        assert!(ablation.clone().all(|j| j.seed == 1) && ablation.count() == 33);
    }

    #[test]
    fn names_are_safe() {
        assert_eq!(plain("a/b c..d"), "a-b-c..d");
    }
}
