//! What each cure costs on ordinary data: error and time of a query. Nothing is free.

use super::page::number;
use super::probe::Figure;
use super::variants::{CALM, CONSTANT, PRINTED, ROOTS, UNSMOOTHED};
use super::workshop::{Workshop, split_errors};
use crate::dataset::SplitName;
use crate::error::Result;
use crate::evaluate::costs;
use crate::query::Reflectance;
use neumip_export::whole_file::write_json;
use serde::{Deserialize, Serialize};

/// File of the prices.
pub(super) const JSON: &str = "prices.json";
/// Queries and rounds of a timing.
const TIMED: usize = 65_536;
const ROUNDS: usize = 5;
/// Levels of timed queries.
const LEVELS: usize = 4;

/// A cure: `improved` without it, or with it where `improved` has not taken it.
#[derive(Clone, Copy, Debug)]
struct Cure {
    name: &'static str,
    /// True if `improved` has it and `set` takes it out.
    taken: bool,
    set: &'static [&'static str],
}

/// The cures of the probes.
const CURES: [Cure; 14] = [
    Cure {
        name: "(x, y, z) of the directions (without: x, y)",
        taken: true,
        set: &["model.encoding.components=2"],
    },
    Cure { name: "textures smoothed while training (without: as they are)", taken: true, set: &UNSMOOTHED },
    Cure { name: "calm textures, against flicker", taken: false, set: &CALM },
    Cure {
        name: "last stage `l2-mean`, which keeps the mean (without: 4th roots to the end)",
        taken: true,
        set: &[ROOTS],
    },
    Cure { name: "steps bounded by `train.clip` = 0.03", taken: true, set: &["train.clip=null"] },
    Cure {
        name: "signed root (without: guarded at 1e-7)",
        taken: true,
        set: &["train.stages.0.terms.0.remap=root4-guarded", "train.stages.0.terms.1.remap=root4-guarded"],
    },
    Cure {
        name: "gradient weight 0.03 (without: 1)",
        taken: true,
        set: &["train.stages.0.terms.1.weight=1.0"],
    },
    Cure {
        name: "gamma(u) attenuated by the footprint, octaves by the resolution (without: 10 octaves as they are)",
        taken: true,
        set: &["model.encoding.u.attenuate=false", "model.encoding.u.limit_to_resolution=false"],
    },
    Cure { name: "directions themselves (without: gamma in their place)", taken: true, set: &PRINTED },
    Cure {
        name: "gamma of amplitude 0.25 beside the directions",
        taken: false,
        set: &[
            "model.encoding.wi.bands=4",
            "model.encoding.wi.amplitude=0.25",
            "model.encoding.wo.bands=4",
            "model.encoding.wo.amplitude=0.25",
        ],
    },
    Cure {
        name: "warm-up of a fiftieth (without: none)",
        taken: true,
        set: &["train.learning_rate.warmup=0.0"],
    },
    Cure { name: "rate falling along a cosine (without: constant)", taken: true, set: &[CONSTANT] },
    Cure { name: "every level counts in every step", taken: false, set: &["train.level_dropout=[]"] },
    Cure { name: "half the texture resolution", taken: false, set: &["model.texture.finest=1"] },
];

/// What a cure costs on a material: with it over without it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Price {
    /// The cure in words.
    pub cure: String,
    /// What sets it.
    pub set: Vec<String>,
    /// Whether `improved` has it; where it has, `set` takes it out.
    pub taken: bool,
    /// The material.
    pub material: String,
    /// `mse` on the test split, with and without.
    pub mse: [Figure; 2],
    /// Nanoseconds a query on one thread, with and without, in one run.
    pub ns: [Figure; 2],
}

/// The prices, measured where they are not there yet.
///
/// # Errors
/// What training and measuring meet.
pub(super) fn prices(workshop: &mut Workshop) -> Result<Vec<Price>> {
    if let Some(known) = workshop.folder().optional(JSON)? {
        return Ok(known);
    }
    let scale = workshop.scale();
    let mut materials = vec![scale.glossy().to_string()];
    if !scale.is_quick() {
        materials.push(scale.matte().to_string());
    }
    let mut prices = Vec::new();
    for material in materials {
        let data = workshop.data(&material)?;
        let base = workshop.train(&material, "improved", &[])?;
        let base = base.sound()?.clone();
        let base_mse = split_errors(&base.material, &data, SplitName::Test)?.mse;
        for cure in CURES {
            workshop.check()?;
            let other = workshop.train(&material, "improved", cure.set)?;
            let Some(other) = other.model() else { continue };
            let answerers: [&dyn Reflectance; 2] = [&base.material, &other.material];
            let times = costs(&answerers, LEVELS, TIMED, ROUNDS)?;
            let mse = split_errors(&other.material, &data, SplitName::Test)?.mse;
            let mut columns = [[base_mse, mse], [times[0].ns_per_query, times[1].ns_per_query]];
            if !cure.taken {
                columns.iter_mut().for_each(|column| column.reverse());
            }
            let [mse, ns] = columns.map(|column| column.map(Figure::new));
            prices.push(Price {
                cure: cure.name.into(),
                set: cure.set.iter().map(ToString::to_string).collect(),
                taken: cure.taken,
                material: material.clone(),
                mse,
                ns,
            });
        }
    }
    write_json(&workshop.folder().root().join(JSON), &prices)?;
    Ok(prices)
}

/// The prices as a table.
pub(super) fn table(prices: &[Price]) -> String {
    let mut out = String::from(
        "\n## What the cures cost\n\nOn ordinary data: `mse` x 10^3 on the test split, nanoseconds a query on one thread \
         (interleaved rounds), with the cure | without it. `improved` has those that say so; seeds differ by several \
         hundredths.\n\n| cure | material | in `improved` | `mse` | ns |\n| --- | --- | --- | --- | --- |\n",
    );
    let pair = |values: [Figure; 2], factor: f64| {
        let one = |f: Figure| f.value().map_or("no number".into(), |v| number(v * factor));
        values.map(one).join(" \\| ")
    };
    for price in prices {
        out += &format!(
            "| {} | {} | {} | {} | {} |\n",
            price.cure,
            price.material,
            if price.taken { "yes" } else { "no" },
            pair(price.mse, 1e3),
            pair(price.ns, 1.0)
        );
    }
    out
}
