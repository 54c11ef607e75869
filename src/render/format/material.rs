//! Materials as they are written.

use super::value::Rgb;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Where a material comes from: exactly one of the first five; the others go with `reference`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MaterialSpec {
    /// A run's folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub run: Option<PathBuf>,
    /// A bundle's folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bundle: Option<PathBuf>,
    /// A checkpoint.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub checkpoint: Option<PathBuf>,
    /// A reference surface: a built-in material's name, a material.json or its folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference: Option<String>,
    /// A matt material of this albedo.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lambert: Option<Rgb>,
    /// Texels along a side of level 0 of the reference.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resolution: Option<usize>,
    /// Bounces of light within the reference surface.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bounces: Option<usize>,
    /// Samples along a side of a built-in reference's field.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub field_side: Option<usize>,
    /// Seed of a built-in reference's shape.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub material_seed: Option<u64>,
    /// Crop and cross-fade maps that do not tile.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub make_tileable: Option<bool>,
    /// Rays to the reference surface a query.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spp: Option<usize>,
}

/// What a material's spec says it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Source<'a> {
    /// A run, bundle or checkpoint.
    Model(&'a Path),
    /// A reference surface.
    Reference(&'a str),
    /// A matt material.
    Lambert([f32; 3]),
}

impl MaterialSpec {
    /// The spec of a run, bundle or checkpoint, whichever the path is.
    pub fn model(path: &Path) -> Self {
        Self { checkpoint: Some(path.to_path_buf()), ..Self::default() }
    }

    /// Where the material comes from.
    ///
    /// # Errors
    /// What is wrong, if there is not exactly one source, or an option that does not go with it.
    pub fn source(&self) -> std::result::Result<Source<'_>, String> {
        let models = [&self.run, &self.bundle, &self.checkpoint].into_iter().flatten();
        let mut sources: Vec<Source<'_>> = models.map(|path| Source::Model(path)).collect();
        sources.extend(self.reference.as_deref().map(Source::Reference));
        sources.extend(self.lambert.map(|Rgb(albedo)| Source::Lambert(albedo)));
        let &[source] = sources.as_slice() else {
            let count = sources.len();
            return Err(format!(
                "has {count} sources; state one of run, bundle, checkpoint, reference and lambert"
            ));
        };
        let options = [
            ("resolution", self.resolution.is_some()),
            ("bounces", self.bounces.is_some()),
            ("field_side", self.field_side.is_some()),
            ("material_seed", self.material_seed.is_some()),
            ("make_tileable", self.make_tileable.is_some()),
            ("spp", self.spp.is_some()),
        ];
        match options.into_iter().find(|(_, stated)| *stated) {
            Some((option, _)) if !matches!(source, Source::Reference(_)) => {
                Err(format!("{option} goes with reference only"))
            }
            _ => Ok(source),
        }
    }
}
