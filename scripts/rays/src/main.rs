//! Rays a second on one heightfield, one thread, in interleaved rounds: neumip's rays in packets and one at a time, parry's
//! heightfield and, given a Python that has it, Mitsuba 3 in its variant scalar_rgb.
//!
//! Bare rays: 16 view rays over a texel share a direction, and so do the 16 shadow rays from their hits. Answers: the same
//! with Lambert shading, a picture under one light. All rays stay inside one tile, since parry's field does not repeat.

use neumip::query::{QueryBuffer, unit};
use neumip::random::{Random, Stream};
use neumip::reference::packet::Tracer;
use neumip::reference::{
    HeightMap, Heightfield, Layer, Material, Paint, Part, Reference, ReferenceOptions, Sampling, builtin,
};
use parry3d::math::{Vec3, Vector};
use parry3d::query::{Ray, RayCast};
use parry3d::shape::HeightField;
use parry3d::utils::Array2;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Command, Stdio};
use std::time::Instant;

/// Texels a side of the field, groups of rays, rays a group, rounds.
const SIDE: usize = 1024;
const GROUPS: usize = 8192;
const RAYS: usize = 16;
const ROUNDS: usize = 7;
/// Pixels a side of the picture, which shows this part of the tile around its middle.
const PICTURE: usize = 256;
const SHOWN: f32 = 0.4;
/// The picture's light and viewer.
const WI: [f32; 2] = [0.5, 0.2];
const WO: [f32; 2] = [-0.3, 0.4];

/// Rays of one view and one light direction.
struct Group {
    origins: Vec<[f64; 3]>,
    down: [f64; 3],
    to_light: [f64; 3],
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().unwrap_or_else(|| "rocks".into());
    let python = arguments.next();
    // SAFETY: no other thread runs yet.
    unsafe { std::env::set_var("RAYON_NUM_THREADS", "1") };
    let material = builtin::make(&name, SIDE, 0)?;
    let Some(Part::Solid(layer)) = material.parts.into_iter().next() else {
        return Err(format!("{name} is no solid heightfield").into());
    };
    let map = layer.height;
    let field = Heightfield::new(&map)?;
    let groups = groups(f64::from(field.range()[1]));
    let theirs = parry(&map);
    let reference = lambert(&map)?;
    let mut mitsuba = python.map(|python| Mitsuba::start(&python, &map)).transpose()?;

    let tracer = Tracer::new(field.clone())?;
    let mut seconds: [Vec<f64>; 5] = Default::default();
    let mut rays = [0; 5];
    for round in 0..=ROUNDS {
        let runs: [&mut dyn FnMut() -> (u64, f64); 5] = [
            &mut || timed(|| packets(&tracer, &groups)),
            &mut || timed(|| bare(&field, &groups)),
            &mut || timed(|| parry_rays(&theirs, &groups)),
            &mut || timed(|| picture(&reference)),
            &mut || {
                mitsuba.as_mut().map_or((0, 0.0), |m| (2 * (PICTURE * PICTURE * RAYS) as u64, m.render()))
            },
        ];
        for (k, run) in runs.into_iter().enumerate() {
            let (count, time) = run();
            rays[k] = count;
            // The first round warms up.
            if round > 0 {
                seconds[k].push(time);
            }
        }
    }
    println!("| {name}, {SIDE} x {SIDE}, one thread | M rays/s, median of {ROUNDS} | slowest, fastest |");
    println!("| --- | ---: | --- |");
    let names = [
        "neumip, packets of 16",
        "neumip, one ray at a time",
        "parry",
        "neumip, shaded picture",
        "Mitsuba scalar_rgb, shaded picture",
    ];
    for (k, name) in names.into_iter().enumerate().filter(|(k, _)| rays[*k] > 0) {
        seconds[k].sort_by(f64::total_cmp);
        let rate = |time: f64| rays[k] as f64 / time / 1e6;
        println!(
            "| {name} | {:.2} | {:.2}, {:.2} |",
            rate(seconds[k][ROUNDS / 2]),
            rate(seconds[k][ROUNDS - 1]),
            rate(seconds[k][0])
        );
    }
    Ok(())
}

fn timed(work: impl FnOnce() -> u64) -> (u64, f64) {
    let begun = Instant::now();
    (work(), begun.elapsed().as_secs_f64())
}

fn groups(high: f64) -> Vec<Group> {
    let group = |k: usize| {
        let mut random = Random::new(1, Stream::Probe, k as u64);
        let middle = [0; 2].map(|_| 0.3 + 0.4 * random.uniform_f64());
        let wo = unit(random.disc(0.8)).map(f64::from);
        let to_light = unit(random.disc(0.8)).map(f64::from);
        let origins = (0..RAYS).map(|_| {
            let p = middle.map(|c| c + random.uniform_f64() / SIDE as f64);
            [p[0] + wo[0] / wo[2] * high, p[1] + wo[1] / wo[2] * high, high]
        });
        Group { origins: origins.collect(), down: wo.map(|c| -c), to_light }
    };
    (0..GROUPS).map(group).collect()
}

fn bare(field: &Heightfield, groups: &[Group]) -> u64 {
    let mut rays = 0;
    for group in groups {
        for origin in &group.origins {
            rays += 1;
            if let Some(hit) = field.intersect(*origin, group.down, f64::INFINITY) {
                rays += 1;
                std::hint::black_box(field.occluded(hit.departure(), group.to_light));
            }
        }
    }
    rays
}

fn packets(tracer: &Tracer, groups: &[Group]) -> u64 {
    let (mut hits, mut departures, mut blocked) = (Vec::new(), Vec::new(), Vec::new());
    let mut rays = 0;
    for group in groups {
        tracer.intersect_packet(&group.origins, group.down, &mut hits);
        departures.clear();
        departures.extend(hits.iter().flatten().map(|hit| hit.departure()));
        tracer.occluded_packet(&departures, group.to_light, &mut blocked);
        rays += (group.origins.len() + departures.len()) as u64;
        std::hint::black_box(&blocked);
    }
    rays
}

/// The field with y up and its middle at the origin.
fn parry(map: &HeightMap) -> HeightField {
    let mut heights = Array2::zeros(SIDE, SIDE);
    for i in 0..SIDE {
        for j in 0..SIDE {
            heights[(i, j)] = map.values[i * SIDE + j];
        }
    }
    let span = (SIDE - 1) as f32 / SIDE as f32;
    HeightField::new(heights, Vector::new(span, 1.0, span))
}

fn parry_rays(field: &HeightField, groups: &[Group]) -> u64 {
    let vector =
        |v: [f64; 3], middle: f64| Vec3::new((v[0] - middle) as f32, v[2] as f32, (v[1] - middle) as f32);
    let mut rays = 0;
    for group in groups {
        for origin in &group.origins {
            rays += 1;
            let ray = Ray::new(vector(*origin, 0.5), vector(group.down, 0.0));
            if let Some(hit) = field.cast_local_ray_and_get_normal(&ray, 10.0, false) {
                rays += 1;
                let start = ray.point_at(hit.time_of_impact - 1e-5);
                let shadow = Ray::new(start, vector(group.to_light, 0.0));
                std::hint::black_box(field.cast_local_ray(&shadow, 10.0, false));
            }
        }
    }
    rays
}

fn lambert(map: &HeightMap) -> neumip::Result<Reference> {
    let paint = Paint::plain([0.5; 3], 0.5, 0.0);
    let part = Part::Solid(Layer { height: map.clone(), paint });
    let material =
        Material { name: "lambert".into(), parts: vec![part], height_range: None, notes: Vec::new() };
    let options = ReferenceOptions { resolution: Some([SIDE; 2]), bounces: 0, ..ReferenceOptions::default() };
    Reference::new(material, &options)
}

fn picture(reference: &Reference) -> u64 {
    let level = (SHOWN / PICTURE as f32 * SIDE as f32).log2();
    let mut queries = QueryBuffer::slice(PICTURE, PICTURE, WI, WO, level);
    queries.u.iter_mut().for_each(|u| *u = u.map(|c| 0.5 + SHOWN * (c - 0.5)));
    let sampling = Sampling { spp: RAYS, seed: 1, first: 0 };
    reference.measure(&queries, &sampling).map_or(0, |measured| measured.rays)
}

/// Mitsuba in a process of its own, asked for a picture at a time.
struct Mitsuba {
    child: Child,
    answers: BufReader<std::process::ChildStdout>,
}

impl Mitsuba {
    fn start(python: &str, map: &HeightMap) -> std::io::Result<Self> {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/mitsuba_picture.py");
        let heights = std::env::temp_dir().join(format!("neumip-heights-{}.f32", std::process::id()));
        let bytes: Vec<u8> = map.values.iter().flat_map(|v| v.to_le_bytes()).collect();
        std::fs::write(&heights, bytes)?;
        let numbers = [SIDE as f32, PICTURE as f32, RAYS as f32, SHOWN, WI[0], WI[1], WO[0], WO[1]];
        let mut child = Command::new(python)
            .arg(script)
            .arg(&heights)
            .args(numbers.map(|n| n.to_string()))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()?;
        let Some(output) = child.stdout.take() else {
            return Err(std::io::Error::other("Mitsuba's answers cannot be read"));
        };
        let mut answers = BufReader::new(output);
        // It says when the scene is built; the file of heights has been read then.
        answers.read_line(&mut String::new())?;
        std::fs::remove_file(&heights)?;
        Ok(Self { child, answers })
    }

    /// Seconds of a picture.
    fn render(&mut self) -> f64 {
        let mut line = String::new();
        let asked = self.child.stdin.as_mut().is_some_and(|input| input.write_all(b"render\n").is_ok());
        if asked && self.answers.read_line(&mut line).is_ok() {
            line.trim().parse().unwrap_or(f64::NAN)
        } else {
            f64::NAN
        }
    }
}
