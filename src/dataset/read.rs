//! Opening a dataset folder: everything is checked before anything is believed.

use super::{
    block::{Block, Layout},
    files::HEIGHTS,
    folder::check_bytes,
    format::{MANIFEST, Manifest, SplitInfo, SplitName},
    frame::{Plane, read_frame},
    grid::read_grid,
    query_frame::read_query_frame_of,
    table::{Row, read_table},
};
use crate::{
    error::{Error, Result},
    query::{QueryBuffer, RgbImage},
};
use rayon::prelude::*;
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// A dataset on disk.
#[derive(Clone, Debug)]
pub struct Dataset {
    root: PathBuf,
    manifest: Manifest,
}

impl Dataset {
    /// A dataset that was just written.
    pub(crate) fn written(root: &Path, manifest: &Manifest) -> Self {
        Self { root: root.into(), manifest: manifest.clone() }
    }

    /// Opens a folder and checks its description, the length of every file and every table. Frames are
    /// decoded, and their values checked, when they are read.
    ///
    /// # Errors
    /// `File`, naming the file, if anything is missing, damaged or inconsistent, or if there is no training
    /// data with at least two pairs of directions where the dataset has a training split.
    pub fn open(root: impl AsRef<Path>) -> Result<Self> {
        let root = root.as_ref().to_path_buf();
        let this = Self { manifest: Manifest::read(&root)?, root };
        let description = this.root.join(MANIFEST);
        for view in this.manifest.pictures() {
            check_bytes(&this.root.join(view.file()), view.bytes)?;
        }
        if let Some(heights) = &this.manifest.heights {
            check_bytes(&this.root.join(HEIGHTS), heights.bytes)?;
        }
        for (name, info) in &this.manifest.splits {
            let split = this.part(*name, info);
            let several = (0..info.files.len())
                .into_par_iter()
                .map(|file| {
                    check_bytes(&split.path(file, "exr"), info.files[file].frame_bytes)?;
                    Ok(first_pair(&split.read_rows(file)?))
                })
                .collect::<Result<Vec<_>>>()?;
            if *name == SplitName::Train {
                let one = several.iter().all(|(pair, alone)| *alone && *pair == several[0].0);
                if several.is_empty() {
                    return Err(Error::file(description, "has no training data yet: resume its generation"));
                } else if one {
                    return Err(Error::file(
                        description,
                        "has training data of a single pair of directions: two at least are needed",
                    ));
                }
            }
        }
        if this.manifest.splits.values().all(|s| s.files.is_empty())
            && this.manifest.pictures().next().is_none()
        {
            return Err(Error::file(description, "describes no data"));
        }
        Ok(this)
    }

    /// The description.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// SHA-256 of the description, which counts and sums up every file: equal for the same data only.
    ///
    /// # Errors
    /// `Config` if the description cannot be written as JSON.
    pub fn identity(&self) -> Result<String> {
        let digest = Sha256::digest(self.manifest.to_json()?);
        Ok(digest.iter().map(|byte| format!("{byte:02x}")).collect())
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Texels of the tile, \[height, width\].
    pub fn resolution(&self) -> [usize; 2] {
        self.manifest.resolution
    }

    /// The splits that hold data.
    pub fn split_names(&self) -> Vec<SplitName> {
        let held = self.manifest.splits.iter().filter(|(_, info)| !info.files.is_empty());
        held.map(|(name, _)| *name).collect()
    }

    /// One split.
    ///
    /// # Errors
    /// `File` if the dataset has no data of that split.
    pub fn split(&self, name: SplitName) -> Result<Split> {
        match self.manifest.splits.get(&name) {
            Some(info) if !info.files.is_empty() => Ok(self.part(name, info)),
            _ => Err(Error::file(self.root.join(MANIFEST), format!("has no data of split {name}"))),
        }
    }

    fn part(&self, name: SplitName, info: &SplitInfo) -> Split {
        Split { root: self.root.clone(), name, resolution: self.manifest.resolution, info: info.clone() }
    }

    /// Queries and answers of a view or of a picture of a sequence, by its name in the description.
    ///
    /// # Errors
    /// `File` if there is no such view or it is damaged.
    pub fn read_view(&self, name: &str) -> Result<(QueryBuffer, RgbImage)> {
        let view = self.manifest.pictures().find(|view| view.name == name);
        let view =
            view.ok_or_else(|| Error::file(self.root.join(MANIFEST), format!("has no view {name}")))?;
        read_query_frame_of(&self.root.join(view.file()), [view.height, view.width])
    }

    /// Rows, columns and values of the height map (tile widths), where one is stored.
    ///
    /// # Errors
    /// `File` if it is damaged.
    pub fn read_heights(&self) -> Result<Option<(usize, usize, Vec<f32>)>> {
        let Some(info) = &self.manifest.heights else { return Ok(None) };
        let path = self.root.join(HEIGHTS);
        let (_, planes) = read_frame(&path, Some([info.height, info.width]), &["Y"])?;
        let values: Vec<f32> = planes.into_iter().flat_map(Plane::into_f32).collect();
        match values.iter().position(|v| !v.is_finite()) {
            Some(k) => Err(Error::file(path, format!("value {k} is not finite"))),
            None => Ok(Some((info.height, info.width, values))),
        }
    }
}

/// The blocks of one split, file by file. It can be sent to another thread.
#[derive(Clone, Debug)]
pub struct Split {
    root: PathBuf,
    name: SplitName,
    resolution: [usize; 2],
    info: SplitInfo,
}

impl Split {
    /// Its name.
    pub fn name(&self) -> SplitName {
        self.name
    }

    /// What the description says of it.
    pub fn info(&self) -> &SplitInfo {
        &self.info
    }

    /// Texels of the tile, \[height, width\].
    pub fn resolution(&self) -> [usize; 2] {
        self.resolution
    }

    /// Number of files.
    pub fn files(&self) -> usize {
        self.info.files.len()
    }

    pub(crate) fn path(&self, file: usize, ending: &str) -> PathBuf {
        self.root.join(format!("{}.{ending}", self.info.files[file].name))
    }

    /// What is asked in the blocks of a file, and how noisy each of them is.
    pub(crate) fn read_rows(&self, file: usize) -> Result<Vec<Row>> {
        let info = &self.info.files[file];
        read_table(
            &self.path(file, "safetensors"),
            info.table_bytes,
            self.info.side,
            info.blocks,
            info.patches,
        )
    }

    /// What is asked in the blocks of a file.
    ///
    /// # Errors
    /// `Usage` if there is no such file, `File` if it is missing or damaged.
    pub fn layouts(&self, file: usize) -> Result<Vec<Layout>> {
        if file >= self.files() {
            return Err(self.no_file(file));
        }
        Ok(self.read_rows(file)?.into_iter().map(|row| row.layout).collect())
    }

    fn no_file(&self, file: usize) -> Error {
        Error::usage(format!("split {} has {} files, no file {file}", self.name, self.files()))
    }

    /// Reads the blocks of a file.
    ///
    /// # Errors
    /// `Usage` if there is no such file, `File` if it is missing or damaged or a value is not finite.
    pub fn read_file(&self, file: usize) -> Result<Vec<Block>> {
        let Some(info) = self.info.files.get(file) else {
            return Err(self.no_file(file));
        };
        let (side, path) = (self.info.side, self.path(file, "exr"));
        let rows = self.read_rows(file)?;
        check_bytes(&path, info.frame_bytes)?;
        read_grid(&path, side, rows)
    }
}

/// The first pair of directions of a file, and whether it is the only one.
fn first_pair(rows: &[Row]) -> (Option<[[f32; 2]; 2]>, bool) {
    let mut pairs = rows.iter().flat_map(|row| row.layout.patches()).map(|p| [p.wi, p.wo]);
    let first = pairs.next();
    (first, pairs.all(|pair| Some(pair) == first))
}
