//! Whether two descriptions are of the same dataset, and how much of one was there before it was appended to.

use super::{
    config::GenerateConfig,
    format::{MANIFEST, Manifest},
    regime::Regime,
    write::Existing,
};
use crate::error::{Error, Result};
use std::path::Path;

/// Refuses a description that was not made in the way that is wanted, naming the first field that differs. Where
/// training data is appended, the amount may.
pub(crate) fn check_same(found: &Manifest, wanted: &Manifest, path: &Path, append: bool) -> Result<()> {
    let failed = |e: serde_json::Error| Error::file(path, e);
    // What was found went through a text, where a number may lose its last bit.
    let mut wanted: Manifest = serde_json::from_slice(&wanted.to_json()?).map_err(failed)?;
    if append && let (Some(wanted), Some(found)) = (&mut wanted.generation, &found.generation) {
        wanted.samples = found.samples;
        if matches!((wanted.regime, found.regime), (Regime::Slices(_), Regime::Slices(_))) {
            wanted.regime = found.regime;
        }
    }
    let parts = |config: &Option<GenerateConfig>| serde_json::to_value(config).map_err(failed);
    let (of_wanted, of_found) = (parts(&wanted.generation)?, parts(&found.generation)?);
    let fields = of_wanted.as_object().into_iter().flatten();
    let generation =
        fields.map(|(field, value)| (format!("generation.{field}"), of_found.get(field) == Some(value)));
    let same = [
        ("generator", wanted.generator == found.generator),
        ("material", wanted.material == found.material),
        ("source", wanted.source == found.source),
        ("resolution", wanted.resolution == found.resolution),
        ("height_range", wanted.height_range == found.height_range),
    ]
    .map(|(field, same)| (field.to_string(), same))
    .into_iter()
    .chain(generation)
    .chain([("generation".to_string(), wanted.generation == found.generation)]);
    match same.into_iter().find(|(_, same)| !same) {
        Some((field, _)) => Err(Error::file(
            path,
            format!("{field} differs from what is asked for: ask for the same or force its replacement"),
        )),
        None => Ok(()),
    }
}

/// The amounts of training data that are there before what `config` asks for, one for each time that the dataset in
/// `root` was appended to.
pub(crate) fn earlier_amounts(root: &Path, config: &GenerateConfig, existing: Existing) -> Result<Vec<u64>> {
    let path = root.join(MANIFEST);
    let there = path.exists();
    match existing {
        Existing::Resume if there => Ok(Manifest::read(root)?.appended_at),
        Existing::Append if there => {
            let found = Manifest::read(root)?;
            let Some(generation) = &found.generation else {
                return Err(Error::file(path, "was not generated: only what was can be appended to"));
            };
            let mut earlier = found.appended_at;
            let before = generation.amount();
            if matches!(config.regime, Regime::Scattered) != matches!(generation.regime, Regime::Scattered) {
                let problem = format!("generation.regime is {}: only its amount can grow", generation.regime);
                return Err(Error::file(path, problem));
            }
            if config.resolved(&earlier)?.amount() == before {
                // What is asked for is there, or was on its way when it was stopped.
                return Ok(earlier);
            }
            if !found.complete {
                let problem =
                    format!("is not complete: resume it ({} of {before}) before more", generation.regime);
                return Err(Error::file(path, problem));
            }
            earlier.push(before);
            let wanted = config.resolved(&earlier)?.amount();
            if wanted <= before {
                let field = if config.regime == Regime::Scattered { "samples" } else { "regime" };
                let problem = format!("asks for {wanted} where {before} are there: ask for more");
                return Err(Error::config(field, problem));
            }
            Ok(earlier)
        }
        Existing::Append => Err(Error::file(root, "holds no dataset to append to: generate it first")),
        _ => Ok(Vec::new()),
    }
}
