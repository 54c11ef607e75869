//! A bundle's viewer: one self-contained page that answers queries by the material's own shaders.
//!
//! ```text
//! bundle ─ numbers (weights, textures, golden answers) ─┐
//!        └ shader source, exact and fast ───────────────┤
//! page.html, page.css, *.js, *.glsl ────────────────────┴─ html
//! ```
//!
//! The page needs WebGL 2 and nothing else: no network, no other file. `engine.js` draws, `lights.js` says what shines,
//! `selftest.js` compares the golden answers, `page.js` is what a person sees. Shapes, their positions and frames are those
//! of Mitsuba's plane and sphere, which the shader meets in closed form; torus and cloth are triangles.

mod numbers;

use crate::error::{Error, Result};
use crate::query::{QueryBuffer, RgbImage};
use crate::report::{escaped, filled, inert};
use neumip_export::shader::{self, Language, Material, Mode};
use neumip_export::weights::Layout;
use neumip_export::{Bundle, Measure};
use serde::Serialize;
use std::collections::BTreeMap;

/// Most pixels of a reference frame: 34 bytes each, and more is not seen on a screen.
pub const MOST_PIXELS: usize = 1 << 20;

/// A frame of queries with true answers, for the view of errors.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// What it is called.
    pub name: String,
    /// What is asked, a query a pixel.
    pub queries: QueryBuffer,
    /// The answers, of the same shape.
    pub rgb: RgbImage,
}

#[derive(Serialize)]
struct Page<'a> {
    name: &'a str,
    resolution: [usize; 2],
    levels: usize,
    coarsest: usize,
    /// Whether the cosine of the light is in the answers.
    cosine: bool,
    flops: usize,
    bytes: usize,
    tolerance: f64,
    numbers: numbers::Places,
    glsl: BTreeMap<&'static str, &'static str>,
    shader: Shader,
    reference: Option<PageReference<'a>>,
}

#[derive(Serialize)]
struct Shader {
    modes: BTreeMap<&'static str, String>,
}

#[derive(Serialize)]
struct PageReference<'a> {
    name: &'a str,
    width: usize,
    height: usize,
}

/// The page of a bundle.
///
/// # Errors
/// `Config`, naming the field: of a decoder that reads neighbours, which no shader can answer point by point, and of what is
/// too large for a page or not of one shape.
pub fn html(bundle: &Bundle, reference: Option<&Reference>) -> Result<String> {
    let header = &bundle.checkpoint.header;
    let architecture = &header.architecture;
    // Written into the source where there are not too many: some drivers check every read of a block.
    let weights = Layout::new(architecture, None).fill(&bundle.checkpoint, None)?;
    let material = Material {
        weights: Some(&weights[..]).filter(|w| w.len() <= shader::MOST_LITERALS),
        ..Material::new(&bundle.checkpoint, None)
    };
    let modes = [("exact", Mode::Exact), ("fast", Mode::Fast)];
    let modes = modes.map(|(name, mode)| Ok((name, shader::source(&material, Language::GlslEs, mode)?)));
    let modes = modes.into_iter().collect::<Result<_>>()?;
    let reference_of = reference.map(described).transpose()?;
    let (places, text) = numbers::pack(bundle, reference)?;
    let page = Page {
        name: &header.material,
        resolution: architecture.tile(),
        levels: architecture.levels(),
        coarsest: architecture.coarsest(),
        cosine: header.measure == Measure::RadianceCosine,
        flops: architecture.flops_per_query(),
        bytes: bundle.sidecar.cost.bytes,
        tolerance: bundle.golden.tolerance,
        numbers: places,
        glsl: BTreeMap::from([
            ("surface", include_str!("surface.glsl")),
            ("scene_vert", include_str!("scene.vert")),
            ("scene_frag", include_str!("scene.frag")),
            ("depth_frag", include_str!("depth.frag")),
            ("blend_frag", include_str!("blend.frag")),
            ("present_frag", include_str!("present.frag")),
        ]),
        shader: Shader { modes },
        reference: reference_of,
    };
    let data = serde_json::to_string(&page).map_err(|e| Error::config("page", e))?;
    let (title, data) = (escaped(&header.material), inert(&data));
    let parts = [
        ("TITLE", title.as_str()),
        ("STYLE", include_str!("page.css")),
        ("DATA", &data),
        ("NUMBERS", &text),
        ("ENGINE", include_str!("engine.js")),
        ("LIGHTS", include_str!("lights.js")),
        ("SELFTEST", include_str!("selftest.js")),
        ("SCRIPT", include_str!("page.js")),
    ];
    Ok(filled(include_str!("page.html"), &parts))
}

fn described(reference: &Reference) -> Result<PageReference<'_>> {
    let Reference { name, queries, rgb } = reference;
    let [height, width] = [queries.height(), queries.width()];
    if queries.is_empty() || [rgb.height, rgb.width, rgb.pixels.len()] != [height, width, height * width] {
        return Err(Error::config("reference", "needs an answer for every query, and at least one"));
    }
    if height * width > MOST_PIXELS {
        let problem = format!("{width} x {height} pixels are more than the {MOST_PIXELS} that a page takes");
        return Err(Error::config("reference", problem));
    }
    Ok(PageReference { name, width, height })
}
