//! `dataset.json`: what a dataset folder holds.
//!
//! The folder: `dataset.json`; `height.exr` (one f32 channel Y, tile widths) where heights are stored; for
//! file 0 of split train `train-00000.exr` (half R, G, B: `grid.rs`) and `train-00000.safetensors`
//! (`table.rs`); views, and the pictures of sequences, as `views-NAME.exr` (`query_frame.rs`); for people `contact-sheet.png`; and while shards are
//! being made, what each of them has (`shard.rs`).

use super::{
    block::{MAX_LEVEL, MAX_SIDE},
    config::{GenerateConfig, MAX_FILES},
    folder::read_json,
    frame::MAX_PIXELS,
    motion::{HALVES, picture_name},
};
use crate::error::{Error, Result};
use neumip_export::Measure;
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, fmt, path::Path, str::FromStr};

/// Version of the format that is written and read.
pub const FORMAT: u32 = 1;
/// Name of the description inside the folder.
pub const MANIFEST: &str = "dataset.json";

/// The parts of a dataset that are made of blocks. A name's place is also its stream of random numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SplitName {
    /// What is learned from.
    Train,
    /// As the training data, held out: scattered patches, or whole slices.
    Validation,
    /// Whole slices under held-out directions, from texel centre to texel centre.
    Test,
    /// Held-out directions, positions between the texels, levels between the integers.
    Offgrid,
    /// Held-out directions, at least one of the two beyond 62 degrees.
    Grazing,
}

impl SplitName {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Train, Self::Validation, Self::Test, Self::Offgrid, Self::Grazing];

    /// The name in files and flags.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Validation => "validation",
            Self::Test => "test",
            Self::Offgrid => "offgrid",
            Self::Grazing => "grazing",
        }
    }
}

impl fmt::Display for SplitName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl FromStr for SplitName {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let found = Self::ALL.into_iter().find(|name| name.as_str() == text);
        found.ok_or_else(|| {
            let names: Vec<_> = Self::ALL.iter().map(|n| n.as_str()).collect();
            Error::usage(format!("{text} is not a split; splits are {}", names.join(", ")))
        })
    }
}

/// Statistics of the samples of a file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Summary {
    /// Mean of R, G, B.
    pub mean: [f32; 3],
    /// Largest value of any channel.
    pub max: f32,
    /// Mean variance of a sample: the squared error that a perfect model would be left with.
    pub variance: f32,
}

/// One frame of blocks and its table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileInfo {
    /// Name without the endings .exr and .safetensors: split, dash, five digits.
    pub name: String,
    /// Blocks in the frame.
    pub blocks: usize,
    /// Patches in the table.
    pub patches: usize,
    /// Blocks whose level rounds to 0, 1, 2 ...
    pub level_blocks: Vec<usize>,
    /// Length of the frame, bytes.
    pub frame_bytes: u64,
    /// Length of the table, bytes.
    pub table_bytes: u64,
    /// Its samples.
    pub summary: Summary,
    /// Mean over the blocks of the square root of their mean variance.
    pub noise: f32,
    /// Blocks whose noise stayed above the one that was asked for.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub noisy_blocks: usize,
}

impl FileInfo {
    /// Checks every bound that later reading relies on: it is the `index`-th file of a split, with blocks of so many
    /// samples.
    pub(crate) fn validate(&self, split: SplitName, index: usize, samples: usize) -> Result<()> {
        let field = format!("splits.{split}.files[{index}]");
        let expected = file_name(split, index);
        if self.name != expected {
            return Err(Error::config(field, format!("is named {}, not {expected}", self.name)));
        }
        // A frame has room for unused cells, at most as many again.
        within(format!("{field}.blocks"), self.blocks, 1, (MAX_PIXELS / 2 / samples).max(1))?;
        within(format!("{field}.patches"), self.patches, self.blocks, self.blocks * samples)?;
        let most = MAX_LEVEL as usize + 1;
        within(format!("{field}.level_blocks length"), self.level_blocks.len(), 1, most)?;
        let counted = self.level_blocks.iter().try_fold(0usize, |sum, n| sum.checked_add(*n));
        if counted != Some(self.blocks) {
            return Err(Error::config(format!("{field}.level_blocks"), "does not add up to the blocks"));
        }
        within(format!("{field}.noisy_blocks"), self.noisy_blocks, 0, self.blocks)
    }
}

fn within(field: impl fmt::Display, value: usize, low: usize, high: usize) -> Result<()> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(Error::config(field.to_string(), format!("{value} is outside {low} to {high}")))
}

fn is_zero(n: &usize) -> bool {
    *n == 0
}

/// How far held-out pairs of directions are from the nearest training pair, degrees. The distance of two
/// pairs is sqrt(angle(wi, wi')^2 + angle(wo, wo')^2).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Distance {
    /// Mean over the (first 512) held-out pairs.
    pub mean_degrees: f32,
    /// The nearest.
    pub min_degrees: f32,
}

/// One split.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplitInfo {
    /// Samples along a side of every block.
    pub side: usize,
    /// Blocks once it is complete.
    pub planned_blocks: usize,
    /// Sub-samples of a sample; absent for measured data.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spp: Option<usize>,
    /// Share of the stored samples whose level rounds to 0, 1, 2 ...
    pub level_shares: Vec<f32>,
    /// Mean over the blocks of the square root of their mean variance.
    pub noise: f32,
    /// Blocks whose noise stayed above the one that was asked for.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub noisy_blocks: usize,
    /// For held-out splits, once there are training directions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nearest_training: Option<Distance>,
    /// The files, in order.
    pub files: Vec<FileInfo>,
}

impl SplitInfo {
    /// Blocks on disk.
    pub fn blocks(&self) -> usize {
        self.files.iter().map(|f| f.blocks).sum()
    }

    /// Samples on disk.
    pub fn samples(&self) -> u64 {
        self.blocks() as u64 * (self.side * self.side) as u64
    }
}

/// One view: a picture as queries and answers, in the file `views-NAME.exr`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewInfo {
    /// Name of the scene.
    pub name: String,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Length of the file, bytes.
    pub bytes: u64,
    /// Its samples.
    pub summary: Summary,
}

impl ViewInfo {
    /// Name of the file inside the folder.
    pub fn file(&self) -> String {
        format!("views-{}.exr", self.name)
    }

    /// Checks its name and size.
    pub(crate) fn validate(&self) -> Result<()> {
        let plain = |c: u8| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'-';
        if self.name.is_empty() || self.name.len() > 64 || !self.name.bytes().all(plain) {
            return Err(Error::config("views.name", "must be lower-case letters, digits and dashes"));
        }
        within(format_args!("views.{}.height", self.name), self.height, 1, MAX_SIDE)?;
        within(format_args!("views.{}.width", self.name), self.width, 1, MAX_SIDE)
    }
}

/// One sequence of views in which something moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SequenceInfo {
    /// What moves.
    pub name: String,
    /// The pictures, all of one size: frame after frame, its two halves, which are independent estimates of it.
    pub pictures: Vec<ViewInfo>,
}

impl SequenceInfo {
    /// The two halves of every frame; of one that was not finished, nothing.
    pub fn frames(&self) -> impl Iterator<Item = [&ViewInfo; HALVES]> {
        self.pictures.as_chunks::<HALVES>().0.iter().map(|halves| halves.each_ref())
    }

    fn validate(&self) -> Result<()> {
        for (index, picture) in self.pictures.iter().enumerate() {
            picture.validate()?;
            let field = || format!("motion.{}.pictures[{index}]", self.name);
            let expected = picture_name(&self.name, index);
            if picture.name != expected {
                return Err(Error::config(field(), format!("is named {}, not {expected}", picture.name)));
            }
            if [picture.height, picture.width] != [self.pictures[0].height, self.pictures[0].width] {
                return Err(Error::config(field(), "is not of the size of the first"));
            }
        }
        Ok(())
    }
}

/// The height map in `height.exr`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeightInfo {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Length of the file, bytes.
    pub bytes: u64,
}

/// The whole description.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of the format.
    pub format: u32,
    /// Program and version that wrote it.
    pub generator: String,
    /// False while it is being written, and after a run was stopped.
    pub complete: bool,
    /// Name of the material.
    pub material: String,
    /// What the source says of itself.
    pub source: serde_json::Value,
    /// Texels of the tile, \[height, width\].
    pub resolution: [usize; 2],
    /// Lowest and highest point of the surface, tile widths.
    pub height_range: [f32; 2],
    /// What the values are.
    pub measure: Measure,
    /// What was generated; absent for imported data.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub generation: Option<GenerateConfig>,
    /// Samples, or pairs of slices, of the training data before each time that it was appended to.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub appended_at: Vec<u64>,
    /// The stored height map.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub heights: Option<HeightInfo>,
    /// The splits.
    pub splits: BTreeMap<SplitName, SplitInfo>,
    /// The views.
    pub views: Vec<ViewInfo>,
    /// The sequences.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub motion: Vec<SequenceInfo>,
}

impl Manifest {
    /// The description of a dataset that holds nothing yet.
    pub fn new(
        material: &str,
        source: serde_json::Value,
        resolution: [usize; 2],
        height_range: [f32; 2],
    ) -> Self {
        Self {
            format: FORMAT,
            generator: format!("neumip {}", env!("CARGO_PKG_VERSION")),
            complete: false,
            material: material.into(),
            source,
            resolution,
            height_range,
            measure: Measure::RadianceCosine,
            generation: None,
            appended_at: Vec::new(),
            heights: None,
            splits: BTreeMap::new(),
            views: Vec::new(),
            motion: Vec::new(),
        }
    }

    /// The views and the pictures of all sequences.
    pub fn pictures(&self) -> impl Iterator<Item = &ViewInfo> {
        self.views.iter().chain(self.motion.iter().flat_map(|sequence| &sequence.pictures))
    }

    /// Reads and checks the description in a folder.
    pub(crate) fn read(root: &Path) -> Result<Self> {
        let path = root.join(MANIFEST);
        let failed = |problem: &dyn fmt::Display| Error::file(&path, problem);
        let value = read_json(&path)?;
        // The version comes first: another one may have other fields.
        match value.get("format").and_then(serde_json::Value::as_u64) {
            Some(version) if version == u64::from(FORMAT) => {}
            Some(version) => {
                return Err(failed(&format!("has format {version}; this program reads {FORMAT}")));
            }
            None => return Err(failed(&"has no field format: it is not a dataset")),
        }
        let this: Self = serde_json::from_value(value).map_err(|e| failed(&e))?;
        this.validate().map_err(|e| failed(&e))?;
        Ok(this)
    }

    /// The bytes of the description.
    pub(crate) fn to_json(&self) -> Result<Vec<u8>> {
        let mut bytes = serde_json::to_vec_pretty(self).map_err(|e| Error::config(MANIFEST, e))?;
        bytes.push(b'\n');
        Ok(bytes)
    }

    /// Checks every bound that later reading relies on.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn validate(&self) -> Result<()> {
        within("resolution[0]", self.resolution[0], 1, MAX_SIDE)?;
        within("resolution[1]", self.resolution[1], 1, MAX_SIDE)?;
        let [low, high] = self.height_range;
        if !(low.is_finite() && high.is_finite() && low <= high) {
            return Err(Error::config("height_range", format!("{low} to {high} is not a range")));
        }
        if let Some(generation) = &self.generation {
            generation.validate()?;
            let amounts: Vec<u64> = self.appended_at.iter().copied().chain([generation.amount()]).collect();
            if !amounts.is_sorted_by(|a, b| a < b) {
                return Err(Error::config("appended_at", "does not grow up to what was generated"));
            }
        }
        within("appended_at length", self.appended_at.len(), 0, MAX_FILES)?;
        if let Some(map) = &self.heights {
            within("heights.height", map.height, 1, MAX_SIDE)?;
            within("heights.width", map.width, 1, MAX_SIDE)?;
        }
        for (name, split) in &self.splits {
            within(format_args!("splits.{name}.side"), split.side, 1, MAX_SIDE)?;
            let samples = split.side * split.side;
            within(format_args!("splits.{name}.files"), split.files.len(), 0, MAX_FILES)?;
            for (k, file) in split.files.iter().enumerate() {
                file.validate(*name, k, samples)?;
            }
        }
        self.views.iter().try_for_each(ViewInfo::validate)?;
        self.motion.iter().try_for_each(SequenceInfo::validate)
    }
}

/// Name of the `index`-th file of a split, without its endings.
pub(crate) fn file_name(split: SplitName, index: usize) -> String {
    format!("{split}-{index:05}")
}
