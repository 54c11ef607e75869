//! `neumip bench`.

use super::console::{Console, short};
use crate::bench::{DEFAULT, Kind, Options, Row, Subject, run};
use crate::config::{Config, EngineKind};
use crate::error::Result;
use clap::Args;
use neumip_export::onnx;
use neumip_export::whole_file::write_whole;
use std::path::PathBuf;

/// Samples of a step, queries of a call.
const BATCHES: [usize; 4] = [2_048, 16_384, 65_536, 262_144];
const RESOLUTION: usize = 512;
const ROUNDS: usize = 7;
/// Least seconds of one timing: a hundred times what a thread is kept waiting for.
const SECONDS: f64 = 0.05;

/// How fast this machine trains and answers: every instruction set, beside plain candle and the machine's own peak.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  neumip bench --json bench.json --markdown bench.md\n  \
    neumip bench --work train --batches 65536 --preset improved --resolution 128\n\n\
    All that does equal work is timed in turn, round by round; medians are shown with the slowest and the fastest round.")]
pub struct Bench {
    /// Kinds of work.
    #[arg(long, value_delimiter = ',', default_value = "train,infer")]
    work: Vec<Kind>,
    /// Samples of a step, queries of a call: multiples of 256 [default: 2048,16384,65536,262144].
    #[arg(long, value_delimiter = ',')]
    batches: Vec<usize>,
    /// Model and losses of a preset or preset file instead of NeuMIP's networks with the paper's encodings.
    #[arg(long)]
    preset: Option<String>,
    /// Texels along a side of the tile [default: 512].
    #[arg(long)]
    resolution: Option<usize>,
    /// Rounds, after one that warms up [default: 7].
    #[arg(long)]
    rounds: Option<usize>,
    /// Numbers of threads [default: 1 and all cores, or --threads].
    #[arg(long, value_delimiter = ',')]
    thread_counts: Vec<usize>,
    /// sigma of the smoothed textures, in texels.
    #[arg(long, default_value_t = 1.0)]
    sigma: f64,
    /// Steps between two updates of the textures, in the rows where they are not updated at every step.
    #[arg(long, default_value_t = 16)]
    texture_every: u64,
    /// One round of a small batch at 128 x 128: whether it works, not how fast it is.
    #[arg(long)]
    quick: bool,
    /// Only the fused engine on the instruction set in use, without smoothing: what other programs are compared with.
    #[arg(long)]
    bare: bool,
    /// Write the model that is timed here as an ONNX graph, for other programs.
    #[arg(long)]
    onnx: Option<PathBuf>,
    /// Write the table here as Markdown.
    #[arg(long)]
    markdown: Option<PathBuf>,
    /// Write the rows here.
    #[arg(long)]
    json: Option<PathBuf>,
}

impl Bench {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        for path in [&self.json, &self.markdown, &self.onnx] {
            super::check_json(path.as_deref())?;
        }
        let options = self.options()?;
        options.validate()?;
        if let Some(path) = &self.onnx {
            write_whole(
                path,
                &onnx::material_graph(&options.subject.checkpoint()?, onnx::Options::default())?,
            )?;
        }
        // In thousandths of a percent.
        const PARTS: f64 = 100_000.0;
        let mut meter = console.meter("bench", PARTS as u64, "parts");
        let rows = run(&options, &mut |share, label| {
            meter.show((share * PARTS) as u64, label);
            console.flow()
        });
        meter.finish(PARTS as u64);
        let rows = rows?;
        super::save_json(self.json.as_deref(), &rows)?;
        if let Some(path) = &self.markdown {
            write_whole(path, markdown(&rows).as_bytes())?;
        }
        console.answer(text_table(&options, &rows))
    }

    fn options(&self) -> Result<Options> {
        let or = |given: &[usize], otherwise: Vec<usize>| match given {
            [] => otherwise,
            given => given.to_vec(),
        };
        let resolution = self.resolution.unwrap_or(if self.quick { 128 } else { RESOLUTION });
        let subject = match &self.preset {
            Some(name) => Subject::preset(name, Config::preset(name)?, resolution)?,
            None => Subject::standard(resolution)?,
        };
        let mut threads = vec![1, rayon::current_num_threads()];
        threads.dedup();
        Ok(Options {
            subject,
            kinds: self.work.clone(),
            batches: or(&self.batches, if self.quick { vec![BATCHES[0]] } else { BATCHES.into() }),
            threads: or(&self.thread_counts, threads),
            rounds: self.rounds.unwrap_or(if self.quick { 1 } else { ROUNDS }),
            sigma: self.sigma,
            texture_every: self.texture_every,
            bare: self.bare,
            seconds: if self.quick { 0.0 } else { SECONDS },
        })
    }
}

/// What a row says, but for its numbers: work, engine with its set, batch, threads, smoothing.
fn names(row: &Row) -> [String; 5] {
    let engine = match row.engine {
        EngineKind::Fused => row.isa.clone(),
        EngineKind::Candle => "candle".into(),
    };
    [row.work.clone(), row.batch.to_string(), engine, row.threads.to_string(), row.smoothing.clone()]
}

/// Its numbers: samples a second, their spread, ratio to candle, useful GFLOP/s, share of the peak.
fn numbers(row: &Row) -> [String; 5] {
    [
        short(row.samples_per_s, "").trim_end().to_string(),
        format!("{} to {}", short(row.low, "").trim_end(), short(row.high, "").trim_end()),
        row.ratio_to_candle.map_or("-".into(), |r| format!("{r:.1}")),
        format!("{:.1}", row.useful_gflops),
        format!("{:.1} %", 100.0 * row.peak_share),
    ]
}

const HEADINGS: [&str; 10] = [
    "work",
    "batch",
    "set",
    "threads",
    "smoothing",
    "samples/s",
    "slowest to fastest",
    "x candle",
    "GFLOP/s",
    "of peak",
];
/// Of these columns the numbers end in one line.
const TO_THE_RIGHT: [bool; 10] = [false, true, false, true, false, true, true, true, true, true];

fn cells(row: &Row) -> Vec<String> {
    names(row).into_iter().chain(numbers(row)).collect()
}

/// The table as text, columns aligned, with what was timed above and the notes below.
fn text_table(options: &Options, rows: &[Row]) -> String {
    let architecture = &options.subject.architecture;
    let name = if options.subject.name == DEFAULT { "the default model" } else { &options.subject.name };
    let mut out = format!(
        "{name} at {} x {}: {} weights, {} FLOPs a query; medians of {} rounds\n\n",
        architecture.resolution[0],
        architecture.resolution[1],
        architecture.network_weights(),
        architecture.flops_per_query(),
        options.rounds
    );
    let mut lines = vec![HEADINGS.map(String::from).to_vec()];
    lines.extend(rows.iter().map(cells));
    let width = |column: usize| lines.iter().map(|line| line[column].len()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..HEADINGS.len()).map(width).collect();
    for line in &lines {
        let aligned = line.iter().zip(&widths).zip(TO_THE_RIGHT).map(|((cell, width), right)| {
            if right { format!("{cell:>width$}") } else { format!("{cell:<width$}") }
        });
        out += aligned.collect::<Vec<_>>().join("  ").trim_end();
        out.push('\n');
    }
    for row in rows.iter().filter(|r| r.threads == 1) {
        if let Some(ratio) = row.ratio_to_whole {
            out += &format!("\n{}: {ratio:.2} times as fast as whole answers, one thread", row.work);
        }
    }
    let mut peaks: Vec<(usize, f64)> = rows.iter().map(|r| (r.threads, r.peak_gflops)).collect();
    peaks.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    for of_threads in peaks.chunk_by(|a, b| a.0 == b.0) {
        // The middle one: a group's peak is measured in its own rounds.
        let (threads, peak) = of_threads[of_threads.len() / 2];
        out += &format!(
            "\npeak on {threads} {}: {peak:.0} GFLOP/s",
            if threads == 1 { "thread" } else { "threads" }
        );
    }
    let fewer = rows.iter().find(|r| r.rounds < options.rounds);
    if let Some(row) = fewer {
        out += &format!("\ncandle at {} and more: {} rounds", row.batch, row.rounds);
    }
    out += "\nGFLOP/s: unpadded multiply-adds of the networks x 2, of training x 3; peak: multiply-adds in registers";
    out
}

/// The table as Markdown.
fn markdown(rows: &[Row]) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    let mut out = line(&HEADINGS.map(String::from));
    out += &line(&TO_THE_RIGHT.map(|right| if right { "---:" } else { "---" }.into()));
    rows.iter().for_each(|row| out += &line(&cells(row)));
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(work: &str, threads: usize) -> Row {
        Row {
            work: work.into(),
            engine: EngineKind::Fused,
            isa: "portable".into(),
            batch: 2048,
            threads,
            smoothing: "none".into(),
            samples_per_s: 2.345e6,
            low: 2e6,
            high: 2.5e6,
            rounds: 7,
            ratio_to_candle: Some(12.34),
            ratio_to_whole: work.starts_with("lights").then_some(1.5),
            useful_gflops: 18.3,
            peak_gflops: 100.0,
            isa_peak_gflops: 30.0,
            peak_share: 0.183,
            resolution: [512; 2],
            model: DEFAULT.into(),
        }
    }

    #[test]
    fn tables_have_a_line_a_row() {
        let rows = [row("train", 1), row("lights-16", 1), row("infer", 2)];
        let text = markdown(&rows);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 2 + rows.len());
        assert_eq!(
            lines[2],
            "| train | 2048 | portable | 1 | none | 2.35 M | 2.00 M to 2.50 M | 12.3 | 18.3 | 18.3 % |"
        );
        assert!(lines.iter().all(|line| line.matches('|').count() == HEADINGS.len() + 1));
    }

    #[test]
    fn batches_come_from_the_command_line_or_from_what_is_asked_for() {
        use clap::Parser;
        #[derive(Parser)]
        struct Line {
            #[command(flatten)]
            bench: Bench,
        }
        let options = |line: &str| {
            let words = std::iter::once("bench").chain(line.split_whitespace());
            Line::try_parse_from(words).unwrap().bench.options().unwrap()
        };
        assert_eq!(options("").batches, BATCHES);
        assert_eq!(options("--quick").batches, [2048]);
        assert_eq!(options("--quick --batches 256,512 --rounds 2").batches, [256, 512]);
        assert_eq!(options("--thread-counts 3,1").threads, [3, 1]);
        assert_eq!(options("--work infer").kinds, [Kind::Infer]);
        let of_preset = options("--preset improved --resolution 64").subject;
        assert_eq!((of_preset.name.as_str(), of_preset.architecture.resolution), ("improved", [64, 64]));
        assert!(options("--batches 0").validate().is_err());
    }
}
