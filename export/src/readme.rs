//! `README.txt`: one page made for a material, for the person who opens the folder.

use crate::bundle::{
    DECODER, EVALUATE, GOLDEN, MATERIAL, MODEL, PDF, PREPARE, SAMPLE, SAMPLER, SAMPLER_GOLDEN, SIDECAR,
};
use crate::sidecar::Sidecar;
use crate::weights;
use std::fmt::Write;

/// The page of a bundle.
pub fn page(sidecar: &Sidecar) -> String {
    let [height, width] = sidecar.resolution;
    let mut page = format!(
        "{}: a neural material ({height} x {width} texels, {} levels)\n\n",
        sidecar.material, sidecar.levels
    );
    files(&mut page, sidecar);
    if let Some(domain) = &sidecar.domain {
        page.push_str("\nFITTED FOR ONE SCENE\n");
        for line in &domain.meaning {
            paragraph(&mut page, "- ", line);
        }
    }
    page.push_str("\nCONVENTIONS\n");
    for line in &sidecar.conventions {
        paragraph(&mut page, "- ", line);
    }
    page.push_str("\nCOST\n");
    let cost = &sidecar.cost;
    paragraph(
        &mut page,
        "- ",
        &format!(
            "{} floating-point operations a query in its networks ({} weights), and two trilinear lookups at most.",
            cost.flops_per_query, cost.network_weights
        ),
    );
    paragraph(
        &mut page,
        "- ",
        &format!(
            "{} bytes: {} texture values and the weights, as they are stored.",
            cost.bytes, cost.texture_values
        ),
    );
    errors(&mut page, sidecar);
    page.push_str("\nTO EVALUATE (all numbers are in material.json)\n");
    for (step, line) in sidecar.evaluate.iter().enumerate() {
        paragraph(&mut page, &format!("{}. ", step + 1), line);
    }
    if let Some(sampler) = &sidecar.sampler {
        page.push_str("\nTO SAMPLE wi BY IMPORTANCE\n");
        for (step, line) in sampler.evaluate.iter().enumerate() {
            paragraph(&mut page, &format!("{}. ", step + 1), line);
        }
    }
    page.push_str(
        "\nTO CHECK\n\
         - neumip export BUNDLE --check runs the golden answers through every file that can be run.\n\
         - python neumip_onnx.py BUNDLE --check does so with numpy and onnxruntime; the script is\n\
         \x20 export/consumers/python/neumip_onnx.py in the neumip repository.\n",
    );
    page
}

fn files(page: &mut String, sidecar: &Sidecar) {
    let extents = if sidecar.neighbourhood.is_some() { "N, H, W" } else { "N" };
    let channels = sidecar.architecture.model.texture.channels;
    let mut list = vec![
        (
            MATERIAL.to_string(),
            format!("the whole material: u, wi, wo [{extents}, 2], level [{extents}] -> rgb [{extents}, 3]"),
        ),
        (
            DECODER.into(),
            format!(
                "the network alone, for renderers that look textures up: features [{extents}, {channels}] first"
            ),
        ),
    ];
    if sidecar.graphs.iter().any(|graph| graph.file == PREPARE) {
        list.push((PREPARE.into(), "what does not depend on the light: u, wo, level -> partial sums".into()));
        list.push((EVALUATE.into(), "the rest, once a light: partial sums, wi -> rgb".into()));
    }
    if sidecar.sampler.is_some() {
        list.push((SAMPLE.into(), "importance sampling: lobes from prepare.onnx, xi -> wi, pdf".into()));
        list.push((PDF.into(), "its density: lobes, wi -> pdf".into()));
        list.push((SAMPLER.into(), format!("the sampler's network; {SAMPLER_GOLDEN}: what it gives")));
    }
    list.push((
        "*.exr".into(),
        format!(
            "{} files of neural textures: half floats, four channels, mip levels",
            sidecar.textures.len()
        ),
    ));
    if sidecar.weights.is_some() {
        let both = format!("{}, {}", weights::SINGLE, weights::HALF);
        list.push((both, format!("the networks row by row, padded to {}", weights::PAD)));
    }
    if !sidecar.shaders.is_empty() {
        let what = "source for shaders: GLSL ES 3.00, GLSL 4.50, WGSL, HLSL; exact, and fast: half floats, hardware filtering";
        list.push(("exact.*, fast.*".into(), what.into()));
    }
    list.push((MODEL.into(), "all weights and textures as 32-bit floats".into()));
    list.push((SIDECAR.into(), "conventions, interfaces, costs, errors, checksums, steps".into()));
    list.push((
        GOLDEN.into(),
        "queries and answers; a reader is right where |difference| <= tolerance (1 + |rgb|)".into(),
    ));
    for (name, what) in list {
        if name.len() > NAMES {
            let _ = writeln!(page, "{name}\n{:NAMES$}  {what}", "");
        } else {
            let _ = writeln!(page, "{name:NAMES$}  {what}");
        }
    }
}

/// Width of the column of names.
const NAMES: usize = 19;
/// Width of the page.
const WIDTH: usize = 110;

/// The table of errors: a row a split, a column a metric; nested tables (levels) are left to material.json.
fn errors(page: &mut String, sidecar: &Sidecar) {
    let splits = sidecar.errors.as_object().into_iter().flatten();
    let rows: Vec<(&String, Vec<(&String, f64)>)> = splits
        .filter_map(|(split, metrics)| {
            let numbers = metrics.as_object()?.iter().filter_map(|(name, v)| Some((name, v.as_f64()?)));
            Some((split, numbers.collect()))
        })
        .collect();
    page.push_str("\nERROR against the reference, on held-out directions (linear RGB)\n");
    if rows.iter().all(|(_, metrics)| metrics.is_empty()) {
        paragraph(page, "- ", "not recorded in the checkpoint");
    }
    for (split, metrics) in rows.iter().filter(|(_, metrics)| !metrics.is_empty()) {
        let list: Vec<String> = metrics.iter().map(|(name, value)| format!("{name} {value:.3e}")).collect();
        paragraph(page, "- ", &format!("{split}: {}", list.join(", ")));
    }
    match &sidecar.rounding {
        None => {
            paragraph(page, "- ", "Only the EXR files and weights-f16.bin are rounded, to half floats.");
        }
        Some(rounding) => paragraph(
            page,
            "- ",
            &format!(
                "All files hold rounded numbers. That moved the golden answers by at most {:.1e} (1 + |value|), {:.1e} \
                 (1 + |value|) in the mean.",
                rounding.largest_difference, rounding.mean_difference
            ),
        ),
    }
}

/// Writes a text with a mark before it, its lines broken and indented.
fn paragraph(page: &mut String, mark: &str, text: &str) {
    let mut line = mark.to_string();
    let mut begun = false;
    for word in text.split_whitespace() {
        if begun && line.chars().count() + 1 + word.chars().count() > WIDTH {
            let _ = writeln!(page, "{line}");
            line = " ".repeat(mark.chars().count());
            begun = false;
        }
        if begun {
            line.push(' ');
        }
        line.push_str(word);
        begun = true;
    }
    let _ = writeln!(page, "{line}");
}
