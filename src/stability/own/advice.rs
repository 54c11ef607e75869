//! What to change, from what a material was made of.

use neumip_export::checkpoint::Checkpoint;
use neumip_export::config::EncodingConfig;
use serde_json::Value;

fn encoding(checkpoint: Option<&Checkpoint>) -> Option<&EncodingConfig> {
    checkpoint.map(|checkpoint| &checkpoint.header.architecture.model.encoding)
}

/// Against a seam at the tile's border.
pub fn seam(checkpoint: Option<&Checkpoint>) -> String {
    match encoding(checkpoint) {
        Some(e) if e.u.bands > 0 && !e.pi => "train with --set model.encoding.pi=true: without pi gamma(u) does not repeat with the tile".into(),
        Some(e) if e.u.raw => "train with --set model.encoding.u.raw=false: the position itself jumps at the border".into(),
        _ => "look whether the surface itself tiles (neumip look); maps that do not need generate --make-tileable".into(),
    }
}

/// Against noise between texels.
pub fn between(checkpoint: Option<&Checkpoint>) -> String {
    match encoding(checkpoint) {
        Some(e) if e.u.bands > 0 && !(e.u.attenuate && e.u.limit_to_resolution) => "train with --set model.encoding.u.attenuate=true \
             --set model.encoding.u.limit_to_resolution=true, as the preset improved does: octaves finer than a texel alias"
            .into(),
        _ => "train on data whose positions lie between the texels too (neumip generate without --regime slices), or longer".into(),
    }
}

/// Against coarse levels that are not the mean of the fine ones.
pub fn means(checkpoint: Option<&Checkpoint>) -> String {
    let terms = checkpoint.map(|checkpoint| &checkpoint.header.provenance["train"]["stages"]);
    let stages = terms.and_then(Value::as_array).into_iter().flatten();
    let mut terms = stages.flat_map(|stage| stage["terms"].as_array().into_iter().flatten());
    // Of a checkpoint that does not say how it was trained nothing is known.
    let keeps_the_mean = terms.clone().next().is_none()
        || terms.any(|term| term["kind"] == "l2-mean" || (term["kind"] == "l2" && term["remap"] == "linear"));
    if !keeps_the_mean {
        return "end the training with l2-mean, as the preset improved does: L1 learns the median and L2 of remapped values a mean \
                of those, both darker than the mean where highlights are rare"
            .into();
    }
    "train longer, on more samples (neumip generate --samples)".into()
}
