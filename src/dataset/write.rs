//! Writing a dataset folder so that it is valid after every file.

use super::{
    block::{Block, Layout},
    contact_sheet::contact_sheet,
    files::{CONTACT_SHEET, HEIGHTS, is_ours, refresh, write_blocks, write_heights, write_view},
    folder::{check_bytes, entries, is_part, name_of, remove, write_whole},
    format::{FileInfo, MANIFEST, Manifest, SequenceInfo, SplitInfo, SplitName, ViewInfo, file_name},
    nearest::Nearest,
    origin::check_same,
    read::Dataset,
    shard::{Collected, is_description},
    table::read_table,
};
use crate::{
    error::{Error, Result},
    query::{QueryBuffer, RgbImage},
};
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
    /// Keep its files and go on, also with what shards have made; its description must be the same.
    Resume,
    /// Keep its files and add training data; its description must be the same but for the amount of that.
    Append,
}

/// A dataset being written. Each file is written whole, then `dataset.json` is; a run that is stopped leaves
/// a smaller dataset.
#[derive(Debug)]
pub struct Writer {
    root: PathBuf,
    manifest: Manifest,
    nearest: BTreeMap<SplitName, Nearest>,
    /// Files that shards have made and that the description does not have yet.
    collected: Collected,
}

impl Writer {
    /// Opens the folder `root` for the dataset that `manifest` describes (without splits, views and heights),
    /// and makes it where it is missing.
    ///
    /// # Errors
    /// `File` if the folder holds something else, or a dataset that `existing` does not allow.
    pub fn create(root: &Path, manifest: Manifest, existing: Existing) -> Result<Self> {
        manifest.validate()?;
        let collected = Collected::default();
        let mut this = Self { root: root.into(), manifest, nearest: BTreeMap::new(), collected };
        let present = entries(root)?;
        let all = |which: &dyn Fn(&str) -> bool| present.iter().all(|path| which(name_of(path)));
        let any = |which: &dyn Fn(&str) -> bool| present.iter().any(|path| which(name_of(path)));
        let shards = any(&is_description);
        if any(&|name| name == MANIFEST) {
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
                Existing::Resume | Existing::Append => this.take_over(existing)?,
            }
        } else if existing == Existing::Append {
            return Err(Error::file(root, "holds no dataset to append to: generate it first"));
        } else if existing == Existing::Replace && all(&is_ours) {
            // What a replacement that was killed left behind.
            remove(&present, MANIFEST, is_ours)?;
        } else if shards && existing == Existing::Refuse {
            let problem = "holds shards of a dataset: resume to collect them, or force its replacement";
            return Err(Error::file(root, problem));
        } else if !(all(&is_part) || shards && existing == Existing::Resume) {
            return Err(Error::file(root, "is not empty and not a dataset: name another folder"));
        }
        if existing == Existing::Resume {
            this.collected = Collected::read(root, &this.manifest)?;
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
    fn take_over(&mut self, existing: Existing) -> Result<()> {
        let found = Manifest::read(&self.root)?;
        let path = self.root.join(MANIFEST);
        check_same(&found, &self.manifest, &path, existing == Existing::Append)?;
        for view in found.pictures() {
            check_bytes(&self.root.join(view.file()), view.bytes)?;
        }
        if let Some(heights) = &found.heights {
            check_bytes(&self.root.join(HEIGHTS), heights.bytes)?;
        }
        let complete = found.complete && found.appended_at == self.manifest.appended_at;
        let Manifest { heights, splits, views, motion, .. } = found;
        self.manifest = Manifest { complete, heights, splits, views, motion, ..self.manifest.clone() };
        // Training data last: it is compared with what is held out.
        for name in SplitName::ALL.into_iter().rev() {
            let Some(SplitInfo { side, files, .. }) = self.manifest.splits.get(&name).cloned() else {
                continue;
            };
            for file in files {
                self.read_back(name, side, &file)?;
            }
        }
        Ok(())
    }

    /// Checks a file that is there and takes note of its directions.
    fn read_back(&mut self, name: SplitName, side: usize, file: &FileInfo) -> Result<()> {
        check_bytes(&self.root.join(format!("{}.exr", file.name)), file.frame_bytes)?;
        let path = self.root.join(format!("{}.safetensors", file.name));
        let table = read_table(&path, file.table_bytes, side, file.blocks, file.patches)?;
        self.track(name, &table.iter().map(|row| &row.layout).collect::<Vec<_>>());
        Ok(())
    }

    /// Announces a split and how many blocks it will have; one that is there already is kept. Training data that is
    /// appended to may have more of them than it had.
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
            noisy_blocks: 0,
            nearest_training: None,
            files: Vec::new(),
        };
        let split = self.manifest.splits.entry(name).or_insert(empty);
        if name == SplitName::Train && !self.manifest.appended_at.is_empty() {
            split.planned_blocks = split.planned_blocks.max(planned_blocks);
        }
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
        let (side, index) = self.next(name)?;
        let noise = self.manifest.generation.as_ref().and_then(|config| config.noise);
        let info = write_blocks(&self.root, name, index, side, blocks, noise)?;
        self.add(name, info);
        self.track(name, &blocks.iter().map(Block::layout).collect::<Vec<_>>());
        self.save()
    }

    /// Side of a split's blocks and number of its next file.
    fn next(&self, name: SplitName) -> Result<(usize, usize)> {
        match self.manifest.splits.get(&name) {
            Some(split) => Ok((split.side, split.files.len())),
            None => Err(Error::config(format!("splits.{name}"), "has not been planned")),
        }
    }

    fn add(&mut self, name: SplitName, info: FileInfo) {
        self.manifest.splits.entry(name).and_modify(|split| {
            split.files.push(info);
            refresh(split);
        });
    }

    /// Takes the next file of a split from the shards; false if none of them has it.
    pub(crate) fn adopt(&mut self, name: SplitName) -> Result<bool> {
        let (side, index) = self.next(name)?;
        let Some(info) = self.collected.files.remove(&file_name(name, index)) else { return Ok(false) };
        info.validate(name, index, side * side)?;
        self.read_back(name, side, &info)?;
        self.add(name, info);
        Ok(true)
    }

    /// Takes a view, or the next picture of a sequence, from the shards; false if none of them has it.
    pub(crate) fn adopt_view(&mut self, sequence: Option<&str>, name: &str) -> Result<bool> {
        let Some(info) = self.collected.views.remove(name) else { return Ok(false) };
        check_bytes(&self.root.join(info.file()), info.bytes)?;
        self.add_view(sequence, info);
        Ok(true)
    }

    fn add_view(&mut self, sequence: Option<&str>, info: ViewInfo) {
        let Some(name) = sequence else { return self.manifest.views.push(info) };
        let motion = &mut self.manifest.motion;
        match motion.iter_mut().find(|sequence| sequence.name == name) {
            Some(sequence) => sequence.pictures.push(info),
            None => motion.push(SequenceInfo { name: name.into(), pictures: vec![info] }),
        }
    }

    /// Number of pictures of a sequence that are there.
    pub(crate) fn pictures(&self, sequence: &str) -> usize {
        let found = self.manifest.motion.iter().find(|found| found.name == sequence);
        found.map_or(0, |sequence| sequence.pictures.len())
    }

    /// Takes the height map from the shards; false if none of them has it.
    pub(crate) fn adopt_heights(&mut self) -> Result<bool> {
        let Some(info) = self.collected.heights.take() else { return Ok(false) };
        check_bytes(&self.root.join(HEIGHTS), info.bytes)?;
        self.manifest.heights = Some(info);
        Ok(true)
    }

    /// Samples that are there or that shards have made.
    pub(crate) fn samples(&self) -> u64 {
        let splits = self.manifest.splits.values().map(SplitInfo::samples).sum::<u64>();
        let views = self.manifest.pictures().map(|view| (view.height * view.width) as u64).sum::<u64>();
        splits + views + self.collected.samples(&self.manifest)
    }

    /// Writes a view, or the next picture of a sequence: a picture as queries and answers, with the mean variance of
    /// the answers.
    ///
    /// # Errors
    /// `Config` if the shapes differ or the name is not plain, `File` if writing fails.
    pub fn push_view(
        &mut self,
        sequence: Option<&str>,
        name: &str,
        queries: &QueryBuffer,
        rgb: &RgbImage,
        variance: f32,
    ) -> Result<()> {
        let info = write_view(&self.root, name, queries, rgb, variance)?;
        self.add_view(sequence, info);
        self.save()
    }

    /// Stores the height map: `height * width` values row by row, tile widths.
    ///
    /// # Errors
    /// `Config` if the number of values is wrong or one is not finite, `File` if writing fails.
    pub fn set_heights(&mut self, height: usize, width: usize, values: Vec<f32>) -> Result<()> {
        self.manifest.heights = Some(write_heights(&self.root, height, width, values)?);
        self.save()
    }

    /// Draws the contact sheet, marks the dataset complete and returns its description.
    ///
    /// # Errors
    /// `File` if writing fails.
    pub fn finish(mut self) -> Result<Manifest> {
        let sheet = contact_sheet(&Dataset::written(&self.root, &self.manifest))?;
        write_whole(&self.root.join(CONTACT_SHEET), &sheet)?;
        self.manifest.complete = true;
        self.save()?;
        self.forget_shards()?;
        Ok(self.manifest)
    }

    /// Removes the descriptions of shards, which the dataset's own has taken in.
    pub(crate) fn forget_shards(&self) -> Result<()> {
        remove(&entries(&self.root)?, "", is_description)
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

/// True if the description in a folder is of this program, of any version, or damaged among nothing but files
/// `all_ours`: other programs have a `dataset.json` too.
fn is_replaceable(root: &Path, all_ours: bool) -> bool {
    let text = std::fs::read(root.join(MANIFEST)).unwrap_or_default();
    serde_json::from_slice::<serde_json::Value>(&text).map_or(all_ours, |value| {
        let generator = value.get("generator").and_then(serde_json::Value::as_str);
        value.get("format").is_some() && generator.is_some_and(|g| g.starts_with("neumip"))
    })
}
