//! What the WebGL sources answer, in a browser: every kind of material and its sampler against 64-bit floats, and a trained
//! material in both modes. Without Chromium or Python the comparison is skipped, and says so.

use super::lobes::{density, lobes, sample, sampler};
use super::materials::{self, Numbers, cases, checkpoint, queries};
use super::plain;
use neumip_export::config::{DecoderConfig, ParallaxConfig};
use neumip_export::sampler::Frame;
use neumip_export::shader::{Language, Material, Mode, file_name, files, source};
use neumip_export::weights::{Layout, SINGLE, single_bytes};
use neumip_export::{Checkpoint, Golden, Sampler};
use std::path::Path;
use std::process::Command;

/// Largest |difference| / (1 + |value|) of the exact source: the tolerance of golden answers.
const EXACT: f64 = 2e-5;
/// The same of the fast one, on a trained material: the hardware places a sample on 1/256 of a texel, and texels are half floats.
/// Measured: 2.3e-4. It is what the head of the source says.
const FAST: f64 = 1e-3;
/// The same of directions and densities. Measured: 3e-5, as narrow lobes make roundings larger; ten times that for others.
const SAMPLED: f64 = 3e-4;
/// What the twins change a weight by: a percent of one of usual size.
const CHANGED: f32 = 1e-2;
/// Queries of a material: as many as the golden ones.
const QUERIES: usize = 1024;
/// Exit status of the script where there is no browser.
const NO_BROWSER: i32 = 3;

/// The sources that are run, by path, and what is to come of them.
#[derive(Default)]
struct Jobs {
    names: Vec<String>,
    within: Vec<[f64; 2]>,
}

impl Jobs {
    /// A source whose largest difference is to be between two numbers.
    fn add(&mut self, path: &Path, queries: &str, within: [f64; 2]) {
        self.names.push(format!("{}{queries}", path.display()));
        self.within.push(within);
    }
}

/// A bundle's checkpoint, block of weights and answers in 64-bit floats.
fn write(folder: &Path, checkpoint: &Checkpoint, sampler: Option<&Sampler>) {
    std::fs::create_dir_all(folder).unwrap();
    checkpoint.write(&folder.join("model.safetensors")).unwrap();
    let mut golden = queries(&checkpoint.header.architecture, QUERIES, 5);
    golden.rgb = (0..QUERIES)
        .map(|k| {
            let (u, wi, wo, level) = (golden.u[k], golden.wi[k], golden.wo[k], golden.level[k]);
            let features = plain::features(checkpoint, u, wo, level);
            plain::decode(checkpoint, &features, u, wi, wo, level).map(|v| v as f32)
        })
        .collect();
    std::fs::write(folder.join("golden.json"), serde_json::to_vec(&golden).unwrap()).unwrap();
    let config = sampler.map(|sampler| &sampler.header.config);
    let block = Layout::new(&checkpoint.header.architecture, config).fill(checkpoint, sampler).unwrap();
    std::fs::write(folder.join(SINGLE), single_bytes(&block)).unwrap();
    if let Some(sampler) = sampler {
        std::fs::write(folder.join("drawn.json"), drawn(checkpoint, sampler, &golden)).unwrap();
    }
}

/// The queries with random numbers, and the directions and densities that come of them.
fn drawn(checkpoint: &Checkpoint, sampler: &Sampler, golden: &Golden) -> String {
    let mut numbers = Numbers::new(11);
    let xi: Vec<[f32; 2]> = (0..QUERIES).map(|_| [0; 2].map(|_| numbers.uniform())).collect();
    let answers: Vec<[f64; 4]> = (0..QUERIES)
        .map(|k| {
            let mut features = plain::features(checkpoint, golden.u[k], golden.wo[k], golden.level[k]);
            features.truncate(sampler.header.config.features);
            let lobes = lobes(sampler, &features, golden.wo[k]);
            let wi = sample(&lobes, xi[k]);
            [wi[0], wi[1], wi[2], density(&lobes, wi)]
        })
        .collect();
    let json = serde_json::json!({
        "u": golden.u, "level": golden.level, "wo": golden.wo, "xi": xi, "drawn": answers
    });
    json.to_string()
}

/// Writes all kinds of materials and adds their sources.
fn all_kinds(folder: &Path, jobs: &mut Jobs) {
    let frames = [Frame::Mirror, Frame::Surface, Frame::Mirror];
    for (k, (_, mut model, resolution)) in cases().into_iter().enumerate() {
        // Small networks: a browser takes long to compile large ones. Widths that do not fill a vector.
        model.decoder = DecoderConfig::Mlp { hidden: vec![13, 6] };
        if !model.encoding.pi {
            // As far as an encoding may go: angles of 2^23.
            model.encoding.u.bands = neumip_export::config::MAX_BANDS;
        }
        if let ParallaxConfig::Offset(offset) = &mut model.parallax {
            offset.hidden = vec![3 + k];
        }
        let checkpoint = checkpoint(&model, resolution, 40 + k as u64);
        let sampler = sampler(1 + (k + 2) % model.texture.channels, &frames[..1 + k % 3], 70 + k as u64);
        let sampler = (k % 2 > 0).then_some(&sampler);
        let folder = folder.join(k.to_string());
        write(&folder, &checkpoint, sampler);
        let bound = Material::new(&checkpoint, sampler.map(|s| &s.header.config));
        // The weights as a uniform block here and as numbers there.
        let text = match k % 3 {
            0 => source(&bound, Language::GlslEs, Mode::Exact).unwrap(),
            _ => files(&checkpoint, sampler).unwrap().swap_remove(0).1,
        };
        let path = folder.join(file_name(Language::GlslEs, Mode::Exact));
        std::fs::write(&path, text).unwrap();
        jobs.add(&path, "", [0.0, EXACT]);
        if sampler.is_some() {
            jobs.add(&path, "@drawn.json", [0.0, SAMPLED]);
        }
    }
}

/// Writes fitted materials and adds their sources, and those of the same with their window a texel further.
fn fitted(folder: &Path, jobs: &mut Jobs) {
    for (k, (_, mut checkpoint)) in materials::fitted().into_iter().enumerate() {
        let folder = folder.join(k.to_string());
        write(&folder, &checkpoint, None);
        let name = file_name(Language::GlslEs, Mode::Exact);
        for within in [[0.0, EXACT], [EXACT, f64::INFINITY]] {
            let path = folder.join(format!("exact{}.es.glsl", jobs.names.len()));
            let text =
                files(&checkpoint, None).unwrap().into_iter().find(|(file, _)| *file == name).unwrap().1;
            std::fs::write(&path, text).unwrap();
            jobs.add(&path, "", within);
            materials::misplace(&mut checkpoint);
        }
    }
}

/// Writes a trained material and adds its sources, and those of a neighbour of it that are to fail.
fn trained(folder: &Path, jobs: &mut Jobs) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/tiny.safetensors");
    let mut checkpoint = Checkpoint::read(&path).unwrap();
    let mut sampler = sampler(checkpoint.header.architecture.model.texture.channels, &[Frame::Mirror], 9);
    write(folder, &checkpoint, Some(&sampler));
    let [exact, fast] = Mode::ALL.map(|mode| file_name(Language::GlslEs, mode));
    let mut add = |checkpoint: &Checkpoint, sampler: &Sampler, prefix: &str, within: [[f64; 2]; 3]| {
        for (name, text) in files(checkpoint, Some(sampler)).unwrap() {
            let path = folder.join(format!("{}{prefix}.es.glsl", name.trim_end_matches(".es.glsl")));
            if name == exact {
                jobs.add(&path, "", within[0]);
                jobs.add(&path, "@drawn.json", within[1]);
            } else if name == fast {
                jobs.add(&path, "", within[2]);
            } else {
                continue;
            }
            std::fs::write(&path, text).unwrap();
        }
    };
    add(&checkpoint, &sampler, "", [[0.0, EXACT], [0.0, SAMPLED], [0.0, FAST]]);
    checkpoint.tensors.get_mut("decoder.mlp.1.weight").unwrap().data[30] += CHANGED;
    checkpoint.tensors.get_mut("decoder.mlp.3.bias").unwrap().data[0] += CHANGED;
    sampler.tensors.get_mut("sampler.mlp.2.bias").unwrap().data[3] += CHANGED;
    let beyond = |bound| [bound, f64::INFINITY];
    add(&checkpoint, &sampler, "-changed", [beyond(EXACT), beyond(SAMPLED), beyond(FAST)]);
}

#[test]
fn sources_answer_in_a_browser_and_changed_weights_are_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let mut jobs = Jobs::default();
    all_kinds(folder.path(), &mut jobs);
    fitted(&folder.path().join("fitted"), &mut jobs);
    trained(&folder.path().join("trained"), &mut jobs);
    let python = std::env::var_os("NEUMIP_PYTHON").unwrap_or_else(|| "python3".into());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/check_shader.py");
    let output = match Command::new(&python).arg("-B").arg(&script).args(&jobs.names).output() {
        Ok(output) => output,
        Err(e) => return eprintln!("skipped: {} cannot be run: {e}", python.display()),
    };
    let said = String::from_utf8_lossy(&output.stdout);
    if output.status.code() == Some(NO_BROWSER) {
        return eprintln!("skipped: {}", said.trim());
    }
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    let largest = said.lines().map(|line| {
        let words = line.split("largest ").nth(1).and_then(|rest| rest.split(' ').next());
        words.and_then(|number| number.parse::<f64>().ok()).unwrap_or_else(|| panic!("{line}"))
    });
    let largest: Vec<f64> = largest.collect();
    println!("{said}");
    assert_eq!(largest.len(), jobs.names.len(), "{said}");
    for ((name, within), found) in jobs.names.iter().zip(&jobs.within).zip(&largest) {
        assert!((within[0]..=within[1]).contains(found), "{name}: {found:e} is not in {within:?}\n{said}");
    }
}
