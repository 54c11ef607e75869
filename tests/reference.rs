//! The ground truth is right: its geometry, its light, its averages, and what it reads.

use neumip::query::{QueryBuffer, Reflectance, unit};
use neumip::random::{Random, Stream};
use neumip::reference::{
    Brdf, HeightMap, Heightfield, Layer, Material, Measured, Paint, Part, Reference, ReferenceOptions,
    Sampling, Texture, View, builtin, maps,
};
use std::f32::consts::PI;
use std::path::Path;

const WHITE: [f32; 3] = [1.0; 3];

/// White, Lambert, everywhere the same, over the given heights.
fn lambert(base: [f32; 3], height: HeightMap) -> Material {
    Material::solid("lambert", height, Paint::plain(base, 0.5, 0.0))
}

fn flat(z: f32) -> HeightMap {
    HeightMap { height: 2, width: 2, values: vec![z; 4] }
}

fn bumps(height: usize, width: usize, depth: f32) -> HeightMap {
    let mut random = Random::new(7, Stream::Probe, 1);
    let values = (0..height * width).map(|_| depth * (random.uniform() - 0.5)).collect();
    HeightMap { height, width, values }
}

fn reference(material: Material) -> Reference {
    Reference::new(material, &ReferenceOptions::default()).unwrap()
}

fn open_builtin(name: &str, field_side: usize) -> Reference {
    Reference::open(name, &ReferenceOptions { field_side, ..ReferenceOptions::default() }).unwrap()
}

fn one(u: [f32; 2], wi: [f32; 2], wo: [f32; 2], level: f32) -> QueryBuffer {
    QueryBuffer::new(1, 1, vec![u], vec![wi], vec![wo], vec![level]).unwrap()
}

fn sampling(spp: usize) -> Sampling {
    Sampling { spp, seed: 5, first: 0 }
}

fn unit64(w: [f32; 2]) -> [f64; 3] {
    unit(w).map(f64::from)
}

/// A uniform direction of the upper hemisphere.
pub fn hemisphere(random: &mut Random) -> [f64; 3] {
    let z = random.uniform_f64().max(1e-3);
    let (sin, cos) = (std::f64::consts::TAU * random.uniform_f64()).sin_cos();
    let radius = (1.0 - z * z).sqrt();
    [radius * cos, radius * sin, z]
}

/// Mean of what `draw` returns, and the standard error of that mean.
pub fn estimate(count: u64, mut draw: impl FnMut(&mut Random) -> f32) -> (f64, f64) {
    let (mut sum, mut squares) = (0.0, 0.0);
    for k in 0..count {
        let value = f64::from(draw(&mut Random::new(11, Stream::Probe, k)));
        sum += value;
        squares += value * value;
    }
    let mean = sum / count as f64;
    (mean, ((squares / count as f64 - mean * mean).max(0.0) / count as f64).sqrt())
}

/// Products of up to some hundred f32 weights, each rounded.
const PATH_ROUNDING: f64 = 1e-4;

/// True if the estimate is 1 within three standard errors.
fn is_one((mean, error): (f64, f64)) -> bool {
    (mean - 1.0).abs() <= 3.0 * error + PATH_ROUNDING
}

#[test]
fn white_surface_under_a_white_sky_returns_everything() {
    for height in [flat(0.1), bumps(16, 16, 0.2)] {
        let sky = |base: [f32; 3]| {
            let reference = reference(lambert(base, height.clone()));
            estimate(20_000, |random| {
                let p = [random.uniform_f64(), random.uniform_f64()];
                let wo = hemisphere(random);
                reference.geometry().sky_radiance(p, wo, random)[0]
            })
        };
        assert!(is_one(sky(WHITE)));
        assert!(!is_one(sky([0.98; 3])), "a loss of 2 % must show");
    }
}

/// A sky of radiance 1 is distant lights of irradiance d omega: over all of them, direct and indirect light add up to 1.
#[test]
fn distant_lights_add_up_to_the_sky() {
    let reference = reference(lambert(WHITE, bumps(16, 16, 0.2)));
    let all_lights = |bounces: usize| {
        estimate(40_000, |random| {
            let p = [random.uniform_f64(), random.uniform_f64()];
            let (wi, wo) = (hemisphere(random), unit64([0.3, 0.2]));
            2.0 * PI * reference.geometry().radiance(p, &View { wi, wo, bounces }, random)[0]
        })
    };
    assert!(is_one(all_lights(64)));
    assert!(!is_one(all_lights(0)), "without indirect light some must be missing");
}

fn direction(random: &mut Random) -> [f32; 3] {
    hemisphere(random).map(|c| c as f32)
}

/// Directional albedo by the model's own sampling.
fn albedo(brdf: &Brdf, wo: [f32; 3], count: u64) -> (f64, f64) {
    estimate(count, |random| {
        let numbers = [random.uniform(), random.uniform(), random.uniform()];
        brdf.sample(wo, numbers).map_or(0.0, |s| s.weight[0])
    })
}

/// What single scattering leaves of a white metal at alpha 0.1 up to 45 degrees: it measures 0.982 there.
const LEAST_METAL_ALBEDO: f64 = 0.97;

fn metal(f0: f32, alpha: f32) -> Brdf {
    Brdf { base_colour: [f0; 3], roughness: alpha.sqrt(), metalness: 1.0, specular: 0.04 }
}

#[test]
fn white_metal_keeps_its_albedo() {
    for degrees in [0.0_f32, 30.0, 45.0, 60.0, 70.0] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let returned = |f0: f32| albedo(&metal(f0, 0.1), [sin, 0.0, cos], 20_000).0;
        let white = returned(1.0);
        println!("albedo of white metal of alpha 0.1 seen at {degrees} degrees: {white:.3}");
        // Beyond, more light would have to bounce on between the facets than this bound allows to be lost.
        if degrees > 45.0 {
            continue;
        }
        assert!((LEAST_METAL_ALBEDO..=1.0 + PATH_ROUNDING).contains(&white), "{degrees}: {white}");
        assert!(returned(0.97) < LEAST_METAL_ALBEDO, "3 % of absorption must show");
    }
}

#[test]
fn roughest_metal_meets_its_closed_form() {
    // At alpha = 1 and wo = n, D = 1 / pi and the integral of D V cos_i is that of c / (1 + c) over [0, 1].
    let want = 1.0 - std::f64::consts::LN_2;
    let meets = |(mean, error): (f64, f64), want: f64| (mean - want).abs() < 4.0 * error;
    let measured = albedo(&metal(1.0, 1.0), [0.0, 0.0, 1.0], 40_000);
    assert!(meets(measured, want), "{measured:?}");
    assert!(!meets(measured, 1.05 * want));
}

fn random_brdf(random: &mut Random) -> Brdf {
    Brdf {
        base_colour: std::array::from_fn(|_| random.uniform()),
        roughness: 0.1 + 0.9 * random.uniform(),
        metalness: if random.uniform() < 0.5 { 0.0 } else { random.uniform() },
        specular: random.uniform() * random.uniform(),
    }
}

#[test]
fn shading_is_reciprocal() {
    // The formula is symmetric down to the order of its sums and products.
    let same = |a: f32, b: f32| a == b;
    let mut random = Random::new(1, Stream::Probe, 0);
    for _ in 0..10_000 {
        let brdf = random_brdf(&mut random);
        let (wi, wo) = (direction(&mut random), direction(&mut random));
        let (f, back) = (brdf.eval(wi, wo), brdf.eval(wo, wi));
        for c in 0..3 {
            assert!(same(f[c], back[c]), "{brdf:?} {wi:?} {wo:?}");
            assert!(!same(f[c], back[c] * 1.001 + 1e-9));
        }
    }
}

#[test]
fn shading_gives_no_more_than_it_gets() {
    // Noise of the estimate; the model has no slack of its own to ask for.
    let no_more = |(mean, error): (f64, f64), gain: f64| gain * mean <= 1.0 + 3.0 * error + PATH_ROUNDING;
    for specular in [0.0, 0.04, 0.2, 1.0] {
        for metalness in [0.0, 0.5, 1.0] {
            for roughness in [0.1, 0.4, 0.7, 1.0] {
                for degrees in [5.0_f32, 40.0, 65.0, 80.0, 88.0] {
                    let (sin, cos) = degrees.to_radians().sin_cos();
                    let brdf = Brdf { base_colour: WHITE, roughness, metalness, specular };
                    let albedo = albedo(&brdf, [sin, 0.0, cos], 2000);
                    assert!(no_more(albedo, 1.0), "{brdf:?} {degrees} {albedo:?}");
                    if specular == 0.0 && metalness == 0.0 {
                        assert!(!no_more(albedo, 1.05), "a white Lambert surface has nothing to spare");
                    }
                }
            }
        }
    }
}

/// The same integral by the model's sampling and by uniform directions: sampling, density and value agree.
#[test]
fn sampling_agrees_with_the_value() {
    let agree = |a: (f64, f64), b: (f64, f64)| (a.0 - b.0).abs() <= 4.0 * a.1.hypot(b.1) + PATH_ROUNDING;
    let mut random = Random::new(2, Stream::Probe, 0);
    for _ in 0..12 {
        let brdf = Brdf { roughness: 0.4 + 0.6 * random.uniform(), ..random_brdf(&mut random) };
        let wo = direction(&mut random);
        let sampled = albedo(&brdf, wo, 40_000);
        let uniform = estimate(40_000, |random| {
            let wi = direction(random);
            2.0 * PI * wi[2] * brdf.eval(wi, wo)[0]
        });
        assert!(agree(sampled, uniform), "{brdf:?} {wo:?} {sampled:?} {uniform:?}");
        assert!(!agree(sampled, (uniform.0 * 1.2 + 0.01, uniform.1)));
        let density = estimate(40_000, |random| 2.0 * PI * brdf.pdf(direction(random), wo));
        assert!(density.0 <= 1.0 + 4.0 * density.1, "{brdf:?} {density:?}");
    }
}

#[test]
fn flat_lambert_is_base_over_pi_times_cosine() {
    let base = [0.2, 0.5, 0.8];
    let reference = reference(lambert(base, flat(0.05)));
    // One rounding each of base / pi, the cosine and the product.
    let exact = |got: f32, want: f32| (got - want).abs() <= 4.0 * f32::EPSILON * want;
    for wi in [[0.0, 0.0], [0.5, -0.3], [-0.9, 0.4]] {
        let measured = reference.measure(&one([0.3, 0.9], wi, [0.6, 0.5], 0.7), &sampling(16)).unwrap();
        for (got, base) in measured.rgb.pixels[0].into_iter().zip(base) {
            let want = base / PI * unit(wi)[2];
            assert!(exact(got, want), "{got} {want}");
            assert!(!exact(got * (1.0 + 1e-6), want));
        }
        assert_eq!(measured.variance, [0.0]);
    }
}

/// A grid of colours over a flat surface.
fn patches(z: f32) -> Material {
    let mut random = Random::new(3, Stream::Probe, 0);
    let texels = (0..256).map(|_| std::array::from_fn(|_| random.uniform())).collect();
    let paint = Paint { base_colour: Texture::new(16, texels).unwrap(), ..Paint::plain(WHITE, 0.5, 0.0) };
    Material::solid("patches", flat(z), paint)
}

#[test]
fn parallax_shifts_by_height_times_slope() {
    // u is f32: off by up to 6e-8 of a tile, on which colours change by at most 16 a tile width.
    const SHIFT_ROUNDING: f32 = 4e-6;
    let wo = [0.6, -0.4];
    let z = unit(wo)[2];
    for height in [0.08_f32, -0.08] {
        let difference = |believed: f32| {
            let u = [0.3, 0.4];
            let moved = std::array::from_fn(|c| u[c] + believed * wo[c] / z);
            let answer = |material: Material, u: [f32; 2]| {
                let options = ReferenceOptions { resolution: Some([64, 64]), ..ReferenceOptions::default() };
                let reference = Reference::new(material, &options).unwrap();
                reference.measure(&one(u, [0.1, 0.2], wo, 0.0), &sampling(4)).unwrap().rgb.pixels[0][0]
            };
            (answer(patches(height), u) - answer(patches(0.0), moved)).abs()
        };
        assert!(difference(height) < SHIFT_ROUNDING);
        assert!(difference(0.9 * height) > SHIFT_ROUNDING, "a tenth of the height must show");
    }
}

#[test]
fn answers_repeat_with_the_tile() {
    let reference = open_builtin("rocks", 64);
    let slice = QueryBuffer::slice(16, 16, [0.5, 0.2], [-0.6, 0.5], 1.5);
    let mut moved = slice.clone();
    moved.u.iter_mut().for_each(|u| *u = [u[0] + 2.0, u[1] - 1.0]);
    let measure = |queries: &QueryBuffer| reference.measure(queries, &sampling(4)).unwrap();
    assert_eq!(measure(&slice), measure(&moved));
    moved.u.iter_mut().for_each(|u| u[0] += 0.25);
    assert_ne!(measure(&slice), measure(&moved));
}

/// A square texture moved by half a tile in both directions.
fn rolled<T: Copy>(side: usize, values: &[T]) -> Vec<T> {
    let half = side / 2;
    (0..side * side).map(|k| values[(k / side + half) % side * side + (k % side + half) % side]).collect()
}

fn rolled_texture<const N: usize>(texture: &Texture<N>) -> Texture<N> {
    Texture::new(texture.side(), rolled(texture.side(), texture.texels())).unwrap_or_else(|| texture.clone())
}

#[test]
fn a_moved_tile_gives_the_moved_picture() {
    let reference = open_builtin("rocks", 64);
    let mut material = builtin::make("rocks", 64, 0).unwrap();
    let Part::Solid(layer) = &mut material.parts[0] else { panic!("rocks are solid") };
    layer.height.values = rolled(64, &layer.height.values);
    layer.paint.base_colour = rolled_texture(&layer.paint.base_colour);
    layer.paint.roughness = rolled_texture(&layer.paint.roughness);
    let moved = material;
    let moved = Reference::new(moved, &ReferenceOptions::default()).unwrap();
    // Positions differ by exactly half a tile, so only rounding does: it may flip a shadow here and there.
    const FLIPPED: usize = 3;
    let differing = |shift: f32| {
        let slice = QueryBuffer::slice(16, 16, [0.5, 0.2], [-0.6, 0.5], 0.0);
        let mut back = slice.clone();
        back.u.iter_mut().for_each(|u| *u = u.map(|c| c + shift));
        let a = reference.measure(&back, &sampling(4)).unwrap().rgb.pixels;
        let b = moved.measure(&slice, &sampling(4)).unwrap().rgb.pixels;
        a.iter().zip(&b).filter(|(a, b)| (a[0] - b[0]).abs() > 1e-5).count()
    };
    assert!(differing(0.5) <= FLIPPED, "{}", differing(0.5));
    assert!(differing(0.25) > FLIPPED);
}

/// First root by brute force: the ray is cut at every grid line, and on each piece its height over the surface, which
/// is a quadratic there, is rebuilt from three samples.
fn brute_force(field: &Heightfield, sides: [usize; 2], o: [f64; 3], d: [f64; 3], t_end: f64) -> Option<f64> {
    let mut cuts = vec![0.0, t_end];
    for c in 0..2 {
        let side = sides[1 - c] as f64;
        let (from, to) = (o[c] * side - 0.5, (o[c] + d[c] * t_end) * side - 0.5);
        let mut line = from.min(to).ceil();
        while line <= from.max(to) {
            cuts.push(((line + 0.5) / side - o[c]) / d[c]);
            line += 1.0;
        }
    }
    cuts.retain(|t| (0.0..=t_end).contains(t));
    cuts.sort_by(f64::total_cmp);
    let above = |t: f64| o[2] + d[2] * t - field.height_at(o[0] + d[0] * t, o[1] + d[1] * t);
    cuts.windows(2).find_map(|piece| {
        let (start, length) = (piece[0], piece[1] - piece[0]);
        let [c, middle, end] = [0.0, 0.5, 1.0].map(|s| above(start + s * length));
        let (a, b) = (2.0 * (c + end - 2.0 * middle), 4.0 * middle - 3.0 * c - end);
        let dips = a > 0.0 && b < 0.0 && -b < 2.0 * a && b * b >= 4.0 * a * c;
        let mut high = match (end < 0.0, dips) {
            (true, _) => 1.0,
            (false, true) => -b / (2.0 * a),
            (false, false) => return None,
        };
        let mut low = 0.0;
        for _ in 0..80 {
            let s = 0.5 * (low + high);
            if c + s * (b + s * a) > 0.0 {
                low = s;
            } else {
                high = s;
            }
        }
        Some(start + high * length)
    })
}

/// How often walk and brute force disagree on rays that start above the surface, and on the light's visibility.
fn disagreements(field: &Heightfield, brute: &Heightfield, sides: [usize; 2]) -> (usize, usize) {
    // A root is as exact as f64; where the ray nearly touches the surface, as its square root.
    const ROOT: f64 = 1e-6;
    let [low, high] = brute.range().map(f64::from);
    let (mut rays, mut shadows) = (0, 0);
    for k in 0..4000 {
        let mut random = Random::new(4, Stream::Probe, k);
        let mut d = hemisphere(&mut random);
        // Half of the rays graze; a few follow the grid.
        if k % 2 == 0 {
            d[2] = 0.01 + 0.05 * random.uniform_f64();
        }
        if k % 50 == 1 {
            d[k as usize / 50 % 2] = 0.0;
        }
        let length = d.iter().map(|c| c * c).sum::<f64>().sqrt();
        let d = d.map(|c| c / length);
        let p = [random.uniform_f64() * 3.0 - 1.0, random.uniform_f64() * 3.0 - 1.0];
        let start = [p[0], p[1], high + 0.1 * random.uniform_f64()];
        let down = d.map(|c| -c);
        let hit = field.intersect(start, down, f64::INFINITY);
        let want = brute_force(brute, sides, start, down, (start[2] - low) / d[2] + 1e-6);
        let agrees = match (hit, want) {
            (Some(hit), Some(t)) => (hit.t - t).abs() < ROOT,
            (None, None) => true,
            _ => false,
        };
        rays += usize::from(!agrees);
        if let Some(hit) = hit {
            let to_light = [d[1], -d[0], d[2]];
            let from = hit.departure();
            let want = brute_force(brute, sides, from, to_light, (high - from[2]).max(0.0) / d[2] + 1e-6);
            shadows += usize::from(field.occluded(from, to_light) != want.is_some());
        }
    }
    (rays, shadows)
}

#[test]
fn walk_agrees_with_brute_force() {
    for (height, width) in [(5, 7), (8, 8), (3, 2), (13, 6)] {
        let map = bumps(height, width, 0.15);
        let field = Heightfield::new(&map).unwrap();
        assert_eq!(disagreements(&field, &field, [height, width]), (0, 0), "{height} x {width}");
        let mut other = map.clone();
        other.values[2] += 0.01;
        let (rays, shadows) = disagreements(&field, &Heightfield::new(&other).unwrap(), [height, width]);
        assert!(rays > 0 && shadows > 0, "one height off by 0.01 must show");
    }
}

#[test]
fn no_ray_falls_through() {
    let field = Heightfield::new(&bumps(33, 20, 0.3)).unwrap();
    for k in 0..20_000 {
        let mut random = Random::new(6, Stream::Probe, k);
        // Straight down, along grid lines, through samples, and at the lowest angles that f32 directions have.
        let w = match k % 4 {
            0 => [0.0, 0.0],
            1 => [0.8, 0.0],
            2 => [0.0, -0.999_999_94],
            _ => random.disc(0.999_999),
        };
        let down = unit64(w).map(|c| -c);
        let p = [(random.below(40) as f64 + 0.5) / 20.0, (random.below(66) as f64 + 0.5) / 33.0];
        let hit = field.intersect([p[0], p[1], 0.2], down, f64::INFINITY).unwrap();
        // Positions hundreds of tiles away are rounded to 1e-13, on slopes of up to 10.
        assert!((hit.position[2] - field.height_at(hit.position[0], hit.position[1])).abs() < 1e-9);
        assert!(hit.normal[2] > 0.0);
    }
}

/// For queries of a level and their four quarters: the sum of normalised differences over its standard deviation, and
/// their root mean square.
fn level_mismatch(reference: &Reference, gain: f32) -> (f64, f64) {
    let wi_wo = ([0.4, -0.3], [-0.2, 0.5]);
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0);
    for level in 1..=5 {
        let side = 64 >> level;
        let ask = |side: usize, level: i32, first: u64| {
            let queries = QueryBuffer::slice(side, side, wi_wo.0, wi_wo.1, level as f32);
            reference.measure(&queries, &Sampling { spp: 32, seed: 9, first }).unwrap()
        };
        let (coarse, fine) = (ask(side, level, 0), ask(2 * side, level - 1, 1 << 20));
        let grey = |m: &Measured, k: usize| m.rgb.pixels[k].iter().map(|&c| f64::from(c)).sum::<f64>() / 3.0;
        for k in 0..side * side {
            let corner = 2 * (k / side) * 2 * side + 2 * (k % side);
            let quarters = [corner, corner + 1, corner + 2 * side, corner + 2 * side + 1];
            let mean = quarters.iter().map(|&q| grey(&fine, q)).sum::<f64>() / 4.0;
            let noise = quarters.iter().map(|&q| f64::from(fine.variance[q])).sum::<f64>() / 16.0
                + f64::from(coarse.variance[k]);
            if noise > 0.0 {
                let z = (grey(&coarse, k) * f64::from(gain) - mean) / noise.sqrt();
                sum += z;
                squares += z * z;
                count += 1;
            }
        }
    }
    (sum / f64::from(count).sqrt(), (squares / f64::from(count)).sqrt())
}

#[test]
fn a_level_is_the_average_of_the_finer_one() {
    let reference = Reference::open(
        "rocks",
        &ReferenceOptions { resolution: Some([64, 64]), field_side: 128, ..ReferenceOptions::default() },
    )
    .unwrap();
    // If the levels agree and the variances are right, the first is a standard normal number and the second is near 1;
    // 16 pairs of samples give a variance tails, so the second has room upwards.
    let consistent = |(sum, rms): (f64, f64)| sum.abs() < 4.0 && (0.8..1.4).contains(&rms);
    let clean = level_mismatch(&reference, 1.0);
    assert!(consistent(clean), "{clean:?}");
    assert!(!consistent(level_mismatch(&reference, 1.03)), "3 % too much at the coarse level must show");
}

#[test]
fn same_bytes_on_any_number_of_threads() {
    let options = ReferenceOptions { bounces: 2, field_side: 64, ..ReferenceOptions::default() };
    let reference = Reference::open("metal-rings", &options).unwrap();
    let queries = QueryBuffer::slice(24, 20, [0.4, -0.3], [0.5, 0.2], 0.5);
    let on = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| reference.measure(&queries, &Sampling { spp: 5, seed, first: 3 }).unwrap())
    };
    let one_thread = on(1, 1);
    assert_eq!(one_thread, on(2, 1));
    assert_eq!(one_thread, on(4, 1));
    assert_ne!(one_thread, on(1, 2));
    // A part of the buffer, told where it starts, draws the same numbers.
    let part =
        reference.measure(&queries.range(100, 200), &Sampling { spp: 5, seed: 1, first: 103 }).unwrap();
    assert_eq!(part.rgb.pixels, one_thread.rgb.pixels[100..200]);
}

#[test]
fn odd_queries_have_answers() {
    let reference = open_builtin("rocks", 32);
    let answer = |u, wi, wo, level| reference.evaluate(&one(u, wi, wo, level)).unwrap().pixels[0];
    let (u, w) = ([0.5, 0.25], [0.3, 0.1]);
    assert_eq!(answer(u, [1.0, 0.0], w, 0.0), [0.0; 3]);
    assert_eq!(answer(u, w, [2.0, 0.0], 0.0), [0.0; 3]);
    assert_eq!(answer(u, w, w, -7.0), answer(u, w, w, 0.0));
    assert_eq!(answer(u, w, w, 1e30), answer(u, w, w, 5.0));
    assert!(answer([3e38, -3e38], w, w, 0.0).iter().all(|c| c.is_finite()));
    assert!(answer(u, [0.999_999_94, 0.0], [0.0, 0.999_999_94], 0.0).iter().all(|c| c.is_finite()));
    assert!(reference.measure(&one(u, w, w, 0.0), &sampling(0)).is_err());
    assert!(
        Reference::open("gravel", &ReferenceOptions::default())
            .unwrap_err()
            .to_string()
            .contains("metal-rings")
    );
}

const SIDE: u32 = 4;

/// Eight-bit values of a grey test map that tiles.
fn grey(k: u32) -> u8 {
    [20, 150, 90, 215][((k + 2 * (k / SIDE)) % 4) as usize]
}

fn write_maps(folder: &Path) {
    let at = |k: usize, side: u32| k as u32 % (side * side);
    let png8 = image::GrayImage::from_fn(SIDE, SIDE, |x, y| image::Luma([grey(y * SIDE + x)]));
    png8.save(folder.join("grey8.png")).unwrap();
    type Grey16 = image::ImageBuffer<image::Luma<u16>, Vec<u16>>;
    let png16 = Grey16::from_fn(SIDE, SIDE, |x, y| image::Luma([u16::from(grey(y * SIDE + x)) * 257]));
    png16.save(folder.join("grey16.png")).unwrap();
    image::RgbImage::from_fn(SIDE, SIDE, |x, y| image::Rgb([grey(y * SIDE + x); 3]))
        .save(folder.join("grey_rgb.png"))
        .unwrap();
    image::RgbImage::from_fn(SIDE, SIDE, |_, _| image::Rgb([188, 64, 0]))
        .save(folder.join("colour.png"))
        .unwrap();
    image::GrayImage::from_fn(6, 4, |x, _| image::Luma([grey(x % 2)])).save(folder.join("wide.png")).unwrap();
    image::GrayImage::new(1, 1).save(folder.join("dot.png")).unwrap();
    std::fs::write(folder.join("broken.png"), &std::fs::read(folder.join("grey8.png")).unwrap()[..40])
        .unwrap();
    std::fs::write(folder.join("photo.jpg"), "no map").unwrap();
    let exr = |name: &str, value: &(dyn Fn(usize) -> f32 + Sync)| {
        let side = SIDE as usize;
        exr::prelude::write_rgb_file(folder.join(name), side, side, |x, y| {
            let v = value(at(y * side + x, SIDE) as usize);
            (v, v, v)
        })
        .unwrap();
    };
    exr("grey.exr", &|k| f32::from(grey(k as u32)) / 255.0);
    exr("nan.exr", &|k| if k == 5 { f32::NAN } else { 0.5 });
    exr("negative.exr", &|k| (k % 2) as f32 - 0.5);
    exr("tall.exr", &|k| 1000.0 * (k % 2) as f32);
}

/// Opens a material.json with the given fields beside the test's maps.
fn open(folder: &Path, fields: &str) -> neumip::error::Result<Reference> {
    std::fs::write(folder.join("material.json"), format!("{{\"version\": 1, \"name\": \"test\", {fields}}}"))
        .unwrap();
    Reference::open(folder.to_str().unwrap(), &ReferenceOptions::default())
}

/// The material of such a file.
fn layer(folder: &Path, fields: &str) -> Material {
    open(folder, fields).unwrap();
    maps::read(&folder.join("material.json")).unwrap()
}

fn solid(material: &Material) -> &Layer {
    match &material.parts[..] {
        [Part::Solid(layer)] => layer,
        _ => panic!("{} is no solid layer", material.name),
    }
}

fn fields(height: &str, colour: &str, roughness: &str) -> String {
    format!(
        "\"height\": {height}, \"displacement\": 0.1, \"base_colour\": {colour}, \"roughness\": {roughness}"
    )
}

#[test]
fn maps_of_every_kind_agree() {
    let folder = tempfile::tempdir().unwrap();
    write_maps(folder.path());
    let material = |map: &str| {
        let map = format!("\"{map}\"");
        let material = layer(folder.path(), &fields(&map, "[0.5, 0.5, 0.5]", &map));
        assert!(material.notes.is_empty(), "{:?}", material.notes);
        material
    };
    let want = material("grey8.png");
    assert_eq!(
        solid(&want).height.values[3],
        (0.1_f32 as f64 * (f64::from(grey(3) as f32 / 255.0) - 0.5)) as f32
    );
    for map in ["grey16.png", "grey_rgb.png", "grey.exr"] {
        let got = material(map);
        assert_eq!(solid(&got).height, solid(&want).height, "{map}");
        assert_eq!(solid(&got).paint.roughness, solid(&want).paint.roughness, "{map}");
    }

    let colour =
        |spec: &str| solid(&layer(folder.path(), &fields("0.5", spec, "0.4"))).paint.base_colour.texels()[0];
    // The transfer function's values at 188 and 64 of 255, to four digits; half an 8-bit step changes the third.
    let close =
        |got: [f32; 3]| got.iter().zip([0.5029, 0.0513, 0.0]).all(|(a, b): (_, f32)| (a - b).abs() < 1e-4);
    assert!(close(colour("\"colour.png\"")));
    assert!(!close(colour("[0.737, 0.251, 0.0]")), "undecoded values must show");
    assert_eq!(colour("\"grey.exr\"")[0], f32::from(grey(0)) / 255.0, "EXR is linear");
}

#[test]
fn other_shapes_are_resampled_with_a_word() {
    let folder = tempfile::tempdir().unwrap();
    write_maps(folder.path());
    let reference = open(folder.path(), &fields("\"wide.png\"", "\"grey8.png\"", "0.4")).unwrap();
    assert_eq!(reference.notes().len(), 1);
    assert!(reference.notes()[0].contains("wide.png is 6 x 4, not square; resampled to 8 x 8"));
    assert_eq!((reference.height_map().unwrap().height, reference.resolution()), (8, [8, 8]));
}

#[test]
fn bad_materials_are_named_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    write_maps(folder.path());
    let good = fields("\"grey8.png\"", "[0.5, 0.5, 0.5]", "0.4");
    open(folder.path(), &good).unwrap();
    let cases = [
        (good.clone() + ", \"colour\": 1", "colour"),
        (good.replace("0.1,", "5,"), "displacement"),
        (good.replace("0.1,", "-0.1,"), "displacement"),
        (good.replace("0.1,", "1e40,"), "displacement"),
        (good.clone() + ", \"midlevel\": 3", "midlevel"),
        (good.clone() + ", \"metalness\": -0.5", "metalness"),
        (good.replace("0.4", "1.5"), "roughness"),
        (good.replace("0.4", "true"), "a number or the name of a map"),
        (good.replace("[0.5, 0.5, 0.5]", "[0.5, 0.5]"), "[r, g, b]"),
        (good.replace("[0.5, 0.5, 0.5]", "[0.5, 0.5, 2]"), "base_colour"),
        (good.replace("grey8.png", "absent.png"), "absent.png"),
        (good.replace("grey8.png", "broken.png"), "broken.png"),
        (good.replace("grey8.png", "dot.png"), "1 x 1"),
        (good.replace("grey8.png", "colour.png"), "three different channels"),
        (good.replace("grey8.png", "photo.jpg"), "neither .png nor .exr"),
        (good.replace("grey8.png", "nan.exr"), "row 1, column 1"),
        (good.replace("grey8.png", "negative.exr"), "not negative"),
        (good.replace("grey8.png", "tall.exr"), "at most 1 from the plane"),
        (good.replace("\"displacement\": 0.1,", ""), "displacement"),
    ];
    for (fields, word) in cases {
        let error = open(folder.path(), &fields).unwrap_err().to_string();
        assert!(error.contains(word) && !error.contains('\n'), "{fields}: {error}");
    }
    std::fs::write(folder.path().join("material.json"), "{\"version\": 2}").unwrap();
    assert!(Reference::open(folder.path().to_str().unwrap(), &ReferenceOptions::default()).is_err());
}
