//! Against plain loops in float64.

use super::super::simd::Isa;
use super::grid::{Grid, Halo, Plane};
use super::*;
use crate::random::{Random, Stream};

/// Float32 sums of some hundred products through a dozen layers, relative to 1 + |value|; gradients of weights sum over all
/// pixels of a batch, of which there are hundreds.
const ROUNDING: f64 = 1e-4;
/// What a twin changes one value by: its effect is far above [`ROUNDING`].
const CHANGE: f32 = 0.1;

const ODD: Shape =
    Shape { inputs: 7, width: 21, modules: 2, paths: [4, 13, 1, 3], reduce: [3, 2], outputs: 3 };
const ONE: Shape = Shape { inputs: 1, width: 4, modules: 1, paths: [1; 4], reduce: [1, 1], outputs: 1 };
const SMALL: Shape =
    Shape { inputs: 25, width: 25, modules: 2, paths: [7, 12, 3, 3], reduce: [9, 2], outputs: 6 };

/// Images, height and width: single pixels, tiles smaller than the kernels, odd ones, many side by side.
const SIZES: [(usize, usize, usize); 8] =
    [(1, 1, 1), (3, 1, 1), (2, 2, 3), (19, 4, 4), (1, 9, 5), (1, 3, 37), (5, 1, 9), (2, 6, 32)];
const BORDERS: [Border; 2] = [Border::Wrap, Border::Zero];

fn noise(n: usize, seed: u64) -> Vec<f32> {
    let mut random = Random::new(seed, Stream::Probe, n as u64);
    (0..n).map(|_| random.normal()).collect()
}

fn worst(a: &[f32], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let error = |(a, b): (&f32, &f64)| (f64::from(*a) - b).abs() / (1.0 + b.abs());
    // A NaN is no agreement.
    a.iter().zip(b).map(error).fold(0.0, |most, e| if e <= most { most } else { e })
}

type Owned = Vec<(Vec<f32>, Vec<f32>)>;

fn weights(shape: &Shape, seed: u64) -> Owned {
    let one = |(k, c): (usize, Convolution)| {
        let scale = (2.0 / (c.inputs * c.kernel * c.kernel) as f32).sqrt();
        let of = |n, k| noise(n, 1000 * seed + k);
        let weight = of(c.weights(), 2 * k as u64).iter().map(|w| w * scale).collect();
        (weight, of(c.outputs, 2 * k as u64 + 1).iter().map(|b| 0.1 * b).collect())
    };
    shape.convolutions().into_iter().enumerate().map(one).collect()
}

fn borrowed(weights: &Owned) -> Vec<(&[f32], &[f32])> {
    weights.iter().map(|(w, b)| (&w[..], &b[..])).collect()
}

/// The plain way, \[pixel\]\[channel\] in float64.
struct Plain {
    size: (usize, usize, usize),
    border: Border,
}

type Values = Vec<f64>;

impl Plain {
    /// Pixels of the window of a side about each pixel: (pixel, tap, pixel there).
    fn taps(&self, side: usize) -> Vec<(usize, usize, usize)> {
        let (n, h, w) = self.size;
        let reach = (side / 2) as isize;
        let inside = |at: isize, size: usize| match self.border {
            Border::Wrap => Some(at.rem_euclid(size as isize) as usize),
            Border::Zero => (at >= 0 && at < size as isize).then_some(at as usize),
        };
        let mut all = Vec::new();
        for p in 0..n * h * w {
            let (image, y, x) = (p / (h * w), p / w % h, p % w);
            for t in 0..side * side {
                let y = inside(y as isize + (t / side) as isize - reach, h);
                let x = inside(x as isize + (t % side) as isize - reach, w);
                if let (Some(y), Some(x)) = (y, x) {
                    all.push((p, t, (image * h + y) * w + x));
                }
            }
        }
        all
    }

    fn conv(&self, c: &Convolution, (weight, bias): (&[f32], &[f32]), x: &[f64]) -> Values {
        let pixels = x.len() / c.inputs;
        let mut out: Values = (0..pixels).flat_map(|_| bias.iter().map(|b| f64::from(*b))).collect();
        let area = c.kernel * c.kernel;
        for (p, t, q) in self.taps(c.kernel) {
            for o in 0..c.outputs {
                for i in 0..c.inputs {
                    out[p * c.outputs + o] +=
                        f64::from(weight[(o * c.inputs + i) * area + t]) * x[q * c.inputs + i];
                }
            }
        }
        out
    }

    /// Adds to the gradients of weight and bias; gives the gradient of the input.
    fn conv_back(&self, c: &Convolution, weight: &[f32], x: &[f64], g: &[f64], all: &mut [f64]) -> Values {
        let mut by_x = vec![0.0; x.len()];
        let area = c.kernel * c.kernel;
        for (p, t, q) in self.taps(c.kernel) {
            for o in 0..c.outputs {
                let g = g[p * c.outputs + o];
                for i in 0..c.inputs {
                    let k = (o * c.inputs + i) * area + t;
                    all[k] += g * x[q * c.inputs + i];
                    by_x[q * c.inputs + i] += g * f64::from(weight[k]);
                }
            }
        }
        for (k, g) in g.iter().enumerate() {
            all[c.weights() + k % c.outputs] += g;
        }
        by_x
    }

    /// The largest of each window, and the pixel of the first of them.
    fn pool(&self, channels: usize, x: &[f64]) -> (Values, Vec<usize>) {
        let mut best = vec![f64::NEG_INFINITY; x.len()];
        let mut from = vec![0; x.len()];
        for (p, _, q) in self.taps(3) {
            for c in 0..channels {
                if x[q * channels + c] > best[p * channels + c] {
                    best[p * channels + c] = x[q * channels + c];
                    from[p * channels + c] = q;
                }
            }
        }
        (best, from)
    }

    /// Outputs; gradients of the weights and of the inputs.
    fn network(&self, shape: &Shape, w: &[(&[f32], &[f32])], input: &[f32], g: &[f32]) -> [Values; 3] {
        let all = shape.convolutions();
        let relu = |mut x: Values| {
            x.iter_mut().for_each(|x| *x = x.max(0.0));
            x
        };
        let input: Values = input.iter().map(|x| f64::from(*x)).collect();
        let mut x = vec![relu(self.conv(&all[0], w[0], &input))];
        let mut kept = Vec::new();
        for m in 0..shape.modules {
            let conv = |k: usize, x: &[f64]| relu(self.conv(&all[1 + 6 * m + k], w[1 + 6 * m + k], x));
            let (pooled, from) = self.pool(shape.width, &x[m]);
            let reduced = [conv(1, &x[m]), conv(3, &x[m])];
            let paths = [conv(0, &x[m]), conv(2, &reduced[0]), conv(4, &reduced[1]), conv(5, &pooled)];
            let pixels = x[m].len() / shape.width;
            let pixel = |p: usize| {
                let part = move |(path, n): (&Values, usize)| path[p * n..(p + 1) * n].to_vec();
                paths.iter().zip(shape.paths).flat_map(part).collect::<Vec<_>>()
            };
            let next = (0..pixels).flat_map(pixel).collect();
            x.push(next);
            kept.push((pooled, from, reduced));
        }
        let last = all.len() - 1;
        let output = self.conv(&all[last], w[last], &x[shape.modules]);

        let mut places = vec![0];
        all.iter().for_each(|c| places.push(places[places.len() - 1] + c.weights() + c.outputs));
        let mut by_weights = vec![0.0; shape.parameters()];
        let mut back = |k: usize, x: &[f64], g: &[f64]| {
            self.conv_back(&all[k], w[k].0, x, g, &mut by_weights[places[k]..places[k + 1]])
        };
        let mask = |mut g: Values, x: &[f64]| {
            g.iter_mut().zip(x).for_each(|(g, x)| *g = if *x > 0.0 { *g } else { 0.0 });
            g
        };
        let g: Values = g.iter().map(|g| f64::from(*g)).collect();
        let mut g = back(last, &x[shape.modules], &g);
        for m in (0..shape.modules).rev() {
            g = mask(g, &x[m + 1]);
            let (pooled, from, reduced) = &kept[m];
            let k = 1 + 6 * m;
            let mut first = 0;
            let paths = shape.paths.map(|n| {
                let start = first;
                first += n;
                g.chunks(shape.width).flat_map(|g| g[start..start + n].to_vec()).collect::<Values>()
            });
            let mut by_x = back(k, &x[m], &paths[0]);
            for (part, path) in [(1, 0), (3, 1)] {
                let by_reduced = mask(back(k + part + 1, &reduced[path], &paths[path + 1]), &reduced[path]);
                let more = back(k + part, &x[m], &by_reduced);
                by_x.iter_mut().zip(more).for_each(|(to, from)| *to += from);
            }
            for (place, g) in back(k + 5, pooled, &paths[3]).iter().enumerate() {
                by_x[from[place] * shape.width + place % shape.width] += g;
            }
            g = by_x;
        }
        let by_input = back(0, &input, &mask(g, &x[0]));
        [output, by_weights, by_input]
    }
}

/// Outputs, gradients of weights and of the first inputs.
fn run(
    isa: Isa,
    shape: &Shape,
    w: &Owned,
    images: Images,
    x: &[f32],
    g: &[f32],
    learned: usize,
) -> [Vec<f32>; 3] {
    let net = Network::learning(isa, shape, learned, &borrowed(w)).unwrap();
    let mut room = Room::default();
    let mut output = vec![f32::NAN; images.pixels() * shape.outputs];
    net.forward(images, x, &mut room, &mut output);
    let answered = output.clone();
    net.forward_keeping(images, x, &mut room, &mut output);
    assert_eq!(answered, output);
    let mut by_weights = vec![1.0; shape.parameters()];
    let mut by_input = vec![f32::NAN; images.pixels() * learned];
    net.backward(images, &mut room, g, &mut by_weights, &mut by_input);
    // Gradients of weights are added to what is there.
    by_weights.iter_mut().for_each(|g| *g -= 1.0);
    [output, by_weights, by_input]
}

fn first_inputs(shape: &Shape, by_input: &[f64], learned: usize) -> Values {
    by_input.chunks(shape.inputs).flat_map(|g| g[..learned].to_vec()).collect()
}

#[test]
fn answers_and_gradients_follow_float64_and_a_changed_value_is_noticed() {
    for (shape, learned) in [(ODD, 5), (ONE, 1), (SMALL, 0)] {
        let w = weights(&shape, 1);
        for (size, border) in SIZES.into_iter().flat_map(|s| BORDERS.map(|b| (s, b))) {
            let images = Images::new(size.0, size.1, size.2, border).unwrap();
            let pixels = images.pixels();
            let (x, mut g) = (noise(pixels * shape.inputs, 3), noise(pixels * shape.outputs, 4));
            let plain = Plain { size, border };
            let [output, by_weights, by_input] = plain.network(&shape, &borrowed(&w), &x, &g);
            let by_input = first_inputs(&shape, &by_input, learned);
            for isa in Isa::all() {
                let got = run(isa, &shape, &w, images, &x, &g, learned);
                let errors =
                    [worst(&got[0], &output), worst(&got[1], &by_weights), worst(&got[2], &by_input)];
                assert!(
                    errors.iter().all(|e| *e < ROUNDING),
                    "{} {size:?} {border:?} {errors:?}",
                    isa.name()
                );
            }
            // The last bias reaches every output; a gradient of an output reaches that bias.
            let mut other = w.clone();
            other.last_mut().unwrap().1[0] += CHANGE;
            let got = run(Isa::all()[0], &shape, &other, images, &x, &g, learned);
            assert!(worst(&got[0], &output) > ROUNDING);
            g[0] += CHANGE;
            let got = run(Isa::all()[0], &shape, &w, images, &x, &g, learned);
            assert!(worst(&got[1], &by_weights) > ROUNDING);
        }
    }
}

/// A weight of each convolution matters: what [`Plain`] shares with the kernels would not show.
#[test]
fn gradients_are_differences() {
    /// Central differences of a float64 sum over a step of 1e-3 across ReLUs, relative to 1 + |gradient|.
    const BEND: f64 = 0.05;
    let size = (1, 5, 6);
    let images = Images::new(size.0, size.1, size.2, Border::Wrap).unwrap();
    let w = weights(&ODD, 2);
    let (x, g) = (noise(images.pixels() * ODD.inputs, 3), noise(images.pixels() * ODD.outputs, 4));
    let plain = Plain { size, border: Border::Wrap };
    let loss = |w: &Owned| -> f64 {
        let [output, ..] = plain.network(&ODD, &borrowed(w), &x, &g);
        output.iter().zip(&g).map(|(a, b)| a * f64::from(*b)).sum()
    };
    let [_, by_weights, _] = run(Isa::all()[0], &ODD, &w, images, &x, &g, 0);
    let mut place = 0;
    let mut far = 0;
    for (k, c) in ODD.convolutions().iter().enumerate() {
        let at = c.weights() / 2;
        let moved = |by: f32| {
            let mut w = w.clone();
            w[k].0[at] += by;
            loss(&w)
        };
        let difference = (moved(1e-3) - moved(-1e-3)) / 2e-3;
        let error = |k: usize| (difference - f64::from(by_weights[k])).abs() / (1.0 + difference.abs());
        assert!(error(place + at) < BEND, "{} {difference} {}", c.name, by_weights[place + at]);
        far += usize::from(error(place + at + 1) > BEND);
        place += c.weights() + c.outputs;
    }
    // The next weight's is another.
    assert!(far > 5, "{far}");
}

#[test]
fn a_pool_gives_all_to_the_first_of_equals() {
    let channels = 5;
    for (size, border) in SIZES.into_iter().flat_map(|s| BORDERS.map(|b| (s, b))) {
        let images = Images::new(size.0, size.1, size.2, border).unwrap();
        let grid = Grid::new(images);
        let plain = Plain { size, border };
        let n = images.pixels() * channels;
        // Few values, all above 0: nearly every window has equals.
        let x: Vec<f32> = noise(n, 1).iter().map(|x| 1.0 + (x.abs() * 2.0).floor().min(2.0)).collect();
        let g: Vec<f32> = noise(n, 2).iter().map(|g| (g * 8.0).round()).collect();
        let (best, from) = plain.pool(channels, &x.iter().map(|x| f64::from(*x)).collect::<Vec<_>>());
        let mut want = vec![0.0; n];
        from.iter().enumerate().for_each(|(k, q)| want[q * channels + k % channels] += g[k]);
        let planes = || -> [Plane; 6] {
            std::array::from_fn(|_| {
                let mut plane = Plane::default();
                plane.fit(&grid, channels);
                plane
            })
        };
        for isa in Isa::all() {
            let [mut input, mut largest, mut pooled, mut places, mut gradient, mut back] = planes();
            for (from, to) in [(&x, &mut input), (&g, &mut gradient)] {
                grid.gather(from, to);
                to.by_line(&grid, |line, rows| grid.finish(line, rows, Halo::Border));
            }
            largest.by_line(&grid, |line, rows| pool::largest(isa, &grid, input.from(0), line, rows));
            pooled.by_line_with(&mut places, &grid, |line, rows, places| {
                pool::winners(isa, &grid, input.from(0), line, rows, places);
                grid.finish(line, places, Halo::Border);
            });
            back.by_line(&grid, |line, rows| {
                pool::back(isa, &grid, gradient.from(0), places.from(0), line, rows);
            });
            let pixels = |plane: &Plane| {
                let mut out = vec![f32::NAN; n];
                grid.scatter(plane, channels, &mut out);
                out
            };
            let best: Vec<f32> = best.iter().map(|x| *x as f32).collect();
            assert_eq!(pixels(&largest), best, "{} {size:?} {border:?}", isa.name());
            assert_eq!(pixels(&pooled), best);
            // Whole numbers add up exactly.
            assert_eq!(pixels(&back), want, "{} {size:?} {border:?}", isa.name());
        }
        if size == (1, 9, 5) {
            // The last of equals would be another.
            let last: Vec<usize> = {
                let turned: Vec<f64> = x.chunks(channels).rev().flatten().map(|x| f64::from(*x)).collect();
                plain.pool(channels, &turned).1.iter().map(|q| images.pixels() - 1 - q).collect()
            };
            let pixels = images.pixels();
            assert!((0..n).any(|k| from[k] != last[(pixels - 1 - k / channels) * channels + k % channels]));
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let images = Images::new(1, 21, 35, Border::Wrap).unwrap();
    let w = weights(&SMALL, 1);
    let (x, g) = (noise(images.pixels() * SMALL.inputs, 3), noise(images.pixels() * SMALL.outputs, 4));
    let of = |threads: usize, x: &[f32]| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let all = pool.install(|| run(Isa::all()[0], &SMALL, &w, images, x, &g, 18));
        all.concat().iter().map(|x| x.to_bits()).collect::<Vec<_>>()
    };
    let one = of(1, &x);
    assert_eq!(one, of(2, &x));
    assert_eq!(one, of(5, &x));
    let mut moved = x.clone();
    moved[7] += CHANGE;
    assert_ne!(one, of(2, &moved));
}

#[test]
fn a_patch_agrees_with_its_tile_inside_the_radius() {
    let (tile, inside) = (24, 3);
    let radius = SMALL.radius();
    let (patch, at) = (inside + 2 * radius, 5);
    let w = weights(&SMALL, 1);
    let x = noise(tile * tile * SMALL.inputs, 3);
    for isa in Isa::all() {
        let net = Network::new(isa, &SMALL, &borrowed(&w)).unwrap();
        let answer = |side: usize, border, x: &[f32]| {
            let images = Images::new(1, side, side, border).unwrap();
            let mut out = vec![f32::NAN; images.pixels() * SMALL.outputs];
            net.forward(images, x, &mut Room::default(), &mut out);
            out
        };
        let whole = answer(tile, Border::Wrap, &x);
        let cut: Vec<f32> = (0..patch * patch)
            .flat_map(|p| {
                let from = (at + p / patch) * tile + at + p % patch;
                x[from * SMALL.inputs..(from + 1) * SMALL.inputs].to_vec()
            })
            .collect();
        let part = answer(patch, Border::Zero, &cut);
        let same = |x: usize, y: usize| {
            let (p, q) = (y * patch + x, (at + y) * tile + at + x);
            let n = SMALL.outputs;
            let want: Values = whole[q * n..(q + 1) * n].iter().map(|x| f64::from(*x)).collect();
            worst(&part[p * n..(p + 1) * n], &want) < ROUNDING
        };
        let range = radius..radius + inside;
        assert!(range.clone().all(|y| range.clone().all(|x| same(x, y))), "{}", isa.name());
        assert!(!same(0, 0));
    }
}

#[test]
fn a_room_serves_batches_of_any_size_in_turn() {
    let w = weights(&ODD, 1);
    let isa = Isa::all()[0];
    let net = Network::learning(isa, &ODD, 2, &borrowed(&w)).unwrap();
    let mut room = Room::default();
    for size in SIZES.iter().chain(SIZES.iter().rev()) {
        let images = Images::new(size.0, size.1, size.2, Border::Zero).unwrap();
        let pixels = images.pixels();
        let (x, g) = (noise(pixels * ODD.inputs, 3), noise(pixels * ODD.outputs, 4));
        // What is left of a poisoned batch must not reach the next.
        let mut output = vec![0.0; pixels * ODD.outputs];
        net.forward_keeping(images, &vec![f32::NAN; x.len()], &mut room, &mut output);
        assert!(output.iter().all(|x| x.is_nan()));
        net.backward(images, &mut room, &g, &mut vec![0.0; ODD.parameters()], &mut vec![0.0; pixels * 2]);
        let mut all = [vec![0.0; pixels * ODD.outputs], vec![1.0; ODD.parameters()], vec![0.0; pixels * 2]];
        net.forward_keeping(images, &x, &mut room, &mut all[0]);
        let [_, by_weights, by_input] = &mut all;
        net.backward(images, &mut room, &g, by_weights, by_input);
        by_weights.iter_mut().for_each(|g| *g -= 1.0);
        assert_eq!(all, run(isa, &ODD, &w, images, &x, &g, 2), "{size:?}");
    }
}

#[test]
fn poison_stays_in_its_image() {
    let (images, side) = (19, 4);
    let w = weights(&SMALL, 1);
    let mut x = noise(images * side * side * SMALL.inputs, 3);
    let poisoned = 7;
    x[poisoned * side * side * SMALL.inputs] = f32::NAN;
    for (isa, border) in Isa::all().into_iter().flat_map(|i| BORDERS.map(|b| (i, b))) {
        let net = Network::new(isa, &SMALL, &borrowed(&w)).unwrap();
        let mut out = vec![0.0; images * side * side * SMALL.outputs];
        let batch = Images::new(images, side, side, border).unwrap();
        net.forward(batch, &x, &mut Room::default(), &mut out);
        for (image, out) in out.chunks(side * side * SMALL.outputs).enumerate() {
            assert_eq!(out.iter().any(|x| x.is_nan()), image == poisoned, "{} {border:?}", isa.name());
        }
    }
}

#[test]
fn sizes_that_cannot_be_are_refused() {
    let refused = |change: fn(&mut Shape)| {
        let mut shape = SMALL;
        change(&mut shape);
        shape.check().unwrap_err().to_string()
    };
    assert!(SMALL.check().is_ok());
    assert!(refused(|s| s.width = 24).contains("decoder.paths"));
    assert!(refused(|s| s.inputs = 0).contains("decoder.inputs"));
    assert!(refused(|s| s.modules = 1000).contains("decoder.modules"));
    assert!(refused(|s| s.reduce[1] = usize::MAX).contains("decoder.reduce[1]"));
    let isa = Isa::all()[0];
    let mut w = weights(&SMALL, 1);
    assert!(Network::learning(isa, &SMALL, 26, &borrowed(&w)).is_err());
    w[3].0.pop();
    let problem = Network::new(isa, &SMALL, &borrowed(&w)).unwrap_err().to_string();
    assert!(problem.contains("decoder.module0.path2:"), "{problem}");
    w.pop();
    assert!(Network::new(isa, &SMALL, &borrowed(&w)).is_err());
    assert!(Images::new(0, 4, 4, Border::Wrap).is_err());
    assert!(Images::new(usize::MAX, 4, 4, Border::Wrap).is_err());
}
