//! Nanoseconds a query of every variant of a study, all in one run.

use super::super::console::Console;
use crate::analytic::{AnalyticMaps, MapsConfig};
use crate::error::Result;
use crate::evaluate::{TIMED_QUERIES, costs, slice_cost};
use crate::inference::answerer;
use crate::model::Variables;
use crate::query::{Reflectance, Support};
use crate::reproduce::variant::ABLATION;
use crate::reproduce::{Folder, Job, Study};
use candle_core::Device;
use neumip_export::checkpoint::{Checkpoint, FORMAT, Header};
use neumip_export::config::Architecture;
use neumip_export::{Measure, Precision};
use std::collections::BTreeMap;

/// What is timed, and how often.
pub struct Times<'a> {
    pub study: &'a Study,
    pub rounds: usize,
    pub console: &'a Console,
}

/// Maps of a job's material.
type Bake<'a> = dyn Fn(&Job, &MapsConfig) -> Result<AnalyticMaps> + 'a;

impl Times<'_> {
    /// Times all variants of the jobs together, so that their ratios are of one run; those of the ablation have the shapes
    /// of others. Nothing is done where every one is timed already.
    pub fn measure(&self, folder: &Folder, jobs: &[Job], bake: &Bake) -> Result<()> {
        if self.rounds == 0 {
            return Ok(());
        }
        let mut times = folder.times()?;
        let mut answerers: BTreeMap<String, Box<dyn Reflectance>> = BTreeMap::new();
        let wanted: BTreeMap<&str, &Job> = jobs
            .iter()
            .filter(|job| !job.variant.label.starts_with(ABLATION))
            .map(|job| (job.variant.label.as_str(), job))
            .collect();
        let mut halves =
            jobs.iter().filter(|job| job.variant.half).map(|job| format!("{}-f16", job.variant.label));
        if wanted.keys().all(|label| times.contains_key(*label)) && halves.all(|l| times.contains_key(&l)) {
            return Ok(());
        }
        for (label, job) in wanted {
            if let Some(config) = &job.variant.maps {
                // What is made of fibres has no maps; another job of the same label has.
                let of_label = jobs.iter().filter(|j| j.variant.label == label);
                if let Some(maps) = of_label.filter_map(|job| bake(job, config).ok()).next() {
                    answerers.insert(label.into(), Box::new(maps));
                }
                continue;
            }
            let checkpoint = self.untrained(job)?;
            let mut add = |label: String, precision| -> Result<()> {
                let answerer = answerer(&checkpoint, None, precision, &Device::Cpu)?;
                answerers.insert(label, answerer.material);
                Ok(())
            };
            add(label.into(), Precision::Single)?;
            // The same label may be asked for by a question that does not want it.
            if jobs.iter().any(|job| job.variant.label == label && job.variant.half) {
                add(format!("{label}-f16"), Precision::Half)?;
            }
        }
        self.console.say(format!("timing {} variants on one thread", answerers.len()));
        let pointwise: Vec<(&String, &dyn Reflectance)> = answerers
            .iter()
            .filter(|(_, a)| a.support() == Support::Pointwise)
            .map(|(label, a)| (label, &**a))
            .collect();
        let levels = self.study.resolution.ilog2() as usize;
        let together: Vec<&dyn Reflectance> = pointwise.iter().map(|(_, answerer)| *answerer).collect();
        let measured = costs(&together, levels, TIMED_QUERIES, self.rounds)?;
        for ((label, _), cost) in pointwise.iter().zip(measured) {
            times.insert((*label).clone(), cost.ns_per_query);
        }
        for (label, answerer) in &answerers {
            if answerer.support() != Support::Pointwise {
                let cost = slice_cost(&**answerer, self.study.resolution, self.rounds)?;
                times.insert(label.clone(), cost.ns_per_query);
            }
        }
        folder.save_times(&times)
    }

    /// A model of the job's shapes: what a query costs depends on those and not on values.
    fn untrained(&self, job: &Job) -> Result<Checkpoint> {
        let architecture = Architecture::new(job.variant.config()?.model, [self.study.resolution; 2])?;
        let tensors = Variables::initial(&architecture, 1, &Device::Cpu)?.to_stored()?;
        let header = Header {
            format: FORMAT,
            architecture,
            height_range: [0.0, 0.0],
            measure: Measure::RadianceCosine,
            material: job.material.clone(),
            provenance: serde_json::Value::Null,
            errors: serde_json::Value::Null,
        };
        Ok(Checkpoint { header, tensors })
    }
}
