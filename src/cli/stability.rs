//! `neumip stability`.

use super::console::Console;
use crate::checkpoint;
use crate::dataset::Dataset;
use crate::engine::FusedMaterial;
use crate::error::{Error, Result};
use crate::stability::own::{self, Examination, Extent, Splits, Subject, Verdict};
use crate::stability::{self, Folder, Scale, Watch, Workshop};
use clap::Args;
use neumip_export::Checkpoint;
use neumip_export::whole_file::write_json;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// Examine a trained material, or show the known failures of these methods, their cures, and that the cures hold.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  neumip stability runs/metal --data data/metal --out metal-stability\n  \
    neumip stability bundles/metal --quick --out metal-stability\n  \
    neumip stability --quick --out stability\n  \
    neumip stability --full --out stability-full\n  \
    neumip stability --quick --probe root-slope --out stability"
)]
pub struct Stability {
    /// A run's folder, a checkpoint or a bundle to examine; without it the suite of known failures runs.
    run: Option<PathBuf>,
    /// Its dataset: errors and means by level, flicker; without it what needs no ground truth.
    #[arg(long, requires = "run")]
    data: Option<PathBuf>,
    /// The suite's folder, where what is finished is not run again; or the examination's.
    #[arg(long, default_value = "stability")]
    out: PathBuf,
    /// Replace an older examination.
    #[arg(long, requires = "run")]
    force: bool,
    /// Small tiles and short trainings, a few minutes; a material in a second or two.
    #[arg(long, conflicts_with = "full")]
    quick: bool,
    /// The sizes of the study, half an hour; a material in half a minute, which is what it is without --quick.
    #[arg(long)]
    full: bool,
    /// Run this probe alone; may be given several times.
    #[arg(long = "probe", value_name = "NAME")]
    probes: Vec<String>,
    /// List the probes and what they provoke, and run none.
    #[arg(long, conflicts_with = "run")]
    list: bool,
    /// Write the figures of the probes that were asked for here as well.
    #[arg(long)]
    json: Option<PathBuf>,
}

impl Watch for Console {
    fn say(&self, line: &str) {
        Console::say(self, line);
    }

    fn flow(&self) -> ControlFlow<()> {
        Console::flow(self)
    }
}

impl Stability {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        super::check_json(self.json.as_deref())?;
        if let Some(run) = &self.run {
            return self.examine(run, console);
        }
        let asked = stability::named(&self.probes)?;
        if self.list {
            let lines: Vec<String> = asked.iter().map(|p| format!("{}: {}", p.name, p.provokes)).collect();
            return console.answer(lines.join("\n"));
        }
        let scale = match (self.quick, self.full) {
            (_, true) => Scale::full(),
            (true, _) => Scale::quick(),
            _ => {
                let problem = "choose --quick (minutes) or --full (half an hour), or name a run to examine";
                return Err(Error::usage(problem));
            }
        };
        let folder = Folder::open(&self.out, &scale)?;
        let mut workshop = Workshop::new(scale, folder, console);
        let report = stability::run(&mut workshop, &asked, &stability::probes())?;
        super::save_json(self.json.as_deref(), &report)?;
        let wrong = report.wrong();
        let root = self.out.display();
        if wrong.is_empty() {
            console.say(format!("{root}: {} probes hold; see STABILITY.md", report.probes.len()));
            return Ok(());
        }
        let problem =
            format!("{} of {} probes do not hold: {}", wrong.len(), report.probes.len(), wrong.join(", "));
        Err(Error::file(self.out.join("STABILITY.md"), problem))
    }

    fn examine(&self, run: &Path, console: &Console) -> Result<()> {
        own::known(&self.probes)?;
        own::free(&self.out, self.force)?;
        let checkpoint = opened(run)?;
        let data = self.data.as_ref().map(Dataset::open).transpose()?;
        let extent = if self.quick { Extent::Quick } else { Extent::Whole };
        let evidence = data.as_ref().map(|data| (data, Splits::All));
        let examination = examined(&checkpoint, evidence, extent, &self.probes, console)?;
        examination.write(&self.out, self.force)?;
        super::save_json(self.json.as_deref(), &examination)?;
        console.answer(examination.table())?;
        console.say(format!("{}: see STABILITY.md", self.out.display()));
        let wrong = |finding: &&own::Finding| finding.verdict == Verdict::Wrong;
        let wrong: Vec<&str> =
            examination.findings.iter().filter(wrong).map(|finding| finding.name).collect();
        match wrong.is_empty() {
            true => Ok(()),
            false => Err(Error::file(self.out.join("STABILITY.md"), format!("wrong: {}", wrong.join(", ")))),
        }
    }
}

/// The checkpoint of a run, a file or a bundle.
fn opened(path: &Path) -> Result<Checkpoint> {
    if !path.exists() {
        return Err(Error::file(path, "no such run, checkpoint or bundle"));
    }
    if path.is_dir() && !path.join("run.json").is_file() {
        if !path.join("golden.json").is_file() {
            return Err(Error::file(
                path,
                "is no run and no bundle: it has neither run.json nor golden.json",
            ));
        }
        return Ok(neumip_export::read_bundle(path)?.checkpoint);
    }
    checkpoint::load(path)
}

fn examined(
    checkpoint: &Checkpoint,
    data: Option<(&Dataset, Splits)>,
    extent: Extent,
    probes: &[String],
    console: &Console,
) -> Result<Examination> {
    let material = FusedMaterial::from_checkpoint(checkpoint)?;
    let subject = Subject::new(&material, checkpoint, extent);
    let subject = match data {
        Some((data, splits)) => subject.with(data, splits)?,
        None => subject,
    };
    own::check(&subject, probes, console)
}

/// The quick form on a finished run: a line, or a warning a finding. Nothing that it meets fails the training.
pub(super) fn after_training(run: &Path, data_path: &Path, data: &Dataset, console: &Console) {
    let done = || -> Result<Examination> {
        let checkpoint = opened(run)?;
        let data = (data, Splits::Validation);
        let examination = examined(&checkpoint, Some(data), Extent::Quick, &[], console)?;
        write_json(&run.join(own::JSON), &examination)?;
        Ok(examination)
    };
    let examination = match done() {
        Ok(examination) => examination,
        Err(problem) => return console.say(format!("stability: not examined: {problem}")),
    };
    let troubles = examination.troubles();
    if troubles.is_empty() {
        return console.say("stability: fine");
    }
    for finding in &troubles {
        console.say(format!("stability: {}: {}: {}", finding.verdict.word(), finding.name, finding.says));
    }
    let (run, data) = (run.display(), data_path.display());
    console.say(format!("stability: `neumip stability {run} --data {data} --out FOLDER` shows more"));
}
