//! Tiles that both renderers get: fields as triangles and as bilinear patches, and a small cloth of curves.

use neumip::reference::fibre_shading::FibreBsdf;
use neumip::reference::primitives::{Curve, TriangleMesh};
use neumip::reference::{FibreLook, Layer, Material, Paint, Part, Texture, builtin};
use serde_json::{Value, json};
use std::f64::consts::TAU;

/// Samples a side of the fields that become triangles.
const FIELD_SIDE: usize = 48;
/// Samples a side of the field that stays one, and triangles that stand for its patches in Mitsuba, along either side of
/// one. At 2, 4, 8 and 16 the images differ by 1.02, 0.23, 0.03 and -0.02 %.
const PATCHES_SIDE: usize = 24;
pub const PATCH_FINENESS: usize = 8;
/// One tile, for both.
pub struct Scene {
    pub name: &'static str,
    pub what: &'static str,
    pub material: Material,
    /// What Mitsuba gets instead of the parts, where it has not the like.
    pub replaced: Option<Vec<Part>>,
    /// What the material's fibres are sampled from.
    pub splines: Vec<Spline>,
    /// Roughness matters.
    pub glossy: bool,
}

/// Control points of a uniform cubic B-spline that goes on by `period` behind its last.
pub struct Spline {
    points: Vec<[f64; 3]>,
    period: [f64; 2],
}

/// The bilinear patches between the samples of a field that repeats as triangles: `fineness` squared times two a patch.
/// Leaned over by `lean` tile widths in x a tile width of height.
fn triangulated(layer: &Layer, fineness: usize, lean: f64) -> TriangleMesh {
    let (rows, columns) = (layer.height.height, layer.height.width);
    let sample = |i: usize, j: usize| f64::from(layer.height.values[i % rows * columns + j % columns]);
    let split = |k: usize| (k / fineness, (k % fineness) as f64 / fineness as f64);
    let mut mesh = TriangleMesh::default();
    for ((i, v), (j, u)) in
        (0..=rows * fineness).flat_map(|i| (0..=columns * fineness).map(move |j| (split(i), split(j))))
    {
        let across = |i: usize| sample(i, j) * (1.0 - u) + sample(i, j + 1) * u;
        let z = across(i) * (1.0 - v) + across(i + 1) * v;
        let [x, y] = [(j as f64 + u + 0.5) / columns as f64, (i as f64 + v + 0.5) / rows as f64];
        mesh.positions.push([x + lean * z, y, z]);
    }
    let side = columns * fineness + 1;
    for k in (0..rows * fineness * side).filter(|k| k % side < side - 1) {
        let [a, b, c, d] = [k, k + 1, k + side, k + side + 1].map(|corner| corner as u32);
        mesh.triangles.extend([[a, b, d], [a, d, c]]);
    }
    mesh
}

/// The layer of a built-in material, rougher by `roughen`: sharp glints on small faces make noise of which no estimate can
/// be trusted.
fn layer(name: &str, side: usize, roughen: f32) -> Layer {
    let material = builtin::make(name, side, 1).unwrap();
    let Some(Part::Solid(mut layer)) = material.parts.into_iter().next() else {
        panic!("{name} is no field")
    };
    layer.paint.roughness = texels(&layer.paint.roughness, |r| r + roughen);
    layer
}

fn texels(texture: &Texture<1>, change: impl Fn(f32) -> f32) -> Texture<1> {
    let texels = texture.texels().iter().map(|[v]| [change(*v).min(1.0)]).collect();
    Texture::new(texture.side(), texels).unwrap()
}

fn scene(name: &'static str, what: &'static str, parts: Vec<Part>) -> Scene {
    let material = Material { name: name.into(), parts, height_range: None, notes: Vec::new() };
    Scene { name, what, material, replaced: None, splines: Vec::new(), glossy: true }
}

pub fn scenes() -> [Scene; 5] {
    let rocks = |side: usize| {
        let mut rocks = layer("rocks", side, 0.0);
        rocks.paint.specular = Texture::constant([0.0]);
        rocks
    };
    let coarse = rocks(PATCHES_SIDE);
    let mesh = |layer: Layer, lean: f64| vec![Part::Mesh(triangulated(&layer, 1, lean), layer.paint)];
    let patches = vec![Part::Mesh(triangulated(&coarse, PATCH_FINENESS, 0.0), coarse.paint.clone())];
    [
        Scene {
            replaced: Some(patches),
            glossy: false,
            ..scene("field", "bilinear patches, Lambert", vec![Part::Solid(coarse)])
        },
        Scene { glossy: false, ..scene("rocks", "triangles, Lambert", mesh(rocks(FIELD_SIDE), 0.0)) },
        scene(
            "metal-rings",
            "triangles, GGX metal beside gloss over diffuse",
            mesh(layer("metal-rings", FIELD_SIDE, 0.1), 0.0),
        ),
        scene(
            "turtle-shell",
            "triangles that overhang, gloss over diffuse",
            mesh(layer("turtle-shell", FIELD_SIDE, 0.25), 1.0),
        ),
        cloth(),
    ]
}

/// Four yarns either way in plain weave, each of four fibres wound around a fifth, over a matte plane.
fn cloth() -> Scene {
    const YARNS: usize = 4;
    const PLACES: usize = 24;
    const RADIUS: f64 = 0.016;
    const PITCH: f64 = 0.042;
    const CRIMP: f64 = 0.062;
    /// Points that stand for a piece of the spline: they leave it by less than a thousandth of the radius.
    const FINENESS: usize = 12;
    let mut splines = Vec::new();
    for yarn in 0..2 * YARNS {
        let (warp, index) = (yarn < YARNS, yarn % YARNS);
        let middle = (index as f64 + 0.5) / YARNS as f64;
        for fibre in 0..5 {
            let point = |k: usize| {
                let t = k as f64 / PLACES as f64;
                let side = if warp == (index % 2 == 0) { CRIMP } else { -CRIMP };
                let turn = TAU * (fibre as f64 / 4.0 + 2.0 * t);
                let [u, v] = if fibre < 4 { [turn.cos(), turn.sin()].map(|c| PITCH * c) } else { [0.0; 2] };
                let z = side * (0.5 * TAU * YARNS as f64 * t).sin() + v;
                if warp { [t, middle + u, z] } else { [middle + u, t, z] }
            };
            let period = if warp { [1.0, 0.0] } else { [0.0, 1.0] };
            splines.push(Spline { points: (0..PLACES).map(point).collect(), period });
        }
    }
    let look = FibreLook {
        colour: [0.75, 0.45, 0.25],
        longitudinal_roughness: 0.6,
        azimuthal_roughness: 0.7,
        ior: 1.5,
        tilt: 3.0,
    };
    let curves = splines.iter().map(|s| Curve { points: s.sampled(FINENESS), radius: RADIUS, look: 0 });
    let curves = Part::Fibres(curves.collect(), vec![look]);
    let low = -CRIMP - PITCH - 2.0 * RADIUS;
    let plane = TriangleMesh {
        positions: vec![[0.0, 0.0, low], [1.0, 0.0, low], [1.0, 1.0, low], [0.0, 1.0, low]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..TriangleMesh::default()
    };
    let plane = Part::Mesh(plane, Paint::plain([0.3, 0.35, 0.5], 1.0, 0.0));
    Scene { splines, ..scene("weave", "fibres as curves over a Lambert plane", vec![curves, plane]) }
}

impl Spline {
    /// Points of one period, and the first one of the next.
    fn sampled(&self, fineness: usize) -> Vec<[f64; 3]> {
        let control = |k: usize| {
            let (turn, [x, y, z]) = ((k / self.points.len()) as f64, self.points[k % self.points.len()]);
            [x + turn * self.period[0], y + turn * self.period[1], z]
        };
        let point = |k: usize| {
            let t = (k % fineness) as f64 / fineness as f64;
            let weights = [
                (1.0 - t).powi(3),
                (3.0 * t - 6.0) * t * t + 4.0,
                ((3.0 - 3.0 * t) * t + 3.0) * t + 1.0,
                t.powi(3),
            ];
            let near = [0, 1, 2, 3].map(|n| control(k / fineness + n));
            std::array::from_fn(|c| (0..4).map(|n| weights[n] * near[n][c]).sum::<f64>() / 6.0)
        };
        (0..=self.points.len() * fineness).map(point).collect()
    }
}

fn paint_json(paint: &Paint) -> Value {
    json!({
        "base_colour": paint.base_colour.texels().concat(),
        "roughness": paint.roughness.texels().concat(),
        "metalness": paint.metalness.texels().concat(),
        "specular": paint.specular.texels().concat(),
    })
}

impl Scene {
    /// The parts as `mitsuba_render.py` reads them.
    pub fn parts_json(&self) -> Vec<Value> {
        let json = |part: &Part| match part {
            Part::Mesh(mesh, paint) => json!({
                "kind": "mesh",
                "positions": mesh.positions.concat(),
                "triangles": mesh.triangles.concat(),
                "paint": paint_json(paint),
            }),
            Part::Fibres(curves, looks) => {
                let spline = |s: &Spline| json!({ "points": s.points, "period": s.period });
                let look = looks[0];
                json!({
                    "kind": "fibres",
                    "splines": self.splines.iter().map(spline).collect::<Vec<_>>(),
                    "radius": curves[0].radius,
                    "look": {
                        "absorption": FibreBsdf::new(&look).unwrap().absorption(),
                        "longitudinal_roughness": look.longitudinal_roughness,
                        "azimuthal_roughness": look.azimuthal_roughness,
                        "ior": look.ior,
                        "tilt": look.tilt,
                    },
                })
            }
            other => panic!("{other:?} has no counterpart"),
        };
        self.replaced.as_ref().unwrap_or(&self.material.parts).iter().map(json).collect()
    }

    /// The same with rougher surfaces and fibres.
    pub fn rougher(&self, factor: f32) -> Self {
        let mut material = self.material.clone();
        for part in &mut material.parts {
            match part {
                Part::Fibres(_, looks) => looks.iter_mut().for_each(|l| l.azimuthal_roughness *= factor),
                Part::Mesh(_, paint) => paint.roughness = texels(&paint.roughness, |r| r * factor),
                other => panic!("{other:?} has no roughness here"),
            }
        }
        Self { material, replaced: None, splines: Vec::new(), ..*self }
    }
}
