//! Paths from the camera: what they meet, and what is asked there.
//!
//! At each point light comes from every light in turn, and from one direction that the material draws: the environment's
//! in part by its own samples and in part by the material's, weighed by both densities (Veach and Guibas 1995, the balance
//! heuristic), and another object's once, which is then lit by the lights alone.

use super::asked::{Part, Slot, Term};
use super::directions::{Lobes, View};
use super::scene::{Frame, Scene};
use super::shape::Ray;
use super::world::{Hit, Spot};
use crate::error::Result;
use crate::query::{above_horizon, project};
use crate::random;
use glam::DVec3;
use std::ops::Range;

/// Rays in which a hemisphere of bounced light is thought to be drawn: each stands for that part of it, by its density, and
/// meets that large a footprint, whatever the number of samples.
const BOUNCE_RAYS: f64 = 64.0;

/// Sets of four numbers that a sample draws. The first two of [`SEEN`] are for the place in the pixel, those of [`FIRST`] and
/// [`SECOND`] for the material's direction from the first and the second point; the other two of each for the environment's
/// direction from the point after.
const SEEN: u32 = 0;
const FIRST: u32 = 1;
const SECOND: u32 = 2;

/// A point that is to be lit.
struct Vertex {
    pixel: u32,
    sample: u32,
    seed: u32,
    /// Numbers for the environment's direction.
    xi: [f32; 2],
    spot: Spot,
    view: View,
    /// Area of a cut through the beam that came here.
    beam: f64,
    before: Option<Before>,
}

/// Where light goes from a second point: to the first, over the density with which it was drawn.
struct Before {
    material: u32,
    view: View,
    wi: [f32; 2],
    over: f32,
    slot: Option<Slot>,
}

/// What pixels of a frame ask.
///
/// # Errors
/// Whatever keeps a material from drawing directions.
pub fn trace(scene: &Scene, frame: &Frame, pixels: Range<usize>) -> Result<Part> {
    let mut tracer = Tracer { scene, frame, part: Part::new(pixels.clone(), scene.materials.len()) };
    let first = tracer.seen(pixels);
    let bounces = scene.file.bounces > 0;
    let second = tracer.light(first, FIRST, bounces)?;
    tracer.light(second, SECOND, false)?;
    Ok(tracer.part)
}

struct Tracer<'a> {
    scene: &'a Scene,
    frame: &'a Frame,
    part: Part,
}

impl Tracer<'_> {
    /// What the camera sees through the pixels.
    fn seen(&mut self, pixels: Range<usize>) -> Vec<Vertex> {
        let Frame { camera, lights, samples, share } = self.frame;
        let each = 1.0 / *samples as f64;
        let mut vertices = Vec::with_capacity(pixels.len() * samples);
        for (k, pixel) in pixels.enumerate() {
            let (column, row) = (pixel % camera.width(), pixel / camera.width());
            // The same in every frame, so that noise does not flicker.
            let seed = random::hash(self.scene.seed ^ random::hash(pixel as u64)) as u32;
            for sample in 0..*samples as u32 {
                let [x, y, xi @ ..] = sobol_burley::sample_4d(sample, SEEN, seed);
                let [x, y] = if *samples == 1 { [0.5; 2] } else { [x, y] };
                let ray = camera.ray(column as f64 + f64::from(x), row as f64 + f64::from(y));
                let Some(hit) = self.scene.world.nearest(&ray) else {
                    if let Some(environment) = &lights.environment {
                        let radiance = environment.radiance(ray.direction.normalize());
                        (0..3).for_each(|c| self.part.constants[k][c] += each * f64::from(radiance[c]));
                    }
                    continue;
                };
                let spot = self.scene.world.spot(&ray, &hit);
                let area = share * camera.footprint(&ray, hit.distance(), spot.geometric);
                let beam = area * ray.direction.normalize().dot(spot.geometric).abs();
                vertices.extend(self.vertex(spot, &ray, area).map(|view| Vertex {
                    pixel: k as u32,
                    sample,
                    seed,
                    xi,
                    spot,
                    view,
                    beam,
                    before: None,
                }));
            }
        }
        vertices
    }

    /// A point as its material sees it, over an area; None from below the horizon.
    fn vertex(&self, spot: Spot, ray: &Ray, area: f64) -> Option<View> {
        let wo = stored(&spot, -ray.direction.normalize());
        let material = &self.scene.materials[spot.material];
        let [height, width] = material.resolution.map(|side| side as f64);
        let texels = area * spot.density * width * height;
        // Not a number only where an infinite area meets degenerate coordinates.
        let level = if texels > 0.0 { 0.5 * texels.log2() } else { 0.0 };
        above_horizon(wo).then(|| View {
            u: spot.uv.map(wrap),
            level: level.clamp(0.0, f64::from(material.coarsest)) as f32,
            wo,
        })
    }

    /// Asks for all light at the points, and gives the points from which bounced light comes to them.
    fn light(&mut self, mut vertices: Vec<Vertex>, set: u32, bounces: bool) -> Result<Vec<Vertex>> {
        let draws = bounces || self.frame.lights.environment.is_some();
        let scene = self.scene;
        let mut lobes: Vec<Option<Box<dyn Lobes>>> = Vec::new();
        let mut places = vec![0; vertices.len()];
        for (m, material) in scene.materials.iter().enumerate() {
            let mut views = Vec::new();
            for (vertex, place) in vertices.iter().zip(&mut places).filter(|(v, _)| v.spot.material == m) {
                *place = views.len();
                views.push(vertex.view);
            }
            let drawn = (draws && !views.is_empty()).then(|| material.directions.lobes(&views));
            lobes.push(drawn.transpose()?);
        }
        let mut next = Vec::new();
        for (vertex, place) in vertices.iter_mut().zip(places) {
            self.distinct(vertex);
            if let Some(lobes) = &lobes[vertex.spot.material] {
                let lobe = Lobe { lobes: &**lobes, place };
                self.environment(vertex, &lobe);
                next.extend(self.drawn(vertex, &lobe, set, bounces));
            }
        }
        Ok(next)
    }

    /// Lights that are seen in one direction.
    fn distinct(&mut self, vertex: &mut Vertex) {
        let frame = self.frame;
        for light in &frame.lights.distinct {
            let Some((wi, irradiance, ray, far)) = light.seen_from(&vertex.spot) else { continue };
            let wi = stored(&vertex.spot, wi);
            if above_horizon(wi) && self.scene.world.is_free(&ray, far) {
                self.add(vertex, wi, irradiance);
            }
        }
    }

    /// The environment by its own samples.
    fn environment(&mut self, vertex: &mut Vertex, lobe: &Lobe) {
        let Some(environment) = &self.frame.lights.environment else { return };
        let (direction, radiance, pdf) = environment.sample(vertex.xi);
        let wi = stored(&vertex.spot, direction);
        let Some(ray) = vertex.spot.leave(direction) else { return };
        if !above_horizon(wi) || !self.scene.world.is_free(&ray, f64::INFINITY) {
            return;
        }
        let local = (vertex.spot.frame.transpose() * direction).as_vec3().to_array();
        // radiance / pdf, weighed by pdf / (pdf + the material's).
        let over = 1.0 / (pdf + f64::from(lobe.lobes.pdf(lobe.place, local)));
        self.add(vertex, wi, radiance.map(|v| v * over as f32));
    }

    /// The direction that the material draws: to the environment, or to another object if light bounces.
    fn drawn(&mut self, vertex: &mut Vertex, lobe: &Lobe, set: u32, bounces: bool) -> Option<Vertex> {
        let [x, y, xi @ ..] = sobol_burley::sample_4d(vertex.sample, set, vertex.seed);
        let (local, pdf) = lobe.lobes.sample(lobe.place, [x, y])?;
        let direction = (vertex.spot.frame * DVec3::from(local.map(f64::from))).normalize();
        let wi = stored(&vertex.spot, direction);
        let ray = vertex.spot.leave(direction)?;
        if !(above_horizon(wi) && pdf > 0.0) {
            return None;
        }
        let world = &self.scene.world;
        let met: Option<Hit> = match bounces {
            true => world.nearest(&ray),
            false if !world.is_free(&ray, f64::INFINITY) => return None,
            false => None,
        };
        let Some(hit) = met else {
            let environment = self.frame.lights.environment.as_ref()?;
            let (radiance, density) = environment.look(direction);
            let over = 1.0 / (f64::from(pdf) + density);
            self.add(vertex, wi, radiance.map(|v| v * over as f32));
            return None;
        };
        let spot = world.spot(&ray, &hit);
        let beam = vertex.beam + hit.distance().powi(2) / (f64::from(pdf) * BOUNCE_RAYS);
        let view = self.vertex(spot, &ray, beam / direction.dot(spot.geometric).abs())?;
        let before = Before {
            material: vertex.spot.material as u32,
            view: vertex.view,
            wi,
            over: 1.0 / pdf,
            slot: None,
        };
        Some(Vertex { xi, spot, view, beam, before: Some(before), ..*vertex })
    }

    /// Asks the material of a point for light of a radiance or irradiance, over its density.
    fn add(&mut self, vertex: &mut Vertex, wi: [f32; 2], light: [f32; 3]) {
        if light == [0.0; 3] {
            return;
        }
        let each = 1.0 / self.frame.samples as f32;
        let here = self.ask(vertex.spot.material as u32, &vertex.view, wi);
        let (first, second, over) = match &mut vertex.before {
            None => (here, None, each),
            Some(before) => {
                // Asked once, and only if any light comes.
                let slot = match before.slot {
                    Some(slot) => slot,
                    None => self.ask(before.material, &before.view, before.wi),
                };
                before.slot = Some(slot);
                (slot, Some(here), each * before.over)
            }
        };
        self.part.terms.push(Term { pixel: vertex.pixel, first, second, weight: light.map(|v| v * over) });
    }

    fn ask(&mut self, material: u32, view: &View, wi: [f32; 2]) -> Slot {
        let queries = &mut self.part.queries[material as usize];
        let index = queries.level.len() as u32;
        queries.u.push(view.u);
        queries.level.push(view.level);
        queries.wo.push(view.wo);
        queries.wi.push(wi);
        Slot { material, index }
    }
}

/// The density of one point.
struct Lobe<'a> {
    lobes: &'a dyn Lobes,
    place: usize,
}

/// A unit direction of the world as queries hold it.
fn stored(spot: &Spot, direction: DVec3) -> [f32; 2] {
    project((spot.frame.transpose() * direction).as_vec3().to_array())
}

/// A coordinate in \[0, 1).
fn wrap(x: f64) -> f32 {
    let wrapped = x.rem_euclid(1.0) as f32;
    if wrapped < 1.0 { wrapped } else { 0.0 }
}
