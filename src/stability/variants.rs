//! Fields that several probes set on `improved`, as on the command line.

/// gamma(wi), gamma(wo) with 4 octaves in place of the directions, as printed.
pub(super) const PRINTED: [&str; 4] = [
    "model.encoding.wi.bands=4",
    "model.encoding.wi.raw=false",
    "model.encoding.wo.bands=4",
    "model.encoding.wo.raw=false",
];

/// The published pixel loss alone.
pub(super) const L1: &str =
    r#"train.stages=[{"share":1,"terms":[{"kind":"l1","remap":"linear","weight":1}]}]"#;

/// `improved` without its last stage, which keeps the mean.
pub(super) const ROOTS: &str = r#"train.stages=[{"share":1,"terms":[{"kind":"l2","remap":{"root4-signed":0.001},"weight":1},{"kind":"gradient","remap":{"root4-signed":0.001},"weight":0.03}]}]"#;

/// One rate to the end, as many published trainings have.
pub(super) const CONSTANT: &str = r#"train.learning_rate.decay={"kind":"constant"}"#;

/// Neither smoothing of lookups nor blending of levels while training.
pub(super) const UNSMOOTHED: [&str; 2] = ["train.smoothing=null", "train.blend=null"];

/// Less motion that is not there. A steep offset slides lookups by many texels within one; gamma(u) and fast steps leave
/// noise in the textures that moves with the pixels.
pub(super) const CALM: [&str; 3] =
    ["model.encoding.u.bands=0", "train.smoothing.offset_minimum=3", "train.learning_rate.peak=0.003"];
