//! Shader sources of every kind of material are programs: compilers that we did not write accept them, and refuse broken
//! ones. What they answer is tested in a browser, by the tests of the whole.

use super::materials::{cases, fitted, image_cases};
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{ShaderStage, front};
use neumip_export::sampler::Frame;
use neumip_export::shader::{Language, Material, Mode, file_name, source};
use neumip_export::{Architecture, Measure, SamplerConfig};
use std::path::Path;
use std::process::Command;

const GLSLANG: &str = "glslangValidator";

/// A source and the name of what it is of.
struct Program {
    name: String,
    language: Language,
    text: String,
}

/// A fragment shader that calls every function.
fn program(name: &str, material: &Material, language: Language, mode: Mode) -> Program {
    let text = source(material, language, mode).unwrap();
    let call = match (language, material.sampler) {
        (_, None) => "",
        (Language::Wgsl, Some(_)) => {
            "let lobes = neumip_lobes(q); let drawn = neumip_sample(lobes, wi); \
             rgb += vec3<f32>(drawn.w + neumip_pdf(lobes, drawn.xyz));"
        }
        (Language::Hlsl, Some(_)) => {
            "NeumipLobes lobes = neumip_lobes(q); float4 drawn = neumip_sample(lobes, wi); \
             rgb += drawn.w + neumip_pdf(lobes, drawn.xyz);"
        }
        (_, Some(_)) => {
            "NeumipLobes lobes = neumip_lobes(q); vec4 drawn = neumip_sample(lobes, wi); \
             rgb += drawn.w + neumip_pdf(lobes, drawn.xyz);"
        }
    };
    let glsl = format!(
        "void main() {{ NeumipPrepared q = neumip_prepare(u, l, wo); vec3 rgb = neumip_evaluate(q, wi); {call} \
         answer = vec4(rgb, 1.0); }}\n"
    );
    let text = match language {
        Language::GlslEs => format!(
            "#version 300 es\n{text}in vec2 u;\nin vec2 wo;\nin vec2 wi;\nin float l;\nout vec4 answer;\n{glsl}"
        ),
        Language::Glsl => format!(
            "#version 450\n{text}layout(location = 0) in vec2 u;\nlayout(location = 1) in vec2 wo;\n\
             layout(location = 2) in vec2 wi;\nlayout(location = 3) in float l;\n\
             layout(location = 0) out vec4 answer;\n{glsl}"
        ),
        Language::Wgsl => format!(
            "{text}@fragment fn main(@location(0) u: vec2<f32>, @location(1) wo: vec2<f32>, @location(2) wi: vec2<f32>, \
             @location(3) l: f32) -> @location(0) vec4<f32> {{ let q = neumip_prepare(u, l, wo); \
             var rgb = neumip_evaluate(q, wi); {call} return vec4<f32>(rgb, 1.0); }}\n"
        ),
        Language::Hlsl => format!(
            "{text}float4 main(float2 u : A, float2 wo : B, float2 wi : C, float l : D) : SV_Target {{ \
             NeumipPrepared q = neumip_prepare(u, l, wo); float3 rgb = neumip_evaluate(q, wi); {call} \
             return float4(rgb, 1.0); }}\n"
        ),
    };
    Program { name: format!("{name}: {}", file_name(language, mode)), language, text }
}

/// Every case in a language: with the weights bound and without a sampler, and the other way round.
fn programs(language: Language) -> Vec<Program> {
    let samplers = [vec![Frame::Mirror], vec![Frame::Surface, Frame::Mirror, Frame::Mirror]];
    let mut out = Vec::new();
    for (k, (name, model, resolution)) in cases().into_iter().enumerate() {
        let architecture = Architecture::new(model, resolution).unwrap();
        let sampler = SamplerConfig {
            features: architecture.model.texture.channels,
            hidden: vec![16; 1 + k % 2],
            lobes: samplers[k % 2].clone(),
            cosine_floor: 0.1,
            min_z: 0.1,
        };
        let sampler = (k % 3 > 0).then_some(&sampler);
        let values = neumip_export::weights::Layout::new(&architecture, sampler).values;
        let block: Vec<f32> = (0..values).map(|i| (i as f32).sin() * 10f32.powi(i as i32 % 9 - 6)).collect();
        let weights = (k % 2 > 0).then_some(block.as_slice());
        let material = Material {
            name,
            measure: Measure::RadianceCosine,
            architecture: &architecture,
            sampler,
            weights,
        };
        out.extend(Mode::ALL.map(|mode| program(name, &material, language, mode)));
    }
    let fitted = fitted();
    for (name, checkpoint) in &fitted {
        let material = Material { name, ..Material::new(checkpoint, None) };
        out.extend(Mode::ALL.map(|mode| program(name, &material, language, mode)));
    }
    // More weights than a uniform block holds.
    let (_, mut model, _) = cases().swap_remove(0);
    model.decoder = neumip_export::config::DecoderConfig::Mlp { hidden: vec![96, 96] };
    let architecture = Architecture::new(model, [512, 256]).unwrap();
    let material = Material {
        name: "wide",
        measure: Measure::Reflectance,
        architecture: &architecture,
        sampler: None,
        weights: None,
    };
    out.extend(Mode::ALL.map(|mode| program("wide", &material, language, mode)));
    out
}

/// The same, broken.
fn broken(program: &Program) -> Program {
    let text = program.text.replace("neumip_evaluate(q, wi)", "neumip_evaluate(q)");
    assert_ne!(text, program.text);
    Program { name: format!("broken {}", program.name), language: program.language, text }
}

fn with_naga(program: &Program) -> Result<(), String> {
    let module = match program.language {
        Language::Wgsl => {
            front::wgsl::parse_str(&program.text).map_err(|e| e.emit_to_string(&program.text))?
        }
        _ => {
            // It has textures and samplers apart only, and no `precise`.
            let switches = "#version 450\n#define NEUMIP_SEPARATE_SAMPLER\n#define NEUMIP_PRECISE\n";
            let text = program.text.replace("#version 450\n", switches);
            let options = front::glsl::Options::from(ShaderStage::Fragment);
            front::glsl::Frontend::default().parse(&options, &text).map_err(|e| e.emit_to_string(&text))?
        }
    };
    let mut validator = Validator::new(ValidationFlags::all(), Capabilities::all());
    validator.validate(&module).map(|_| ()).map_err(|e| format!("{e:?}"))
}

fn with_glslang(programs: &[Program], folder: &Path) -> Result<(), String> {
    let mut command = Command::new(GLSLANG);
    if programs[0].language == Language::Hlsl {
        // It makes code of HLSL or nothing, and of one file at a time.
        if programs.len() > 1 {
            return programs.chunks(1).try_for_each(|one| with_glslang(one, folder));
        }
        command.args(["-D", "-V", "-Od", "-e", "main", "-o"]).arg(folder.join("code.spv"));
    }
    for (k, program) in programs.iter().enumerate() {
        let path = folder.join(format!("{k}.frag"));
        std::fs::write(&path, &program.text).unwrap();
        command.arg(path);
    }
    let output = command.output().unwrap();
    match output.status.success() {
        true => Ok(()),
        false => {
            let said = [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
            Err(format!("{}: {}", output.status, said.concat()))
        }
    }
}

#[test]
fn naga_accepts_wgsl_and_glsl_and_refuses_broken_sources() {
    for language in [Language::Wgsl, Language::Glsl] {
        let programs = programs(language);
        for program in &programs {
            with_naga(program).unwrap_or_else(|e| panic!("{}: {e}", program.name));
        }
        for program in &programs[..2] {
            assert!(with_naga(&broken(program)).is_err(), "{}", program.name);
        }
    }
}

#[test]
fn wgsl_computes_in_16_bits_where_it_is_told_to() {
    for program in programs(Language::Wgsl).iter().filter(|p| p.name.contains("fast")) {
        let text = program.text.replace("alias NeumipHalf = f32;", "alias NeumipHalf = f16;");
        assert_ne!(text, program.text);
        let half = Program { text: format!("enable f16;\n{text}"), name: program.name.clone(), ..*program };
        with_naga(&half).unwrap_or_else(|e| panic!("{}: {e}", program.name));
    }
}

#[test]
fn glslang_accepts_glsl_es_glsl_and_hlsl_and_refuses_broken_sources() {
    if Command::new(GLSLANG).arg("--version").output().is_err() {
        eprintln!("skipped: {GLSLANG} is not installed (Debian's package glslang-tools)");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for language in [Language::GlslEs, Language::Glsl, Language::Hlsl] {
        let programs = programs(language);
        with_glslang(&programs, folder.path()).unwrap_or_else(|e| panic!("{e}"));
        for program in &programs[..2] {
            assert!(with_glslang(&[broken(program)], folder.path()).is_err(), "{}", program.name);
        }
    }
}

#[test]
fn what_has_no_source_is_named() {
    let (name, model, resolution) = image_cases().swap_remove(0);
    let architecture = Architecture::new(model, resolution).unwrap();
    let material = Material {
        name,
        measure: Measure::RadianceCosine,
        architecture: &architecture,
        sampler: None,
        weights: None,
    };
    let problem = source(&material, Language::Wgsl, Mode::Exact).unwrap_err().to_string();
    assert!(problem.starts_with("decoder.kind") && !problem.contains('\n'), "{problem}");

    let (_, model, resolution) = cases().swap_remove(0);
    let architecture = Architecture::new(model, resolution).unwrap();
    let material = Material { architecture: &architecture, ..material };
    let refused = |material: &Material, names: &str| {
        let problem = source(material, Language::Glsl, Mode::Fast).unwrap_err().to_string();
        assert!(problem.starts_with(names), "{problem}");
    };
    refused(&Material { weights: Some(&[0.5; 3]), ..material }, "weights");
    let sampler = SamplerConfig {
        features: 8,
        hidden: vec![8],
        lobes: vec![Frame::Surface],
        cosine_floor: 0.1,
        min_z: 0.1,
    };
    refused(&Material { sampler: Some(&sampler), ..material }, "sampler.features");
}

#[test]
fn a_name_stays_in_its_comment() {
    let (_, model, resolution) = cases().swap_remove(0);
    let architecture = Architecture::new(model, resolution).unwrap();
    let material = Material {
        name: "a\n#error\r\u{2028}b",
        measure: Measure::RadianceCosine,
        architecture: &architecture,
        sampler: None,
        weights: None,
    };
    for language in Language::ALL {
        let text = source(&material, language, Mode::Exact).unwrap();
        let named = text.lines().next().unwrap();
        assert!(named.starts_with("//") && named.contains('b'), "{named}");
        assert_eq!(text, source(&material, language, Mode::Exact).unwrap());
    }
}
