//! The ground truth against Mitsuba 3, a renderer that we did not write: the same geometry, reflectance and light, image by
//! image. Without network or Python the comparison is skipped, and says so.
//!
//! ```text
//! NEUMIP_MITSUBA=full cargo test --release --test promises mitsuba -- --nocapture
//! ```
//! renders every pair of directions at full size and writes `docs/mitsuba.md` and its pictures.

use crate::python_environment;
use neumip::query::{QueryBuffer, RgbImage, above_horizon};
use neumip::reference::bvh::{Curve, TriangleMesh};
use neumip::reference::fibre_shading::FibreBsdf;
use neumip::reference::{
    FibreLook, Layer, Material, Paint, Part, Reference, ReferenceOptions, Sampling, Texture, builtin,
};
use neumip::report::picture;
use serde::Deserialize;
use serde_json::{Value, json};
use std::f64::consts::TAU;
use std::fmt::Write;
use std::path::{Path, PathBuf};

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
/// Samples a side of the field that stays one, and triangles that stand for its patches in Mitsuba, along either side of one.
/// At 2, 4, 8 and 16 the images differ by 1.02, 0.23, 0.03 and -0.02 %.
const PATCHES_SIDE: usize = 24;
const PATCH_FINENESS: usize = 8;
/// Our samples a pixel.
const SPP: usize = 256;
/// Independent renders of Mitsuba, whose spread says how noisy their mean is, and samples a pixel in each.
const RENDERS: usize = 4;
const RENDER_SPP: usize = 16;
/// Copies of the tile to every side in Mitsuba, where it does not repeat. At 70 degrees light comes from 2.7 heights away,
/// and no surface here is a fifth of a tile high.
const REPEAT: usize = 2;

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
    /// What Mitsuba gets instead of the parts, where it has not the like.
    replaced: Option<Vec<Part>>,
    /// What the material's fibres are sampled from.
    splines: Vec<Spline>,
    /// Roughness matters.
    glossy: bool,
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

/// The layer of a built-in material, rougher by `roughen`: sharp glints on small faces make noise of which no estimate can be
/// trusted.
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

fn scenes() -> [Scene; 5] {
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
            "parts": self.replaced.as_ref().unwrap_or(&self.material.parts).iter().map(part).collect::<Vec<_>>(),
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

    /// Our image of a view whose light's polar angle is off by `tilt` degrees.
    fn image(&self, side: usize, (pair, bounces): (usize, usize), tilt: f64) -> Image {
        let [[polar, azimuth], wo] = PAIRS[pair];
        let (wi, wo) = (direction([polar + tilt, azimuth]), direction(wo));
        assert!(above_horizon(wi) && above_horizon(wo));
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
                Part::Mesh(_, paint) => paint.roughness = texels(&paint.roughness, |r| r * ROUGHER),
                other => panic!("{other:?} has no roughness here"),
            }
        }
        Self { material, replaced: None, splines: Vec::new(), ..*self }
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
    let (mut table, mut failed) = (String::from(HEAD), String::new());
    for (scene, theirs) in scenes.iter().zip(&rendered) {
        let mut columns = Vec::new();
        for (&view, theirs) in extent.views.iter().zip(&theirs.images) {
            let ours = scene.image(extent.side, view, 0.0);
            let difference = Difference::new(&ours, theirs);
            let row = row(scene.name, view, &difference);
            if !difference.is_noise() {
                failed += &row;
            }
            table += &row;
            columns.push((view, ours, theirs));
        }
        if full {
            let shown = columns.iter().filter(|((_, bounces), ..)| *bounces == 1);
            picture(scene, extent.side, shown.map(|(_, ours, theirs)| [ours, *theirs]));
        }
    }
    println!("Mitsuba {}\n{table}", rendered[0].version);
    if full {
        let page = page(&scenes, &rendered[0].version, &table);
        std::fs::write(docs("mitsuba.md"), page).unwrap();
    }
    assert!(failed.is_empty(), "differ by more than noise:\n{HEAD}{failed}");

    // The same comparison finds small mistakes.
    let mut twins = String::from(HEAD);
    let mut missed = String::new();
    for (scene, theirs) in scenes.iter().zip(&rendered) {
        let (view, theirs) = (extent.views[0], &theirs.images[0]);
        let mut twin = |change: &str, ours: Image| {
            let difference = Difference::new(&ours, theirs);
            let row = row(&format!("{}, {change}", scene.name), view, &difference);
            if difference.is_noise() {
                missed += &row;
            }
            twins += &row;
        };
        twin("light tilted", scene.image(extent.side, view, TILT));
        if scene.glossy {
            twin("rougher", scene.rougher().image(extent.side, view, 0.0));
        }
    }
    println!("Twins that must differ:\n{twins}");
    assert!(missed.is_empty(), "are taken for the same:\n{HEAD}{missed}");
}

const HEAD: &str =
    "| material | light | viewer | bounces | mean difference | in standard errors | RMSE / predicted noise |
|---|---|---|---|---|---|---|
";

fn row(name: &str, (pair, bounces): (usize, usize), difference: &Difference) -> String {
    let [[i, phi_i], [o, phi_o]] = PAIRS[pair];
    let mut row = format!("| {name} | {i:.0}°, {phi_i:.0}° | {o:.0}°, {phi_o:.0}° | {bounces} ");
    let (percent, deviation) = (100.0 * difference.bias, difference.bias / difference.error);
    writeln!(row, "| {percent:+.2} % | {deviation:+.1} | {:.2} |", difference.noise_ratio).unwrap();
    row
}

fn docs(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs").join(name)
}

/// Rows: ours, Mitsuba's, ten times their difference around grey. A column a pair.
fn picture<'a>(scene: &Scene, side: usize, columns: impl Iterator<Item = [&'a Image; 2]>) {
    let mut rows = vec![Vec::new(); 3];
    for images in columns {
        let mean = images[1].rgb.as_flattened().iter().sum::<f32>() / (3 * images[1].rgb.len()) as f32;
        let show = |pixel: &dyn Fn(usize) -> [f32; 3]| {
            let pixels = (0..images[0].rgb.len()).map(|k| pixel(k).map(|v| v * SHOWN_MEAN / mean)).collect();
            let image = RgbImage { height: side, width: side, pixels };
            picture::enlarged(&picture::srgb(&image, 0.0).unwrap(), 2).unwrap()
        };
        let [ours, theirs] = images.map(|image| &image.rgb);
        let grey = SHOWN_GREY * mean / SHOWN_MEAN;
        rows[0].push(show(&|k| ours[k]));
        rows[1].push(show(&|k| theirs[k]));
        rows[2].push(show(&|k| std::array::from_fn(|c| grey + 10.0 * (ours[k][c] - theirs[k][c]))));
    }
    let sheet = picture::png(&picture::sheet(&rows).unwrap()).unwrap();
    std::fs::write(docs(&format!("mitsuba-{}.png", scene.name)), sheet).unwrap();
}

/// Linear value that a picture's mean is shown as, and that stands for no difference.
const SHOWN_MEAN: f32 = 0.18;
const SHOWN_GREY: f32 = 0.214;

fn page(scenes: &[Scene], version: &str, table: &str) -> String {
    let mut page = format!(
        "# Against Mitsuba {version}

The reference renders what Mitsuba 3 renders, to within the noise that both predict.

```sh
{EXTENT}=full cargo test --release --test promises mitsuba -- --nocapture
```

makes this page; without the variable two pairs of directions at a quarter of the pixels are compared. The test installs
Mitsuba into an environment of its own, uses its variant `scalar_rgb`, which needs nothing else, and is skipped with the
reason where that fails.

Both get the same triangles, face normals, maps and curves, an orthographic view whose pixels are the texels of the plane
z = 0, and a distant light of irradiance 1 on a plane facing it. Mitsuba's `path` follows as many bounces; `diffuse` is
Lambert, the layered GGX is written again in Python over Mitsuba's own microfacets (`tests/mitsuba_render.py`), fibres are
`bsplinecurve` with `hair`. The tile stands {tiles} x {tiles} times beside itself.

- **mean difference**: sum(ours - theirs) / sum(theirs); at most {bias:.0} % and {LARGEST_DEVIATION:.0} standard errors, by the noise of
  both. Ours comes from the variance stored with every answer ({SPP} samples a pixel), Mitsuba's from {RENDERS} independent renders of
  {RENDER_SPP} samples a pixel.
- **RMSE / predicted noise**: {low} to {high}. 1 if the images differ by noise alone and no more noise is predicted than there is.

Directions are a polar angle and an azimuth. Pictures: ours, Mitsuba's, ten times their difference around grey; a column a pair,
one bounce.
",
        tiles = 2 * REPEAT + 1,
        bias = 100.0 * LARGEST_BIAS,
        low = NOISE_RATIO[0],
        high = NOISE_RATIO[1],
    );
    for Scene { name, what, .. } in scenes {
        write!(page, "\n## {name}: {what}\n\n![ours, Mitsuba, difference](mitsuba-{name}.png)\n\n{HEAD}")
            .unwrap();
        for row in table.lines().filter(|row| row.starts_with(&format!("| {name} |"))) {
            writeln!(page, "{row}").unwrap();
        }
    }
    page
}
