//! The order in which training data is presented, from memory that is bounded.
//!
//! Blocks are cut into square pieces. Each epoch permutes the files, takes them in consecutive windows that
//! fit half of the memory, and permutes the pieces within a window; batches run across the borders of windows
//! and epochs. While one window is used, a thread of its own decodes the next. A split that fits the memory
//! is one window that is loaded once. So the order is a function of the seed, the batch, the piece and the
//! windows (hence the memory), never of timing; any step can be sought.

use super::{
    block::{Block, stack},
    format::SplitName,
    frame::MAX_PIXELS,
    read::{Dataset, Split},
};
use crate::{
    error::{Error, Result},
    query::QueryBuffer,
    random::{Random, Stream as RandomStream},
};
use rayon::prelude::*;
use std::thread::JoinHandle;

/// Part of the shuffle stream that orders files; the other orders pieces.
const FILES: u64 = 0;
const PIECES: u64 = 1;
/// Bytes that a block costs besides its samples and patches.
const BLOCK_BYTES: usize = 128;

/// Pieces of one training step.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// Number of the step, from 0.
    pub step: u64,
    /// The pieces, all of one side.
    pub pieces: Vec<Block>,
}

impl Batch {
    /// All queries on a tile of \[H, W\] texels, piece under piece: a (pieces x side) x side grid.
    pub fn queries(&self, resolution: [usize; 2]) -> QueryBuffer {
        let side = self.pieces.first().map_or(1, Block::side);
        let rows = 0..self.pieces.len() * side;
        stack(rows.map(|row| (self.pieces[row / side].layout(), row % side)), side, resolution)
    }

    /// All answers in the order of the queries.
    pub fn target(&self) -> Vec<[f32; 3]> {
        self.pieces.iter().flat_map(Block::target).collect()
    }
}

/// One window: consecutive files of an epoch's order.
#[derive(Clone, Debug, PartialEq)]
struct Window {
    epoch: u64,
    index: usize,
    files: Vec<usize>,
    /// Pieces of the epoch before this window.
    start: u64,
    pieces: usize,
}

/// An endless, seekable order of batches.
#[derive(Debug)]
pub struct Stream {
    split: Split,
    piece_side: usize,
    batch_pieces: usize,
    seed: u64,
    step: u64,
    /// Bytes of each file in memory.
    bytes: Vec<usize>,
    /// Most bytes of a window.
    window_bytes: usize,
    pieces_per_block: usize,
    epoch_pieces: u64,
    /// Windows of the epoch that was asked for last.
    windows: Vec<Window>,
    current: Option<Loaded>,
    next: Option<Prefetch>,
}

/// A thread that decodes the files of a window.
#[derive(Debug)]
struct Prefetch {
    files: Vec<usize>,
    thread: JoinHandle<Result<Vec<Block>>>,
}

#[derive(Debug)]
struct Loaded {
    window: Window,
    blocks: Vec<Block>,
    order: Vec<u32>,
}

impl Stream {
    /// Batches of `batch_pieces` pieces of side `piece_side` out of a split, holding about `memory_bytes`, or
    /// two files where that is more.
    ///
    /// # Errors
    /// `Config` if the pieces do not cut the blocks, `File` if the split is missing or damaged.
    pub fn new(
        dataset: &Dataset,
        split: SplitName,
        piece_side: usize,
        batch_pieces: usize,
        memory_bytes: usize,
        seed: u64,
    ) -> Result<Self> {
        let split = dataset.split(split)?;
        let side = split.info().side;
        (0..split.files()).into_par_iter().try_for_each(|file| {
            split.read_rows(file)?.iter().try_for_each(|row| row.layout.check_cut(piece_side))
        })?;
        let most = MAX_PIXELS / (piece_side * piece_side);
        if !(1..=most).contains(&batch_pieces) {
            return Err(Error::config("batch_pieces", format!("{batch_pieces} is outside 1 to {most}")));
        }
        let of_block = side * side * size_of::<[u16; 3]>() + BLOCK_BYTES;
        let bytes: Vec<usize> = split
            .info()
            .files
            .iter()
            .map(|f| f.blocks * of_block + f.patches * size_of::<super::block::Patch>())
            .collect();
        let total: usize = bytes.iter().sum();
        let pieces_per_block = (side / piece_side) * (side / piece_side);
        let epoch_pieces = split.info().blocks() as u64 * pieces_per_block as u64;
        if epoch_pieces > u64::from(u32::MAX) {
            return Err(Error::config(
                "train.piece",
                format!("{epoch_pieces} pieces are more than can be ordered"),
            ));
        }
        Ok(Self {
            piece_side,
            batch_pieces,
            seed,
            step: 0,
            bytes,
            window_bytes: if total <= memory_bytes { total } else { memory_bytes / 2 },
            pieces_per_block,
            epoch_pieces,
            windows: Vec::new(),
            current: None,
            next: None,
            split,
        })
    }

    /// The step that the next batch is for.
    pub fn step(&self) -> u64 {
        self.step
    }

    /// Pieces of an epoch.
    pub fn epoch_pieces(&self) -> u64 {
        self.epoch_pieces
    }

    /// True if the whole split is loaded once and kept.
    pub fn in_memory(&self) -> bool {
        self.bytes.iter().sum::<usize>() <= self.window_bytes
    }

    /// Continues with the batch of any step, as if all before it had been taken.
    pub fn seek(&mut self, step: u64) {
        self.step = step;
    }

    /// The next batch.
    ///
    /// # Errors
    /// `File` if data is missing or damaged; the same batch can then be asked for again.
    pub fn next_batch(&mut self) -> Result<Batch> {
        let first = u128::from(self.step) * self.batch_pieces as u128;
        let mut pieces = Vec::with_capacity(self.batch_pieces);
        while pieces.len() < self.batch_pieces {
            let at = first + pieces.len() as u128;
            let epoch = (at / u128::from(self.epoch_pieces)) as u64;
            let within = (at % u128::from(self.epoch_pieces)) as u64;
            let resolution = self.split.resolution();
            let (per_block, side) = (self.pieces_per_block, self.piece_side);
            let wanted = self.batch_pieces - pieces.len();
            let loaded = self.load(epoch, within)?;
            let start = (within - loaded.window.start) as usize;
            pieces.extend(loaded.order[start..].iter().take(wanted).map(|k| {
                let k = *k as usize;
                loaded.blocks[k / per_block].piece(side, k % per_block, resolution)
            }));
        }
        let batch = Batch { step: self.step, pieces };
        self.step += 1;
        Ok(batch)
    }

    /// The windows of an epoch.
    fn windows_of(&self, epoch: u64) -> Vec<Window> {
        let n = self.split.files();
        let order: Vec<usize> = if self.in_memory() {
            (0..n).collect()
        } else {
            let mut random = Random::sub_stream(self.seed, RandomStream::Shuffle, FILES, epoch);
            random.permutation(n).into_iter().map(|k| k as usize).collect()
        };
        let mut windows: Vec<Window> = Vec::new();
        let (mut bytes, mut start) = (0, 0);
        for file in order {
            let pieces = self.split.info().files[file].blocks * self.pieces_per_block;
            match windows.last_mut() {
                Some(window) if bytes + self.bytes[file] <= self.window_bytes => {
                    window.files.push(file);
                    window.pieces += pieces;
                    bytes += self.bytes[file];
                }
                _ => {
                    windows.push(Window { epoch, index: windows.len(), files: vec![file], start, pieces });
                    bytes = self.bytes[file];
                }
            }
            start += pieces as u64;
        }
        windows
    }

    /// The window of the `within`-th piece of an epoch, loaded; the one after it is on its way.
    fn load(&mut self, epoch: u64, within: u64) -> Result<&Loaded> {
        if self.windows.first().is_none_or(|w| w.epoch != epoch) {
            self.windows = self.windows_of(epoch);
        }
        let index = self.windows.partition_point(|w| w.start <= within) - 1;
        let window = self.windows[index].clone();
        let loaded = match self.current.take() {
            Some(loaded) if loaded.window == window => loaded,
            // The order changes with every epoch even where the files stay.
            Some(Loaded { window: before, blocks, .. }) if before.files == window.files => {
                self.ordered(window, blocks)
            }
            before => {
                let blocks = self.fetch(&window.files)?;
                drop(before);
                self.prefetch(index);
                self.ordered(window, blocks)
            }
        };
        Ok(self.current.insert(loaded))
    }

    fn ordered(&self, window: Window, blocks: Vec<Block>) -> Loaded {
        let part = window.epoch << 24 | window.index as u64;
        let order =
            Random::sub_stream(self.seed, RandomStream::Shuffle, PIECES, part).permutation(window.pieces);
        Loaded { window, blocks, order }
    }

    /// The blocks of a window: from the thread that was sent for them, or read by all threads now.
    fn fetch(&mut self, files: &[usize]) -> Result<Vec<Block>> {
        if let Some(Prefetch { files: sent_for, thread }) = self.next.take()
            && sent_for == files
            && let Ok(Ok(blocks)) = thread.join()
        {
            return Ok(blocks);
        }
        // Also after a failure in the thread: reading again names the error.
        let read = files.par_iter().map(|file| self.split.read_file(*file)).collect::<Result<Vec<_>>>()?;
        Ok(read.into_iter().flatten().collect())
    }

    /// Sends a thread for the window after the `index`-th.
    fn prefetch(&mut self, index: usize) {
        let files = match self.windows.get(index + 1) {
            Some(window) => window.files.clone(),
            None => self.windows_of(self.windows[index].epoch + 1)[0].files.clone(),
        };
        if files == self.windows[index].files {
            return;
        }
        let split = self.split.clone();
        let sent_for = files.clone();
        // Where no thread can be had, the window is read when it is needed.
        let thread = std::thread::Builder::new().name("dataset".into()).spawn(move || {
            let mut blocks = Vec::new();
            for file in files {
                blocks.extend(split.read_file(file)?);
            }
            Ok(blocks)
        });
        self.next = thread.ok().map(|thread| Prefetch { files: sent_for, thread });
    }
}
