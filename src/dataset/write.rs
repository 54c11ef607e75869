//! Writing a dataset folder so that it is valid after every file.

use super::{
    block::{Block, Layout},
    folder::{check_bytes, entries, is_part, name_of, remove, write_whole},
    format::{FileInfo, HeightInfo, MANIFEST, Manifest, SplitInfo, SplitName, Summary, ViewInfo, file_name},
    frame::{Plane, write_frame},
    grid::write_grid,
    nearest::Nearest,
    query_frame::write_query_frame,
    table::{read_table, write_table},
};
use crate::{
    error::{Error, Result},
    query::{QueryBuffer, RgbImage},
};
use half::f16;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// What to do with a dataset that is already there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Existing {
    /// Refuse to touch it.
    #[default]
    Refuse,
    /// Remove its files and start again.
    Replace,
    /// Keep its files and go on; its description must be the same.
    Resume,
}

/// A dataset being written. Each file is written whole, then `dataset.json` is; a run that is stopped leaves
/// a smaller dataset.
#[derive(Debug)]
pub struct Writer {
    root: PathBuf,
    manifest: Manifest,
    nearest: BTreeMap<SplitName, Nearest>,
}

impl Writer {
    /// Opens the folder `root` for the dataset that `manifest` describes (without splits, views and heights),
    /// and makes it where it is missing.
    ///
    /// # Errors
    /// `File` if the folder holds something else, or a dataset that `existing` does not allow.
    pub fn create(root: &Path, manifest: Manifest, existing: Existing) -> Result<Self> {
        manifest.validate()?;
        let mut this = Self { root: root.into(), manifest, nearest: BTreeMap::new() };
        let present = entries(root)?;
        let all = |which: &dyn Fn(&str) -> bool| present.iter().all(|path| which(name_of(path)));
        if present.iter().any(|path| name_of(path) == MANIFEST) {
            // The description goes first: a folder without it is no dataset, with it and without files a
            // broken one.
            match existing {
                Existing::Refuse => {
                    let problem = "holds a dataset already: resume it or force its replacement";
                    return Err(Error::file(root, problem));
                }
                Existing::Replace if is_replaceable(root, all(&is_ours)) => {
                    remove(&present, MANIFEST, is_ours)?;
                }
                Existing::Replace => {
                    let problem = format!("its {MANIFEST} is not of a dataset of ours: name another folder");
                    return Err(Error::file(root, problem));
                }
                Existing::Resume => this.take_over()?,
            }
        } else if existing == Existing::Replace && all(&is_ours) {
            // What a replacement that was killed left behind.
            remove(&present, MANIFEST, is_ours)?;
        } else if !all(&is_part) {
            return Err(Error::file(root, "is not empty and not a dataset: name another folder"));
        }
        std::fs::create_dir_all(root).map_err(|e| Error::file(root, format!("cannot be made: {e}")))?;
        remove(&entries(root)?, MANIFEST, is_part)?;
        this.save()?;
        Ok(this)
    }

    /// The description so far.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Continues from what is on disk if it was made in the same way.
    fn take_over(&mut self) -> Result<()> {
        let found = Manifest::read(&self.root)?;
        // Both sides go through the same text, where a number may lose its last bit.
        let wanted: Manifest = serde_json::from_slice(&self.manifest.to_json()?)
            .map_err(|e| Error::file(self.root.join(MANIFEST), e))?;
        let same = [
            ("generator", wanted.generator == found.generator),
            ("material", wanted.material == found.material),
            ("source", wanted.source == found.source),
            ("resolution", wanted.resolution == found.resolution),
            ("height_range", wanted.height_range == found.height_range),
            ("generation", wanted.generation == found.generation),
        ];
        if let Some((field, _)) = same.iter().find(|(_, same)| !same) {
            return Err(Error::file(
                self.root.join(MANIFEST),
                format!("{field} differs from what is asked for: ask for the same or force its replacement"),
            ));
        }
        for view in &found.views {
            check_bytes(&self.root.join(view.file()), view.bytes)?;
        }
        if let Some(heights) = &found.heights {
            check_bytes(&self.root.join(HEIGHTS), heights.bytes)?;
        }
        let Manifest { complete, heights, splits, views, .. } = found;
        self.manifest = Manifest { complete, heights, splits, views, ..self.manifest.clone() };
        // Training data last: it is compared with what is held out.
        for name in SplitName::ALL.into_iter().rev() {
            let Some(SplitInfo { side, files, .. }) = self.manifest.splits.get(&name).cloned() else {
                continue;
            };
            for file in files {
                check_bytes(&self.root.join(format!("{}.exr", file.name)), file.frame_bytes)?;
                let path = self.root.join(format!("{}.safetensors", file.name));
                let table = read_table(&path, file.table_bytes, side, file.blocks, file.patches)?;
                self.track(name, &table.iter().map(|(layout, _)| layout).collect::<Vec<_>>());
            }
        }
        Ok(())
    }

    /// Announces a split and how many blocks it will have; one that is there already is kept.
    ///
    /// # Errors
    /// `Config` if one is there with another block side or number of blocks.
    pub fn plan_split(
        &mut self,
        name: SplitName,
        side: usize,
        planned_blocks: usize,
        spp: Option<usize>,
    ) -> Result<()> {
        let empty = SplitInfo {
            side,
            planned_blocks,
            spp,
            level_shares: Vec::new(),
            noise: 0.0,
            nearest_training: None,
            files: Vec::new(),
        };
        let split = self.manifest.splits.entry(name).or_insert(empty);
        if (split.side, split.planned_blocks, split.spp) != (side, planned_blocks, spp) {
            return Err(Error::config(format!("splits.{name}"), "is there with another plan"));
        }
        self.manifest.complete = false;
        self.save()
    }

    /// Writes blocks as the next file of a split.
    ///
    /// # Errors
    /// `Config` if the split is not planned or the blocks do not fit it, `File` if writing fails.
    pub fn push(&mut self, name: SplitName, blocks: &[Block]) -> Result<()> {
        let Some(split) = self.manifest.splits.get(&name) else {
            return Err(Error::config(format!("splits.{name}"), "has not been planned"));
        };
        if blocks.is_empty() || blocks.iter().any(|block| block.side() != split.side) {
            return Err(Error::config(
                format!("splits.{name}"),
                format!("a file needs at least one block, each of side {}", split.side),
            ));
        }
        let file = file_name(name, split.files.len());
        let layouts: Vec<&Layout> = blocks.iter().map(Block::layout).collect();
        let noise: Vec<f32> = blocks.iter().map(Block::noise).collect();
        let info = FileInfo {
            blocks: blocks.len(),
            patches: layouts.iter().map(|layout| layout.patches().len()).sum(),
            level_blocks: count_levels(&layouts),
            frame_bytes: write_grid(&self.root.join(format!("{file}.exr")), split.side, blocks)?,
            table_bytes: write_table(&self.root.join(format!("{file}.safetensors")), &layouts, &noise)?,
            summary: summary(
                blocks.iter().flat_map(|block| block.rgb()).map(|p| p.map(f16::to_f32)),
                mean(noise.iter().map(|v| f64::from(*v))),
            ),
            noise: mean(noise.iter().map(|v| f64::from(*v).sqrt())),
            name: file,
        };
        self.manifest.splits.entry(name).and_modify(|split| {
            split.files.push(info);
            refresh(split);
        });
        self.track(name, &layouts);
        self.save()
    }

    /// Writes a view: a picture as queries and answers, with the mean variance of the answers.
    ///
    /// # Errors
    /// `Config` if the shapes differ or the name is not plain, `File` if writing fails.
    pub fn push_view(
        &mut self,
        name: &str,
        queries: &QueryBuffer,
        rgb: &RgbImage,
        variance: f32,
    ) -> Result<()> {
        let mut info = ViewInfo {
            name: name.into(),
            height: queries.height(),
            width: queries.width(),
            bytes: 0,
            summary: summary(rgb.pixels.iter().copied(), variance),
        };
        let mut checked = self.manifest.clone();
        checked.views.push(info.clone());
        checked.validate()?;
        info.bytes = write_query_frame(&self.root.join(info.file()), queries, rgb)?;
        self.manifest.views.push(info);
        self.save()
    }

    /// Stores the height map: `height * width` values row by row, tile widths.
    ///
    /// # Errors
    /// `Config` if the number of values is wrong or one is not finite, `File` if writing fails.
    pub fn set_heights(&mut self, height: usize, width: usize, values: Vec<f32>) -> Result<()> {
        if values.is_empty() || height.checked_mul(width) != Some(values.len()) {
            return Err(Error::config(
                "height_map",
                format!("{} values are not {height} x {width}", values.len()),
            ));
        }
        if let Some(k) = values.iter().position(|v| !v.is_finite()) {
            return Err(Error::config(format!("height_map[{k}]"), "is not finite"));
        }
        let path = self.root.join(HEIGHTS);
        let bytes = write_frame(&path, [height, width], vec![("Y", Plane::Float(values))])?;
        self.manifest.heights = Some(HeightInfo { height, width, bytes });
        self.save()
    }

    /// Marks the dataset complete and returns its description.
    ///
    /// # Errors
    /// `File` if writing fails.
    pub fn finish(mut self) -> Result<Manifest> {
        self.manifest.complete = true;
        self.save()?;
        Ok(self.manifest)
    }

    /// Brings the distances between held-out and training directions up to date.
    fn track(&mut self, name: SplitName, layouts: &[&Layout]) {
        let layouts = || layouts.iter().copied();
        if name == SplitName::Train {
            self.nearest.values_mut().for_each(|nearest| nearest.compare(layouts()));
        } else {
            self.nearest.entry(name).or_default().hold_out(layouts());
        }
        for (name, nearest) in &self.nearest {
            if let Some(split) = self.manifest.splits.get_mut(name) {
                split.nearest_training = nearest.distance();
            }
        }
    }

    fn save(&self) -> Result<()> {
        write_whole(&self.root.join(MANIFEST), &self.manifest.to_json()?)?;
        Ok(())
    }
}

/// Name of the height map's file.
pub(crate) const HEIGHTS: &str = "height.exr";

/// True for the names that a dataset's files have.
fn is_ours(name: &str) -> bool {
    let numbered = |rest: &str| {
        let number = rest.strip_suffix(".exr").or(rest.strip_suffix(".safetensors"));
        number.is_some_and(|n| n.len() == 5 && n.bytes().all(|c| c.is_ascii_digit()))
    };
    let of_split = |split: SplitName| name.strip_prefix(&format!("{split}-")).is_some_and(numbered);
    name == MANIFEST
        || name == HEIGHTS
        || is_part(name)
        || (name.starts_with("views-") && name.ends_with(".exr"))
        || SplitName::ALL.into_iter().any(of_split)
}

/// True if the description in a folder is of this program, of any version, or damaged among nothing but files `all_ours`:
/// other programs have a `dataset.json` too.
fn is_replaceable(root: &Path, all_ours: bool) -> bool {
    let text = std::fs::read(root.join(MANIFEST)).unwrap_or_default();
    serde_json::from_slice::<serde_json::Value>(&text).map_or(all_ours, |value| {
        let generator = value.get("generator").and_then(serde_json::Value::as_str);
        value.get("format").is_some() && generator.is_some_and(|g| g.starts_with("neumip"))
    })
}

fn count_levels(layouts: &[&Layout]) -> Vec<usize> {
    let mut counts = vec![0];
    for layout in layouts {
        let level = layout.level().round() as usize;
        if counts.len() <= level {
            counts.resize(level + 1, 0);
        }
        counts[level] += 1;
    }
    counts
}

fn summary(rgb: impl Iterator<Item = [f32; 3]>, variance: f32) -> Summary {
    let (mut sum, mut max, mut n) = ([0.0f64; 3], f32::NEG_INFINITY, 0u64);
    for pixel in rgb {
        for c in 0..3 {
            sum[c] += f64::from(pixel[c]);
            max = max.max(pixel[c]);
        }
        n += 1;
    }
    Summary { mean: sum.map(|s| (s / n.max(1) as f64) as f32), max: if n > 0 { max } else { 0.0 }, variance }
}

/// Mean of at least one value.
fn mean(values: impl ExactSizeIterator<Item = f64>) -> f32 {
    let n = values.len().max(1) as f64;
    (values.sum::<f64>() / n) as f32
}

/// Recomputes what a split says of its files together.
fn refresh(split: &mut SplitInfo) {
    let blocks = split.blocks().max(1) as f64;
    let levels = split.files.iter().map(|f| f.level_blocks.len()).max().unwrap_or(0);
    let count =
        |level: usize| -> usize { split.files.iter().filter_map(|f| f.level_blocks.get(level)).sum() };
    split.level_shares = (0..levels).map(|level| (count(level) as f64 / blocks) as f32).collect();
    let noise: f64 = split.files.iter().map(|f| f.blocks as f64 * f64::from(f.noise)).sum();
    split.noise = (noise / blocks) as f32;
}
