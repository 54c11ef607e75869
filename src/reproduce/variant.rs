//! What is compared: presets with fields changed, under a label.

use super::study::Study;
use crate::analytic::MapsConfig;
use crate::config::Config;
use crate::error::Result;
use serde_json::json;

/// A model of the comparison.
#[derive(Clone, Debug, PartialEq)]
pub struct Variant {
    /// Name in tables and charts.
    pub label: String,
    /// Preset that it starts from.
    pub preset: String,
    /// Fields that are set, as `--set` takes them.
    pub set: Vec<String>,
    /// The preset's tuning is used.
    pub tuned: bool,
    /// Its textures in half precision are measured too, under the label with `-f16`.
    pub half: bool,
    /// Nothing is trained: the material's own maps are marched and shaded, and the fields above have no part in it.
    pub maps: Option<MapsConfig>,
}

impl Variant {
    /// A preset as it is.
    pub fn preset(name: &str) -> Self {
        let label =
            std::path::Path::new(name).file_stem().map_or(name.into(), |s| s.to_string_lossy().into());
        Self { label, preset: name.into(), set: Vec::new(), tuned: true, half: false, maps: None }
    }

    fn changed(preset: &str, label: String, set: Vec<String>) -> Self {
        Self { label, preset: preset.into(), set, tuned: true, half: true, maps: None }
    }

    /// The rival that is not neural.
    fn maps(config: MapsConfig) -> Self {
        let MapsConfig { view_steps, shadow_steps, rays, .. } = config;
        let rays = if rays > 1 { format!("-rays-{}", rays * rays) } else { String::new() };
        let shadow = if shadow_steps == view_steps { String::new() } else { format!("-{shadow_steps}") };
        let label = format!("maps-{view_steps}{shadow}{rays}");
        Self { tuned: false, maps: Some(config), ..Self::preset(&label) }
    }

    /// The configuration of what is trained.
    ///
    /// # Errors
    /// As [`Config::preset`] and [`Config::set`].
    pub fn config(&self) -> Result<Config> {
        let mut config = Config::preset(&self.preset)?;
        self.set.iter().try_for_each(|field| config.set(field))?;
        Ok(config)
    }
}

/// Widths of the chart's decoders; 25 is every preset's own.
const WIDTHS: [usize; 4] = [8, 16, 40, 64];
/// Channels of the chart's textures; 7 is every preset's own.
const CHANNELS: [usize; 3] = [3, 5, 12];
/// Finest levels of the chart's textures, with the names of their resolutions.
const FINEST: [(usize, &str); 2] = [(1, "half"), (2, "quarter")];
/// Steps of the view ray and of the shadow ray, and rays along a side of the footprint, of the maps that are marched.
const MARCHES: [(usize, usize, usize); 4] = [(4, 4, 1), (8, 8, 1), (16, 16, 1), (16, 16, 2)];
/// The families whose sizes are varied.
const FAMILIES: [&str; 2] = ["neumip", "improved"];

/// The variants of the speed and accuracy chart: both families in several sizes, and the encodings on their own.
pub fn of_chart() -> Vec<Variant> {
    let mut all = Vec::new();
    for family in FAMILIES {
        all.push(Variant { half: true, ..Variant::preset(family) });
        for width in WIDTHS {
            let set = vec![format!("model.decoder.hidden=[{width},{width},{width}]")];
            all.push(Variant::changed(family, format!("{family}-w{width}"), set));
        }
        for channels in CHANNELS {
            let set = vec![format!("model.texture.channels={channels}")];
            all.push(Variant::changed(family, format!("{family}-c{channels}"), set));
        }
        for (finest, name) in FINEST {
            let set = vec![format!("model.texture.finest={finest}")];
            all.push(Variant::changed(family, format!("{family}-{name}"), set));
        }
        let small = ["model.decoder.hidden=[16,16]", "model.texture.channels=4"].map(String::from);
        all.push(Variant::changed(family, format!("{family}-w16x2-c4"), small.into()));
    }
    all.push(Variant { half: true, ..Variant::preset("paper") });
    let gamma = json!({ "bands": 4, "raw": true, "amplitude": 0.25 });
    let encodings = [
        ("improved-gamma-all", ["wi", "wo"].map(|w| format!("model.encoding.{w}={gamma}")).to_vec()),
        ("improved-no-gamma", vec!["model.encoding.u.bands=0".to_string()]),
        ("improved-no-offset", vec![r#"model.parallax={"kind":"none"}"#.to_string()]),
    ];
    all.extend(encodings.map(|(label, set)| Variant::changed("improved", label.into(), set)));
    all.extend(MARCHES.map(|(view_steps, shadow_steps, rays)| {
        Variant::maps(MapsConfig { view_steps, shadow_steps, rays, ..MapsConfig::default() })
    }));
    all
}

/// Input encodings of the ablation.
pub const ENCODINGS: [&str; 3] = ["off", "paper", "code"];
/// Images that its gradient loss is taken on.
pub const GRADIENTS: [&str; 2] = ["linear", "root"];
/// Its schedules of losses.
pub const STAGES: [&str; 5] = ["none", "s1", "s2", "s3", "adaptive"];

/// First word of the labels of the ablation's cells.
pub const ABLATION: &str = "ablation";

/// Label of a cell of the ablation.
pub fn ablation_label(encoding: &str, gradient: &str, stages: &str) -> String {
    format!("{ABLATION} {encoding} {gradient} {stages}")
}

/// The factorial of figure 3. Without a gradient loss there is nothing to stage (section 3.3 stages that loss), so those
/// cells are void and left out.
pub fn of_ablation(study: &Study) -> Vec<Variant> {
    let mut all = Vec::new();
    for encoding in ENCODINGS {
        all.push(ablation(study, encoding, "off", "none"));
        for gradient in GRADIENTS {
            all.extend(STAGES.iter().map(|stages| ablation(study, encoding, gradient, stages)));
        }
    }
    all
}

/// One cell: `improved`'s training, the encoding and the losses of the cell.
fn ablation(study: &Study, encoding: &str, gradient: &str, stages: &str) -> Variant {
    let encoding_value = match encoding {
        "paper" => json!({
            "pi": true, "components": 2,
            "u": { "bands": 10, "limit_to_resolution": false, "attenuate": false, "raw": false },
            "wi": { "bands": 4, "raw": false, "amplitude": 1.0 },
            "wo": { "bands": 4, "raw": false, "amplitude": 1.0 },
        }),
        "code" => json!({
            "pi": false, "components": 3,
            "u": { "bands": 10, "limit_to_resolution": false, "attenuate": false, "raw": true },
            "wi": { "bands": 4, "raw": true, "amplitude": 1.0 },
            "wo": { "bands": 4, "raw": true, "amplitude": 1.0 },
        }),
        _ => json!({
            "pi": true, "components": 2,
            "u": { "bands": 0, "limit_to_resolution": false, "attenuate": false, "raw": false },
            "wi": { "bands": 0, "raw": true, "amplitude": 1.0 },
            "wo": { "bands": 0, "raw": true, "amplitude": 1.0 },
        }),
    };
    let stages_value = losses(gradient, stages, study.gradient_weight);
    Variant {
        label: ablation_label(encoding, gradient, stages),
        preset: "improved".into(),
        set: vec![format!("model.encoding={encoding_value}"), format!("train.stages={stages_value}")],
        tuned: false,
        half: false,
        maps: None,
    }
}

/// The losses of a cell. The pixel loss is L1 as printed, on 4th roots where a schedule has it so; the 4th roots are
/// signed, since neither printed form can be trained from the start at any learning rate.
fn losses(gradient: &str, stages: &str, weight: f64) -> serde_json::Value {
    let root = json!({ "root4-signed": 1e-3 });
    let square_root = json!({ "sqrt": 1e-3 });
    let l1 = |remap: &serde_json::Value| json!({ "kind": "l1", "remap": remap, "weight": 1.0 });
    let linear = json!("linear");
    let of_gradient = match gradient {
        "linear" => Some(json!({ "kind": "gradient", "remap": "linear", "weight": weight })),
        "root" => Some(json!({ "kind": "gradient", "remap": root, "weight": weight })),
        _ => None,
    };
    let both =
        |remap: &serde_json::Value| std::iter::once(l1(remap)).chain(of_gradient.clone()).collect::<Vec<_>>();
    let stage = |share: f64, terms: Vec<serde_json::Value>| json!({ "share": share, "terms": terms });
    match stages {
        "s1" => {
            json!([stage(0.25, vec![l1(&root)]), stage(0.5, both(&linear)), stage(0.25, both(&square_root)),])
        }
        "s2" => json!([stage(0.5, vec![l1(&root)]), stage(0.5, both(&linear))]),
        "s3" => json!([stage(0.25, vec![l1(&root)]), stage(0.75, both(&root))]),
        // "Adaptive to the progress of the learning phase": the next stage begins when validation stops improving.
        "adaptive" => json!([
            { "share": 0.6, "plateau": { "patience": 2, "improvement": 0.01 }, "terms": [l1(&root)] },
            stage(1.0, both(&linear)),
        ]),
        _ => json!([stage(1.0, both(&linear))]),
    }
}

#[cfg(test)]
mod tests {
    use super::super::study::tests::study;
    use super::*;
    use neumip_export::config::Architecture;
    use std::collections::BTreeSet;

    #[test]
    fn every_variant_can_be_trained_and_has_its_own_label() {
        let study = study();
        let all = [of_chart(), of_ablation(&study)];
        for variants in &all {
            let labels: BTreeSet<_> = variants.iter().map(|v| v.label.clone()).collect();
            assert_eq!(labels.len(), variants.len());
            let trained: Vec<_> = variants.iter().filter(|v| v.maps.is_none()).collect();
            let configs: BTreeSet<_> = trained
                .iter()
                .map(|v| {
                    let config = v.config().unwrap();
                    config.train.validate().unwrap();
                    Architecture::new(config.model.clone(), [64, 64]).unwrap();
                    serde_json::to_string(&config).unwrap()
                })
                .collect();
            assert_eq!(configs.len(), trained.len(), "two variants are the same");
        }
        assert!(all[0].len() >= 20, "{}", all[0].len());
        assert_eq!(all[1].len(), ENCODINGS.len() * (1 + GRADIENTS.len() * STAGES.len()));
    }
}
