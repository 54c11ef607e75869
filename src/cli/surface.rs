//! Flags of everything that renders a reference surface.

use crate::error::Result;
use crate::reference::{Reference, ReferenceOptions, builtin};
use clap::Args;

/// How a material is made and lit.
#[derive(Clone, Debug, Args)]
pub struct Surface {
    /// Indirect bounces of light after the direct one.
    #[arg(long, default_value_t = ReferenceOptions::default().bounces)]
    pub bounces: usize,
    /// Samples along a side of a built-in material's field.
    #[arg(long, default_value_t = ReferenceOptions::default().field_side)]
    pub field_side: usize,
    /// Seed of a built-in material's shape.
    #[arg(long, default_value_t = 0)]
    pub material_seed: u64,
    /// Crop and cross-fade maps that do not tile.
    #[arg(long)]
    pub make_tileable: bool,
}

impl Surface {
    /// The reference of a material on a tile of `resolution` x `resolution` texels.
    ///
    /// # Errors
    /// As [`Reference::open`].
    pub fn open(&self, material: &str, resolution: usize) -> Result<Reference> {
        Reference::open(material, &self.options(resolution))
    }

    /// The options of a reference on a tile of `resolution` x `resolution` texels.
    pub fn options(&self, resolution: usize) -> ReferenceOptions {
        ReferenceOptions {
            resolution: Some([resolution; 2]),
            bounces: self.bounces,
            field_side: self.field_side,
            material_seed: self.material_seed,
            make_tileable: self.make_tileable,
            ..ReferenceOptions::default()
        }
    }

    /// The flags that make the same surface again.
    pub fn flags(&self) -> String {
        let Self { bounces, field_side, material_seed, make_tileable } = self;
        let mend = if *make_tileable { " --make-tileable" } else { "" };
        format!("--bounces {bounces} --field-side {field_side} --material-seed {material_seed}{mend}")
    }
}

/// The materials that a name stands for: `all` is every built-in one.
pub fn materials(name: &str) -> Vec<String> {
    if name == "all" { builtin::NAMES.map(String::from).to_vec() } else { vec![name.into()] }
}
