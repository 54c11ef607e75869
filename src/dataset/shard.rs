//! Making a dataset in parts that know nothing of each other.
//!
//! The work is the list of all files; shard i of n makes every n-th of them and lists what it has made in
//! `shard-I-of-N.json`, which is written anew after every file. Shards may share a folder, or theirs be copied into
//! one; resuming there collects what they have made, makes what is missing and writes `dataset.json`.

use super::{
    block::Block,
    files::{is_ours, write_blocks, write_heights, write_view},
    folder::{check_bytes, entries, name_of, read_json, write_whole},
    format::{FileInfo, HeightInfo, MANIFEST, Manifest, SplitName, ViewInfo, file_name},
    origin::check_same,
    write::Existing,
};
use crate::{
    error::{Error, Result},
    query::{QueryBuffer, RgbImage},
};
use serde::{Deserialize, Serialize};
use std::{
    collections::BTreeMap,
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
};

/// Most shards of a dataset.
const MAX_SHARDS: usize = 10_000;

/// One of several equal shares of the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shard {
    /// Number of this share, from 1.
    pub index: usize,
    /// Number of shares.
    pub count: usize,
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl FromStr for Shard {
    type Err = Error;

    /// From `i/n`, i from 1.
    fn from_str(text: &str) -> Result<Self> {
        let numbers = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match numbers {
            Some((index, count)) => {
                let this = Self { index, count };
                this.validate().map(|()| this)
            }
            None => Err(Error::config("shard", format!("{text} is not I/N, as in 1/4"))),
        }
    }
}

impl Shard {
    /// Checks that it is one of its shares.
    ///
    /// # Errors
    /// `Config` if it is not.
    pub fn validate(&self) -> Result<()> {
        if (1..=MAX_SHARDS).contains(&self.count) && (1..=self.count).contains(&self.index) {
            return Ok(());
        }
        let problem = format!("{self} is not I/N with I from 1 to N and N up to {MAX_SHARDS}");
        Err(Error::config("shard", problem))
    }

    /// True if the `k`-th piece of work is of this share.
    pub(crate) fn takes(&self, k: usize) -> bool {
        k % self.count + 1 == self.index
    }

    fn file(&self) -> String {
        format!("shard-{}-of-{}.json", self.index, self.count)
    }
}

/// True for the name of a shard's description.
pub(crate) fn is_description(name: &str) -> bool {
    let numbers = || name.strip_prefix("shard-")?.strip_suffix(".json")?.split_once("-of-");
    numbers().is_some_and(|(i, n)| {
        [i, n].iter().all(|part| !part.is_empty() && part.bytes().all(|c| c.is_ascii_digit()))
    })
}

/// What a shard's description holds.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Description {
    shard: Shard,
    /// The dataset without its files.
    dataset: Manifest,
    heights: Option<HeightInfo>,
    /// Files of blocks by their names.
    files: BTreeMap<String, FileInfo>,
    /// Views and pictures of sequences by their names.
    views: BTreeMap<String, ViewInfo>,
}

impl Description {
    fn read(path: &Path, wanted: &Manifest) -> Result<Self> {
        let this: Self = serde_json::from_value(read_json(path)?).map_err(|e| Error::file(path, e))?;
        check_same(&this.dataset, wanted, path, false)?;
        this.views
            .iter()
            .try_for_each(|(name, view)| {
                view.validate()?;
                if view.name == *name {
                    Ok(())
                } else {
                    Err(Error::config(format!("views.{name}"), "is another view"))
                }
            })
            .map_err(|e| Error::file(path, e))?;
        Ok(this)
    }
}

/// What all shards in a folder have made.
#[derive(Debug, Default)]
pub(crate) struct Collected {
    pub(crate) heights: Option<HeightInfo>,
    pub(crate) files: BTreeMap<String, FileInfo>,
    pub(crate) views: BTreeMap<String, ViewInfo>,
}

impl Collected {
    /// Reads the descriptions of the shards in a folder, which must be of the dataset that is `wanted`; what that
    /// has already is left out.
    pub(crate) fn read(root: &Path, wanted: &Manifest) -> Result<Self> {
        let mut this = Self::default();
        for path in entries(root)?.iter().filter(|path| is_description(name_of(path))) {
            let description = Description::read(path, wanted)?;
            this.heights = this.heights.or(description.heights);
            this.files.extend(description.files);
            this.views.extend(description.views);
        }
        wanted.splits.values().flat_map(|split| &split.files).for_each(|file| {
            this.files.remove(&file.name);
        });
        wanted.pictures().for_each(|view| {
            this.views.remove(&view.name);
        });
        Ok(this)
    }

    /// Samples of all of it, where the description has the splits.
    pub(crate) fn samples(&self, manifest: &Manifest) -> u64 {
        let of_file = |file: &FileInfo| {
            let split = manifest.splits.iter().find(|(name, _)| file.name.starts_with(name.as_str()));
            let side = split.map_or(0, |(_, split)| split.side as u64);
            (file.blocks as u64).saturating_mul(side * side)
        };
        let files = self.files.values().map(of_file).fold(0, u64::saturating_add);
        let views = self.views.values().map(|view| (view.height * view.width) as u64);
        views.fold(files, u64::saturating_add)
    }
}

/// A shard being written.
pub(crate) struct ShardWriter {
    root: PathBuf,
    made: Description,
}

impl ShardWriter {
    /// Opens the folder `root` for a shard of the dataset that `manifest` describes, and makes it where it is
    /// missing.
    pub(crate) fn create(root: &Path, manifest: Manifest, shard: Shard, existing: Existing) -> Result<Self> {
        shard.validate()?;
        manifest.validate()?;
        let present = entries(root)?;
        if present.iter().any(|path| name_of(path) == MANIFEST) {
            let problem = "holds a dataset already: name another folder for its shards";
            return Err(Error::file(root, problem));
        }
        if !present.iter().all(|path| is_ours(name_of(path))) {
            return Err(Error::file(root, "is not empty and not a dataset: name another folder"));
        }
        let path = root.join(shard.file());
        let mut made = Description {
            shard,
            dataset: manifest,
            heights: None,
            files: BTreeMap::new(),
            views: BTreeMap::new(),
        };
        match (path.exists(), existing) {
            (_, Existing::Append) => {
                return Err(Error::usage("a dataset is appended to as a whole, not by shards"));
            }
            (true, Existing::Refuse) => {
                let problem = "is there already: resume the shard or force its replacement";
                return Err(Error::file(path, problem));
            }
            (true, Existing::Resume) => {
                made = Description { shard, ..Description::read(&path, &made.dataset)? }
            }
            // Other shards may be at work here: only its own list goes, and its files are written over.
            _ => {}
        }
        std::fs::create_dir_all(root).map_err(|e| Error::file(root, format!("cannot be made: {e}")))?;
        let this = Self { root: root.into(), made };
        this.save()?;
        Ok(this)
    }

    /// True if a file is there, whole.
    pub(crate) fn has_file(&self, name: SplitName, index: usize) -> bool {
        self.made.files.get(&file_name(name, index)).is_some_and(|file| {
            let is =
                |ending: &str, bytes| check_bytes(&self.root.join(format!("{}.{ending}", file.name)), bytes);
            is("exr", file.frame_bytes).and(is("safetensors", file.table_bytes)).is_ok()
        })
    }

    /// True if a view is there, whole.
    pub(crate) fn has_view(&self, name: &str) -> bool {
        let view = self.made.views.get(name);
        view.is_some_and(|view| check_bytes(&self.root.join(view.file()), view.bytes).is_ok())
    }

    /// True if the height map is there.
    pub(crate) fn has_heights(&self) -> bool {
        let path = self.root.join(super::files::HEIGHTS);
        self.made.heights.as_ref().is_some_and(|heights| check_bytes(&path, heights.bytes).is_ok())
    }

    /// Writes blocks as a file.
    pub(crate) fn put_file(
        &mut self,
        name: SplitName,
        index: usize,
        side: usize,
        blocks: &[Block],
    ) -> Result<()> {
        let noise = self.made.dataset.generation.as_ref().and_then(|config| config.noise);
        let info = write_blocks(&self.root, name, index, side, blocks, noise)?;
        self.made.files.insert(info.name.clone(), info);
        self.save()
    }

    /// Writes a view.
    pub(crate) fn put_view(
        &mut self,
        name: &str,
        queries: &QueryBuffer,
        rgb: &RgbImage,
        variance: f32,
    ) -> Result<()> {
        let info = write_view(&self.root, name, queries, rgb, variance)?;
        self.made.views.insert(name.into(), info);
        self.save()
    }

    /// Writes the height map.
    pub(crate) fn put_heights(&mut self, height: usize, width: usize, values: Vec<f32>) -> Result<()> {
        self.made.heights = Some(write_heights(&self.root, height, width, values)?);
        self.save()
    }

    fn save(&self) -> Result<()> {
        let path = self.root.join(self.made.shard.file());
        let mut bytes = serde_json::to_vec_pretty(&self.made).map_err(|e| Error::file(&path, e))?;
        bytes.push(b'\n');
        write_whole(&path, &bytes).map(|_| ())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_disjoint_and_whole() {
        let shards: Vec<Shard> = (1..=3).map(|index| Shard { index, count: 3 }).collect();
        for k in 0..20 {
            assert_eq!(shards.iter().filter(|shard| shard.takes(k)).count(), 1);
        }
        assert!(is_description(&shards[1].file()) && !is_description("shard-1-of-.json"));
        assert_eq!("2/3".parse::<Shard>().unwrap(), shards[1]);
        for wrong in ["0/3", "4/3", "1/0", "1/10001", "1", "a/b", "1/-2"] {
            assert!(wrong.parse::<Shard>().unwrap_err().to_string().starts_with("shard: "), "{wrong}");
        }
    }
}
