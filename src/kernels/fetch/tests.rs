//! Lookups and scatters against plain float64.

use super::*;
use crate::kernels::simd::Isa;
use crate::random::{Random, Stream};

/// Mixing eight texels of size 1 at a position within a tile of up to 64 texels, whose rounding moves it by 4e-6 of a texel.
const ROUNDING: f64 = 3e-5;
/// Slopes are that times the side.
const SLOPE_ROUNDING: f64 = 3e-4;
/// f16 keeps 11 bits of values up to 4.
const HALF_ROUNDING: f64 = 2e-3;
const STRIDE: usize = 48;

struct Pyramid {
    sizes: Vec<(usize, usize)>,
    channels: usize,
    texels: Vec<Vec<f32>>,
    halves: Vec<Vec<f16>>,
}

impl Pyramid {
    fn new(sizes: &[(usize, usize)], channels: usize) -> Self {
        let mut random = Random::new(11, Stream::Probe, channels as u64);
        let texels: Vec<Vec<f32>> =
            sizes.iter().map(|(h, w)| (0..h * w * channels).map(|_| random.normal()).collect()).collect();
        let halves = texels
            .iter()
            .map(|t: &Vec<f32>| {
                t.chunks(channels)
                    .flat_map(|t| (0..padded(channels)).map(|c| f16::from_f32(*t.get(c).unwrap_or(&0.0))))
                    .collect()
            })
            .collect();
        Self { sizes: sizes.to_vec(), channels, texels, halves }
    }

    fn textures(&self, half: bool) -> super::Pyramid<'_> {
        let level = |l: usize| match half {
            true => Texels::Half(&self.halves[l]),
            false => Texels::Single(&self.texels[l]),
        };
        let levels = (0..self.sizes.len()).map(level).collect();
        super::Pyramid { levels, height: self.sizes[0].0, width: self.sizes[0].1 }
    }

    /// Texel of the table, weight, and slopes of the weight, of all taps of a sample.
    fn taps64(&self, x: f64, y: f64, level: f64) -> Vec<Tap64> {
        let last = self.sizes.len() - 1;
        let level = level.min(last as f64);
        let finer = level.floor() as usize;
        let share = level - finer as f64;
        let mut out = Vec::new();
        for (l, mix) in [(finer, 1.0 - share), ((finer + 1).min(last), share)] {
            let base: usize = self.sizes[..l].iter().map(|(h, w)| h * w).sum();
            let (h, w) = self.sizes[l];
            let (px, py) = (x * w as f64 - 0.5, y * h as f64 - 0.5);
            let (fx, fy) = (px - px.floor(), py - py.floor());
            for (i, wy, sy) in [(0, 1.0 - fy, -1.0), (1, fy, 1.0)] {
                for (j, wx, sx) in [(0, 1.0 - fx, -1.0), (1, fx, 1.0)] {
                    let row = (py.floor() as i64 + i).rem_euclid(h as i64) as usize;
                    let column = (px.floor() as i64 + j).rem_euclid(w as i64) as usize;
                    let slopes = [mix * sx * w as f64 * wy, mix * sy * h as f64 * wx];
                    out.push((l, base + row * w + column, mix * wx * wy, slopes));
                }
            }
        }
        out
    }

    fn texel(&self, l: usize, index: usize, c: usize) -> f64 {
        let base: usize = self.sizes[..l].iter().map(|(h, w)| h * w).sum();
        f64::from(self.texels[l][(index - base) * self.channels + c])
    }
}

fn places(levels: usize) -> [Vec<f32>; 3] {
    let mut random = Random::new(12, Stream::Probe, levels as u64);
    let mut all = [vec![], vec![], vec![]];
    for k in 0..STRIDE {
        for axis in all.iter_mut().take(2) {
            axis.push(match k % 4 {
                0 => random.uniform(),
                1 => 4.0 * random.uniform() - 2.0,
                2 => (random.uniform() * 8.0).floor() / 8.0,
                _ => 1.0,
            });
        }
        let level = random.uniform() * (levels - 1) as f32;
        all[2].push(if k < 16 { level.floor() } else { level });
    }
    all
}

fn lookup(isa: Isa, channels: usize, pyramid: &super::Pyramid, at: Places, found: Found) {
    let mut aimed = Aim::default();
    aim(isa, STRIDE, channels, pyramid, at, &mut aimed);
    read(isa, STRIDE, channels, pyramid, &aimed, found);
}

/// Level, texel of the table, weight, slopes of the weight.
type Tap64 = (usize, usize, f64, [f64; 2]);

/// Largest errors of features and of slopes with the positions moved.
fn worst(isa: Isa, pyramid: &Pyramid, half: bool, moved: f32) -> [f64; 2] {
    let textures = pyramid.textures(half);
    let [x, y, level] = places(textures.levels.len());
    let given: Vec<f32> = x.iter().map(|x| x + moved).collect();
    let channels = pyramid.channels;
    let mut features = vec![f32::NAN; channels * STRIDE];
    let mut slopes = vec![f32::NAN; 2 * channels * STRIDE];
    let mut taps = vec![Taps::default(); 2 * STRIDE];
    let found = Found { features: &mut features, slopes: &mut slopes, taps: &mut taps };
    let at = Places { x: &given, y: &y, level: &level };
    lookup(isa, channels, &textures, at, found);
    let mut worst = [0.0f64; 2];
    for k in 0..STRIDE {
        let exact = pyramid.taps64(f64::from(x[k]), f64::from(y[k]), f64::from(level[k]));
        for c in 0..channels {
            let sum = |f: &dyn Fn(&Tap64) -> f64| -> f64 {
                exact.iter().map(|t| f(t) * pyramid.texel(t.0, t.1, c)).sum()
            };
            let value = f64::from(features[c * STRIDE + k]);
            worst[0] = worst[0].max((value - sum(&|t| t.2)).abs());
            // On an edge between texels a slope has two sides.
            if k % 4 != 2 && k % 4 != 3 {
                for axis in 0..2 {
                    let slope = f64::from(slopes[(axis * channels + c) * STRIDE + k]);
                    worst[1] = worst[1].max((slope - sum(&|t| t.3[axis])).abs());
                }
            }
        }
        if moved == 0.0 && k % 4 < 2 {
            for (t, tap) in exact.iter().zip((0..8).map(|i| (taps[i / 4 * STRIDE + k], i % 4))) {
                assert_eq!(tap.0.index()[tap.1] as usize, t.1);
                worst[0] = worst[0].max((f64::from(tap.0.weight()[tap.1]) - t.2).abs());
            }
        }
    }
    worst
}

#[test]
fn lookups_follow_float64_and_a_moved_position_is_noticed() {
    let shapes: [&[(usize, usize)]; 4] =
        [&[(64, 64), (32, 32), (16, 16)], &[(7, 9), (3, 4)], &[(5, 2)], &[(12, 20), (6, 10), (3, 5), (1, 2)]];
    for isa in Isa::all() {
        for sizes in shapes {
            for channels in [1, 3, 7, 8, 12, 16] {
                let pyramid = Pyramid::new(sizes, channels);
                let [value, slope] = worst(isa, &pyramid, false, 0.0);
                assert!(value < ROUNDING, "{} {sizes:?} {channels}: {value:e}", isa.name());
                assert!(slope < SLOPE_ROUNDING * 64.0, "{} {sizes:?} {channels}: {slope:e}", isa.name());
                assert!(worst(isa, &pyramid, false, 1e-3)[0] > ROUNDING);
                let half = worst(isa, &pyramid, true, 0.0)[0];
                assert!(half < HALF_ROUNDING && half > ROUNDING, "{half:e}");
            }
        }
    }
}

#[test]
fn gradients_arrive_at_their_texels_for_any_number_of_owners() {
    let (channels, isas) = (7, Isa::all());
    let pyramid = Pyramid::new(&[(40, 40), (20, 20), (10, 10)], channels);
    let textures = pyramid.textures(false);
    let [x, y, level] = places(textures.levels.len());
    let texels = 1600 + 400 + 100;
    let mut random = Random::new(13, Stream::Probe, 0);
    let rows: Vec<f32> = (0..channels * STRIDE).map(|_| random.normal()).collect();
    let mut expected = vec![0.0f64; texels * channels];
    for k in (0..STRIDE).filter(|k| k % 4 < 2) {
        for (_, index, weight, _) in pyramid.taps64(f64::from(x[k]), f64::from(y[k]), f64::from(level[k])) {
            for c in 0..channels {
                expected[index * channels + c] += weight * f64::from(rows[c * STRIDE + k]);
            }
        }
    }
    for isa in isas {
        let mut features = vec![0.0; channels * STRIDE];
        let mut taps = vec![Taps::default(); 2 * STRIDE];
        let found = Found { features: &mut features, slopes: &mut [], taps: &mut taps };
        lookup(isa, channels, &textures, Places { x: &x, y: &y, level: &level }, found);
        for tap in taps.iter_mut().enumerate().filter(|(i, _)| i % STRIDE % 4 > 1) {
            *tap.1 = Taps::default();
        }
        let mut gradients = vec![f32::NAN; STRIDE * padded(channels)];
        by_sample(isa, STRIDE, channels, &rows, &mut gradients);
        let mut tables = Vec::new();
        for owners in [1, 2, 3] {
            let mut table = vec![0.0f32; texels * padded(channels)];
            for mut owner in Owned::split(&mut table, padded(channels), owners) {
                owner.scatter(isa, &taps[..STRIDE], &gradients);
                owner.scatter(isa, &taps[STRIDE..], &gradients);
            }
            tables.push(table);
        }
        assert!(tables[0] == tables[1] && tables[0] == tables[2]);
        let error = |expected: &[f64]| {
            (0..texels * channels)
                .map(|i| {
                    (f64::from(tables[0][i / channels * padded(channels) + i % channels]) - expected[i]).abs()
                })
                .fold(0.0, f64::max)
        };
        assert!(error(&expected) < ROUNDING, "{} {:e}", isa.name(), error(&expected));
        let mut wrong = expected.clone();
        *wrong.iter_mut().find(|v| **v != 0.0).unwrap() += 1e-3;
        assert!(error(&wrong) > ROUNDING);
    }
}

#[test]
fn poison_reads_some_texel_and_says_so() {
    let pyramid = Pyramid::new(&[(7, 9), (3, 4)], 3);
    let textures = pyramid.textures(false);
    for isa in Isa::all() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 3e38, -1e30, 1e-42] {
            let (x, y) = (vec![bad; STRIDE], vec![0.5; STRIDE]);
            for level in [0.0, 0.5, -3.0, 9.0, f32::NAN, f32::INFINITY] {
                let level = vec![level; STRIDE];
                let mut features = vec![0.0; 3 * STRIDE];
                let mut taps = vec![Taps::default(); 2 * STRIDE];
                let found = Found { features: &mut features, slopes: &mut [], taps: &mut taps };
                lookup(isa, 3, &textures, Places { x: &x, y: &y, level: &level }, found);
                assert!(taps.iter().flat_map(|t| t.index()).all(|i| i < 63 + 12));
                if bad.is_nan() {
                    assert!(features.iter().all(|f| f.is_nan()));
                }
            }
        }
    }
}
