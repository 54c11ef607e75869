//! The command line: one verb a file. Only this module prints.

mod analyze;
mod bench;
mod chart;
mod console;
mod demo;
mod evaluate;
mod export;
mod fit;
mod generate;
mod info;
mod look;
mod render;
mod reproduce;
mod sampler;
mod stability;
mod surface;
mod train;
mod view;

use crate::error::{Error, Result};
use clap::{Parser, Subcommand};
use neumip_export::whole_file::write_json;
use std::path::Path;

/// Neural materials that other renderers can use.
#[derive(Debug, Parser)]
#[command(name = "neumip", version, about, max_term_width = 110)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Threads; by default all cores.
    #[arg(long, global = true)]
    threads: Option<usize>,
    /// Print nothing but errors.
    #[arg(long, global = true)]
    quiet: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// The whole way on a built-in material in a few minutes, ending in report.html.
    Demo(demo::Demo),
    /// Render a contact sheet of materials.
    Look(look::Look),
    /// Render a dataset of a material.
    Generate(generate::Generate),
    /// Train a model on a dataset.
    Train(train::Train),
    /// Error per split and level, and time per query, of one or more trained models.
    Evaluate(evaluate::Evaluate),
    /// Write what another renderer needs.
    Export(export::Export),
    /// Make a page that shows a bundle's material in a browser.
    View(view::View),
    /// Fit an importance sampler to a trained material and measure it beside cosine sampling.
    Sampler(sampler::Sampler),
    /// Render pictures of a scene.
    Render(render::Render),
    /// Find out what a scene asks of its materials.
    Analyze(analyze::Analyze),
    /// Train the smallest model that a scene cannot tell from the full one.
    Fit(fit::Fit),
    /// Fit materials to scenes of every kind and put what it saves in a table.
    FitTable(fit::table::FitTable),
    /// Ask the paper's questions again: tables, ablation, Inception decoder, speed against accuracy.
    Reproduce(reproduce::Reproduce),
    /// Examine a trained material, or show known failures, their cures, and that the cures hold.
    Stability(stability::Stability),
    /// Chart error against time and bytes over all results found.
    Chart(chart::Chart),
    /// How fast this machine trains and answers.
    Bench(bench::Bench),
    /// Say what a checkpoint, run, dataset or bundle is.
    Info(info::Info),
}

impl Cli {
    /// Runs the command.
    ///
    /// # Errors
    /// Whatever the command meets; [`Error::exit_code`] is the process's.
    pub fn run(self) -> Result<()> {
        use_threads(self.threads)?;
        let console = console::Console::new(self.quiet);
        match self.command {
            Command::Demo(command) => command.run(&console),
            Command::Look(command) => command.run(&console),
            Command::Generate(command) => command.run(&console),
            Command::Train(command) => command.run(&console),
            Command::Evaluate(command) => command.run(&console),
            Command::Export(command) => command.run(&console),
            Command::View(command) => command.run(&console),
            Command::Sampler(command) => command.run(&console),
            Command::Render(command) => command.run(&console),
            Command::Analyze(command) => command.run(&console),
            Command::Fit(command) => command.run(&console),
            Command::FitTable(command) => command.run(&console),
            Command::Reproduce(command) => command.run(&console),
            Command::Stability(command) => command.run(&console),
            Command::Chart(command) => command.run(&console),
            Command::Bench(command) => command.run(&console),
            Command::Info(command) => command.run(&console),
        }
    }
}

/// Sets the threads of rayon, over which every command spreads its work, and keeps candle to the thread that calls it: its
/// own pool spins between operations that are smaller than ours and takes the cores from the other chunks.
fn use_threads(threads: Option<usize>) -> Result<()> {
    if let Some(threads) = threads.filter(|t| !(1..=1024).contains(t)) {
        return Err(Error::usage(format!("--threads {threads}: use 1 to 1024")));
    }
    // SAFETY: this runs before any other thread is started, so nothing reads the environment meanwhile.
    unsafe {
        std::env::set_var("CANDLE_NUM_THREADS", "1");
        if let Some(threads) = threads {
            std::env::set_var("RAYON_NUM_THREADS", threads.to_string());
        }
    }
    Ok(())
}

/// Refuses a `--json` that could only fail once the work is done.
fn check_json(path: Option<&Path>) -> Result<()> {
    let Some(path) = path else {
        return Ok(());
    };
    let parent = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if path.is_dir() || path.file_name().is_none() {
        return Err(Error::file(path, "is a folder where the name of a file is wanted"));
    }
    if !parent.is_dir() {
        return Err(Error::file(path, format!("cannot be written: {} is no folder", parent.display())));
    }
    Ok(())
}

/// Writes what `--json` asked for.
fn save_json(path: Option<&Path>, value: &impl serde::Serialize) -> Result<()> {
    match path {
        Some(path) => Ok(write_json(path, value)?),
        None => Ok(()),
    }
}

/// Bytes from a text such as `512M` or `2G`.
fn parse_bytes(text: &str) -> std::result::Result<usize, String> {
    let (digits, factor) = match text.chars().last().map(|c| c.to_ascii_uppercase()) {
        Some('K') => (&text[..text.len() - 1], 1usize << 10),
        Some('M') => (&text[..text.len() - 1], 1 << 20),
        Some('G') => (&text[..text.len() - 1], 1 << 30),
        _ => (text, 1),
    };
    let number: usize = digits.parse().map_err(|_| format!("{text} is no size such as 512M or 2G"))?;
    number
        .checked_mul(factor)
        .filter(|n| *n > 0)
        .ok_or_else(|| format!("{text} is no size such as 512M or 2G"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        use clap::CommandFactory;
        Cli::command().debug_assert();
    }

    #[test]
    fn sizes() {
        assert_eq!(parse_bytes("2G"), Ok(2 << 30));
        assert_eq!(parse_bytes("17"), Ok(17));
        assert!(parse_bytes("2X").is_err() && parse_bytes("").is_err() && parse_bytes("0").is_err());
    }
}
