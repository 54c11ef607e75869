//! Every kind of surface obeys the same physics: energy, tiling, parallax, layers and normals.

use crate::reference::{estimate, hemisphere};
use neumip::kernels::simd::Isa;
use neumip::query::{QueryBuffer, unit};
use neumip::random::{Random, Stream};
use neumip::reference::packet::Tracer;
use neumip::reference::primitives::{Curve, TriangleMesh};
use neumip::reference::{
    FibreLook, Geometry, HeightMap, Heightfield, Layer, Material, Paint, Part, Reference, ReferenceOptions,
    Sampling, Texture, View, builtin,
};
use std::f64::consts::{PI, TAU};

const WHITE: [f32; 3] = [1.0; 3];

fn lambert(base: f32) -> Paint {
    Paint::plain([base; 3], 0.5, 0.0)
}

fn field(side: usize, height: impl Fn(f64, f64) -> f64) -> HeightMap {
    let at = |k: usize| (k as f64 + 0.5) / side as f64;
    let values = (0..side * side).map(|k| height(at(k % side), at(k / side)) as f32).collect();
    HeightMap { height: side, width: side, values }
}

fn rough(side: usize, low: f64, high: f64, salt: u64) -> HeightMap {
    let mut random = Random::new(7, Stream::Probe, salt);
    HeightMap {
        height: side,
        width: side,
        values: (0..side * side).map(|_| (low + (high - low) * random.uniform_f64()) as f32).collect(),
    }
}

fn holes(side: usize) -> Texture<1> {
    let mut random = Random::new(8, Stream::Probe, 0);
    Texture::new(side, (0..side * side).map(|_| [random.uniform()]).collect()).unwrap()
}

/// A heightfield as triangles, two a cell, whose borders meet those of the next tile.
fn triangulated(map: &HeightMap) -> TriangleMesh {
    let (rows, columns) = (map.height, map.width);
    let z = |i: usize, j: usize| f64::from(map.values[i % rows * columns + j % columns]);
    let positions = (0..=rows)
        .flat_map(|i| (0..=columns).map(move |j| (i, j)))
        .map(|(i, j)| [j as f64 / columns as f64, i as f64 / rows as f64, z(i, j)])
        .collect();
    let corner = |i: usize, j: usize| (i * (columns + 1) + j) as u32;
    let triangles = (0..rows * columns).flat_map(|k| {
        let (i, j) = (k / columns, k % columns);
        let (a, b, c, d) = (corner(i, j), corner(i, j + 1), corner(i + 1, j), corner(i + 1, j + 1));
        [[a, b, d], [a, d, c]]
    });
    TriangleMesh { positions, triangles: triangles.collect(), normals: None, uv: None }
}

fn look(colour: f32) -> FibreLook {
    FibreLook {
        colour: [colour; 3],
        longitudinal_roughness: 0.3,
        azimuthal_roughness: 0.3,
        ior: 1.55,
        tilt: 0.0,
    }
}

/// Wavy fibres along x over straight ones along y.
fn fibres() -> Vec<Curve> {
    let along = |k: usize, turn: bool| {
        let side = (f64::from(k as u32) + 0.5) / 6.0;
        let points = (0..=24).map(|s| {
            let t = f64::from(s) / 24.0;
            let z = if turn { -0.06 } else { 0.03 + 0.02 * (TAU * (2.0 * t + side)).sin() };
            if turn { [side, t, z] } else { [t, side, z] }
        });
        Curve { points: points.collect(), radius: 0.03, look: 0 }
    };
    (0..6).flat_map(|k| [along(k, false), along(k, true)]).collect()
}

/// The kinds of surface; `base` is the albedo of all their paint, the colour of all their fibres.
fn kinds(base: f32) -> Vec<(&'static str, Vec<Part>)> {
    let solid = |low, high| Part::Solid(Layer { height: rough(12, low, high, 3), paint: lambert(base) });
    let sheet = Layer { height: rough(9, 0.0, 0.1, 4), paint: lambert(base) };
    vec![
        ("solid", vec![solid(-0.1, 0.1)]),
        ("sheet", vec![Part::Sheet(sheet, holes(16)), solid(-0.12, -0.02)]),
        ("mesh", vec![Part::Mesh(triangulated(&rough(10, -0.1, 0.1, 5)), lambert(base))]),
        ("fibres", vec![Part::Fibres(fibres(), vec![look(base)]), solid(-0.2, -0.12)]),
    ]
}

fn material(parts: Vec<Part>) -> Material {
    Material { name: "test".into(), parts, height_range: None, notes: Vec::new() }
}

fn geometry(parts: Vec<Part>) -> Geometry {
    Geometry::new(material(parts)).unwrap()
}

fn reference(parts: Vec<Part>, side: usize) -> Reference {
    let options = ReferenceOptions { resolution: Some([side; 2]), ..ReferenceOptions::default() };
    Reference::new(material(parts), &options).unwrap()
}

/// Products of up to some hundred f32 weights, each rounded; a fibre's weights are off by up to 1e-4 of 1 each.
const PATH_ROUNDING: f64 = 1e-3;

fn is_one((mean, error): (f64, f64)) -> bool {
    (mean - 1.0).abs() <= 3.0 * error + PATH_ROUNDING
}

#[test]
fn white_surfaces_of_every_kind_return_the_whole_sky() {
    for (white, grey) in kinds(1.0).into_iter().zip(kinds(0.97)) {
        let sky = |parts: Vec<Part>| {
            let geometry = geometry(parts);
            estimate(10_000, |random| {
                let p = [random.uniform_f64(), random.uniform_f64()];
                let wo = hemisphere(random);
                geometry.sky_radiance(p, wo, random)[0]
            })
        };
        let (name, all) = (white.0, sky(white.1));
        assert!(is_one(all), "{name}: {all:?}");
        assert!(!is_one(sky(grey.1)), "{name}: a loss of 3 % a bounce must show");
    }
}

#[test]
fn distant_lights_of_every_kind_add_up_to_the_sky() {
    for (name, parts) in kinds(1.0) {
        let geometry = geometry(parts);
        let all_lights = |bounces: usize| {
            estimate(20_000, |random| {
                let p = [random.uniform_f64(), random.uniform_f64()];
                let (wi, wo) = (hemisphere(random), unit([0.3, 0.2]).map(f64::from));
                TAU as f32 * geometry.radiance(p, &View { wi, wo, bounces }, random)[0]
            })
        };
        let all = all_lights(64);
        assert!(is_one(all), "{name}: {all:?}");
        assert!(!is_one(all_lights(0)), "{name}: without indirect light some must be missing");
    }
}

/// The parts moved by half a tile in x and y.
fn moved(parts: Vec<Part>) -> Vec<Part> {
    fn roll<T: Copy>(side: usize, values: &[T]) -> Vec<T> {
        let half = side / 2;
        (0..side * side).map(|k| values[(k / side + half) % side * side + (k % side + half) % side]).collect()
    }
    let layer = |layer: Layer| {
        let values = roll(layer.height.width, &layer.height.values);
        Layer { height: HeightMap { values, ..layer.height }, ..layer }
    };
    let shift = |p: &mut [f64; 3]| (p[0], p[1]) = (p[0] - 0.5, p[1] - 0.5);
    let parts = parts.into_iter().map(|part| match part {
        Part::Solid(solid) => Part::Solid(layer(solid)),
        Part::Sheet(sheet, opacity) => {
            let texels = roll(opacity.side(), opacity.texels());
            Part::Sheet(layer(sheet), Texture::new(opacity.side(), texels).unwrap())
        }
        Part::Mesh(mut mesh, paint) => {
            mesh.positions.iter_mut().for_each(shift);
            Part::Mesh(mesh, paint)
        }
        Part::Fibres(mut curves, looks) => {
            curves.iter_mut().flat_map(|curve| &mut curve.points).for_each(shift);
            Part::Fibres(curves, looks)
        }
    });
    parts.collect()
}

/// Fields of even sides, which half a tile moves by whole samples.
fn even(parts: Vec<Part>) -> Vec<Part> {
    let parts = parts.into_iter().map(|part| match part {
        Part::Sheet(sheet, opacity) => Part::Sheet(Layer { height: rough(8, 0.0, 0.1, 4), ..sheet }, opacity),
        other => other,
    });
    parts.collect()
}

#[test]
fn a_tile_of_every_kind_moved_by_half_gives_the_moved_picture() {
    for (name, parts) in kinds(0.7) {
        let parts = even(parts);
        let (here, there) = (reference(parts.clone(), 16), reference(moved(parts), 16));
        let sampling = Sampling { spp: 4, seed: 5, first: 0 };
        let differing = |shift: f32| {
            let slice = QueryBuffer::slice(16, 16, [0.5, 0.2], [-0.6, 0.5], 0.0);
            let mut back = slice.clone();
            back.u.iter_mut().for_each(|u| *u = u.map(|c| c + shift));
            let a = here.measure(&back, &sampling).unwrap().rgb.pixels;
            let b = there.measure(&slice, &sampling).unwrap().rgb.pixels;
            a.iter().zip(&b).filter(|(a, b)| (a[0] - b[0]).abs() > 1e-3).count()
        };
        // Positions differ by half a tile, so rounding does: it may flip a shadow or a path of single precision.
        const FLIPPED: usize = 12;
        assert!(differing(0.5) <= FLIPPED, "{name}: {}", differing(0.5));
        assert!(differing(0.25) > FLIPPED, "{name}");
    }
}

/// First root of `above` along a ray, by small steps and halving.
fn marched(above: impl Fn(f64) -> f64, end: f64) -> Option<f64> {
    let steps = 20_000;
    let at = |k: usize| end * k as f64 / steps as f64;
    let k = (1..=steps).find(|&k| above(at(k)) <= 0.0)?;
    let (mut low, mut high) = (at(k - 1), at(k));
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if above(middle) > 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    Some(0.5 * (low + high))
}

/// Largest distance, in tile widths, of hits on a field from those on the surface that it samples, over rays that meet the
/// surface steeply enough.
fn parallax_error(surface: &dyn Fn(f64, f64) -> f64, side: usize, scale: f64) -> f64 {
    let field = Heightfield::new(&field(side, |x, y| scale * surface(x, y))).unwrap();
    let (mut worst, mut elsewhere) = (0.0_f64, 0);
    for k in 0..200 {
        let mut random = Random::new(12, Stream::Probe, k);
        let p = [random.uniform_f64(), random.uniform_f64()];
        let w = random.disc(0.8);
        let down = unit(w).map(|c| -f64::from(c));
        let origin = [0, 1].map(|c| p[c] + down[c] / down[2] * 0.2);
        let origin = [origin[0], origin[1], 0.2];
        let point = |t: f64| [0, 1, 2].map(|c| origin[c] + down[c] * t);
        let above = |t: f64| {
            let [x, y, z] = point(t);
            z - surface(x, y)
        };
        let Some(t) = marched(above, 0.5 / -down[2]) else { panic!("a surface without holes is met") };
        // Where the ray nearly touches, a small error in height moves the hit far.
        let slope = (above(t + 1e-5) - above(t - 1e-5)) / 2e-5;
        if slope > -0.3 {
            continue;
        }
        let hit = field.intersect(origin, down, f64::INFINITY).unwrap();
        // A ray that nearly touches a crest before it may be stopped there by one of the two.
        if (hit.t - t).abs() < 0.05 {
            worst = worst.max((hit.t - t).abs());
        } else {
            elsewhere += 1;
        }
    }
    assert!(elsewhere <= 2, "{elsewhere} of 200 rays met another part of the surface");
    worst
}

#[test]
fn parallax_meets_analytic_surfaces() {
    let sine = |x: f64, y: f64| 0.05 * (TAU * x).sin() * (TAU * y).cos();
    // Spherical caps of radius 0.3 on a plane: their height over it is 0.1.
    let caps = |x: f64, y: f64| {
        let (dx, dy) = (x - x.floor() - 0.5, y - y.floor() - 0.5);
        ((0.09 - dx * dx - dy * dy).max(0.0).sqrt() - 0.2).max(0.0)
    };
    // Bilinear interpolation between samples h apart is off by h^2 / 8 times the curvature, at most 4 pi^2 0.05 x 2 and
    // 2 / 0.3 (1 + 1.25^2)^1.5 here (twice that at the caps' rims, where the slope jumps: h times half the slope 1.12), over
    // a slope of at least 0.3.
    let (sine_bound, caps_bound) = (1.0 / 512.0_f64.powi(2) / 8.0 * 4.0 / 0.3, 0.5 * 1.12 / 512.0 / 0.3);
    assert!(parallax_error(&sine, 512, 1.0) < sine_bound, "{}", parallax_error(&sine, 512, 1.0));
    assert!(parallax_error(&sine, 512, 1.02) > sine_bound, "2 % of the height must show");
    assert!(parallax_error(&caps, 512, 1.0) < caps_bound, "{}", parallax_error(&caps, 512, 1.0));
    assert!(parallax_error(&caps, 512, 1.1) > caps_bound, "a tenth of the height must show");
}

fn picture(parts: Vec<Part>) -> Vec<[f32; 3]> {
    let slice = QueryBuffer::slice(16, 16, [0.5, 0.2], [-0.6, 0.5], 0.0);
    reference(parts, 16).measure(&slice, &Sampling { spp: 4, seed: 5, first: 0 }).unwrap().rgb.pixels
}

#[test]
fn a_sheet_without_holes_hides_and_a_sheet_of_holes_shows_its_base() {
    let base = || Part::Solid(Layer { height: rough(12, -0.2, -0.1, 3), paint: lambert(0.3) });
    let layer = || Layer { height: rough(12, -0.05, 0.05, 4), paint: lambert(0.7) };
    let sheet = |opacity: f32| vec![Part::Sheet(layer(), Texture::constant([opacity])), base()];
    assert_eq!(picture(sheet(1.0)), picture(vec![Part::Solid(layer())]));
    // The view rays start at the top of all parts, so their hits differ by rounding.
    const ROUNDING: f32 = 1e-5;
    let close = |a: Vec<[f32; 3]>, b: Vec<[f32; 3]>| {
        a.iter().zip(&b).filter(|(a, b)| (a[0] - b[0]).abs() > ROUNDING).count() <= 2
    };
    assert!(close(picture(sheet(0.0)), picture(vec![base()])));
    assert!(!close(picture(sheet(0.0)), picture(sheet(1.0))));
    let half = vec![Part::Sheet(layer(), holes(16)), base()];
    assert!(!close(picture(half.clone()), picture(sheet(0.0))) && !close(picture(half), picture(sheet(1.0))));
}

/// Sheets met from both sides: the walk against small steps.
#[test]
fn rays_meet_sheets_from_both_sides() {
    let map = rough(7, -0.1, 0.1, 9);
    let sheet = Heightfield::new(&map).unwrap();
    let opacity = holes(8);
    let disagreements = |opacity: &Texture<1>| {
        let differ = (0..600).filter(|&k| {
            let mut random = Random::new(13, Stream::Probe, k);
            let mut w = hemisphere(&mut random);
            w[2] = w[2].max(0.15);
            let direction = if k % 2 == 0 { w } else { w.map(|c| -c) };
            let z = if k % 3 == 0 { 0.02 } else { -0.11 * direction[2].signum() };
            let origin = [random.uniform_f64() * 3.0 - 1.0, random.uniform_f64(), z];
            let point = |t: f64| [0, 1, 2].map(|c| origin[c] + direction[c] * t);
            let side = |t: f64| {
                let [x, y, z] = point(t);
                z > sheet.height_at(x, y)
            };
            let steps = 6000;
            let end = 0.23 / 0.15;
            let at = |k: usize| end * k as f64 / steps as f64;
            let want = (1..=steps).find(|&k| {
                let [x, y, _] = point(at(k));
                side(at(k - 1)) != side(at(k)) && self::holes(8).at(x, y)[0] >= 0.5
            });
            let got = sheet.intersect_sheet(opacity, origin, direction, end);
            match (want, got) {
                (Some(k), Some(hit)) => (hit.t - at(k)).abs() > 2.0 * end / steps as f64,
                (None, None) => false,
                _ => true,
            }
        });
        differ.count()
    };
    // Steps of 2.6e-4 miss a few crossings that come in pairs, and holes' borders between two steps.
    const MISSED: usize = 12;
    let count = disagreements(&opacity);
    assert!(count <= MISSED, "{count} of 600");
    assert!(disagreements(&Texture::constant([1.0])) > MISSED, "closed holes must show");
}

#[test]
fn a_normal_map_turns_the_shading() {
    let tilted = |n: [f32; 3]| {
        let length = n.iter().map(|c| c * c).sum::<f32>().sqrt();
        n.map(|c| c / length)
    };
    let n = tilted([0.3, -0.2, 1.0]);
    let paint = Paint { normal: Some(Texture::constant(n)), ..lambert(0.6) };
    let flat = HeightMap { height: 2, width: 2, values: vec![0.02; 4] };
    let reference = reference(vec![Part::Solid(Layer { height: flat, paint })], 16);
    let wi = [0.4, 0.3];
    let queries = QueryBuffer::slice(1, 1, wi, [0.1, -0.5], 0.0);
    let got = reference.measure(&queries, &Sampling { spp: 4, seed: 1, first: 0 }).unwrap().rgb.pixels[0][0];
    let wi = unit(wi);
    let lit = |n: [f32; 3]| 0.6 / PI as f32 * (n[0] * wi[0] + n[1] * wi[1] + n[2] * wi[2]);
    // A handful of f32 roundings.
    assert!((got - lit(n)).abs() < 1e-6, "{got} {}", lit(n));
    assert!((got - lit([0.0, 0.0, 1.0])).abs() > 1e-6);
}

#[test]
fn built_in_materials_answer_with_finite_light_and_honest_noise() {
    for name in builtin::NAMES {
        let options = ReferenceOptions { resolution: Some([64; 2]), field_side: 128, ..Default::default() };
        let reference = Reference::open(name, &options).unwrap();
        let [low, high] = reference.height_range();
        assert!(high - low > 0.02 && low > -0.25 && high < 0.25, "{name}: {low} to {high}");
        for (wi, wo) in [([0.0, 0.0], [0.0, 0.0]), ([0.6, 0.3], [-0.5, 0.1]), ([0.99, 0.0], [0.0, -0.99])] {
            let slice = QueryBuffer::slice(16, 16, wi, wo, 2.0);
            let measured = reference.measure(&slice, &Sampling { spp: 8, seed: 2, first: 0 }).unwrap();
            let mean = measured.rgb.pixels.iter().flatten().sum::<f32>() / (3.0 * 256.0);
            // Radiance of a white Lambert plane under this light is at most 1 / pi; a highlight may triple it.
            assert!(mean > 1e-4 && mean < 1.0, "{name}: {mean} under {wi:?}");
            assert!(measured.rgb.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0), "{name}");
            assert!(measured.variance.iter().all(|v| v.is_finite() && *v >= 0.0), "{name}");
            assert!(measured.variance.iter().any(|v| *v > 0.0), "{name}");
            assert!(measured.rays >= 256 * 8);
        }
        let white_light = reference.geometry().sky_radiance(
            [0.3, 0.4],
            [0.0, 0.0, 1.0],
            &mut Random::new(1, Stream::Probe, 0),
        );
        assert!(white_light.iter().all(|v| (0.0..=1.0 + 1e-4).contains(v)), "{name}");
    }
}

#[test]
fn materials_that_cannot_be_are_refused() {
    let refused = |material: Material| {
        let error = Reference::new(material, &ReferenceOptions::default()).unwrap_err().to_string();
        assert!(!error.contains('\n'), "{error}");
        error
    };
    assert!(refused(material(Vec::new())).contains("parts"));
    let fibre = Part::Fibres(fibres(), Vec::new());
    assert!(refused(material(vec![fibre])).contains("look"));
    let layer = Layer { height: rough(4, -0.1, 0.1, 1), paint: lambert(WHITE[0]) };
    let stated = Material { height_range: Some([-0.01, 0.01]), ..material(vec![Part::Solid(layer)]) };
    assert!(refused(stated).contains("height_range"));
}

/// Where a view ray hits, and whether that point is in shadow.
type Answer = (Option<f64>, bool);

/// Hits and shadows of packets of 16 rays over one texel, by an instruction set.
fn packets(map: &HeightMap, isa: Isa) -> Vec<Answer> {
    let tracer = Tracer::with_isa(Heightfield::new(map).unwrap(), isa);
    let high = f64::from(tracer.field().range()[1]);
    let mut found = Vec::new();
    for k in 0..150 {
        let mut random = Random::new(21, Stream::Probe, k);
        let limit = if k % 5 == 0 { 0.999_99 } else { 0.99 };
        let (wi, wo) = (unit(random.disc(limit)).map(f64::from), unit(random.disc(limit)).map(f64::from));
        let p = [0; 2].map(|_| 4.0 * random.uniform_f64() - 2.0);
        let origins: Vec<[f64; 3]> = (0..16)
            .map(|_| {
                let q = p.map(|c| c + random.uniform_f64() / map.width as f64);
                [q[0] + wo[0] / wo[2] * high, q[1] + wo[1] / wo[2] * high, high]
            })
            .collect();
        let (mut hits, mut blocked) = (Vec::new(), Vec::new());
        tracer.intersect_packet(&origins, wo.map(|c| -c), &mut hits);
        let departures: Vec<_> = hits.iter().map(|hit| hit.as_ref().unwrap().departure()).collect();
        tracer.occluded_packet(&departures, wi, &mut blocked);
        for ((hit, blocked), (origin, departure)) in
            hits.iter().zip(&blocked).zip(origins.iter().zip(&departures))
        {
            // One ray alone has the answer that it has among others.
            let (mut alone, mut dark) = (Vec::new(), Vec::new());
            tracer.intersect_packet(&[*origin], wo.map(|c| -c), &mut alone);
            tracer.occluded_packet(&[*departure], wi, &mut dark);
            assert_eq!((&alone[0], dark[0]), (hit, *blocked));
            found.push((hit.map(|hit| hit.t), *blocked));
        }
        for (origin, departure) in origins.iter().zip(&departures) {
            let single = tracer.field().intersect(*origin, wo.map(|c| -c), f64::INFINITY);
            found.push((single.map(|hit| hit.t), tracer.field().occluded(*departure, wi)));
        }
    }
    found
}

#[test]
fn packets_agree_with_single_rays_on_every_instruction_set() {
    // Both solve the same quadratic in f64 from another start; near silhouettes that moves the root.
    const ROOT: f64 = 1e-7;
    for (side, depth) in [(7, 0.2), (33, 0.05), (64, 0.6)] {
        let map = rough(side, -depth, depth, 6);
        let of =
            |map: &HeightMap| -> Vec<_> { Isa::all().into_iter().map(|isa| packets(map, isa)).collect() };
        let all = of(&map);
        assert!(all.iter().all(|found| *found == all[0]), "instruction sets differ");
        let differing = |found: &[Answer]| {
            let pairs = found.chunks_exact(32).flat_map(|group| group[..16].iter().zip(&group[16..]));
            let differ = |(a, b): &(&Answer, &Answer)| match (a.0, b.0) {
                (Some(s), Some(t)) => (s - t).abs() > ROOT || a.1 != b.1,
                (a, b) => a != b,
            };
            pairs.filter(differ).count()
        };
        assert!(differing(&all[0]) <= 2, "{side}: {} of 2400", differing(&all[0]));
        let mut other = map.clone();
        other.values.iter_mut().for_each(|z| *z *= 0.999);
        let mixed: Vec<_> = all[0]
            .chunks_exact(32)
            .zip(packets(&other, Isa::all()[0]).chunks_exact(32))
            .flat_map(|(ours, theirs)| [&ours[..16], &theirs[16..]].concat())
            .collect();
        assert!(differing(&mixed) > 100, "a thousandth of the height must show");
    }
}
