//! `neumip generate`.

use super::console::Console;
use crate::dataset::{Dataset, Existing, GenerateConfig, Regime, SplitName, generate};
use crate::error::{Error, Result};
use crate::reference::{Reference, ReferenceOptions};
use clap::Args;
use std::path::{Path, PathBuf};

/// Render a dataset of a material.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  neumip generate metal-rings --out data/metal\n  \
    neumip generate my-material/material.json --out data/mine --resolution 256 --spp 32")]
pub struct Generate {
    /// A built-in material (metal-rings, rocks), a material.json or the folder that holds it.
    material: String,
    /// The dataset's folder.
    #[arg(long)]
    out: PathBuf,
    /// Texels along a side of the tile, a power of two.
    #[arg(long, default_value_t = 128)]
    resolution: usize,
    /// scattered (a pair of directions a patch) or slices-N (N pairs, full images).
    #[arg(long, default_value = "scattered")]
    regime: Regime,
    /// Unique training samples, by default 200 a texel.
    #[arg(long)]
    samples: Option<u64>,
    /// Rays a training sample.
    #[arg(long, default_value_t = 16)]
    spp: usize,
    /// Rays a held-out sample.
    #[arg(long, default_value_t = 64)]
    held_out_spp: usize,
    /// Pairs of directions of the test split.
    #[arg(long)]
    test_pairs: Option<usize>,
    /// Side of the perspective views in pixels; 0 leaves them out.
    #[arg(long)]
    view_size: Option<usize>,
    /// Tiles along a side of the viewed plane.
    #[arg(long)]
    view_tiles: Option<usize>,
    /// Leave the height map out.
    #[arg(long)]
    without_heights: bool,
    /// Seed of directions, positions and rays.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Seed of a built-in material's shape.
    #[arg(long, default_value_t = 0)]
    material_seed: u64,
    /// Go on with an interrupted dataset of the same options.
    #[arg(long, conflicts_with = "force")]
    resume: bool,
    /// Replace an existing dataset.
    #[arg(long)]
    force: bool,
    /// Write the dataset's description here too.
    #[arg(long)]
    json: Option<PathBuf>,
}

impl Generate {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        super::check_json(self.json.as_deref())?;
        let mut config = GenerateConfig::new(self.resolution);
        config.regime = self.regime;
        config.samples = self.samples.unwrap_or(config.samples);
        config.spp = self.spp;
        config.held_out_spp = self.held_out_spp;
        config.test_pairs = self.test_pairs.unwrap_or(config.test_pairs);
        config.view_size = self.view_size.unwrap_or(config.view_size);
        config.view_tiles = self.view_tiles.unwrap_or(config.view_tiles);
        config.seed = self.seed;
        config.heights = !self.without_heights;
        let existing = match (self.resume, self.force) {
            (true, _) => Existing::Resume,
            (_, true) => Existing::Replace,
            _ => Existing::Refuse,
        };
        let reference = reference(&self.material, self.material_seed, &config)?;
        let data = dataset(&reference, &config, &self.out, existing, console)?;
        super::save_json(self.json.as_deref(), data.manifest())
    }
}

/// The surface of a material at a dataset's resolution, once the configuration is known to work.
pub fn reference(material: &str, material_seed: u64, config: &GenerateConfig) -> Result<Reference> {
    config.validate()?;
    let options = ReferenceOptions {
        resolution: Some([config.resolution; 2]),
        material_seed,
        ..ReferenceOptions::default()
    };
    Reference::open(material, &options)
}

/// Renders a dataset with progress.
pub fn dataset(
    reference: &Reference,
    config: &GenerateConfig,
    out: &Path,
    existing: Existing,
    console: &Console,
) -> Result<Dataset> {
    for note in reference.notes() {
        console.say(format!("note: {note}"));
    }
    let mut meter = None;
    let mut done = 0;
    generate(reference, config, out, existing, &mut |progress| {
        done = progress.done;
        meter
            .get_or_insert_with(|| {
                console.meter(format!("generate {}", reference.name()), progress.total, "samples")
            })
            .update(progress.done, progress.split);
        console.flow()
    })
    .map_err(|error| match error {
        Error::Interrupted(_) => {
            Error::Interrupted(format!("{} holds what was finished; go on with --resume", out.display()))
        }
        other => other,
    })?;
    let rate = meter.map_or(0.0, |m| m.finish(done));
    let data = Dataset::open(out)?;
    let train = data.split(SplitName::Train)?;
    console.say(format!(
        "{}: {} at {} x {}, {} training samples ({}/s)",
        out.display(),
        data.manifest().material,
        config.resolution,
        config.resolution,
        train.info().samples(),
        super::console::short(rate, "samples")
    ));
    Ok(data)
}
