//! The maps against the reflectance itself, against geometry that can be written down, and against the reference.

use super::*;
use crate::random::{Random, Stream};
use crate::reference::{
    Brdf, HeightMap, Paint, Reference, ReferenceOptions, Sampling, Texture, builtin, material::Layer,
};

/// Colours, F0 and alpha are kept in 11 bits; a lobe depends on alpha's fourth power.
const HALF_ROUNDING: f32 = 4e-3;
/// Mixing in another order rounds otherwise: a few units in the seventh digit of answers up to about 10.
const ORDER: f32 = 2e-5;
/// Mean squared error of relief at level 0: light through one ray instead of 64, along borders of shadows. A fifth more
/// height, or no shadows, gives at least twice as much.
const RELIEF: f64 = 3e-4;
/// Bounced light over random directions, as a share of the reference's: 32 paths a texel.
const BOUNCED_SHARE: f64 = 0.1;

const RAMP: usize = 16;

fn config(view_steps: usize, shadow_steps: usize) -> MapsConfig {
    MapsConfig { view_steps, shadow_steps, bounces: 0, ..MapsConfig::default() }
}

fn heights(side: usize, height: impl Fn(f32, f32) -> f32) -> HeightMap {
    let centre = |k: usize| (k as f32 + 0.5) / side as f32;
    let values = (0..side * side).map(|k| height(centre(k % side), centre(k / side))).collect();
    HeightMap { height: side, width: side, values }
}

fn waves(scale: f32) -> Material {
    let tau = std::f32::consts::TAU;
    let map = heights(64, |x, y| scale * 0.03 * (tau * (2.0 * x + y)).sin() * (tau * y).cos());
    Material::solid("waves", map, Paint::plain([0.8, 0.5, 0.2], 0.6, 0.04))
}

fn random_queries(n: usize, level: f32) -> QueryBuffer {
    let mut queries = QueryBuffer::slice(1, n, [0.0; 2], [0.0; 2], level);
    for k in 0..n {
        let mut random = Random::new(5, Stream::Probe, k as u64);
        queries.u[k] = [random.uniform(), random.uniform()];
        (queries.wi[k], queries.wo[k]) = (random.disc(0.9), random.disc(0.9));
    }
    queries
}

fn one(u: [f32; 2], wi: [f32; 2], wo: [f32; 2], level: f32) -> QueryBuffer {
    QueryBuffer::new(1, 1, vec![u], vec![wi], vec![wo], vec![level]).unwrap()
}

fn answer(maps: &AnalyticMaps, u: [f32; 2], wi: [f32; 2], wo: [f32; 2], level: f32) -> [f32; 3] {
    maps.evaluate(&one(u, wi, wo, level)).unwrap().pixels[0]
}

fn mse(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    let sum: f64 = pairs.map(|(a, b)| f64::from(a.min(1.0) - b.min(1.0)).powi(2)).sum();
    sum / (3 * a.len()) as f64
}

fn reference(material: &Material, side: usize, bounces: usize) -> Reference {
    let options = ReferenceOptions { resolution: Some([side; 2]), bounces, ..ReferenceOptions::default() };
    Reference::new(material.clone(), &options).unwrap()
}

fn measured(material: &Material, side: usize, bounces: usize, queries: &QueryBuffer) -> Vec<[f32; 3]> {
    let sampling = Sampling { spp: 64, seed: 1, first: 0 };
    reference(material, side, bounces).measure(queries, &sampling).unwrap().rgb.pixels
}

#[test]
fn a_plate_reflects_as_its_brdf_at_every_level() {
    let off = |plate: Brdf, asked: Brdf| {
        let mut paint = Paint::plain(plate.base_colour, plate.roughness, plate.specular);
        paint.metalness = Texture::constant([plate.metalness]);
        let mut worst = 0.0_f32;
        for sides in [[8, 8], [12, 20], [5, 3]] {
            let map = HeightMap { height: 7, width: 9, values: vec![0.02; 63] };
            let maps =
                AnalyticMaps::new(&Material::solid("", map, paint.clone()), sides, &config(4, 4)).unwrap();
            for level in [0.0, 0.5, 1.0, 2.3, 9.0] {
                let queries = random_queries(200, level);
                let answers = maps.evaluate(&queries).unwrap().pixels;
                for (k, got) in answers.iter().enumerate() {
                    let [wi, wo] = [crate::query::unit(queries.wi[k]), crate::query::unit(queries.wo[k])];
                    for (got, f) in got.iter().zip(asked.eval(wi, wo)) {
                        worst = worst.max((got - f * wi[2]).abs() / (f * wi[2]).max(1e-2));
                    }
                }
            }
        }
        eprintln!("PLATE {worst}");
        worst
    };
    for metalness in [0.0, 0.3, 1.0] {
        let plate = Brdf { base_colour: [0.9, 0.4, 0.1], roughness: 0.5, metalness, specular: 0.04 };
        assert!(off(plate, plate) < HALF_ROUNDING, "{}", off(plate, plate));
        assert!(off(plate, Brdf { roughness: 0.51, ..plate }) > HALF_ROUNDING);
        assert!(off(plate, Brdf { base_colour: [0.91, 0.4, 0.1], ..plate }) > HALF_ROUNDING);
    }
}

#[test]
fn a_raised_plate_is_seen_where_parallax_moves_it() {
    // Colour rises along x over the tile; the plate lies 0.1 above the plane.
    let ramp: Vec<[f32; 3]> = (0..RAMP * RAMP).map(|k| [(k % RAMP) as f32 / RAMP as f32; 3]).collect();
    let mut paint = Paint::plain([1.0; 3], 1.0, 0.0);
    paint.base_colour = Texture::new(RAMP, ramp).unwrap();
    let height = 0.1;
    let material = Material::solid("", heights(RAMP, |_, _| height), paint.clone());
    let maps = AnalyticMaps::new(&material, [RAMP; 2], &config(2, 2)).unwrap();
    let wo = [0.6, 0.0];
    let seen = |height: f32| {
        let x = f64::from(0.3 + 0.6 / 0.8 * height);
        paint.brdf(x, 0.4).base_colour[0] * std::f32::consts::FRAC_1_PI
    };
    let got = answer(&maps, [0.3, 0.4], [0.0, 0.0], wo, 0.0)[0];
    // The box of a texel reads a ramp as a point does.
    eprintln!("PAR {got} {} {}", seen(height), seen(0.9 * height));
    assert!((got - seen(height)).abs() < HALF_ROUNDING * got, "{got} {}", seen(height));
    assert!((got - seen(-height)).abs() > HALF_ROUNDING * got);
    assert!((got - seen(0.9 * height)).abs() > HALF_ROUNDING * got);
}

#[test]
fn a_step_casts_its_shadow_and_no_more() {
    // A wall of 0.1 over half of the tile; light from there at 45 degrees reaches 0.1 into the floor.
    let wall = heights(64, |x, _| if x < 0.5 { 0.1 } else { 0.0 });
    let material = Material::solid("", wall, Paint::plain([1.0; 3], 1.0, 0.0));
    let maps = AnalyticMaps::new(&material, [64; 2], &config(16, 16)).unwrap();
    let light = [-std::f32::consts::FRAC_1_SQRT_2, 0.0];
    let at = |x: f32| answer(&maps, [x, 0.3], light, [0.0; 2], 0.0)[0];
    let lit = std::f32::consts::FRAC_1_PI * std::f32::consts::FRAC_1_SQRT_2;
    for x in [0.53, 0.55, 0.56] {
        assert_eq!(at(x), 0.0, "{x}");
    }
    for x in [0.64, 0.7, 0.9, 0.2] {
        assert!((at(x) - lit).abs() < HALF_ROUNDING * lit, "{x}: {} {lit}", at(x));
    }
    let unshadowed = maps.marched(16, 0, 1).unwrap();
    assert!(answer(&unshadowed, [0.56, 0.3], light, [0.0; 2], 0.0)[0] > 0.5 * lit);
}

#[test]
fn relief_is_near_the_reference() {
    let queries = random_queries(1500, 0.0);
    let target = measured(&waves(3.0), 64, 0, &queries);
    let error = |scale: f32, view, shadow| {
        let maps = AnalyticMaps::new(&waves(3.0 * scale), [64; 2], &config(view, shadow)).unwrap();
        mse(&maps.evaluate(&queries).unwrap().pixels, &target)
    };
    eprintln!(
        "REL {:?}",
        [(1.0, 16, 16), (1.1, 16, 16), (1.2, 16, 16), (1.0, 16, 0), (1.0, 2, 16), (1.0, 3, 16)]
            .map(|(a, b, c)| error(a, b, c))
    );
    assert!(error(1.0, 16, 16) < RELIEF, "{}", error(1.0, 16, 16));
    assert!(error(1.2, 16, 16) > 2.0 * RELIEF, "{}", error(1.2, 16, 16));
    assert!(error(1.0, 16, 0) > 2.0 * RELIEF, "{}", error(1.0, 16, 0));
    assert!(error(1.0, 2, 16) > 2.0 * RELIEF, "{}", error(1.0, 2, 16));
}

#[test]
fn more_rays_and_finer_maps_lead_to_the_reference() {
    let queries = random_queries(600, 3.0);
    let target = measured(&waves(1.0), 32, 0, &queries);
    let maps = |rays| {
        let config = MapsConfig { rays, resolution: Some([64; 2]), ..config(16, 16) };
        let maps = AnalyticMaps::new(&waves(1.0), [32; 2], &config).unwrap();
        mse(&maps.evaluate(&queries).unwrap().pixels, &target)
    };
    let errors = [1, 2, 4].map(maps);
    assert!(errors[1] < 0.5 * errors[0] && errors[2] < 0.5 * errors[1], "{errors:?}");
}

#[test]
fn slopes_that_are_averaged_away_widen_the_lobe() {
    let tau = std::f32::consts::TAU;
    let ripples = |scale: f32| {
        let waves = [[8.0, 1.0], [3.0, 7.0], [-6.0, 5.0], [2.0, -9.0], [7.0, 7.0]];
        let wave = |x: f32, y: f32| waves.map(|[a, b]| (tau * (a * x + b * y)).sin()).iter().sum::<f32>();
        let map = heights(64, |x, y| scale * 0.002 * wave(x, y));
        Material::solid("", map, Paint::plain([0.0; 3], 0.3, 0.5))
    };
    let mut queries = random_queries(64, 5.0);
    queries.wi.fill([0.02, 0.0]);
    queries.wo.fill([-0.02, 0.0]);
    let mean =
        |pixels: &[[f32; 3]]| pixels.iter().map(|p| f64::from(p[0])).sum::<f64>() / pixels.len() as f64;
    let maps = |scale| {
        let maps = AnalyticMaps::new(&ripples(scale), [64; 2], &config(8, 8)).unwrap();
        mean(&maps.evaluate(&queries).unwrap().pixels)
    };
    for l in [64.0_f32, 32.0, 16.0, 8.0, 4.0, 2.0, 1.0] {
        let q = AnalyticMaps::new(&ripples(1.0), [l.max(2.0) as usize; 2], &config(8, 8)).unwrap();
        eprintln!("SPR {l} {:?}", q.maps.first());
    }
    eprintln!("RIP {} {} {}", maps(1.0), maps(0.0), mean(&measured(&ripples(1.0), 64, 0, &queries)));
    let target = mean(&measured(&ripples(1.0), 64, 0, &queries));
    // A Gaussian stands for a sine's slopes, and the flat plate reflects three times as much.
    assert!((maps(1.0) / target - 1.0).abs() < 0.3, "{} {target}", maps(1.0));
    assert!((maps(0.0) / target - 1.0).abs() > 1.0, "{} {target}", maps(0.0));
}

#[test]
fn bounced_light_is_baked() {
    let mut material = waves(2.0);
    let Some(Part::Solid(Layer { paint, .. })) = material.parts.first_mut() else { panic!() };
    paint.base_colour = Texture::constant([0.9; 3]);
    let queries = random_queries(1500, 0.0);
    let mean = |pixels: Vec<[f32; 3]>| {
        pixels.as_flattened().iter().map(|v| f64::from(*v)).sum::<f64>() / queries.len() as f64
    };
    let target = mean(measured(&material, 32, 1, &queries)) - mean(measured(&material, 32, 0, &queries));
    let baked = |albedo: f32| {
        let mut material = material.clone();
        let Some(Part::Solid(Layer { paint, .. })) = material.parts.first_mut() else { panic!() };
        paint.base_colour = Texture::constant([albedo; 3]);
        let [direct, all] = [0, 1].map(|bounces| {
            let config = MapsConfig { bounces, ..config(16, 16) };
            mean(AnalyticMaps::new(&material, [32; 2], &config).unwrap().evaluate(&queries).unwrap().pixels)
        });
        (all - direct) / target
    };
    assert!((baked(0.9) - 1.0).abs() < BOUNCED_SHARE, "{}", baked(0.9));
    assert!((baked(0.8) - 1.0).abs() > BOUNCED_SHARE, "{}", baked(0.8));
}

#[test]
fn tiles_repeat() {
    let maps = AnalyticMaps::new(&waves(1.0), [64; 2], &config(8, 8)).unwrap();
    let ask = |u| answer(&maps, u, [0.3, -0.2], [-0.5, 0.4], 0.7);
    for (u, same) in [
        ([0.25, 0.5], [-2.75, 1.5]),
        ([0.0, 0.0], [1e6, -1e6]),
        ([0.75, 0.125], [-0.25, -0.875]),
        ([0.0, 0.0], [1e30, -1e30]),
    ] {
        assert_eq!(ask(u), ask(same));
        assert_ne!(ask(u), ask([u[0] + 0.125, u[1]]));
    }
    // Across the border nothing jumps: a ten-thousandth of the tile is a hundredth of a texel.
    let (before, after) = (ask([-5e-5, 0.3]), ask([5e-5, 0.3]));
    assert!((before[0] - after[0]).abs() < 0.01 * before[0] && before[0] > 0.0, "{before:?} {after:?}");
}

#[test]
fn nothing_comes_from_below_the_horizon_and_everything_is_finite() {
    let material = builtin::make("metal-rings", 32, 0).unwrap();
    let config = MapsConfig { paths: 2, rays: 2, ..MapsConfig::default() };
    let maps = AnalyticMaps::new(&material, [32; 2], &config).unwrap();
    for (wi, wo) in [([1.0, 0.0], [0.0; 2]), ([0.0; 2], [0.8, 0.8]), ([1e30, 0.0], [0.0; 2])] {
        assert_eq!(answer(&maps, [0.3; 2], wi, wo, 0.0), [0.0; 3]);
    }
    let grazing = 1.0 - f32::EPSILON;
    let directions = [[0.0, 0.0], [grazing, 0.0], [0.0, -grazing], [0.7, 0.7], [-0.6, 0.79]];
    for level in [-1e30, -1.0, 0.0, 0.4999, 4.5, 5.0, 100.0, 1e30] {
        for u in [[0.5, 0.5], [1e6, -1e6], [f32::MAX, f32::MIN], [-1e-9, 1.0 - 1e-7]] {
            for wi in directions {
                for wo in directions {
                    let rgb = answer(&maps, u, wi, wo, level);
                    assert!(
                        rgb.iter().all(|v| v.is_finite() && *v >= 0.0),
                        "{u:?} {wi:?} {wo:?} {level}: {rgb:?}"
                    );
                }
            }
        }
    }
    assert_eq!(
        answer(&maps, [0.3; 2], [0.1; 2], [0.2; 2], 5.0),
        answer(&maps, [0.3; 2], [0.1; 2], [0.2; 2], 90.0)
    );
    assert_ne!(
        answer(&maps, [0.3; 2], [0.1; 2], [0.2; 2], 5.0),
        answer(&maps, [0.3; 2], [0.1; 2], [0.2; 2], 4.0)
    );
    // Values that a buffer refuses, written into it afterwards.
    let mut poisoned = one([0.5; 2], [0.1; 2], [0.1; 2], 1.0);
    poisoned.u[0] = [f32::NAN, f32::INFINITY];
    poisoned.level[0] = f32::NAN;
    assert!(maps.evaluate(&poisoned).is_ok());
}

#[test]
fn instruction_sets_and_threads_agree() {
    let queries = random_queries(5000, 1.3);
    let [one_thread, two] = [1, 2].map(|n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap());
    let mut before: Option<Vec<[f32; 3]>> = None;
    for isa in Isa::all() {
        let maps = AnalyticMaps::with_isa(&waves(1.0), [64; 2], &config(8, 8), isa).unwrap();
        let pixels = one_thread.install(|| maps.evaluate(&queries)).unwrap().pixels;
        assert_eq!(pixels, two.install(|| maps.evaluate(&queries)).unwrap().pixels);
        if let Some(before) = &before {
            let pairs = pixels.as_flattened().iter().zip(before.as_flattened());
            let worst = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(worst < ORDER, "{}: {worst}", isa.name());
        }
        before = Some(pixels);
    }
    let other = AnalyticMaps::new(&waves(1.001), [64; 2], &config(8, 8)).unwrap();
    let pixels = other.evaluate(&queries).unwrap().pixels;
    let before = before.unwrap();
    let pairs = pixels.as_flattened().iter().zip(before.as_flattened());
    assert!(pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) > ORDER);
}

#[test]
fn bytes_are_those_of_the_pyramids() {
    let maps = AnalyticMaps::new(&waves(1.0), [8; 2], &config(2, 0)).unwrap();
    let texels = (64 + 16 + 4 + 1) * 16 * 2;
    let heights = (9 * 9 + 5 * 5 + 3 * 3 + 2 * 2) * 4;
    assert_eq!(maps.bytes(), texels + heights);
    assert!(maps.marched(8, 8, 2).unwrap().flops() > 4 * maps.flops());
}

#[test]
fn what_has_no_maps_is_refused() {
    for name in ["twill", "insulation-foam"] {
        let material = builtin::make(name, 16, 0).unwrap();
        let error = AnalyticMaps::new(&material, [16; 2], &MapsConfig::default()).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains("no maps"), "{error}");
    }
    let refused =
        |config: MapsConfig| AnalyticMaps::new(&waves(1.0), [8; 2], &config).unwrap_err().to_string();
    let base = config(8, 8);
    assert!(refused(MapsConfig { view_steps: 1, ..base }).contains("maps.view_steps"));
    assert!(refused(MapsConfig { shadow_steps: usize::MAX, ..base }).contains("maps.shadow_steps"));
    assert!(refused(MapsConfig { rays: 0, ..base }).contains("maps.rays"));
    assert!(refused(MapsConfig { paths: 0, ..base }).contains("maps.paths"));
    assert!(refused(MapsConfig { resolution: Some([1 << 20, 8]), ..base }).contains("maps.resolution"));
    assert!(AnalyticMaps::new(&waves(f32::NAN), [8; 2], &base).is_err());
    let paint = Paint::plain([f32::NAN; 3], 0.5, 0.04);
    let poisoned = Material::solid("", heights(8, |_, _| 0.0), paint);
    assert!(AnalyticMaps::new(&poisoned, [8; 2], &base).unwrap_err().to_string().contains("not finite"));
}

#[test]
fn names_tell_the_variants_apart() {
    let named = |config| AnalyticMaps::new(&waves(1.0), [8; 2], &config).unwrap().name();
    assert_eq!(named(MapsConfig { bounces: 1, paths: 1, ..config(8, 8) }), "maps-8");
    assert_eq!(named(MapsConfig { rays: 2, ..config(8, 4) }), "maps-8-4-rays-4-direct");
    assert_eq!(named(MapsConfig { resolution: Some([16, 8]), ..config(8, 8) }), "maps-8-16x8-direct");
}
