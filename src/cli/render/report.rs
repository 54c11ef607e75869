//! What a rendering took and how well it did, as JSON and as text.

use super::super::console::short;
use super::Finished;
use crate::outside::Count;
use crate::render::Scene;
use crate::render::compare::Comparison;
use serde::Serialize;
use std::path::Path;

/// What `--json` says.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    scene: String,
    identity: String,
    materials: Vec<MaterialRow>,
    width: usize,
    height: usize,
    samples: usize,
    bounces: usize,
    seed: u64,
    threads: usize,
    /// Of the frames that were rendered now.
    queries: u64,
    seconds: f64,
    /// Of all time, and of the time of answering.
    queries_per_second: f64,
    answers_per_second: f64,
    /// The mean over frames.
    #[serde(skip_serializing_if = "Option::is_none")]
    comparison: Option<Comparison>,
    frames: Vec<FrameRow>,
}

#[derive(Debug, Serialize)]
struct MaterialRow {
    name: String,
    is: String,
    /// Of a fitted material: queries of the frames that were rendered now that it was not fitted for.
    #[serde(skip_serializing_if = "Option::is_none")]
    outside: Option<Count>,
}

#[derive(Debug, Serialize)]
struct FrameRow {
    frame: usize,
    /// Finished by an earlier run: nothing is known of its cost.
    kept: bool,
    rays: u64,
    queries: u64,
    seconds: f64,
    tracing_seconds: f64,
    answering_seconds: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    comparison: Option<Comparison>,
}

impl Report {
    pub fn new(name: &str, scene: &Scene, seed: u64, frames: &[Finished]) -> Self {
        let camera = &scene.file.camera;
        let rows: Vec<FrameRow> = frames.iter().map(row).collect();
        let sum = |value: fn(&FrameRow) -> f64| rows.iter().map(value).sum::<f64>();
        let queries = rows.iter().map(|row| row.queries).sum::<u64>();
        let rate = |seconds: f64| if seconds > 0.0 { queries as f64 / seconds } else { 0.0 };
        let compared: Option<Vec<Comparison>> = frames.iter().map(|frame| frame.comparison.clone()).collect();
        let material = |(k, m): (usize, &crate::render::Material)| {
            let mut outside: Option<Count> = None;
            for count in frames.iter().filter_map(|frame| frame.outside.get(k)?.as_ref()) {
                outside.get_or_insert_default().join(count);
            }
            MaterialRow { name: m.name.clone(), is: m.described.clone(), outside }
        };
        Self {
            scene: name.into(),
            identity: scene.identity.clone(),
            materials: scene.materials.iter().enumerate().map(material).collect(),
            width: camera.width,
            height: camera.height.unwrap_or(camera.width),
            samples: camera.samples,
            bounces: scene.file.bounces,
            seed,
            threads: rayon::current_num_threads(),
            queries,
            seconds: sum(|row| row.seconds),
            queries_per_second: rate(sum(|row| row.seconds)),
            answers_per_second: rate(sum(|row| row.answering_seconds)),
            comparison: compared.and_then(|frames| Comparison::mean(&frames)),
            frames: rows,
        }
    }

    /// What was done, in a line.
    pub fn summary(&self, out: &Path) -> String {
        let kept = self.frames.iter().filter(|row| row.kept).count();
        let plural = if self.frames.len() == 1 { "" } else { "s" };
        let frames = format!("{} x {}, {} frame{plural}", self.width, self.height, self.frames.len());
        if kept == self.frames.len() {
            return format!("{}: {frames}, finished before", out.display());
        }
        let kept = if kept > 0 { format!(", {kept} finished before") } else { String::new() };
        format!(
            "{}: {frames}{kept}; {} in {:.1} s, {}/s ({}/s while answering)",
            out.display(),
            short(self.queries as f64, "queries"),
            self.seconds,
            short(self.queries_per_second, "queries"),
            short(self.answers_per_second, "queries"),
        )
    }

    /// How many queries each fitted material was not fitted for, a line each.
    pub fn outside(&self) -> impl Iterator<Item = String> {
        self.materials.iter().filter_map(|material| {
            let count = material.outside.as_ref()?;
            Some(format!("{}: outside of what it was fitted for: {}", material.name, count.described()))
        })
    }

    /// The errors of the frames as text, if they were compared.
    pub fn table(&self) -> Option<String> {
        let mean = self.comparison.as_ref()?;
        let number = |v: Option<f64>, digits: usize| v.map_or("-".to_string(), |v| format!("{v:.digits$}"));
        let line = |name: String, c: &Comparison| {
            format!(
                "{name:>5} {:>10.4} {:>7} {:>6} {:>6} {:>10}",
                1e3 * c.mse,
                number(c.psnr, 2),
                number(c.ssim, 3),
                number(c.flip, 3),
                number(c.noise.map(|v| 1e3 * v), 4)
            )
        };
        let mut lines = vec![format!(
            "{:>5} {:>10} {:>7} {:>6} {:>6} {:>10}",
            "frame", "mse", "psnr", "ssim", "flip", "noise"
        )];
        let rows = self.frames.iter();
        lines.extend(rows.filter_map(|row| Some(line(row.frame.to_string(), row.comparison.as_ref()?))));
        lines.push(line("mean".into(), mean));
        lines.push(
            "mse and noise x 10^3; mse of linear RGB clamped to [0, 1]; noise: what the reference's own rays add to it"
                .into(),
        );
        Some(lines.join("\n"))
    }
}

fn row(frame: &Finished) -> FrameRow {
    let cost = frame.cost.unwrap_or_default();
    FrameRow {
        frame: frame.index,
        kept: frame.cost.is_none(),
        rays: cost.rays,
        queries: cost.queries,
        seconds: cost.total.as_secs_f64(),
        tracing_seconds: cost.tracing.as_secs_f64(),
        answering_seconds: cost.answering.as_secs_f64(),
        comparison: frame.comparison.clone(),
    }
}
