//! A fit's report as a page of its own.

use super::outcome::{FITTED, FULL, Outcome};
use crate::error::Result;
use crate::report::{self, escaped, figures, filled, picture};
use neumip_export::Precision;

const TEMPLATE: &str = include_str!("page.html");

/// How a storage is called.
pub fn storage(storage: neumip_export::Storage) -> &'static str {
    match (storage.textures, storage.weights) {
        (Precision::Byte, _) => "bytes",
        (_, Precision::Half) => "half floats",
        (Precision::Half, _) => "half-float textures",
        _ => "single precision",
    }
}

/// The page; `sheet` is the picture of all frames as PNG.
///
/// # Errors
/// `Config` if a chart cannot be laid out.
pub fn html(outcome: &Outcome, sheet: &[u8]) -> Result<String> {
    let title = format!("{} fitted to {}", outcome.trained_on, outcome.scene);
    Ok(filled(
        TEMPLATE,
        &[
            ("STYLE", report::STYLE),
            ("TITLE", &escaped(&title)),
            ("VERDICT", &escaped(&verdict(outcome))),
            ("FACTS", &facts(outcome)),
            ("MODELS", &models(outcome)),
            ("SHEET", &picture::data_uri(sheet)),
            ("PICTURES", &pictures(outcome)),
            ("FRONT", &front(outcome)?),
            ("TRIALS", &trials(outcome)),
            ("ELSEWHERE", &elsewhere(outcome)),
        ],
    ))
}

/// One sentence that says what came out.
pub fn verdict(outcome: &Outcome) -> String {
    let Some([bytes, ns, error]) = outcome.savings() else { return String::new() };
    let metric = outcome.goal.metric().name();
    let mut text = format!("{bytes:.1} times fewer bytes, {ns:.2} times fewer ns");
    // Where the full model is the truth it has no error.
    if error.is_finite() {
        text += &format!(", {metric} {error:.3} of the full model's");
    }
    if let (Some(bound), Some(row)) = (outcome.bound, outcome.row(FITTED)) {
        let reached = outcome.goal.metric().of(&row.errors).unwrap_or(f64::NAN);
        let held = if outcome.holds { "held" } else { "NOT held" };
        text += &format!("; the bound {metric} {bound:.4} is {held} ({reached:.4})");
    }
    if let Some(trainings) = outcome.trainings {
        text += &format!("; the search took {trainings:.2} trainings of the full model");
    }
    text
}

fn row(cells: &[String]) -> String {
    format!(
        "<tr>{}</tr>\n",
        cells.iter().map(|cell| format!("<td>{}</td>", escaped(cell))).collect::<String>()
    )
}

fn facts(outcome: &Outcome) -> String {
    let need = &outcome.need;
    let part = (need.size[0] * need.size[1]) as f64 / (need.tile[0] * need.tile[1]) as f64;
    let angle = |cosine: f32| cosine.clamp(-1.0, 1.0).acos().to_degrees();
    let all = [
        ("levels that are asked", format!("{:.2} to {:.2}", need.levels[0], need.levels[1])),
        (
            "part of the tile",
            format!(
                "{:.3}: {} x {} of {} x {} texels",
                part, need.size[1], need.size[0], need.tile[1], need.tile[0]
            ),
        ),
        ("pixels that a tile spans, at most", format!("{:.0}", need.span)),
        ("light within", format!("{:.1} degrees of its mean", angle(need.wi.cosine))),
        ("seen within", format!("{:.1} degrees of the mean view", angle(need.wo.cosine))),
        ("truth", outcome.truth.clone()),
        (
            "training samples",
            format!("{}, {:.0} % of them anywhere", outcome.unique_samples, 100.0 * outcome.floor),
        ),
        ("pictures", format!("{} of {:.0} queries", outcome.pictures, outcome.queries_per_picture)),
        ("measuring", format!("{:.1} s", outcome.measuring_seconds)),
        (
            "search",
            format!("{:.1} s of training, {} samples", outcome.search_seconds, outcome.search_samples),
        ),
    ];
    all.into_iter().map(|(name, value)| row(&[name.into(), value])).collect()
}

fn models(outcome: &Outcome) -> String {
    let number = |value: Option<f64>| value.map_or("-".into(), |v| format!("{v:.4}"));
    let each = outcome.rows.iter().map(|r| {
        row(&[
            r.name.clone(),
            r.shape.clone(),
            storage(r.storage).into(),
            r.bytes.to_string(),
            r.flops.to_string(),
            format!("{:.1} ({:.1} to {:.1})", r.cost.ns_per_query, r.cost.ns_low, r.cost.ns_high),
            format!("{:.2}", r.frame_ms),
            format!("{:.1}", r.training_seconds),
            number(r.errors.flip),
            format!("{:.3}", 1e3 * r.errors.mse),
            number(r.errors.ssim),
        ])
    });
    each.collect()
}

fn pictures(outcome: &Outcome) -> String {
    let count = outcome.rows.first().map_or(0, |row| row.pictures.len());
    let cells = |k: usize| {
        let mut cells = vec![k.to_string()];
        for row in &outcome.rows {
            cells.push(row.pictures.get(k).and_then(|c| c.flip).map_or("-".into(), |v| format!("{v:.4}")));
        }
        row(&cells)
    };
    (0..count).map(cells).collect()
}

/// Error against expected nanoseconds: the last trial of every candidate.
fn front(outcome: &Outcome) -> Result<String> {
    let metric = outcome.goal.metric();
    let mut marks: Vec<figures::Mark> = Vec::new();
    for trial in outcome.trials.iter().rev() {
        // Names of marks are short.
        let name = trial.shape.replace(" offset ", "+");
        if marks.iter().any(|mark| mark.name == name) {
            continue;
        }
        let y = match metric {
            super::goal::Metric::Flip => trial.flip.unwrap_or(f64::NAN),
            super::goal::Metric::Mse => trial.mse,
        };
        marks.push(figures::Mark { name, x: trial.ns, y, spread: None });
    }
    if let (Some(full), Some(bound)) = (outcome.row(FULL), metric_of(outcome)) {
        marks.push(figures::Mark { name: FULL.into(), x: full.cost.ns_per_query, y: bound, spread: None });
    }
    let label = format!("{} of the pictures that choices are made on", metric.name());
    Ok(figures::scatter(&marks, "nanoseconds a query, expected", &label)?.unwrap_or_default())
}

fn metric_of(outcome: &Outcome) -> Option<f64> {
    outcome.goal.metric().of(&outcome.row(FULL)?.errors).ok()
}

fn trials(outcome: &Outcome) -> String {
    let each = outcome.trials.iter().map(|trial| {
        row(&[
            trial.shape.clone(),
            trial.rung.to_string(),
            trial.samples.to_string(),
            format!("{:.1}", trial.seconds),
            trial.bytes.to_string(),
            format!("{:.0}", trial.ns),
            trial.flip.map_or("-".into(), |v| format!("{v:.4}")),
            format!("{:.3}", 1e3 * trial.mse),
        ])
    });
    each.collect()
}

fn thousandths(mse: Option<f64>) -> String {
    mse.map_or("-".into(), |mse| format!("{:.3}", 1e3 * mse))
}

fn elsewhere(outcome: &Outcome) -> String {
    let each = outcome.elsewhere.iter().flat_map(|split| {
        ["inside", "outside"].into_iter().enumerate().map(|(k, place)| {
            row(&[
                split.split.clone(),
                place.into(),
                split.queries[k].to_string(),
                thousandths(split.full[k]),
                thousandths(split.fitted[k]),
            ])
        })
    });
    each.collect()
}
