//! `neumip stability`.

use super::console::Console;
use crate::error::{Error, Result};
use crate::stability::{self, Folder, Scale, Watch, Workshop};
use clap::Args;
use std::ops::ControlFlow;
use std::path::PathBuf;

/// Show the known failures of these methods, their cures, and that the cures hold.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  neumip stability --quick --out stability\n  \
    neumip stability --full --out stability-full\n  \
    neumip stability --quick --probe root-slope --out stability")]
pub struct Stability {
    /// The suite's folder; what is finished there is not run again.
    #[arg(long, default_value = "stability")]
    out: PathBuf,
    /// Small tiles and short trainings, a few minutes.
    #[arg(long, conflicts_with = "full")]
    quick: bool,
    /// The sizes of the study, about an hour.
    #[arg(long)]
    full: bool,
    /// Run this probe alone; may be given several times.
    #[arg(long = "probe", value_name = "NAME")]
    probes: Vec<String>,
    /// List the probes and what they provoke, and run none.
    #[arg(long)]
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
        let asked = stability::named(&self.probes)?;
        if self.list {
            let lines: Vec<String> = asked.iter().map(|p| format!("{}: {}", p.name, p.provokes)).collect();
            return console.answer(lines.join("\n"));
        }
        let scale = match (self.quick, self.full) {
            (_, true) => Scale::full(),
            (true, _) => Scale::quick(),
            _ => return Err(Error::usage("choose --quick (minutes) or --full (about an hour)")),
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
}
