//! The material that is examined, and the questions that checks ask it.

use crate::dataset::Dataset;
use crate::error::{Error, Result};
use crate::query::{QueryBuffer, Reflectance, RgbImage, Support};
use crate::random::{Random, Stream};
use neumip_export::checkpoint::{Checkpoint, Measure};

/// Queries that are answered at a time.
const CHUNK: usize = 1 << 16;
/// Squared radius of directions that are drawn: up to 84 degrees.
const DISC: f32 = 0.99;
/// Pairs of directions are mirrored where their number is a multiple of this: gloss shows there.
const MIRRORED: usize = 3;
/// How far a mirrored pair is from the mirror direction, projected.
const BESIDE_MIRROR: f32 = 0.1;
/// Seed of everything that is drawn.
const SEED: u64 = 1;

/// How much is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// A second or two.
    Quick,
    /// Half a minute.
    Whole,
}

/// Which held-out data may be looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Splits {
    /// What choices may see.
    Validation,
    /// All of them, to report.
    All,
}

/// What is examined.
#[derive(Clone, Copy)]
pub struct Subject<'a> {
    /// Whatever answers.
    pub material: &'a dyn Reflectance,
    /// Texels of the tile, \[height, width\].
    pub resolution: [usize; 2],
    /// The coarsest level.
    pub coarsest: usize,
    /// What its RGB is.
    pub measure: Measure,
    /// What it was made from, where that is known.
    pub checkpoint: Option<&'a Checkpoint>,
    /// Ground truth, where there is some.
    pub data: Option<(&'a Dataset, Splits)>,
    /// How much is asked.
    pub extent: Extent,
}

/// A pair of directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Light.
    pub wi: [f32; 2],
    /// View.
    pub wo: [f32; 2],
}

/// Queries in the order in which they were added.
#[derive(Clone, Debug, Default)]
pub struct Questions {
    u: Vec<[f32; 2]>,
    wi: Vec<[f32; 2]>,
    wo: Vec<[f32; 2]>,
    level: Vec<f32>,
}

impl Questions {
    /// Adds a query.
    pub fn push(&mut self, u: [f32; 2], Pair { wi, wo }: Pair, level: f32) {
        self.u.push(u);
        self.wi.push(wi);
        self.wo.push(wo);
        self.level.push(level);
    }

    /// The query at `k` as a place.
    pub fn place(&self, k: usize, value: f64) -> super::finding::Place {
        let value = Some(value).filter(|v| v.is_finite());
        super::finding::Place { u: self.u[k], wi: self.wi[k], wo: self.wo[k], level: self.level[k], value }
    }

    /// Number of queries.
    pub fn len(&self) -> usize {
        self.u.len()
    }

    /// As a buffer of one row.
    ///
    /// # Errors
    /// `Config` for what is not finite.
    pub fn buffer(self) -> Result<QueryBuffer> {
        QueryBuffer::new(1, self.u.len(), self.u, self.wi, self.wo, self.level)
    }
}

impl<'a> Subject<'a> {
    /// A checkpoint's material without ground truth.
    pub fn new(material: &'a dyn Reflectance, checkpoint: &'a Checkpoint, extent: Extent) -> Self {
        let header = &checkpoint.header;
        Self {
            material,
            resolution: header.architecture.tile(),
            coarsest: header.architecture.coarsest(),
            measure: header.measure,
            checkpoint: Some(checkpoint),
            data: None,
            extent,
        }
    }

    /// With ground truth.
    ///
    /// # Errors
    /// `File` if the data is of a tile of another size.
    pub fn with(mut self, data: &'a Dataset, splits: Splits) -> Result<Self> {
        let [height, width] = data.resolution();
        if data.resolution() != self.resolution {
            let [h, w] = self.resolution;
            let problem =
                format!("is of {height} x {width} texels, the material of {h} x {w}; give its own --data");
            return Err(Error::file(data.root(), problem));
        }
        self.data = Some((data, splits));
        Ok(self)
    }

    /// `quick` or `whole`, as the extent has it.
    pub fn choose<T>(&self, quick: T, whole: T) -> T {
        match self.extent {
            Extent::Quick => quick,
            Extent::Whole => whole,
        }
    }

    /// True if every query is answered on its own.
    pub fn is_pointwise(&self) -> bool {
        self.material.support() == Support::Pointwise
    }

    /// Texels of a level, \[height, width\]; at least one.
    pub fn grid(&self, level: usize) -> [usize; 2] {
        self.resolution.map(|side| (side >> level.min(31)).max(1))
    }

    /// The levels whose texels fill the tile.
    pub fn whole_levels(&self) -> Vec<usize> {
        let fills = |level: &usize| self.resolution.iter().all(|side| (side >> level) << level == *side);
        (0..=self.coarsest.min(31)).take_while(fills).collect()
    }

    /// The generator of the `index`-th thing of a check.
    pub fn random(check: u64, index: usize) -> Random {
        Random::sub_stream(SEED, Stream::Probe, check, index as u64)
    }

    /// Pairs of directions, every third one near the mirror direction.
    pub fn pairs(&self, count: usize) -> Vec<Pair> {
        let pair = |k: usize| {
            let mut random = Self::random(0, k);
            let wo = random.disc(0.8 * DISC);
            let wi = match k % MIRRORED {
                0 => {
                    let beside = random.disc(1.0).map(|v| v * BESIDE_MIRROR);
                    [beside[0] - wo[0], beside[1] - wo[1]]
                }
                _ => random.disc(DISC),
            };
            Pair { wi, wo }
        };
        (0..count).map(pair).collect()
    }

    /// A random direction above the horizon.
    pub fn direction(random: &mut Random) -> [f32; 2] {
        random.disc(DISC)
    }

    /// Answers of a buffer, chunk by chunk.
    ///
    /// # Errors
    /// What the material reports.
    pub fn ask(&self, questions: Questions) -> Result<Vec<[f32; 3]>> {
        let buffer = questions.buffer()?;
        let mut pixels = Vec::with_capacity(buffer.len());
        for start in (0..buffer.len()).step_by(CHUNK) {
            let end = (start + CHUNK).min(buffer.len());
            pixels.extend(self.material.evaluate(&buffer.range(start, end))?.pixels);
        }
        Ok(pixels)
    }

    /// The whole tile at the texels of a level.
    ///
    /// # Errors
    /// What the material reports.
    pub fn tile(&self, pair: Pair, level: usize) -> Result<RgbImage> {
        let [height, width] = self.grid(level);
        self.material.evaluate(&QueryBuffer::slice(height, width, pair.wi, pair.wo, level as f32))
    }
}

/// Sum over the channels of squares.
pub fn energy(v: [f32; 3]) -> f64 {
    v.iter().map(|v| f64::from(*v) * f64::from(*v)).sum()
}

/// a - b.
pub fn minus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [0, 1, 2].map(|c| a[c] - b[c])
}

/// Mean over the channels.
pub fn grey(v: [f32; 3]) -> f64 {
    v.iter().map(|v| f64::from(*v)).sum::<f64>() / 3.0
}
