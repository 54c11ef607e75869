//! The same material in smaller numbers, on other instruction sets and in candle.

use super::finding::{Bounds, Seen};
use super::numbers::worst;
use super::pictures::{Panel, strip};
use super::subject::{Pair, Questions, Subject, energy, minus};
use super::{Check, Needs};
use crate::engine::FusedMaterial;
use crate::error::{Error, Result};
use crate::golden::TOLERANCE;
use crate::kernels::simd::Isa;
use crate::model::NeuralMaterial;
use crate::query::{QueryBuffer, Reflectance};
use candle_core::Device;
use neumip_export::checkpoint::Checkpoint;
use neumip_export::{Precision, Storage};

/// Stream of what is drawn.
const QUERIES: u64 = 12;

pub(super) fn checks() -> Vec<Check> {
    vec![
        Check {
            name: "half-floats",
            measures: "root mean square of what half floats change, textures and weights, over that of the answers",
            bounds: Bounds {
                watch: 0.01,
                wrong: Some(0.1),
                reason: "a hundredth is below what training leaves; a tenth is seen",
            },
            needs: Needs::Checkpoint,
            run: |subject| rounded(subject, Storage::HALF),
        },
        Check {
            name: "bytes",
            measures: "root mean square of what byte textures and half weights change, over that of the answers",
            bounds: Bounds {
                watch: 0.1,
                wrong: None,
                reason: "bytes are a choice of the export and never the default; beyond a tenth they are seen",
            },
            needs: Needs::Checkpoint,
            run: |subject| rounded(subject, Storage::BYTE),
        },
        Check {
            name: "engines",
            measures: "largest |difference| / (1 + |value|) between instruction sets, and of candle",
            bounds: Bounds {
                watch: TOLERANCE,
                wrong: Some(50.0 * TOLERANCE),
                reason: "golden answers of bundles have this tolerance; fifty times more is seen in gradients of the sky",
            },
            needs: Needs::Checkpoint,
            run: engines,
        },
    ]
}

fn known<'a>(subject: &Subject<'a>) -> Result<&'a Checkpoint> {
    subject.checkpoint.ok_or_else(|| Error::config("checkpoint", "is not known"))
}

fn queries(subject: &Subject, count: usize) -> Questions {
    let mut questions = Questions::default();
    for (k, pair) in subject.pairs(count).into_iter().enumerate() {
        let mut random = Subject::random(QUERIES, k);
        let u = [random.uniform(), random.uniform()];
        questions.push(u, pair, random.uniform() * subject.coarsest as f32);
    }
    questions
}

fn rounded(subject: &Subject, storage: Storage) -> Result<Seen> {
    let checkpoint = known(subject)?;
    let small = FusedMaterial::from_checkpoint(&storage.round(checkpoint.clone())?)?;
    let small = Subject { material: &small, ..*subject };
    let questions = queries(subject, subject.choose(1 << 15, 1 << 18));
    let (exact, near) = (subject.ask(questions.clone())?, small.ask(questions.clone())?);
    let apart: Vec<f64> = exact.iter().zip(&near).map(|(a, b)| energy(minus(*a, *b))).collect();
    let own: f64 = exact.iter().map(|p| energy(*p)).sum();
    let figure = if own > 0.0 { (apart.iter().sum::<f64>() / own).sqrt() } else { 0.0 };
    let order = worst(&apart);
    let places: Vec<_> = order.iter().map(|(k, value)| questions.place(*k, value.sqrt())).collect();
    let picture = match places.first() {
        Some(place) => {
            let pair = Pair { wi: place.wi, wo: place.wo };
            let (a, b) = (subject.tile(pair, 0)?, small.tile(pair, 0)?);
            let png = strip(&[Panel::Light(&a), Panel::Light(&b), Panel::Apart(&a, &b)])?;
            Some(("The tile at level 0 as trained, as stored, the difference.".to_string(), png))
        }
        None => None,
    };
    let (name, change) = match storage.textures {
        Precision::Byte => ("bytes", "export without --int8"),
        _ => ("half floats", "export in 32-bit floats, without --half and --half-textures"),
    };
    Ok(Seen {
        figure,
        says: format!("stored in {name} answers change by {:.2} % of themselves", 100.0 * figure),
        change: change.into(),
        places,
        picture,
        ..Seen::default()
    })
}

fn engines(subject: &Subject) -> Result<Seen> {
    let checkpoint = known(subject)?;
    let architecture = &checkpoint.header.architecture;
    let questions = queries(subject, subject.choose(1 << 12, 1 << 15));
    let buffer: QueryBuffer = questions.clone().buffer()?;
    let expected = subject.ask(questions.clone())?;
    let mut all: Vec<(String, Box<dyn Reflectance>)> = Vec::new();
    for isa in Isa::all() {
        let material = FusedMaterial::new(architecture, &checkpoint.tensors, Precision::Single, isa)?;
        all.push((isa.name().into(), Box::new(material)));
    }
    all.push(("candle".into(), Box::new(NeuralMaterial::from_checkpoint(checkpoint, &Device::Cpu)?)));
    let mut seen = Seen::default();
    for (name, material) in &all {
        let answers = material.evaluate(&buffer)?.pixels;
        let apart = |(a, b): (&[f32; 3], &[f32; 3])| {
            let channel = |c: usize| f64::from((a[c] - b[c]).abs()) / f64::from(1.0 + b[c].abs());
            channel(0).max(channel(1)).max(channel(2))
        };
        let apart: Vec<f64> = answers.iter().zip(&expected).map(apart).collect();
        let Some((k, largest)) = worst(&apart).first().copied() else { continue };
        seen.values.insert(name.clone(), largest);
        if largest > seen.figure {
            (seen.figure, seen.places) = (largest, vec![questions.place(k, largest)]);
        }
    }
    let names: Vec<&str> = all.iter().map(|(name, _)| name.as_str()).collect();
    Ok(Seen {
        says: format!("{} agree to {:.1e}", names.join(", "), seen.figure),
        change: "answers of more than 1000, or weights of more than 100, lose their last digits: train with a lower --learning-rate".into(),
        ..seen
    })
}
