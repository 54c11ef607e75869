//! The parts of a material as geometry: which of them a ray meets first, and how the point scatters light.

use super::fibre_shading::{self, FibreBsdf, FibrePoint};
use super::frame::Frame;
use super::heightfield::{HeightMap, Heightfield};
use super::material::{Material, Paint, Part};
use super::packet::{Ray, Tracer};
use super::primitives::{Curves, Triangles};
use super::raycast::Hit;
use super::shading::Brdf;
use super::texture::Texture;
use crate::error::{Error, Result};
use crate::random::Random;

/// Parts ready for rays.
#[derive(Debug)]
pub struct Geometry {
    objects: Vec<Object>,
    low: f64,
    high: f64,
}

#[derive(Debug)]
enum Object {
    Solid(Tracer, Paint),
    Sheet(Heightfield, Texture<1>, Paint),
    Mesh(Triangles, Paint),
    Fibres(Curves, Vec<FibreBsdf>),
}

/// A point that a ray met, as it is seen along that ray.
#[derive(Debug)]
pub struct Point<'a> {
    /// Distance along the ray.
    pub t: f64,
    /// From where rays leave it.
    pub departure: [f64; 3],
    /// Unit normal of the geometry, on the side from which the ray came.
    pub normal: [f64; 3],
    /// Axes of the frame in which it scatters.
    pub frame: Frame,
    /// How it scatters.
    pub scatter: Scatter<'a>,
}

/// How a point scatters towards the viewer.
#[derive(Debug)]
pub enum Scatter<'a> {
    /// Opaque, lit from above only; the viewer's direction is in the point's frame.
    Surface(Brdf, [f32; 3]),
    /// A fibre, lit from everywhere.
    Fibre(FibrePoint<'a>),
}

impl Point<'_> {
    /// What it sends to the viewer of a distant light from the unit vector `wi` with irradiance 1 on a plane facing it,
    /// shadows aside: f cos(theta).
    pub fn reflected(&self, wi: [f64; 3]) -> [f32; 3] {
        let wi = self.frame.to_local(wi);
        match &self.scatter {
            Scatter::Surface(brdf, wo) => brdf.eval(wi, *wo).map(|f| f * wi[2].max(0.0)),
            Scatter::Fibre(point) => point.eval(wi),
        }
    }

    /// Draws the direction in which a path goes on, and its weight.
    pub fn sample(&self, random: &mut Random) -> Option<([f64; 3], [f32; 3])> {
        let sampled = match &self.scatter {
            Scatter::Surface(brdf, wo) => brdf.sample(*wo, std::array::from_fn(|_| random.uniform())),
            Scatter::Fibre(point) => point.sample(std::array::from_fn(|_| random.uniform())),
        }?;
        let direction = self.frame.to_world(sampled.direction);
        self.may_leave(direction).then_some((direction, sampled.weight))
    }

    /// True if a ray in `direction` stays on the side from which the point is seen; always for fibres, which light
    /// passes through.
    pub fn may_leave(&self, direction: [f64; 3]) -> bool {
        matches!(self.scatter, Scatter::Fibre(..)) || dot(direction, self.normal) > 0.0
    }
}

impl Geometry {
    /// The parts of a material.
    ///
    /// # Errors
    /// `Config` for a material without parts, and as the constructors of the parts.
    pub fn new(material: Material) -> Result<Self> {
        let objects = material.parts.into_iter().map(Object::new).collect::<Result<Vec<_>>>()?;
        let ranges = || objects.iter().map(Object::range);
        let low = ranges().map(|r| r[0]).reduce(f64::min);
        let high = ranges().map(|r| r[1]).reduce(f64::max);
        match (low, high) {
            (Some(low), Some(high)) => Ok(Self { objects, low, high }),
            _ => Err(Error::config("parts", "the material has none")),
        }
    }

    /// Lowest and highest point, in tile widths.
    pub fn range(&self) -> [f64; 2] {
        [self.low, self.high]
    }

    /// The heights where the material is one solid layer.
    pub fn height_map(&self) -> Option<HeightMap> {
        match self.objects.as_slice() {
            [Object::Solid(tracer, _)] => Some(tracer.field().height_map()),
            _ => None,
        }
    }

    /// The first point that a ray meets.
    pub fn intersect(&self, origin: [f64; 3], direction: [f64; 3]) -> Option<Point<'_>> {
        let mut nearest = None;
        let mut t_max = f64::INFINITY;
        for object in &self.objects {
            if let Some(point) = object.intersect(origin, direction, t_max) {
                t_max = point.t;
                nearest = Some(point);
            }
        }
        nearest
    }

    /// [`Geometry::intersect`] for many rays, those near each other after each other; `hits` is scratch.
    pub fn intersect_all<'a>(
        &'a self,
        rays: &[Ray],
        hits: &mut Vec<Option<Hit>>,
        points: &mut Vec<Option<Point<'a>>>,
    ) {
        points.clear();
        points.resize_with(rays.len(), || None);
        for object in &self.objects {
            match object {
                Object::Solid(tracer, paint) => {
                    tracer.intersect_many(rays, hits);
                    for ((point, hit), (_, direction)) in points.iter_mut().zip(&*hits).zip(rays) {
                        let Some(hit) = hit else { continue };
                        if point.as_ref().is_none_or(|nearest| hit.t <= nearest.t) {
                            *point = Some(field_point(paint, hit, *direction, false));
                        }
                    }
                }
                _ => {
                    for (point, (origin, direction)) in points.iter_mut().zip(rays) {
                        let t_max = point.as_ref().map_or(f64::INFINITY, |nearest| nearest.t);
                        if let Some(nearer) = object.intersect(*origin, *direction, t_max) {
                            *point = Some(nearer);
                        }
                    }
                }
            }
        }
    }

    /// [`Geometry::occluded`] for many rays of one direction.
    pub fn occluded_all(&self, origins: &[[f64; 3]], direction: [f64; 3], blocked: &mut Vec<bool>) {
        if let [Object::Solid(tracer, _)] = self.objects.as_slice() {
            tracer.occluded_packet(origins, direction, blocked);
        } else {
            blocked.clear();
            blocked.extend(origins.iter().map(|origin| self.occluded(*origin, direction)));
        }
    }

    /// True if a ray meets anything on its way out.
    pub fn occluded(&self, origin: [f64; 3], direction: [f64; 3]) -> bool {
        self.objects.iter().any(|object| object.occluded(origin, direction))
    }
}

impl Object {
    fn new(part: Part) -> Result<Self> {
        Ok(match part {
            Part::Solid(layer) => Self::Solid(Tracer::new(Heightfield::new(&layer.height)?)?, layer.paint),
            Part::Sheet(layer, opacity) => {
                Self::Sheet(Heightfield::new(&layer.height)?, opacity, layer.paint)
            }
            Part::Mesh(mesh, paint) => Self::Mesh(Triangles::new(mesh)?, paint),
            Part::Fibres(curves, looks) => {
                if let Some(curve) = curves.iter().find(|curve| curve.look as usize >= looks.len()) {
                    let problem = format!("a curve has look {} of {}", curve.look, looks.len());
                    return Err(Error::config("fibres", problem));
                }
                let looks = looks.iter().map(FibreBsdf::new).collect::<Result<_>>()?;
                Self::Fibres(Curves::new(&curves)?, looks)
            }
        })
    }

    fn range(&self) -> [f64; 2] {
        match self {
            Self::Solid(tracer, _) => tracer.field().range().map(f64::from),
            Self::Sheet(field, ..) => field.range().map(f64::from),
            Self::Mesh(triangles, _) => triangles.range(),
            Self::Fibres(curves, _) => curves.range(),
        }
    }

    fn intersect(&self, origin: [f64; 3], direction: [f64; 3], t_max: f64) -> Option<Point<'_>> {
        match self {
            Self::Solid(tracer, paint) => {
                let hit = tracer.field().intersect(origin, direction, t_max)?;
                Some(field_point(paint, &hit, direction, false))
            }
            Self::Sheet(field, opacity, paint) => {
                let hit = field.intersect_sheet(opacity, origin, direction, t_max)?;
                Some(field_point(paint, &hit, direction, dot(hit.normal, direction) > 0.0))
            }
            Self::Mesh(triangles, paint) => {
                let hit = triangles.intersect(origin, direction, t_max)?;
                let shading = paint.normal(hit.uv[0], hit.uv[1]).unwrap_or(hit.shading_normal);
                let frame = shading_frame(shading, hit.normal, direction);
                Some(Point {
                    t: hit.t,
                    departure: hit.departure(),
                    normal: hit.normal,
                    scatter: surface(paint, hit.uv, &frame, direction),
                    frame,
                })
            }
            Self::Fibres(curves, looks) => {
                let hit = curves.intersect(origin, direction, t_max)?;
                let frame = Frame::along(hit.tangent, hit.normal);
                let wo = frame.to_local(direction.map(|c| -c));
                Some(Point {
                    t: hit.t,
                    departure: hit.departure(),
                    normal: hit.normal,
                    scatter: Scatter::Fibre(looks[hit.look as usize].at(fibre_shading::offset(wo), wo)),
                    frame,
                })
            }
        }
    }

    fn occluded(&self, origin: [f64; 3], direction: [f64; 3]) -> bool {
        match self {
            Self::Solid(tracer, _) => tracer.field().occluded(origin, direction),
            Self::Sheet(field, opacity, _) => {
                field.intersect_sheet(opacity, origin, direction, f64::INFINITY).is_some()
            }
            Self::Mesh(triangles, _) => triangles.occluded(origin, direction),
            Self::Fibres(curves, _) => curves.occluded(origin, direction),
        }
    }
}

/// A point of a heightfield; `from_below` turns it to a ray that met it from there.
fn field_point<'a>(paint: &Paint, hit: &Hit, direction: [f64; 3], from_below: bool) -> Point<'a> {
    let turned = |n: [f64; 3]| if from_below { n.map(|c| -c) } else { n };
    let [x, y, _] = hit.position;
    let normal = turned(hit.normal);
    let frame = shading_frame(paint.normal(x, y).map_or(normal, turned), normal, direction);
    Point {
        t: hit.t,
        departure: Hit { normal, ..*hit }.departure(),
        normal,
        scatter: surface(paint, [x, y], &frame, direction),
        frame,
    }
}

fn surface<'a>(paint: &Paint, at: [f64; 2], frame: &Frame, direction: [f64; 3]) -> Scatter<'a> {
    Scatter::Surface(paint.brdf(at[0], at[1]), frame.to_local(direction.map(|c| -c)))
}

/// The frame around the normal to shade with; around the geometry's where the other looks away from the viewer.
fn shading_frame(shading: [f64; 3], normal: [f64; 3], direction: [f64; 3]) -> Frame {
    Frame::new(if dot(shading, direction) < 0.0 { shading } else { normal })
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
