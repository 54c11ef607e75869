//! What a call of `neumip reproduce` does: trials, cells, times, results.

use super::super::console::Console;
use super::super::{generate, surface::Surface};
use super::Reproduce;
use super::machine::machine;
use super::times::Times;
use super::training::{configured, trained};
use crate::analytic::{AnalyticMaps, MapsConfig};
use crate::checkpoint;
use crate::config::Config;
use crate::dataset::{Dataset, Existing};
use crate::error::{Error, Result};
use crate::inference::{Answerer, answerer};
use crate::lpips::Lpips;
use crate::query::Reflectance;
use crate::reference::{Reference, ReferenceOptions, builtin};
use crate::report::picture;
use crate::reproduce::folder::Finished;
use crate::reproduce::measure::{Answered, Data, cells, rows};
use crate::reproduce::page::{Heading, picture_name, results_html, results_markdown};
use crate::reproduce::study::Directions;
use crate::reproduce::{Folder, Job, Scope, Study, Variant, jobs, tuning};
use crate::results::{self, Trial};
use candle_core::Device;
use neumip_export::Precision;
use neumip_export::whole_file::write_whole;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

/// Seed of the trials.
const TRIAL_SEED: u64 = 1;
/// The seed whose views are kept as pictures.
const PICTURED: u64 = 1;

/// One call.
pub struct Run<'a> {
    pub study: Study,
    pub scope: Scope,
    pub asked: &'a Reproduce,
    pub lpips: Option<Lpips>,
    pub console: &'a Console,
}

/// Datasets and tuning that were needed so far.
#[derive(Default)]
struct Known {
    data: BTreeMap<(String, Directions), Dataset>,
    tuned: BTreeMap<(String, Directions), Vec<String>>,
}

impl Run<'_> {
    /// Runs it.
    pub fn run(self) -> Result<()> {
        let share = self.asked.cells;
        let all = jobs(&self.study, &self.scope);
        let mine: Vec<&Job> = all
            .iter()
            .enumerate()
            .filter(|(k, _)| k % share.of == share.index - 1)
            .map(|(_, job)| job)
            .collect();
        for job in all.iter().filter(|job| job.variant.maps.is_none()) {
            configured(job.variant.config()?, &self.study, job.seed, 1.0).train.validate()?;
        }
        // A wrong name is said now and not after an hour.
        let options = self.surface().options(self.study.resolution);
        let named = all.iter().map(|job| &job.material).chain(&self.study.tuned_on);
        for material in named.collect::<BTreeSet<_>>() {
            if !builtin::NAMES.contains(&material.as_str()) {
                Reference::material(material, &options)?;
            }
        }
        if self.asked.plan {
            return self.console.answer(self.plan(&all, &mine));
        }
        let folder = Folder::open(&self.asked.out, &self.study)?;
        for other in &self.asked.merge {
            let taken = folder.merge(other)?;
            self.console.say(format!("{}: {taken} files taken over", other.display()));
        }
        let mut known = Known::default();
        if self.asked.prepare {
            for job in mine.iter().filter(|job| self.scope.regimes.contains(&job.directions)) {
                self.data(&folder, &job.material, job.directions, &mut known)?;
            }
            return Ok(());
        }
        let clock = Instant::now();
        let mut trained = 0u32;
        for (k, job) in mine.iter().enumerate() {
            if folder.finished(job)?.is_some() {
                continue;
            }
            let left = clock.elapsed().as_secs_f64() / f64::from(trained.max(1)) * (mine.len() - k) as f64;
            let left = if trained > 0 { format!(", about {left:.0} s left") } else { String::new() };
            self.console.say(format!("[{}/{}] {}{left}", k + 1, mine.len(), job.name()));
            let finished = self.job(&folder, job, &mut known)?;
            folder.save(job, &finished)?;
            trained += 1;
            self.console.check(&format!(
                "{} keeps what is finished; the same command goes on",
                folder.root().display()
            ))?;
        }
        Times { study: &self.study, rounds: self.asked.rounds, console: self.console }.measure(
            &folder,
            &all,
            &|job, config| self.baked(&job.material, config),
        )?;
        self.report(&folder, &all)
    }

    fn plan(&self, all: &[Job], mine: &[&Job]) -> String {
        let mut out = String::new();
        for job in mine {
            out += &format!("{}\n", job.name());
        }
        let mut presets: Vec<_> =
            all.iter().filter(|j| j.variant.tuned).map(|j| (tuned_as(&j.variant), j.directions)).collect();
        presets.sort();
        presets.dedup();
        let trials = presets.len() * self.study.trials * self.study.tuned_on.len();
        out + &format!(
            "{} of {} trainings of {} samples, and {trials} trials of {:.0}",
            mine.len(),
            all.len(),
            self.study.samples(),
            self.study.samples() as f64 * self.study.trial_share
        )
    }

    /// The dataset of a material and regime, rendered where it is not there yet.
    fn data(
        &self,
        folder: &Folder,
        material: &str,
        directions: Directions,
        known: &mut Known,
    ) -> Result<Dataset> {
        let key = (material.to_string(), directions);
        if let Some(data) = known.data.get(&key) {
            return Ok(data.clone());
        }
        let path = folder.data(material, directions);
        let config = self.study.generation(directions);
        let whole = Dataset::open(&path).ok().filter(|d| d.manifest().complete);
        let data = match whole {
            Some(data) => data,
            None => {
                let reference = generate::reference(material, &self.surface(), &config)?;
                let existing = if path.exists() { Existing::Resume } else { Existing::Refuse };
                generate::dataset(&reference, &config, &path, existing, self.console)?
            }
        };
        known.data.insert(key, data.clone());
        Ok(data)
    }

    fn surface(&self) -> Surface {
        Surface {
            bounces: self.study.bounces,
            field_side: ReferenceOptions::default().field_side,
            material_seed: 0,
            make_tileable: false,
        }
    }

    /// The maps of a material, baked.
    fn baked(&self, material: &str, config: &MapsConfig) -> Result<AnalyticMaps> {
        let side = self.study.resolution;
        let material = Reference::material(material, &self.surface().options(side))?;
        AnalyticMaps::new(&material, [side; 2], &MapsConfig { bounces: self.study.bounces, ..*config })
    }

    /// Measures a material's own maps.
    fn maps(&self, folder: &Folder, job: &Job, config: &MapsConfig, known: &mut Known) -> Result<Finished> {
        let maps = match self.baked(&job.material, config) {
            Ok(maps) => maps,
            // What is made of fibres or sheets has no maps; that is a result too.
            Err(Error::Config { problem, .. }) => {
                let failure = Some(format!("{}: {problem}", job.name()));
                return Ok(Finished { machine: machine(), seconds: 0.0, cells: Vec::new(), failure });
            }
            Err(other) => return Err(other),
        };
        let held_out = self.data(folder, &job.material, Directions::Scattered, known)?;
        let data = Data { training: &held_out, held_out: &held_out };
        let engine = format!("maps {}", maps.isa().name());
        let answered = Answered { suffix: "", engine, bytes: maps.bytes(), flops: maps.flops() };
        let mut cells = cells(job, data, 0, &answered, rows(&maps, &self.study, data, self.lpips.as_ref())?);
        cells.retain(|cell| cell.level.is_none());
        Ok(Finished { machine: machine(), seconds: 0.0, cells, failure: None })
    }

    /// Trains and measures one job.
    fn job(&self, folder: &Folder, job: &Job, known: &mut Known) -> Result<Finished> {
        if let Some(config) = &job.variant.maps {
            return self.maps(folder, job, config, known);
        }
        let training = self.data(folder, &job.material, job.directions, known)?;
        let held_out = self.data(folder, &job.material, Directions::Scattered, known)?;
        let mut config = job.variant.config()?;
        if job.variant.tuned {
            tuning::apply(&mut config, &self.tuned(folder, &job.variant, job.directions, known)?)?;
        }
        let config = configured(config, &self.study, job.seed, 1.0);
        let progress = match trained(folder, &job.name(), config, &training, self.console) {
            Ok(progress) => progress,
            Err(Error::Diverged(problem)) => {
                self.console.say(format!("{}: {problem}", job.name()));
                let failure = Some(format!("{}: {problem}", job.name()));
                return Ok(Finished { machine: machine(), seconds: 0.0, cells: Vec::new(), failure });
            }
            Err(other) => return Err(other),
        };
        let checkpoint = checkpoint::load(&folder.run(&job.name()))?;
        let data = Data { training: &training, held_out: &held_out };
        let mut all = Vec::new();
        let halves =
            if job.variant.half { vec![Precision::Single, Precision::Half] } else { vec![Precision::Single] };
        for precision in halves {
            let Answerer { material, engine } = answerer(&checkpoint, None, precision, &Device::Cpu)?;
            let answered = Answered::model(&checkpoint.header.architecture, precision, engine);
            let rows = rows(&*material, &self.study, data, self.lpips.as_ref())?;
            let mut cells = cells(job, data, progress.samples, &answered, rows);
            // Dozens of variants are compared as wholes; the tables by level are of the presets.
            cells.retain(|cell| job.variant.set.is_empty() || cell.level.is_none());
            all.extend(cells);
            if precision == Precision::Single && job.seed == PICTURED && job.variant.set.is_empty() {
                self.pictures(folder, job, &held_out, &*material)?;
            }
        }
        Ok(Finished { machine: machine(), seconds: progress.seconds, cells: all, failure: None })
    }

    /// The views of a model and of the reference.
    fn pictures(&self, folder: &Folder, job: &Job, data: &Dataset, material: &dyn Reflectance) -> Result<()> {
        for view in &data.manifest().views {
            let (queries, reference) = data.read_view(&view.name)?;
            // What cannot answer a perspective view has no picture of it.
            let Ok(answer) = material.evaluate(&queries) else { return Ok(()) };
            let regime = job.directions.to_string();
            let name = picture_name(&job.material, Some((&regime, &job.variant.label)), &view.name);
            folder.save_picture(&name, &picture::png(&picture::srgb(&answer, 0.0)?)?)?;
            let name = picture_name(&job.material, None, &view.name);
            folder.save_picture(&name, &picture::png(&picture::srgb(&reference, 0.0)?)?)?;
        }
        Ok(())
    }

    /// What the best trial of a preset set; trials that are missing are run.
    fn tuned(
        &self,
        folder: &Folder,
        variant: &Variant,
        directions: Directions,
        known: &mut Known,
    ) -> Result<Vec<String>> {
        let preset = tuned_as(variant);
        let key = (preset.clone(), directions);
        if let Some(set) = known.tuned.get(&key) {
            return Ok(set.clone());
        }
        let base = Config::preset(&preset)?;
        let label = Variant::preset(&preset).label;
        let mut trials = Vec::new();
        for index in 0..self.study.trials {
            let set = tuning::settings(&base, index, TRIAL_SEED);
            for material in &self.study.tuned_on {
                let name = format!("{label}.{directions}.{material}.t{index}");
                if let Some(trial) = folder.trial(&name)? {
                    trials.push(trial);
                    continue;
                }
                self.console.say(format!("trial {} of {}: {name}", index + 1, self.study.trials));
                let data = self.data(folder, material, directions, known)?;
                let mut config = base.clone();
                tuning::apply(&mut config, &set)?;
                let config = configured(config, &self.study, TRIAL_SEED, self.study.trial_share);
                let mse = match trained(folder, &format!("trial-{name}"), config, &data, self.console) {
                    Ok(progress) => progress.best.map(|best| best.errors.mse),
                    Err(Error::Diverged(_)) => None,
                    Err(other) => return Err(other),
                };
                let trial = Trial {
                    preset: label.clone(),
                    material: material.clone(),
                    regime: directions.to_string(),
                    index,
                    set: set.clone(),
                    seed: TRIAL_SEED,
                    samples_per_texel: self.study.budget as f64 * self.study.trial_share,
                    mse,
                    chosen: false,
                };
                folder.save_trial(&name, &trial)?;
                trials.push(trial);
            }
        }
        let best = tuning::best(&trials, &self.study.tuned_on).ok_or_else(|| {
            Error::Diverged(format!("no trial of {label} on {directions} data gave numbers"))
        })?;
        let set = tuning::settings(&base, best, TRIAL_SEED);
        self.console
            .say(format!("{label} on {directions} data: trial {best} is the best{}", described(&set)));
        known.tuned.insert(key, set.clone());
        Ok(set)
    }

    /// Writes what the folder knows.
    fn report(&self, folder: &Folder, all: &[Job]) -> Result<()> {
        let results = folder.results(&self.study)?;
        let mut failures = Vec::new();
        let mut missing = 0;
        for job in all {
            match folder.finished(job)? {
                Some(finished) => failures.extend(finished.failure),
                None => missing += 1,
            }
        }
        let heading = Heading {
            command: self.asked.command(&self.study, &self.scope),
            failures,
            missing: [missing, all.len()],
        };
        results.write(&folder.root().join(results::FILE))?;
        let markdown = results_markdown(&self.study, &results, &heading);
        write_whole(&folder.root().join("RESULTS.md"), markdown.as_bytes())?;
        let page = results_html(folder, &self.study, &results, &heading)?;
        write_whole(&folder.root().join("results.html"), page.as_bytes())?;
        super::super::save_json(self.asked.json.as_deref(), &results)?;
        let missing = if missing > 0 { format!(", {missing} trainings are missing") } else { String::new() };
        self.console.say(format!(
            "{}: {} cells of {} trainings{missing}; see RESULTS.md, results.html and results.json",
            folder.root().display(),
            results.cells.len(),
            all.len()
        ));
        Ok(())
    }
}

/// The preset whose trials a variant uses: the large Inception decoder costs too much to be tried itself.
fn tuned_as(variant: &Variant) -> String {
    if variant.preset == "inception" { "inception-small".into() } else { variant.preset.clone() }
}

fn described(set: &[String]) -> String {
    if set.is_empty() { ", the preset as it is".into() } else { format!(": {}", set.join(" ")) }
}
