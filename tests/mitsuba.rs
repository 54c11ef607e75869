//! The ground truth against Mitsuba 3, a renderer that we did not write: the same geometry, reflectance and light, image by
//! image. Without network or Python the comparison is skipped, and says so.
//!
//! ```text
//! NEUMIP_MITSUBA=full cargo test --release --test promises mitsuba -- --nocapture
//! ```
//! renders every pair of directions at full size and writes `docs/mitsuba.md` and its pictures.

mod scenes;

use crate::python_environment::{self, Python};
use neumip::query::{QueryBuffer, RgbImage, above_horizon};
use neumip::random::{Random, Stream};
use neumip::reference::{Reference, ReferenceOptions, Sampling};
use neumip::report::picture;
use scenes::{Scene, scenes};
use serde::Deserialize;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// The releases whose `hair`, `bsplinecurve` and Python interface are known to work, and what the consumer's deferred
/// shading runs its graph in: one environment for all tests with Mitsuba.
const REQUIREMENTS: [&str; 3] = ["mitsuba>=3.9,<4", "numpy>=1.26,<3", "onnxruntime>=1.20,<2"];
/// Set to `full`, renders everything and writes the docs.
const EXTENT: &str = "NEUMIP_MITSUBA";

/// Largest |sum(ours - theirs) / sum(theirs)|: two renderers of one scene differ by noise and by how they leave a surface.
const LARGEST_BIAS: f64 = 0.01;
/// The same, in standard errors of both.
const LARGEST_DEVIATION: f64 = 3.0;
/// Largest bias where Mitsuba has triangles for what is smooth here. That shows long before it matters: the standard error
/// is a hundredth of a percent there. Measured: 0.11 %.
const LARGEST_FACETING: f64 = 0.002;
/// Root mean square difference over the noise that both predict: 1 if all of the difference is noise and no more noise
/// is predicted than there is.
const NOISE_RATIO: [f64; 2] = [0.8, 1.3];
/// What the twins change: the light's polar angle in degrees, and the factor on the roughness.
const TILT: f64 = 2.0;
const ROUGHER: f32 = 1.1;

/// Our samples a pixel.
const SPP: usize = 256;
/// Independent renders of Mitsuba, whose spread says how noisy their mean is, and samples a pixel in each.
const RENDERS: usize = 4;
const RENDER_SPP: usize = 25;
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

fn direction([polar, azimuth]: [f64; 2]) -> [f32; 2] {
    let (sin, cos) = azimuth.to_radians().sin_cos();
    [cos, sin].map(|c| (polar.to_radians().sin() * c) as f32)
}

impl Scene {
    /// As `mitsuba_render.py` reads it.
    fn json(&self, extent: &Extent) -> Value {
        let view = |&(pair, bounces): &(usize, usize)| {
            let [wi, wo] = PAIRS[pair].map(direction);
            json!({ "wi": wi, "wo": wo, "bounces": bounces })
        };
        json!({
            "parts": self.parts_json(),
            "height_range": self.reference(0, extent.side).height_range(),
            "repeat": REPEAT,
            "side": extent.side,
            "spp": RENDER_SPP,
            "renders": RENDERS,
            "views": extent.views.iter().map(view).collect::<Vec<_>>(),
        })
    }

    fn reference(&self, bounces: usize, side: usize) -> Reference {
        let resolution = Some([side; 2]);
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

    /// `stands_in`: Mitsuba has triangles for what is smooth here.
    fn is_noise(&self, stands_in: bool) -> bool {
        let unbiased = if stands_in {
            self.bias.abs() <= LARGEST_FACETING
        } else {
            self.bias.abs() <= LARGEST_BIAS && self.bias.abs() <= LARGEST_DEVIATION * self.error
        };
        unbiased && (NOISE_RATIO[0]..=NOISE_RATIO[1]).contains(&self.noise_ratio)
    }
}

/// The interpreter that has Mitsuba, or why there is none.
pub fn environment() -> Result<Python, String> {
    python_environment::named("mitsuba-environment", &REQUIREMENTS)
}

/// Mitsuba's images, or why there are none.
fn render(scenes: &[Scene], extent: &Extent) -> Result<Vec<Rendered>, String> {
    let python = environment()?;
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
fn the_comparison_tells_noise_from_error() {
    // 1 / sqrt(3 * 4096) of the noise is left in a mean: a tenth of the largest bias.
    const NOISE: f32 = 0.1;
    let image = |seed: u64, noise: f32, scale: f32| {
        let mut random = Random::new(seed, Stream::Probe, 0);
        let mut pixel = || [(); 3].map(|()| scale * (1.0 + noise * random.normal()));
        Image { rgb: (0..4096).map(|_| pixel()).collect(), variance: vec![NOISE * NOISE; 4096] }
    };
    let is_noise = |ours: &Image| Difference::new(ours, &image(1, NOISE, 1.0)).is_noise(false);
    assert!(is_noise(&image(2, NOISE, 1.0)));
    assert!(!is_noise(&image(2, NOISE, 1.015)), "brighter");
    assert!(!is_noise(&image(2, 1.7 * NOISE, 1.0)), "noisier than predicted");
    assert!(!is_noise(&image(1, NOISE, 1.0)), "equal: the predicted noise is not there");
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
            if !difference.is_noise(scene.replaced.is_some()) {
                failed += &row;
            }
            table += &row;
            columns.push((view, ours, theirs));
        }
        if full {
            let shown =
                columns.iter().filter(|((pair, bounces), ..)| *bounces == 1 && SHOWN_PAIRS.contains(pair));
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
            if difference.is_noise(scene.replaced.is_some()) {
                missed += &row;
            }
            twins += &row;
        };
        twin("light tilted", scene.image(extent.side, view, TILT));
        if scene.glossy {
            twin("rougher", scene.rougher(ROUGHER).image(extent.side, view, 0.0));
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

/// Pairs that the docs show: enough for the eye, and under a megabyte.
const SHOWN_PAIRS: std::ops::RangeInclusive<usize> = 1..=4;
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
Lambert; the layered GGX is written again in Python over Mitsuba's own microfacets (`tests/mitsuba_render.py`); fibres are
`bsplinecurve` with `hair`, ours are polylines along the same splines. The tile stands {tiles} x {tiles} times beside itself.

- **mean difference**: sum(ours - theirs) / sum(theirs); at most {bias:.0} % and {LARGEST_DEVIATION:.0} standard errors, by the noise of both.
  For `field`, whose smooth patches Mitsuba gets as {patch} triangles each, at most {faceting:.1} %. Our noise is the variance stored
  with every answer ({SPP} samples a pixel), Mitsuba's is the spread of {RENDERS} independent renders of {RENDER_SPP} samples a pixel.
- **RMSE / predicted noise**: {low} to {high}; 1 if the images differ by noise alone and as much noise is predicted as there is.

Directions are a polar angle and an azimuth. Pictures: ours, Mitsuba's, ten times their difference around grey; a column for
the second pair to the fifth, with one bounce.
",
        tiles = 2 * REPEAT + 1,
        bias = 100.0 * LARGEST_BIAS,
        faceting = 100.0 * LARGEST_FACETING,
        patch = 2 * scenes::PATCH_FINENESS * scenes::PATCH_FINENESS,
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
