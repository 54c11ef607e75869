//! The ground truth against Mitsuba 3, a renderer that we did not write: the same geometry, reflectance and light, image by
//! image. Without network or Python the comparison is skipped, and says so.
//!
//! ```text
//! NEUMIP_MITSUBA=full cargo test --release --test promises mitsuba -- --nocapture
//! ```
//! renders every pair of directions at full size and writes `docs/mitsuba.md` and its pictures.

use crate::python_environment;
use neumip::query::{QueryBuffer, unit};
use neumip::reference::bvh::{Curve, TriangleMesh};
use neumip::reference::fibre_shading::FibreBsdf;
use neumip::reference::{
    FibreLook, Layer, Material, Paint, Part, Reference, ReferenceOptions, Sampling, Texture, builtin,
};
use serde::Deserialize;
use serde_json::{Value, json};
use std::f64::consts::TAU;
use std::fmt::Write;
use std::path::Path;

/// The releases whose `hair`, `bsplinecurve` and Python interface are known to work.
const REQUIREMENTS: [&str; 2] = ["mitsuba>=3.9,<4", "numpy>=1.26,<3"];
/// Set to `full`, renders everything and writes the docs.
const EXTENT: &str = "NEUMIP_MITSUBA";

/// Largest |sum(ours - theirs) / sum(theirs)|: two renderers of one scene differ by noise and by how they leave a surface.
const LARGEST_BIAS: f64 = 0.01;
/// The same, in standard errors of both.
const LARGEST_DEVIATION: f64 = 3.0;
/// Root mean square difference over the noise that both predict: 1 if all of the difference is noise and no more noise
/// is predicted than there is.
const NOISE_RATIO: [f64; 2] = [0.8, 1.3];
/// What the twins change: the light's polar angle in degrees, and the factor on the roughness.
const TILT: f64 = 2.0;
const ROUGHER: f32 = 1.1;

/// Samples a side of the fields that become triangles.
const FIELD_SIDE: usize = 48;
/// Our samples a pixel.
const SPP: usize = 256;
/// Independent renders of Mitsuba, whose spread says how noisy their mean is, and samples a pixel in each.
const RENDERS: usize = 4;
const RENDER_SPP: usize = 36;
/// Copies of the tile to every side in Mitsuba, where it does not repeat. At 70 degrees light comes from 2.7 heights away,
/// and no surface here is a fifth of a tile high.
const REPEAT: usize = 3;

/// Directions to the light and to the viewer as polar angle and azimuth in degrees: around the middle; oblique; a grazing
/// viewer; a grazing light; opposite each other, where gloss mirrors; the same, where no shadow is seen.
const PAIRS: [[[f64; 2]; 2]; 6] = [
    [[20.0, 30.0], [0.0, 0.0]],
    [[45.0, 120.0], [30.0, 20.0]],
    [[30.0, 200.0], [70.0, 250.0]],
    [[70.0, 60.0], [35.0, 300.0]],
    [[50.0, 75.0], [50.0, 255.0]],
    [[40.0, 140.0], [40.0, 140.0]],
];

/// How much is rendered.
struct Extent {
    side: usize,
    /// Indices of pairs, and indirect bounces.
    views: Vec<(usize, usize)>,
}

/// One tile, for both.
struct Scene {
    name: &'static str,
    what: &'static str,
    material: Material,
    /// What the material's fibres are sampled from.
    splines: Vec<Spline>,
}

/// Control points of a uniform cubic B-spline that goes on by `period` behind its last.
struct Spline {
    points: Vec<[f64; 3]>,
    period: [f64; 2],
}

fn direction([polar, azimuth]: [f64; 2]) -> [f32; 2] {
    let (sin, cos) = azimuth.to_radians().sin_cos();
    [cos, sin].map(|c| (polar.to_radians().sin() * c) as f32)
}

/// Two triangles a cell between the samples of a field that repeats, leaned over by `lean` tile widths in x a tile width of
/// height.
fn triangulated(layer: &Layer, lean: f64) -> TriangleMesh {
    let (rows, columns) = (layer.height.height, layer.height.width);
    let mut mesh = TriangleMesh::default();
    for i in 0..=rows {
        for j in 0..=columns {
            let z = f64::from(layer.height.values[i % rows * columns + j % columns]);
            let [x, y] = [(j as f64 + 0.5) / columns as f64, (i as f64 + 0.5) / rows as f64];
            mesh.positions.push([x + lean * z, y, z]);
        }
    }
    for k in (0..rows * (columns + 1)).filter(|k| k % (columns + 1) < columns) {
        let [a, b, c, d] = [k, k + 1, k + columns + 1, k + columns + 2].map(|corner| corner as u32);
        mesh.triangles.extend([[a, b, d], [a, d, c]]);
    }
    mesh
}

/// A built-in field as triangles.
fn field(name: &'static str, what: &'static str, lean: f64, repaint: impl Fn(&mut Paint)) -> Scene {
    let mut material = builtin::make(name, FIELD_SIDE, 1).unwrap();
    let Some(Part::Solid(mut layer)) = material.parts.pop() else { panic!("{name} is no field") };
    repaint(&mut layer.paint);
    material.parts = vec![Part::Mesh(triangulated(&layer, lean), layer.paint)];
    Scene { name, what, material, splines: Vec::new() }
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
    let material =
        Material { name: "weave".into(), parts: vec![curves, plane], height_range: None, notes: Vec::new() };
    Scene { name: "weave", what: "fibres as curves over a Lambert plane", material, splines }
}

/// Sharp glints on small faces make noise, of which no estimate can be trusted.
fn duller(paint: &mut Paint, by: f32) {
    let texels = paint.roughness.texels().iter().map(|[r]| [(r + by).min(1.0)]).collect();
    paint.roughness = Texture::new(paint.roughness.side(), texels).unwrap();
}

fn scenes() -> [Scene; 4] {
    [
        field("rocks", "triangles, Lambert", 0.0, |paint| paint.specular = Texture::constant([0.0])),
        field("metal-rings", "triangles, GGX metal beside gloss over diffuse", 0.0, |paint| duller(paint, 0.1)),
        field("turtle-shell", "triangles that overhang, gloss over diffuse", 1.0, |paint| duller(paint, 0.25)),
        cloth(),
    ]
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
    /// As `mitsuba_render.py` reads it.
    fn json(&self, extent: &Extent) -> Value {
        let part = |part: &Part| match part {
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
        let view = |&(pair, bounces): &(usize, usize)| {
            let [wi, wo] = PAIRS[pair].map(direction);
            json!({ "wi": wi, "wo": wo, "bounces": bounces })
        };
        json!({
            "parts": self.material.parts.iter().map(part).collect::<Vec<_>>(),
            "height_range": self.reference(0, 1).height_range(),
            "repeat": REPEAT,
            "side": extent.side,
            "spp": RENDER_SPP,
            "renders": RENDERS,
            "views": extent.views.iter().map(view).collect::<Vec<_>>(),
        })
    }

    fn reference(&self, bounces: usize, side: usize) -> Reference {
        let resolution = Some([side.max(2); 2]);
        let options = ReferenceOptions { resolution, bounces, ..ReferenceOptions::default() };
        Reference::new(self.material.clone(), &options).unwrap()
    }

    /// Our image of a pair whose light's polar angle is off by `tilt`.
    fn image(&self, side: usize, pair: usize, bounces: usize, tilt: f64) -> Image {
        let [[polar, azimuth], wo] = PAIRS[pair];
        let (wi, wo) = (direction([polar + tilt, azimuth]), direction(wo));
        assert!(unit(wi)[2] > 0.0 && unit(wo)[2] > 0.0);
        let queries = QueryBuffer::slice(side, side, wi, wo, 0.0);
        let sampling = Sampling { spp: SPP, seed: pair as u64, first: 0 };
        let measured = self.reference(bounces, side).measure(&queries, &sampling).unwrap();
        Image { rgb: measured.rgb.pixels, variance: measured.variance }
    }

    /// The same with rougher surfaces and fibres.
    fn rougher(&self) -> Self {
        let mut material = self.material.clone();
        for part in &mut material.parts {
            match part {
                Part::Fibres(_, looks) => looks.iter_mut().for_each(|l| l.azimuthal_roughness *= ROUGHER),
                Part::Mesh(_, paint) => {
                    let texels = paint.roughness.texels().iter().map(|[r]| [(r * ROUGHER).min(1.0)]).collect();
                    paint.roughness = Texture::new(paint.roughness.side(), texels).unwrap();
                }
                other => panic!("{other:?} has no roughness here"),
            }
        }
        Self { material, splines: Vec::new(), ..*self }
    }
}

/// What `mitsuba_render.py` writes.
#[derive(Deserialize)]
struct Rendered {
    version: String,
    /// An image a view.
    images: Vec<Image>,
}

/// Pixels, and the variance of each, averaged over RGB.
#[derive(Deserialize)]
struct Image {
    rgb: Vec<[f32; 3]>,
    variance: Vec<f32>,
}

/// How two images differ.
#[derive(Clone, Copy, Debug)]
struct Difference {
    /// sum(ours - theirs) / sum(theirs).
    bias: f64,
    /// Standard error of the bias. The channels' noise is taken to be one and the same, which can only overstate it.
    error: f64,
    /// Root mean square difference over the root of the mean predicted variance.
    noise_ratio: f64,
}

impl Difference {
    fn new(ours: &Image, theirs: &Image) -> Self {
        assert_eq!(ours.rgb.len(), theirs.rgb.len());
        let (mut sum, mut theirs_sum, mut squares) = (0.0, 0.0, 0.0);
        for (a, b) in ours.rgb.as_flattened().iter().zip(theirs.rgb.as_flattened()) {
            let d = f64::from(a - b);
            sum += d;
            squares += d * d;
            theirs_sum += f64::from(*b);
        }
        let variance: f64 = ours.variance.iter().chain(&theirs.variance).map(|&v| f64::from(v)).sum();
        Self {
            bias: sum / theirs_sum,
            error: 3.0 * variance.sqrt() / theirs_sum,
            noise_ratio: (squares / (3.0 * variance)).sqrt(),
        }
    }

    fn deviation(&self) -> f64 {
        self.bias.abs() / self.error
    }

    fn is_noise(&self) -> bool {
        self.bias.abs() <= LARGEST_BIAS
            && self.deviation() <= LARGEST_DEVIATION
            && (NOISE_RATIO[0]..=NOISE_RATIO[1]).contains(&self.noise_ratio)
    }
}

/// Mitsuba's images, or why there are none.
fn render(scenes: &[Scene], extent: &Extent) -> Result<Vec<Rendered>, String> {
    let python = python_environment::named("mitsuba-environment", &REQUIREMENTS)?;
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/mitsuba_render.py");
    let one = |scene: &Scene| -> Rendered {
        let folder = tempfile::tempdir().unwrap();
        let [input, output] = ["scene.json", "result.json"].map(|name| folder.path().join(name));
        std::fs::write(&input, serde_json::to_vec(&scene.json(extent)).unwrap()).unwrap();
        let rendered = python.script(&script).args([&input, &output]).output().unwrap();
        assert!(rendered.status.success(), "{}", String::from_utf8_lossy(&rendered.stderr));
        serde_json::from_slice(&std::fs::read(output).unwrap()).unwrap()
    };
    // A process each: a reflectance in Python runs on one thread a process.
    std::thread::scope(|scope| {
        let renders: Vec<_> = scenes.iter().map(|scene| scope.spawn(|| one(scene))).collect();
        Ok(renders.into_iter().map(|render| render.join().unwrap()).collect())
    })
}

#[test]
fn mitsuba_renders_the_same_images() {
    let full = std::env::var(EXTENT).is_ok_and(|extent| extent == "full");
    let extent = if full {
        Extent { side: 64, views: (0..PAIRS.len()).flat_map(|pair| [(pair, 0), (pair, 1)]).collect() }
    } else {
        Extent { side: 32, views: vec![(1, 0), (2, 1)] }
    };
    let scenes = scenes();
    let rendered = match render(&scenes, &extent) {
        Ok(rendered) => rendered,
        Err(problem) => {
            println!("SKIPPED: the comparison with Mitsuba 3 needs its Python package: {problem}");
            return;
        }
    };
    let mut table = String::from(HEAD);
    let mut failed = Vec::new();
    for (scene, images) in scenes.iter().zip(&rendered) {
        for (&(pair, bounces), theirs) in extent.views.iter().zip(&images.images) {
            let difference = Difference::new(&scene.image(extent.side, pair, bounces, 0.0), theirs);
            let row = row(scene, pair, bounces, &difference);
            if !difference.is_noise() {
                failed.push(row.clone());
            }
            table += &row;
        }
    }
    println!("Mitsuba {}\n{table}", rendered[0].version);
    assert!(failed.is_empty(), "differ by more than noise:\n{HEAD}{}", failed.concat());
}

const HEAD: &str = "| material | light | viewer | bounces | mean difference | in standard errors | RMSE / predicted noise |
|---|---|---|---|---|---|---|
";

fn row(scene: &Scene, pair: usize, bounces: usize, difference: &Difference) -> String {
    let [[i, phi_i], [o, phi_o]] = PAIRS[pair];
    let mut row = format!("| {} | {i:.0}°, {phi_i:.0}° | {o:.0}°, {phi_o:.0}° | {bounces} ", scene.name);
    let (percent, deviation) = (100.0 * difference.bias, difference.bias / difference.error);
    writeln!(row, "| {percent:+.2} % | {deviation:+.1} | {:.2} |", difference.noise_ratio).unwrap();
    row
}
