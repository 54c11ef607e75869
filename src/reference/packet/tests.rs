//! Packets against the walk of one ray.

use super::*;
use crate::random::{Random, Stream};
use crate::reference::heightfield::HeightMap;

/// Two distances are the same: roundings of f64 in other places, over up to thousands of tiles.
const SAME: f64 = 1e-9;

/// Share of rays that may differ: those that touch a corner of a patch which they cross within the rounding of f32.
/// Among eight million rays on four fields there was none.
const LOST: f64 = 1e-4;

fn field(height: usize, width: usize, value: impl FnMut(usize) -> f32) -> Heightfield {
    let values = (0..height * width).map(value).collect();
    Heightfield::new(&HeightMap { height, width, values }).unwrap()
}

fn noise(height: usize, width: usize, range: f32) -> Heightfield {
    let mut random = Random::new(5, Stream::Probe, width as u64);
    field(height, width, |_| range * (random.uniform() - 0.5))
}

fn waves(height: usize, width: usize, range: f32) -> Heightfield {
    field(height, width, |k| {
        let turns = |k: usize, n: usize, waves: f32| waves * std::f32::consts::TAU * k as f32 / n as f32;
        0.25 * range * (turns(k % width, width, 5.0).sin() + turns(k / width, height, 7.0).cos())
    })
}

/// Rough, steep, smooth, tiny, long and large fields, sides odd and even.
fn fields() -> Vec<Heightfield> {
    vec![
        noise(33, 47, 0.05),
        noise(5, 9, 1.9),
        waves(96, 61, 0.1),
        noise(2, 2, 0.5),
        noise(3, 130, 0.02),
        waves(700, 513, 0.2),
    ]
}

fn unit([x, y, z]: [f64; 3]) -> [f64; 3] {
    let scale = 1.0 / (x * x + y * y + z * z).sqrt();
    [x * scale, y * scale, z * scale]
}

/// A direction above the horizon: uniform in the projected disc, grazing, along an axis, or straight up.
fn upward(random: &mut Random, kind: usize) -> [f64; 3] {
    let [x, y] = random.disc(0.99).map(f64::from);
    match kind % 4 {
        0 | 1 => [x, y, (1.0 - x * x - y * y).sqrt()],
        2 => unit([x, y, 0.03 * random.uniform_f64() + 1e-4]),
        _ => [[0.0, 0.0, 1.0], [0.0, 0.6, 0.8], [-0.8, 0.0, 0.6], [1e-9, -1e-7, 1.0]][random.below(4)],
    }
}

/// Rays of one direction.
struct Packet {
    origins: Vec<[f64; 3]>,
    direction: [f64; 3],
}

/// View rays over small and large footprints on any copy of the tile.
fn views(field: &Heightfield, count: usize) -> Vec<Packet> {
    let high = field.high;
    let packet = |index: usize| {
        let mut random = Random::new(6, Stream::Probe, index as u64);
        let wo = upward(&mut random, index);
        let size = [1.0 / field.width as f64, 0.3][random.below(2)];
        let copy = [0.0, 37.0, -12.0][random.below(3)];
        let corner = [copy + random.uniform_f64(), random.uniform_f64() - copy];
        let climb = (high + [0.0, 0.5][random.below(2)]) / wo[2];
        let origins = (0..1 + random.below(40)).map(|_| {
            let [x, y] = corner.map(|c| c + size * random.uniform_f64());
            [x + wo[0] * climb, y + wo[1] * climb, wo[2] * climb]
        });
        Packet { origins: origins.collect(), direction: wo.map(|c| -c) }
    };
    (0..count).map(packet).collect()
}

/// Rays to a light from where view rays end.
fn shadows(field: &Heightfield, views: &[Packet]) -> Vec<Packet> {
    let packet = |(index, view): (usize, &Packet)| {
        let mut random = Random::new(7, Stream::Probe, index as u64);
        let hits = view.origins.iter().filter_map(|o| field.intersect(*o, view.direction, f64::INFINITY));
        let origins = hits.map(|hit| hit.departure()).collect();
        Packet { origins, direction: upward(&mut random, index / 4) }
    };
    views.iter().enumerate().map(packet).collect()
}

/// Shares of rays for which the tracer and the walk of one ray over `field` differ: views, then shadows.
fn differing(tracer: &Tracer, field: &Heightfield, count: usize) -> [f64; 2] {
    let views = views(field, count);
    let (mut hits, mut blocked) = (Vec::new(), Vec::new());
    let (mut rays, mut lost) = ([0; 2], [0; 2]);
    for Packet { origins, direction } in &views {
        tracer.intersect_packet(origins, *direction, &mut hits);
        assert_eq!(hits.len(), origins.len());
        rays[0] += origins.len();
        for (origin, hit) in origins.iter().zip(&hits) {
            let same = match (field.intersect(*origin, *direction, f64::INFINITY), hit) {
                (Some(a), Some(b)) => {
                    (a.t - b.t).abs() < SAME && (0..3).all(|c| (a.normal[c] - b.normal[c]).abs() < 1e-6)
                }
                (a, b) => a.is_none() && b.is_none(),
            };
            lost[0] += usize::from(!same);
        }
    }
    for Packet { origins, direction } in &shadows(field, &views) {
        tracer.occluded_packet(origins, *direction, &mut blocked);
        rays[1] += origins.len();
        let expected = origins.iter().map(|origin| field.occluded(*origin, *direction));
        lost[1] += expected.zip(&blocked).filter(|(a, b)| a != *b).count();
    }
    [0, 1].map(|k| lost[k] as f64 / rays[k] as f64)
}

#[test]
fn packets_find_what_single_rays_find() {
    for field in fields() {
        let size = (field.height, field.width);
        let tracer = Tracer::new(field.clone()).unwrap();
        let shares = differing(&tracer, &field, 200);
        assert!(shares.iter().all(|share| *share < LOST), "{size:?} {shares:?}");
    }
}

#[test]
fn a_surface_raised_by_a_millionth_is_another() {
    let field = waves(96, 61, 0.1);
    let mut map = field.height_map();
    for height in &mut map.values {
        *height += 1e-6;
    }
    let raised = Tracer::new(Heightfield::new(&map).unwrap()).unwrap();
    let [views, _] = differing(&raised, &field, 50);
    assert!(views > 0.9, "{views}");
    for height in &mut map.values {
        *height *= 1.5;
    }
    let steeper = Tracer::new(Heightfield::new(&map).unwrap()).unwrap();
    let [_, shadows] = differing(&steeper, &field, 50);
    assert!(shadows > 0.01, "{shadows}");
}

/// All bits of all answers to rays of their own directions, in chunks of the size.
fn answers(tracer: &Tracer, rays: &[Ray], chunk: usize) -> Vec<u64> {
    let (mut hits, mut blocked, mut all) = (Vec::new(), Vec::new(), Vec::new());
    for rays in rays.chunks(chunk) {
        tracer.intersect_many(rays, &mut hits);
        tracer.occluded_many(rays, &mut blocked);
        for (hit, blocked) in hits.iter().zip(&blocked) {
            let hit = hit.map_or([f64::INFINITY; 7], |h| {
                let ([x, y, z], [a, b, c]) = (h.position, h.normal);
                [h.t, x, y, z, a, b, c]
            });
            all.extend(hit.map(f64::to_bits));
            all.push(u64::from(*blocked));
        }
    }
    all
}

#[test]
fn answers_depend_neither_on_the_instruction_set_nor_on_the_company() {
    for field in fields() {
        let views = views(&field, 40);
        let shadows = shadows(&field, &views);
        let packets = views.iter().chain(&shadows);
        let rays: Vec<Ray> = packets.flat_map(|p| p.origins.iter().map(|o| (*o, p.direction))).collect();
        let want = answers(&Tracer::new(field.clone()).unwrap(), &rays, usize::MAX);
        for isa in Isa::all() {
            let tracer = Tracer::with_isa(field.clone(), isa);
            for chunk in [1, 7, 16, 37] {
                assert!(answers(&tracer, &rays, chunk) == want, "{} {chunk}", isa.name());
            }
            let order = Random::new(8, Stream::Probe, 0).permutation(rays.len());
            let shuffled: Vec<Ray> = order.iter().map(|&k| rays[k as usize]).collect();
            let got = answers(&tracer, &shuffled, 100);
            let same = |at: usize, k: u32| got[at * 8..][..8] == want[k as usize * 8..][..8];
            assert!(order.iter().enumerate().all(|(at, &k)| same(at, k)), "{}", isa.name());

            let mut moved = rays.clone();
            moved[rays.len() / 3].0[0] += 1e-12;
            assert!(answers(&tracer, &moved, 16) != want, "{}", isa.name());
        }
    }
}

#[test]
fn rays_on_borders_of_patches_fall_through_nowhere() {
    let (height, width) = (700, 513);
    let field = waves(height, width, 0.2);
    let tracer = Tracer::new(field.clone()).unwrap();
    let mut random = Random::new(9, Stream::Probe, 0);
    // Single precision takes each of these for a place on the border, or across it.
    for steps in [0.0, 1e-13, 1e-9, 1e-6, 3e-5] {
        for direction in [[0.0, 0.0, -1.0], [1e-12, -1e-12, -1.0], [1e-5, 2e-6, -1.0], [-1e-4, 0.0, -1.0]] {
            let origins: Vec<_> = (0..64)
                .map(|k| {
                    let side = if k % 2 == 0 { steps } else { -steps };
                    let x = (random.below(width) as f64 + 0.5 + side) / width as f64;
                    [x, (random.below(height) as f64 + 0.5 - side) / height as f64, 0.3]
                })
                .collect();
            let mut hits = Vec::new();
            tracer.intersect_packet(&origins, direction, &mut hits);
            for (origin, hit) in origins.iter().zip(hits) {
                let want = field.intersect(*origin, direction, f64::INFINITY).unwrap();
                let hit = hit.expect("a ray that falls on a solid surface meets it");
                assert!((hit.t - want.t).abs() < SAME, "{steps} {direction:?} {origin:?}");
            }
        }
    }
}

#[test]
fn points_beside_borders_of_patches_are_met_where_they_are() {
    for field in [waves(700, 513, 0.2), noise(700, 513, 0.01), waves(256, 512, 0.2)] {
        let (height, width) = (field.height, field.width);
        let tracer = Tracer::new(field.clone()).unwrap();
        let mut random = Random::new(10, Stream::Probe, 0);
        let mut hits = Vec::new();
        for k in 0..60 {
            let wo = upward(&mut random, k % 3);
            let origins: Vec<_> = (0..32)
                .map(|_| {
                    let beside = 1e-5 * (random.uniform_f64() - 0.5);
                    // Half of them are borders of the tile.
                    let (row, column) = (random.below(height), random.below(width) * random.below(2));
                    let x = (column as f64 + 0.5 + beside) / width as f64;
                    let y = (row as f64 + 0.5 + random.uniform_f64()) / height as f64;
                    let climb = (0.11 - field.height_at(x, y)) / wo[2];
                    [x + climb * wo[0], y + climb * wo[1], 0.11]
                })
                .collect();
            let direction = wo.map(|c| -c);
            tracer.intersect_packet(&origins, direction, &mut hits);
            for (origin, hit) in origins.iter().zip(&hits) {
                let want = field.intersect(*origin, direction, f64::INFINITY).unwrap();
                let t = hit.as_ref().map(|hit| hit.t).unwrap();
                assert!((t - want.t).abs() < SAME, "{wo:?} {origin:?} {t} {want:?}");
            }
        }
    }
}

#[test]
fn a_flat_surface_casts_no_shadow_on_itself_and_a_wall_does() {
    let mut values = vec![0.1; 64 * 64];
    for wall in [false, true] {
        if wall {
            values[0] = 0.4;
        }
        let tracer = Tracer::new(field(64, 64, |k| values[k])).unwrap();
        // So low that single precision does not see it rise.
        let light = unit([0.3, 0.2, 1e-7]);
        let (mut hits, mut blocked, mut count) = (Vec::new(), Vec::new(), 0);
        for packet in views(tracer.field(), 60) {
            tracer.intersect_packet(&packet.origins, packet.direction, &mut hits);
            let departures: Vec<_> = hits.iter().flatten().map(Hit::departure).collect();
            assert_eq!(departures.len(), packet.origins.len());
            tracer.occluded_packet(&departures, light, &mut blocked);
            count += blocked.iter().filter(|blocked| **blocked).count();
        }
        assert_eq!(count > 0, wall);
    }
}

#[test]
fn rays_that_are_none_meet_nothing_and_end() {
    let tracer = Tracer::new(noise(33, 47, 0.05)).unwrap();
    let bad = [f64::NAN, f64::INFINITY, -f64::INFINITY, 1e300, -1e300];
    let (fine, down) = ([0.3, 0.4, 0.5], [0.1, 0.2, -0.9]);
    let mut rays: Vec<Ray> = vec![(fine, [0.0; 3]), ([0.3, 0.4, -0.2], [0.0; 3])];
    for value in bad {
        for c in 0..3 {
            let (mut origin, mut direction) = (fine, down);
            origin[c] = value;
            direction[c] = value;
            rays.extend([(origin, down), (fine, direction), (origin, direction)]);
        }
    }
    let (mut hits, mut blocked) = (Vec::new(), Vec::new());
    tracer.intersect_many(&rays, &mut hits);
    tracer.occluded_many(&rays, &mut blocked);
    let met: Vec<usize> = (0..rays.len()).filter(|k| hits[*k].is_some()).collect();
    // Only the second is inside the solid.
    assert_eq!(met, [1]);
    assert_eq!(blocked.iter().filter(|blocked| **blocked).count(), 1);

    tracer.intersect_packet(&[], down, &mut hits);
    tracer.occluded_packet(&[], down, &mut blocked);
    assert!(hits.is_empty() && blocked.is_empty());
    tracer.intersect_packet(&[fine], down, &mut hits);
    assert!(hits[0].is_some());
}
