//! A plain safetensors file of f32 tensors with one JSON string of metadata.
//!
//! Layout: 8 bytes of little-endian header length n, n bytes of JSON, then the data. The JSON maps each
//! tensor's name to `{"dtype": "F32", "shape": [...], "data_offsets": [begin, end]}` and `__metadata__` to
//! `{key: string}`. There is exactly one metadata key, because a map of several is written in hash order and
//! two runs would differ.
//!
//! The reader trusts nothing: what it allocates is bounded by the file's length, and every complaint names
//! the tensor.

use crate::error::{Error, Result};
use crate::whole_file::write_whole;
use safetensors::tensor::{Dtype, View};
use serde::Deserialize;
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// Longest header that is read: thousands of tensors and a few megabytes of metadata.
const MAX_HEADER: u64 = 16 << 20;
/// Bytes that are converted at a time.
const CHUNK: usize = 1 << 16;
const METADATA: &str = "__metadata__";

/// Values with a shape, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Extents, outermost first.
    pub shape: Vec<usize>,
    /// As many values as the product of `shape`.
    pub data: Vec<f32>,
}

impl Tensor {
    /// Says what is wrong with the values, if anything: a wrong number of them, or one that is not finite.
    pub(crate) fn problem(&self) -> Option<String> {
        let count = self.shape.iter().try_fold(1usize, |n, &side| n.checked_mul(side));
        if count != Some(self.data.len()) {
            return Some(format!("has {} values where its shape is {:?}", self.data.len(), self.shape));
        }
        let bad = self.data.iter().position(|v| !v.is_finite())?;
        Some(format!("value {bad} is {}", self.data[bad]))
    }
}

impl View for &Tensor {
    fn dtype(&self) -> Dtype {
        Dtype::F32
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        self.data.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    fn data_len(&self) -> usize {
        4 * self.data.len()
    }
}

/// Writes tensors and one JSON string under `key`; the same content gives the same bytes.
///
/// # Errors
/// `File`, naming the path, and the tensor where a value is not finite.
pub fn write_tensors(path: &Path, key: &str, json: &str, tensors: &BTreeMap<String, Tensor>) -> Result<()> {
    let bytes = encode(key, json, tensors).map_err(|e| Error::file(path, e))?;
    write_whole(path, &bytes)
}

/// Reads what [`write_tensors`] wrote: the JSON string and the tensors, all finite.
///
/// # Errors
/// `File`, naming the path, and the tensor where one is at fault.
pub fn read_tensors(path: &Path, key: &str) -> Result<(String, BTreeMap<String, Tensor>)> {
    let mut reader = TensorReader::open(path, key)?;
    let json = std::mem::take(&mut reader.json);
    Ok((json, reader.read()?))
}

/// The bytes of a file.
///
/// # Errors
/// `Config`, naming the tensor.
pub(crate) fn encode(key: &str, json: &str, tensors: &BTreeMap<String, Tensor>) -> Result<Vec<u8>> {
    for (name, tensor) in tensors {
        if name == METADATA {
            return Err(Error::config(name, "is not a tensor's name"));
        }
        if let Some(problem) = tensor.problem() {
            return Err(Error::config(name, problem));
        }
    }
    let metadata = HashMap::from([(key.to_string(), json.to_string())]);
    let bytes = safetensors::serialize(tensors, Some(metadata)).map_err(|e| Error::config(key, e))?;
    let header = u64::from_le_bytes(bytes[..8].try_into().unwrap_or_default());
    if header > MAX_HEADER {
        return Err(Error::config(key, format!("a header of {header} bytes; {MAX_HEADER} can be read back")));
    }
    Ok(bytes)
}

/// One tensor of the header.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    dtype: String,
    shape: Vec<usize>,
    data_offsets: [u64; 2],
}

/// A file whose header was read and checked, and whose data was not read yet.
pub(crate) struct TensorReader<'a> {
    path: &'a Path,
    source: Box<dyn Read + 'a>,
    /// The metadata string.
    pub json: String,
    entries: Vec<(String, Vec<usize>)>,
}

impl<'a> TensorReader<'a> {
    /// Reads the header of a file.
    pub fn open(path: &'a Path, key: &str) -> Result<Self> {
        let failed = |e: std::io::Error| Error::file(path, format!("cannot be read: {e}"));
        let about = std::fs::metadata(path).map_err(failed)?;
        if !about.is_file() {
            return Err(Error::file(path, "is not a file"));
        }
        let file = File::open(path).map_err(failed)?;
        Self::new(path, key, Box::new(BufReader::new(file)), about.len())
    }

    /// Reads the header of `length` bytes from anywhere; `path` names them in errors.
    pub fn new(path: &'a Path, key: &str, mut source: Box<dyn Read + 'a>, length: u64) -> Result<Self> {
        let broken = |problem: String| Error::file(path, problem);
        let cut = |e: std::io::Error| broken(format!("ends early: {e}"));
        if length < 8 {
            return Err(broken(format!("has {length} bytes: not a safetensors file")));
        }
        let mut prefix = [0; 8];
        source.read_exact(&mut prefix).map_err(cut)?;
        let header = u64::from_le_bytes(prefix);
        if header > MAX_HEADER || header > length - 8 {
            return Err(broken(format!(
                "claims a header of {header} bytes in a file of {length}: damaged, or not a safetensors file"
            )));
        }
        let mut text = vec![0; header as usize];
        source.read_exact(&mut text).map_err(cut)?;
        let mut map: serde_json::Map<String, serde_json::Value> =
            serde_json::from_slice(&text).map_err(|e| broken(format!("header: {e}")))?;
        let metadata = map.remove(METADATA).unwrap_or_default();
        let json = match metadata.as_object() {
            Some(keys) if keys.len() == 1 => keys.get(key).and_then(|v| v.as_str()).map(str::to_string),
            _ => None,
        };
        let json = json.ok_or_else(|| broken(format!("has no `{key}` as its one metadata key")))?;
        let entries = layout(map, length - 8 - header).map_err(broken)?;
        Ok(Self { path, source, json, entries })
    }

    /// Names and shapes.
    pub fn shapes(&self) -> impl Iterator<Item = (&str, &[usize])> {
        self.entries.iter().map(|(name, shape)| (name.as_str(), shape.as_slice()))
    }

    /// Reads all values.
    pub fn read(mut self) -> Result<BTreeMap<String, Tensor>> {
        let mut tensors = BTreeMap::new();
        let mut chunk = vec![0; CHUNK];
        for (name, shape) in self.entries {
            let broken = |problem: String| Error::file(self.path, format!("tensor {name}: {problem}"));
            let count = shape.iter().product();
            let mut data: Vec<f32> = Vec::new();
            data.try_reserve_exact(count).map_err(|e| broken(e.to_string()))?;
            while data.len() < count {
                let bytes = &mut chunk[..(4 * (count - data.len())).min(CHUNK)];
                self.source.read_exact(bytes).map_err(|e| broken(format!("ends early: {e}")))?;
                data.extend(bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)));
            }
            let tensor = Tensor { shape, data };
            if let Some(problem) = tensor.problem() {
                return Err(broken(problem));
            }
            tensors.insert(name, tensor);
        }
        Ok(tensors)
    }
}

/// Checks that the tensors are f32 and tile the `length` bytes of data; returns them in the order of the
/// data.
fn layout(
    map: serde_json::Map<String, serde_json::Value>,
    length: u64,
) -> std::result::Result<Vec<(String, Vec<usize>)>, String> {
    let mut entries = Vec::with_capacity(map.len());
    for (name, value) in map {
        let entry: Entry = serde_json::from_value(value).map_err(|e| format!("tensor {name}: {e}"))?;
        if entry.dtype != "F32" {
            return Err(format!("tensor {name}: is {}; only F32 is read", entry.dtype));
        }
        let [begin, end] = entry.data_offsets;
        let bytes = entry.shape.iter().try_fold(4u64, |n, &side| n.checked_mul(side as u64));
        if end > length || begin > end || bytes != Some(end - begin) {
            return Err(format!(
                "tensor {name}: shape {:?} at bytes {begin} to {end} does not fit {length} bytes of data",
                entry.shape
            ));
        }
        entries.push((name, entry));
    }
    entries.sort_by_key(|(_, entry)| entry.data_offsets);
    let mut next = 0;
    for (name, entry) in &entries {
        if entry.data_offsets[0] != next {
            return Err(format!("tensor {name}: starts at byte {} instead of {next}", entry.data_offsets[0]));
        }
        next = entry.data_offsets[1];
    }
    if next != length {
        return Err(format!("has {length} bytes of data where its tensors take {next}"));
    }
    Ok(entries.into_iter().map(|(name, entry)| (name, entry.shape)).collect())
}
