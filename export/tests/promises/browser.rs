//! What the WebGL sources answer, in a browser: every kind of material and its sampler against 64-bit floats, and a trained
//! material in both modes. Without Chromium or Python the comparison is skipped, and says so.

use super::materials::{Numbers, cases, checkpoint, queries};
use super::plain;
use neumip_export::config::{DecoderConfig, ParallaxConfig};
use neumip_export::sampler::{FORMAT, Frame, SAMPLER_MLP, SamplerHeader};
use neumip_export::shader::{Language, Material, Mode, file_name, files, source};
use neumip_export::weights::{Layout, SINGLE, single_bytes};
use neumip_export::{Checkpoint, Golden, Sampler, SamplerConfig, Tensor};
use std::f64::consts::PI;
use std::path::Path;
use std::process::Command;

/// Largest |difference| / (1 + |value|) of the exact source: the tolerance of golden answers.
const EXACT: f64 = 2e-5;
/// The same of the fast one, on a trained material: the hardware places a sample on 1/256 of a texel, and texels are half floats.
/// Measured: 2.3e-4. It is what the head of the source says.
const FAST: f64 = 1e-3;
/// The same of directions and densities. Measured: 4e-6, as steep lobes make roundings larger.
const SAMPLED: f64 = 2e-5;
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

fn sampler(features: usize, lobes: &[Frame], seed: u64) -> Sampler {
    let config =
        SamplerConfig { features, hidden: vec![9, 8], lobes: lobes.to_vec(), cosine_floor: 0.1, min_z: 0.1 };
    let mut numbers = Numbers::new(seed);
    let tensors = config.tensors().into_iter().map(|(name, shape)| {
        let data = (0..shape.iter().product()).map(|_| numbers.between(-0.6, 0.6)).collect();
        (name, Tensor { shape, data })
    });
    let tensors = tensors.collect();
    Sampler { header: SamplerHeader { format: FORMAT, config, provenance: serde_json::Value::Null }, tensors }
}

/// The queries with random numbers, and the directions and densities that come of them.
fn drawn(checkpoint: &Checkpoint, sampler: &Sampler, golden: &Golden) -> String {
    let mut numbers = Numbers::new(11);
    let xi: Vec<[f32; 3]> = (0..QUERIES).map(|_| [0; 3].map(|_| numbers.uniform())).collect();
    let answers: Vec<[f64; 4]> = (0..QUERIES)
        .map(|k| {
            // Below the horizon nothing is drawn, and features are of no use there.
            let lobes = lobes(checkpoint, sampler, golden.u[k], golden.wo[k], golden.level[k]);
            sampled(&lobes, xi[k].map(f64::from))
        })
        .collect();
    let json = serde_json::json!({
        "u": golden.u, "level": golden.level, "wo": golden.wo, "xi": xi, "drawn": answers
    });
    json.to_string()
}

/// One lobe: weight, matrix, centre.
struct Lobe(f64, [[f64; 2]; 2], [f64; 2]);

fn lobes(checkpoint: &Checkpoint, sampler: &Sampler, u: [f32; 2], wo: [f32; 2], level: f32) -> Vec<Lobe> {
    let config = &sampler.header.config;
    let mut x = plain::features(checkpoint, u, wo, level);
    x.truncate(config.features);
    x.extend(wo.map(f64::from));
    let layers = config.hidden.len() + 1;
    for layer in 0..layers {
        let weight = &sampler.tensors[&format!("{SAMPLER_MLP}.{layer}.weight")];
        let bias = &sampler.tensors[&format!("{SAMPLER_MLP}.{layer}.bias")];
        let rows = weight.data.chunks(weight.shape[1]).zip(&bias.data);
        let sums = rows.map(|(row, bias)| {
            f64::from(*bias) + row.iter().zip(&x).map(|(w, x)| f64::from(*w) * x).sum::<f64>()
        });
        x = sums.map(|v| if layer + 1 < layers { v.max(0.0) } else { v }).collect();
    }
    let wo = wo.map(f64::from);
    let z = (1.0 - wo[0] * wo[0] - wo[1] * wo[1]).max(0.0).sqrt().max(f64::from(config.min_z));
    let m = wo.map(|w| -w / z);
    let g = (1.0 + m[0] * m[0] + m[1] * m[1]).sqrt();
    let t = [0, 1].map(|i| [0, 1].map(|j| g * (f64::from(u8::from(i == j)) + m[i] * m[j] / (1.0 + g))));
    let logits: Vec<f64> = x.chunks(6).map(|o| o[0].clamp(-20.0, 20.0).exp()).collect();
    let total = 1.0 + logits.iter().sum::<f64>();
    let floor = f64::from(config.cosine_floor);
    let mut lobes = vec![Lobe(floor + (1.0 - floor) / total, [[1.0, 0.0], [0.0, 1.0]], [0.0; 2])];
    for (k, o) in x.chunks(6).enumerate() {
        let c = [o[1].clamp(-8.0, 8.0), o[2].clamp(-8.0, 8.0)];
        let (p, r, q) = (o[3].clamp(-6.0, 2.0), o[4].clamp(-4.0, 4.0), o[5].clamp(-6.0, 2.0));
        let l = [[p.exp(), 0.0], [r * p.exp(), q.exp()]];
        let (a, b) = match config.lobes[k] {
            Frame::Surface => (l, c),
            Frame::Mirror => (
                [0, 1].map(|i| [0, 1].map(|j| t[i][0] * l[0][j] + t[i][1] * l[1][j])),
                [0, 1].map(|i| m[i] + t[i][0] * c[0] + t[i][1] * c[1]),
            ),
        };
        lobes.push(Lobe((1.0 - floor) * logits[k] / total, a, b));
    }
    lobes
}

fn sampled(lobes: &[Lobe], xi: [f64; 3]) -> [f64; 4] {
    let mut rest = xi[0];
    let chosen = lobes.iter().position(|lobe| {
        rest -= lobe.0;
        rest < 0.0
    });
    let Lobe(_, a, b) = &lobes[chosen.unwrap_or(lobes.len() - 1)];
    let radius = xi[1].sqrt() / (1.0 - xi[1]).sqrt();
    let t = [radius * (2.0 * PI * xi[2]).cos(), radius * (2.0 * PI * xi[2]).sin()];
    let s = [0, 1].map(|i| a[i][0] * t[0] + a[i][1] * t[1] + b[i]);
    let length = (1.0 + s[0] * s[0] + s[1] * s[1]).sqrt();
    let (x, y, z) = (s[0] / length, s[1] / length, 1.0 / length);
    let density = lobes.iter().map(|Lobe(weight, a, b)| {
        let det = a[0][0] * a[1][1] - a[0][1] * a[1][0];
        let d = [x - b[0] * z, y - b[1] * z];
        let v = [(a[1][1] * d[0] - a[0][1] * d[1]) / det, (a[0][0] * d[1] - a[1][0] * d[0]) / det];
        weight * z / (PI * det.abs() * (z * z + v[0] * v[0] + v[1] * v[1]).powi(2))
    });
    [x, y, z, density.sum()]
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
