//! Seeded random numbers: every choice derives from one seed and the index of the thing drawn.

/// Independent streams, so that no two kinds of choice share numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Stream {
    /// Initial weights and textures.
    Weights = 1,
    /// Parameters of a built-in material.
    Material,
    /// Sub-samples of the reference.
    Reference,
    /// Directions, positions and levels of one split; add the split's index.
    Patches,
    /// Order in which training data is read.
    Shuffle = 32,
    /// Levels left out of a step.
    LevelDropout,
    /// Queries that are drawn to check or to time something.
    Probe,
    /// Settings of tuning trials.
    Trials,
    /// The importance sampler's conditions and directions.
    Sampler,
}

/// PCG-XSH-RR 64/32 (O'Neill 2014), started from a hash of (seed, stream, index).
#[derive(Clone, Debug)]
pub struct Random {
    state: u64,
    increment: u64,
}

/// Mixes 64 bits (SplitMix64's finaliser).
pub fn hash(value: u64) -> u64 {
    let mut z = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Random {
    /// The generator of item `index` of a stream.
    pub fn new(seed: u64, stream: Stream, index: u64) -> Self {
        Self::sub_stream(seed, stream, 0, index)
    }

    /// The generator of item `index` of the `part`-th part of a stream.
    pub fn sub_stream(seed: u64, stream: Stream, part: u64, index: u64) -> Self {
        let key = hash(hash(seed) ^ hash((stream as u64) << 32 | part));
        let mut this = Self { state: hash(key ^ hash(index)), increment: hash(key) | 1 };
        this.next_u32();
        this
    }

    /// 32 uniform bits.
    pub fn next_u32(&mut self) -> u32 {
        let old = self.state;
        self.state = old.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(self.increment);
        let xorshifted = (((old >> 18) ^ old) >> 27) as u32;
        xorshifted.rotate_right((old >> 59) as u32)
    }

    /// Uniform in [0, 1), 24 bits.
    pub fn uniform(&mut self) -> f32 {
        (self.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0)
    }

    /// Uniform in [0, 1), 53 bits.
    pub fn uniform_f64(&mut self) -> f64 {
        let high = u64::from(self.next_u32()) << 21;
        let low = u64::from(self.next_u32() >> 11);
        (high | low) as f64 * (1.0 / 9_007_199_254_740_992.0)
    }

    /// Uniform integer in [0, n), n > 0 (Lemire's multiply-shift; the bias is below n / 2^32).
    pub fn below(&mut self, n: usize) -> usize {
        ((u64::from(self.next_u32()) * n as u64) >> 32) as usize
    }

    /// Standard normal (Box-Muller).
    pub fn normal(&mut self) -> f32 {
        let radius = (-2.0 * (1.0 - self.uniform_f64()).ln()).sqrt();
        (radius * (std::f64::consts::TAU * self.uniform_f64()).cos()) as f32
    }

    /// A direction above the horizon as (x, y), uniform in the projected disc of squared radius `limit`.
    pub fn disc(&mut self, limit: f32) -> [f32; 2] {
        let radius = (self.uniform() * limit).sqrt();
        let (sin, cos) = (std::f32::consts::TAU * self.uniform()).sin_cos();
        [radius * cos, radius * sin]
    }

    /// Fisher-Yates permutation of 0..n.
    pub fn permutation(&mut self, n: usize) -> Vec<u32> {
        let mut order: Vec<u32> = (0..n as u32).collect();
        for last in (1..n).rev() {
            order.swap(last, self.below(last + 1));
        }
        order
    }
}
