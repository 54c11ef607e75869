//! Hits against brute force, watertightness, repetition, self-hits, bad input.

mod input;

use super::*;
use crate::random::{Random, Stream};
use crate::reference::raycast::SURFACE_OFFSET;

/// What rounding in f64 leaves of a distance where both sides see the same geometry: 1e-16 times distances to 10,
/// through squares of radii near 1e-2.
const ROUNDING: f64 = 1e-9;

/// What the grid of coordinates may move a hit by on a surface that does not graze the ray.
const SNAPPING: f64 = 1e-6;

/// Coordinates on this grid are kept as they are.
const EXACT: f64 = 1.0 / 1_048_576.0;

const SEED: u64 = 5;

fn random(item: usize) -> Random {
    Random::new(SEED, Stream::Probe, item as u64)
}

fn between(random: &mut Random, low: f64, high: f64) -> f64 {
    ((low + (high - low) * random.uniform_f64()) / EXACT).round() * EXACT
}

fn add(a: [f64; 3], s: f64, b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|c| a[c] + s * b[c])
}

/// Unit vectors over the sphere; every fourth is nearly level, every eighth along an axis.
fn direction(random: &mut Random, k: usize) -> [f64; 3] {
    if k.is_multiple_of(8) {
        let mut d = [0.0; 3];
        d[random.below(3)] = if random.below(2) == 0 { 1.0 } else { -1.0 };
        return d;
    }
    let (z, a) = (2.0 * random.uniform_f64() - 1.0, std::f64::consts::TAU * random.uniform_f64());
    let z = if k.is_multiple_of(4) { 0.01 * z } else { z };
    let s = (1.0 - z * z).sqrt();
    [s * a.cos(), s * a.sin(), z]
}

/// Curves that wander, leave the tile and come from far away; the last repeats with the tile.
fn some_curves() -> Vec<Curve> {
    let mut curves: Vec<Curve> = (0..12)
        .map(|k| {
            let mut random = random(k);
            let low = if k < 8 { -0.5 } else { 3.0 };
            let mut p = [0; 2].map(|_| between(&mut random, low, low + 2.0));
            let points = (0..6).map(|_| {
                p = p.map(|x| x + between(&mut random, -0.3, 0.3));
                [p[0], p[1], between(&mut random, -0.2, 0.2)]
            });
            Curve { points: points.collect(), radius: between(&mut random, 0.004, 0.03), look: k as u32 }
        })
        .collect();
    curves[0].points = vec![[-1.25, 0.5, 0.0], [2.5, 0.75, 0.125]];
    let ends = [[0.25, 0.5, 0.0], [0.75, 0.625, 0.125], [1.25, 1.5, 0.0]];
    curves.push(Curve { points: ends.to_vec(), radius: 1.0 / 64.0, look: 12 });
    curves
}

/// Triangles of all sizes, some beyond the tile.
fn some_triangles() -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    for k in 0..40 {
        let mut random = random(100 + k);
        let size = if k % 10 == 0 { 1.5 } else { 0.2 };
        let centre = [0; 3].map(|_| between(&mut random, -0.4, 1.4));
        for _ in 0..3 {
            let [x, y, _] = centre.map(|c| c + between(&mut random, -size, size));
            mesh.positions.push([x, y, between(&mut random, -0.2, 0.2)]);
        }
        let first = 3 * k as u32;
        mesh.triangles.push([first, first + 1, first + 2]);
    }
    mesh
}

/// Tiles around the ray that brute force looks at; rays go as far as they reach with the farthest curves.
const TILES: i32 = 9;
const REACH: f64 = 3.0;

fn moved(point: [f64; 3], x: i32, y: i32) -> [f64; 3] {
    add(point, 1.0, [f64::from(x), f64::from(y), 0.0])
}

fn tiles() -> impl Iterator<Item = (i32, i32)> {
    (-TILES..=TILES).flat_map(|y| (-TILES..=TILES).map(move |x| (x, y)))
}

/// Distance of a point from a segment.
fn distance(x: [f64; 3], [p, q]: [[f64; 3]; 2]) -> f64 {
    let axis = sub(q, p);
    let s = (dot(sub(x, p), axis) / dot(axis, axis)).clamp(0.0, 1.0);
    let off = sub(x, add(p, s, axis));
    dot(off, off).sqrt()
}

/// Where the ray comes within `radius` of the segment: marching by the distance itself, which no formula shares.
fn march(ends: [[f64; 3]; 2], radius: f64, origin: [f64; 3], d: [f64; 3]) -> Option<f64> {
    let middle = add(ends[0], 0.5, sub(ends[1], ends[0]));
    let (reach, along) = (distance(middle, [ends[0], ends[0]]) + radius, dot(sub(middle, origin), d));
    if distance(middle, [origin, add(origin, REACH, d)]) > reach || along + reach < 0.0 {
        return None;
    }
    let mut t = (along - reach).max(0.0);
    while t <= REACH {
        let gap = distance(add(origin, t, d), ends) - radius;
        if gap < ROUNDING * 1e-3 {
            return Some(t);
        }
        t += gap;
    }
    None
}

fn march_all(curves: &[Curve], origin: [f64; 3], d: [f64; 3]) -> Option<f64> {
    let pieces = curves.iter().flat_map(|c| c.points.windows(2).map(|ends| ([ends[0], ends[1]], c.radius)));
    pieces
        .flat_map(|(ends, radius)| {
            tiles().filter_map(move |(x, y)| march(ends.map(|p| moved(p, x, y)), radius, origin, d))
        })
        .min_by(f64::total_cmp)
}

/// Moeller and Trumbore's test, over all copies.
fn cut_all(mesh: &TriangleMesh, origin: [f64; 3], d: [f64; 3]) -> Option<f64> {
    let corners = mesh.triangles.iter().map(|t| t.map(|k| mesh.positions[k as usize]));
    let cut = |[a, b, c]: [[f64; 3]; 3]| {
        let (e, f) = (sub(b, a), sub(c, a));
        let p = cross(d, f);
        let w = sub(origin, a);
        let (u, q) = (dot(w, p) / dot(e, p), cross(w, e));
        let (v, t) = (dot(d, q) / dot(e, p), dot(f, q) / dot(e, p));
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && (0.0..=REACH).contains(&t)).then_some(t)
    };
    corners
        .flat_map(|t| tiles().filter_map(move |(x, y)| cut(t.map(|p| moved(p, x, y)))))
        .min_by(f64::total_cmp)
}

/// Rays on which the two sides disagree, of `rays`.
fn disagreements(
    rays: &[([f64; 3], [f64; 3])],
    ours: impl Fn([f64; 3], [f64; 3]) -> Option<f64>,
    theirs: impl Fn([f64; 3], [f64; 3]) -> Option<f64>,
) -> usize {
    let differs = |&&(o, d): &&([f64; 3], [f64; 3])| match (ours(o, d), theirs(o, d)) {
        (None, None) => false,
        (Some(a), Some(b)) => (a - b).abs() > ROUNDING,
        _ => true,
    };
    rays.iter().filter(differs).count()
}

fn some_rays(count: usize, clear: impl Fn([f64; 3]) -> bool) -> Vec<([f64; 3], [f64; 3])> {
    let ray = |k| {
        let mut random = random(1000 + k);
        let origin = [(-2.0, 3.0), (-2.0, 3.0), (-0.25, 0.3)].map(|(a, b)| between(&mut random, a, b));
        (origin, direction(&mut random, k))
    };
    (0..count).map(ray).filter(|(origin, _)| clear(*origin)).collect()
}

#[test]
fn curves_are_hit_where_brute_force_says() {
    let mut data = some_curves();
    let inside = |x| {
        data.iter().any(|c| {
            c.points.windows(2).any(|ends| {
                tiles().any(|(i, j)| distance(x, [moved(ends[0], i, j), moved(ends[1], i, j)]) < c.radius)
            })
        })
    };
    let rays = some_rays(300, |x| !inside(x));
    let curves = Curves::new(&data).unwrap();
    let ours = |o, d| curves.intersect(o, d, REACH).map(|hit| hit.t);
    let hits = rays.iter().filter(|(o, d)| ours(*o, *d).is_some()).count();
    assert!(hits > rays.len() / 3 && hits < rays.len(), "{hits} of {}", rays.len());
    assert_eq!(disagreements(&rays, ours, |o, d| march_all(&data, o, d)), 0);
    // The twin: a thousandth of a radius more.
    for curve in &mut data {
        curve.radius *= 1.001;
    }
    assert!(disagreements(&rays, ours, |o, d| march_all(&data, o, d)) > hits / 2);
}

#[test]
fn triangles_are_hit_where_brute_force_says() {
    let mut mesh = some_triangles();
    let rays = some_rays(400, |_| true);
    let triangles = Triangles::new(mesh.clone()).unwrap();
    let ours = |o, d| triangles.intersect(o, d, REACH).map(|hit| hit.t);
    let hits = rays.iter().filter(|(o, d)| ours(*o, *d).is_some()).count();
    assert!(hits > rays.len() / 2 && hits < rays.len(), "{hits} of {}", rays.len());
    assert_eq!(disagreements(&rays, ours, |o, d| cut_all(&mesh, o, d)), 0);
    for position in &mut mesh.positions {
        position[2] += 1e-6;
    }
    assert!(disagreements(&rays, ours, |o, d| cut_all(&mesh, o, d)) > hits / 2);
}

#[test]
fn occlusion_agrees_with_hits() {
    let (curves, mesh) = (Curves::new(&some_curves()).unwrap(), Triangles::new(some_triangles()).unwrap());
    let (mut hits, mut misses) = (0, 0);
    for (o, d) in some_rays(4000, |_| true) {
        let (a, b) = (curves.intersect(o, d, f64::INFINITY), mesh.intersect(o, d, f64::INFINITY));
        assert_eq!(a.is_some(), curves.occluded(o, d));
        assert_eq!(b.is_some(), mesh.occluded(o, d));
        for hit in [a.is_some(), b.is_some()] {
            if hit { hits += 1 } else { misses += 1 }
        }
        // A limit just behind the hit changes nothing, one before it takes it away, and t counts in lengths of d.
        let Some(a) = a else { continue };
        assert_eq!(curves.intersect(o, d, a.t + ROUNDING).map(|hit| hit.t), Some(a.t));
        assert!(curves.intersect(o, d, a.t - ROUNDING).is_none());
        let double = curves.intersect(o, d.map(|x| 2.0 * x), f64::INFINITY).unwrap();
        assert!((2.0 * double.t - a.t).abs() < ROUNDING);
    }
    assert!(hits > 500 && misses > 500);
}

/// A closed displaced grid over the tile, `n` a side.
fn sheet(n: u32, height: f64) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let z = |k: u32| ((height * (random((k + 7) as usize).uniform_f64() - 0.5)) / EXACT).round() * EXACT;
    for (y, x) in (0..=n).flat_map(|y| (0..=n).map(move |x| (y, x))) {
        let at = |k: u32| f64::from(k) / f64::from(n);
        mesh.positions.push([at(x), at(y), z((y % n) * n + x % n)]);
    }
    for (y, x) in (0..n).flat_map(|y| (0..n).map(move |x| (y, x))) {
        let (a, b) = (y * (n + 1) + x, (y + 1) * (n + 1) + x);
        mesh.triangles.extend([[a, a + 1, b], [a + 1, b + 1, b]]);
    }
    mesh
}

/// Rays from above exactly through corners and points on edges of the sheet that fall through it.
fn leaks(triangles: &Triangles, mesh: &TriangleMesh) -> usize {
    let count = mesh.triangles.len();
    let through = (0..6 * count).filter(|k| {
        let corners = mesh.triangles[k % count].map(|corner| mesh.positions[corner as usize]);
        let mut random = random(*k);
        let (a, b) = (corners[k % 3], corners[(k + 1) % 3]);
        let target = if k / count < 2 { a } else { add(a, random.uniform_f64(), sub(b, a)) };
        let mut d = direction(&mut random, 8 * usize::from(k / count == 0) + 1);
        d[2] = -d[2].abs().max(1e-3);
        if k / count == 5 {
            d = [0.0, 0.0, -1.0];
        }
        triangles.intersect(add(target, -2.0 / -d[2], d), d, f64::INFINITY).is_none()
    });
    through.count()
}

#[test]
fn nothing_falls_through_a_closed_sheet() {
    // 48 is no power of two: corners lie on no round coordinate.
    for n in [48, 32] {
        let mut mesh = sheet(n, 0.05);
        let closed = Triangles::new(mesh.clone()).unwrap();
        assert_eq!(leaks(&closed, &mesh), 0);
        let gone = mesh.triangles.swap_remove(7);
        let open = Triangles::new(mesh.clone()).unwrap();
        mesh.triangles.push(gone);
        assert!(leaks(&open, &mesh) > 0);
    }
}

#[test]
fn shifted_geometry_gives_shifted_hits() {
    let by = [0.5, 0.5, 0.0];
    let mut data = some_curves();
    let mut mesh = some_triangles();
    let (curves, triangles) = (Curves::new(&data).unwrap(), Triangles::new(mesh.clone()).unwrap());
    data.iter_mut().flat_map(|c| &mut c.points).for_each(|p| *p = add(*p, 1.0, by));
    mesh.positions.iter_mut().for_each(|p| *p = add(*p, 1.0, by));
    let (later_curves, later_triangles) = (Curves::new(&data).unwrap(), Triangles::new(mesh).unwrap());
    let mut hits = 0;
    for (o, d) in some_rays(2000, |_| true) {
        let a = curves.intersect(o, d, f64::INFINITY).map(|hit| (hit.t, hit.normal));
        let b = later_curves.intersect(add(o, 1.0, by), d, f64::INFINITY).map(|hit| (hit.t, hit.normal));
        let c = triangles.intersect(o, d, f64::INFINITY).map(|hit| (hit.t, hit.normal));
        let e = later_triangles.intersect(add(o, 1.0, by), d, f64::INFINITY).map(|hit| (hit.t, hit.normal));
        for (a, b) in [(a, b), (c, e)] {
            assert_eq!(a.is_some(), b.is_some());
            let (Some((t, n)), Some((s, m))) = (a, b) else { continue };
            // Far away rays are less exact.
            assert!((t - s).abs() < ROUNDING * (1.0 + t), "{t} {s}");
            assert!(dot(n, m) > 1.0 - SNAPPING);
            hits += 1;
        }
    }
    assert!(hits > 1000);
    // The twin: another shift.
    let o = [0.3, 0.4, 0.4];
    let down = [0.1, 0.2, -1.0];
    let (a, b) = (triangles.intersect(o, down, 9.0), later_triangles.intersect(o, down, 9.0));
    assert!(a.map(|hit| hit.t) != b.map(|hit| hit.t));
}

/// A fibre along x in many short pieces; `bend` is the height of its wave.
fn fibre(bend: f64) -> Vec<Curve> {
    let at = |k: i32| {
        let s = f64::from(k) / 100.0;
        [s, 0.5, bend * (std::f64::consts::TAU * s).sin()]
    };
    vec![Curve { points: (0..=100).map(at).collect(), radius: 0.02, look: 3 }]
}

#[test]
fn light_leaves_a_fibre_through_it_and_outward() {
    let curves = Curves::new(&fibre(0.0)).unwrap();
    let (mut outside, mut rays) = (0, 0);
    for k in 0..4000 {
        let mut random = random(k);
        let origin = [random.uniform_f64(), 0.5 + 0.03 * (random.uniform_f64() - 0.5), 0.3];
        let d = [0.3 * random.uniform_f64(), 0.0, -1.0];
        let Some(hit) = curves.intersect(origin, d, f64::INFINITY) else { continue };
        let w = direction(&mut random, k);
        rays += 1;
        // Until the copy in the next tile nothing is in the way.
        assert!(curves.intersect(hit.departure(), w, 0.9).is_none(), "{hit:?} {w:?}");
        // The twin: from outside inward there is.
        let start = add(hit.position, 1e-6, hit.normal);
        outside += usize::from(dot(w, hit.normal) < -1e-2 && curves.intersect(start, w, 0.9).is_some());
    }
    assert!(rays > 3000 && outside > rays / 3, "{rays} {outside}");
}

#[test]
fn a_bent_fibre_shades_smoothly_and_does_not_shadow_its_convex_side() {
    let curves = Curves::new(&fibre(0.1)).unwrap();
    let mut last: Option<CurveHit> = None;
    let mut steepest: f64 = 0.0;
    for k in 0..=4000 {
        let x = f64::from(k) / 4000.0 + 1e-7;
        let hit = curves.intersect([x, 0.507, 0.5], [0.0, 0.0, -1.0], 9.0).unwrap();
        assert!((dot(hit.normal, hit.normal) - 1.0).abs() < ROUNDING);
        assert!(dot(hit.normal, hit.tangent).abs() < ROUNDING);
        assert!(hit.normal[2] > 0.0 && hit.tangent[0] > 0.0 && hit.look == 3);
        if let Some(last) = last.replace(hit) {
            steepest =
                steepest.max(dot(sub(last.tangent, hit.tangent), sub(last.tangent, hit.tangent)).sqrt());
        }
        // The first half bends away from its upper side.
        if (0.05..0.45).contains(&x) {
            let mut random = random(k as usize);
            let w = direction(&mut random, 1);
            let up = dot(w, hit.normal);
            if up > 0.0 && w[2] > 0.0 {
                let again = curves.intersect(hit.departure(), w, 0.3);
                assert!(again.is_none(), "{hit:?} {w:?} {again:?}");
            }
        }
    }
    // A wave of 0.1 turns by 4 pi^2 0.1 a tile width; its 100 pieces would turn by 4e-2 at once.
    assert!(steepest < 2e-3, "{steepest}");
    let (first, end) = ([1e-6, 0.5, 0.5], [1.0 - 1e-6, 0.5, 0.5]);
    let [a, b] = [first, end].map(|o| curves.intersect(o, [0.0, 0.0, -1.0], 9.0).unwrap().tangent);
    assert!(dot(a, b) > 1.0 - SNAPPING, "{a:?} {b:?}");
}

#[test]
fn rays_leave_a_mesh_without_meeting_it_again() {
    let triangles = Triangles::new(sheet(40, 0.03)).unwrap();
    let mut back = 0;
    for k in 0..4000 {
        let mut random = random(k);
        let origin = [300.0 * random.uniform_f64(), random.uniform_f64(), 0.1];
        let d = direction(&mut random, k);
        let Some(hit) = triangles.intersect(origin, [d[0], d[1], -d[2].abs()], f64::INFINITY) else {
            continue;
        };
        let mut w = direction(&mut random, 4 * (k % 2) + 1);
        if dot(w, hit.normal) < 0.0 {
            w = w.map(|x| -x);
        }
        let near = 100.0 * SURFACE_OFFSET;
        assert!(triangles.intersect(hit.departure(), w, near).is_none());
        let below = add(hit.position, -SURFACE_OFFSET, hit.normal);
        back += usize::from(triangles.intersect(below, w, near).is_some());
    }
    assert!(back > 2000, "{back}");
}

#[test]
fn hits_are_described() {
    let mut mesh = TriangleMesh {
        positions: vec![[0.0, 0.0, 0.1], [1.0, 0.0, 0.1], [1.0, 1.0, 0.1], [0.0, 1.0, 0.1]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        normals: None,
        uv: None,
    };
    let (o, d) = ([2.25, -0.5, 0.6], [0.0, 0.0, -1.0]);
    let hit = Triangles::new(mesh.clone()).unwrap().intersect(o, d, 9.0).unwrap();
    assert!((hit.t - 0.5).abs() < SNAPPING && (hit.position[0] - 2.25).abs() < SNAPPING);
    assert_eq!((hit.normal, hit.shading_normal), ([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]));
    assert!((hit.uv[0] - 0.25).abs() < ROUNDING && (hit.uv[1] - 0.5).abs() < ROUNDING);
    mesh.normals = Some(vec![[0.1, 0.0, -1.0]; 4]);
    mesh.uv = Some(vec![[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]);
    let triangles = Triangles::new(mesh).unwrap();
    let above = triangles.intersect(o, d, 9.0).unwrap();
    assert!(above.shading_normal[2] > 0.9 && above.shading_normal[0] < -0.09);
    assert!((above.uv[0] - 0.5).abs() < ROUNDING && (above.uv[1] - 1.0).abs() < ROUNDING);
    let below = triangles.intersect([2.25, -0.5, 0.0], [0.0, 0.0, 1.0], 9.0).unwrap();
    assert_eq!(below.normal, [0.0, 0.0, -1.0]);
    assert!(below.shading_normal[2] < -0.9);

    let curves = Curves::new(&fibre(0.0)).unwrap();
    let range = curves.range();
    assert!((range[0] + 0.02).abs() < SNAPPING && (range[1] - 0.02).abs() < SNAPPING);
    let hit = curves.intersect([-3.5, 7.5, 1.0], d, 9.0).unwrap();
    assert!((hit.t - 0.98).abs() < SNAPPING && (hit.radius - 0.02).abs() < SNAPPING);
    assert!(
        dot(hit.normal, [0.0, 0.0, 1.0]) > 1.0 - SNAPPING
            && dot(hit.tangent, [1.0, 0.0, 0.0]) > 1.0 - SNAPPING
    );
    // The round end of an open curve, met along its axis.
    let stub = vec![Curve { points: vec![[0.4, 0.5, 0.0], [0.6, 0.5, 0.0]], radius: 0.05, look: 0 }];
    let hit = Curves::new(&stub).unwrap().intersect([0.0, 0.5, 0.0], [1.0, 0.0, 0.0], 1.0).unwrap();
    assert!((hit.t - 0.35).abs() < SNAPPING);
    assert!(dot(hit.normal, hit.tangent).abs() < ROUNDING && dot(hit.normal, hit.normal) > 1.0 - ROUNDING);
    assert!(hit.departure()[0] > hit.position[0]);
}

#[test]
fn threads_do_not_change_anything() {
    let build = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let curves = Curves::new(&some_curves()).unwrap();
            format!("{curves:?} {:?}", Triangles::new(sheet(16, 0.1)).unwrap())
        })
    };
    assert_eq!(build(1), build(5));
}
