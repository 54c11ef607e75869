//! The shape of the repository: which way imports flow, how long files are, what they may not mention, and that the
//! commands of the README and other pages exist.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

/// What each module of `src/` may import besides itself and [`ANYWHERE`]. `export` is the exporter's crate but for its
/// `config`, which is our `config`'s own ground. A module that is missing here fails.
const FLOW: [(&str, &[&str]); 34] = [
    ("error", &["export"]),
    ("config", &[]),
    ("query", &["error"]),
    // Counts queries by the domain of an architecture.
    ("outside", &["query"]),
    ("random", &[]),
    // An instruction set that the machine has not is an error of the user's.
    ("kernels", &["error"]),
    ("engine", &["query", "kernels", "dataset", "export"]),
    ("srgb", &[]),
    ("metrics", &["srgb"]),
    // A metric, but a network in candle.
    ("lpips", &["srgb"]),
    // Packets of rays run on the instruction sets of the kernels.
    ("reference", &["query", "random", "kernels", "srgb"]),
    // Files appear whole by the exporter's one routine, and the measure of the values is the checkpoint's.
    ("dataset", &["query", "reference", "random", "srgb", "export"]),
    // Initial values are random; variables leave as the checkpoint's tensors.
    ("model", &["query", "kernels", "random", "export"]),
    ("loss", &[]),
    ("checkpoint", &["export"]),
    (
        "trainer",
        &[
            "dataset",
            "model",
            "engine",
            "inference",
            "loss",
            "checkpoint",
            "metrics",
            "query",
            "kernels",
            "random",
            "export",
        ],
    ),
    ("inference", &["query", "kernels", "engine", "model", "export"]),
    ("bench", &["engine", "kernels", "model", "trainer", "dataset", "query", "random", "export"]),
    // Its rows leave as the metrics of results.
    ("evaluate", &["query", "metrics", "lpips", "dataset", "random", "results", "outside"]),
    ("onnx_material", &["query"]),
    ("golden", &["model", "query", "random", "export"]),
    ("artefacts", &["engine", "inference", "onnx_material", "query", "export"]),
    // Golden samples are drawn where golden answers are.
    ("sampler", &["query", "random", "kernels", "engine", "golden", "export"]),
    ("analytic", &["query", "random", "kernels", "reference"]),
    ("results", &["export"]),
    ("chart", &["results", "report"]),
    ("report", &["query", "metrics", "srgb"]),
    ("view", &["query", "report", "export"]),
    // Runs and bundles are opened here; what answers for them is the caller's choice.
    (
        "render",
        &[
            "query",
            "random",
            "srgb",
            "reference",
            "metrics",
            "report",
            "checkpoint",
            "sampler",
            "outside",
            "export",
        ],
    ),
    // Drawn as charts are.
    ("analyze", &["query", "render", "chart", "report", "export"]),
    (
        "reproduce",
        &[
            "config", "analytic", "lpips", "query", "random", "dataset", "evaluate", "results", "report",
            "export",
        ],
    ),
    // Trains, answers and measures by every way there is.
    (
        "stability",
        &[
            "query",
            "random",
            "kernels",
            "reference",
            "dataset",
            "engine",
            "model",
            "loss",
            "checkpoint",
            "trainer",
            "inference",
            "metrics",
            "evaluate",
            "onnx_material",
            "artefacts",
            "report",
            // The tolerance that engines are held to.
            "golden",
            "export",
        ],
    ),
    // Asks scenes, measures answers, trains, and says what came of it.
    (
        "fit",
        &[
            "query",
            "random",
            "kernels",
            "reference",
            "dataset",
            "engine",
            "model",
            "checkpoint",
            "trainer",
            "evaluate",
            "render",
            "analyze",
            "report",
            "export",
        ],
    ),
    ("cli", EVERYTHING),
];
const EVERYTHING: &[&str] = &[
    "query",
    "random",
    "kernels",
    "metrics",
    "lpips",
    "reference",
    "dataset",
    "engine",
    "inference",
    "bench",
    "model",
    "outside",
    "loss",
    "checkpoint",
    "trainer",
    "evaluate",
    "onnx_material",
    "golden",
    "artefacts",
    "analytic",
    "report",
    "results",
    "reproduce",
    "sampler",
    "chart",
    "view",
    "render",
    "analyze",
    "stability",
    "fit",
    "export",
];
/// What every module may import but those of [`BARE`].
const ANYWHERE: [&str; 2] = ["error", "config"];
/// Modules that import what [`FLOW`] lists and nothing else: others could be built on them alone.
const BARE: [&str; 5] = ["query", "random", "kernels", "metrics", "srgb"];
/// Where candle may be mentioned; everything else works without it.
const CANDLE: [&str; 12] = [
    "error.rs",
    "kernels/custom_op.rs",
    "model/",
    "loss/",
    "lpips/",
    "trainer/",
    "inference.rs",
    "golden.rs",
    "artefacts.rs",
    "stability/",
    "fit/",
    "cli/",
];

const MOST_BYTES: u64 = 20 << 20;
/// Half of the files of the program are shorter, and none is longer than the other.
const MEDIAN_LINES: usize = 200;
const MOST_LINES: usize = 500;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Files that git tracks or would track, relative to the root.
fn repository() -> Vec<PathBuf> {
    let output = Command::new("git")
        .args(["ls-files", "--cached", "--others", "--exclude-standard", "-z"])
        .current_dir(root())
        .output()
        .expect("git lists the repository's files");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let names = String::from_utf8(output.stdout).unwrap();
    let files = names.split_terminator('\0').map(PathBuf::from).filter(|path| root().join(path).is_file());
    files.collect::<BTreeSet<_>>().into_iter().collect()
}

/// Rust files under a folder, by their path inside it, with their text; files of tests are left out.
fn sources(folder: &str) -> BTreeMap<String, String> {
    let sources = repository().into_iter().filter(|path| path.extension().is_some_and(|e| e == "rs"));
    let sources = sources.filter(|path| path.file_name().is_some_and(|name| name != "tests.rs"));
    let named = sources.filter_map(|path| {
        let name = path.strip_prefix(folder).ok()?.to_str()?.to_string();
        Some((name, std::fs::read_to_string(root().join(&path)).unwrap()))
    });
    named.collect()
}

/// The text without comments and without the module of tests at its end.
fn code(text: &str) -> String {
    let lines = text.lines().map(|line| line.split("//").next().unwrap_or_default());
    let text: String = lines.flat_map(|line| [line, "\n"]).collect();
    let mut kept = String::new();
    let mut rest = text.as_str();
    while let Some((before, after)) = rest.split_once("#[cfg(test)]") {
        kept += before;
        // `mod tests;` is a file of its own, `mod tests {` lasts to the end of this one.
        rest = match after.split_once([';', '{']) {
            Some((head, tail)) if after[head.len()..].starts_with(';') => tail,
            _ => "",
        };
    }
    kept + rest
}

/// The first names after `prefix::`, be it `prefix::name` or `prefix::{name, name}`.
fn first_names(code: &str, prefix: &str) -> BTreeSet<String> {
    let of_name = |c: char| c.is_alphanumeric() || c == '_';
    let name = |text: &str| text.chars().take_while(|c| of_name(*c)).collect::<String>();
    let mut found = BTreeSet::new();
    let start = format!("{prefix}::");
    for (at, _) in code.match_indices(&start) {
        if code[..at].ends_with(|c| of_name(c) || c == ':') {
            continue;
        }
        let rest = code[at + start.len()..].trim_start();
        let Some(group) = rest.strip_prefix('{') else {
            found.insert(name(rest));
            continue;
        };
        let mut depth = 1;
        let mut item = String::new();
        for c in group.chars() {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                _ => {}
            }
            if depth == 0 || (depth == 1 && c == ',') {
                found.insert(name(item.trim_start()));
                item.clear();
            } else {
                item.push(c);
            }
            if depth == 0 {
                break;
            }
        }
    }
    found.remove("");
    found
}

/// The module that a file of `src/` belongs to, and what that file imports of ours.
fn imports(file: &str, text: &str) -> (String, BTreeSet<String>) {
    let path = file.trim_end_matches(".rs").trim_end_matches("/mod");
    let depth = path.split('/').count();
    let module = path.split('/').next().unwrap_or_default().to_string();
    let code = code(text);
    let mut found = first_names(&code, "crate");
    found.extend(first_names(&code, &vec!["super"; depth].join("::")));
    let ours = |name: String| match name.as_str() {
        "Error" | "Result" => "error".to_string(),
        _ => name,
    };
    let mut found: BTreeSet<String> = found.into_iter().map(ours).collect();
    let exporter = first_names(&code, "neumip_export").into_iter();
    found.extend(exporter.map(|name| if name == "config" { name } else { "export".to_string() }));
    found.retain(|name| *name != module && name != "super" && name != "self");
    (module, found)
}

/// What a file does that [`FLOW`] and [`CANDLE`] do not allow.
fn strays(file: &str, text: &str) -> Vec<String> {
    let (module, imported) = imports(file, text);
    let Some((_, allowed)) = FLOW.iter().find(|(name, _)| *name == module) else {
        return vec![format!("{file}: module {module} is not in the table of tests/house.rs")];
    };
    let general: &[&str] = if BARE.contains(&module.as_str()) { &[] } else { &ANYWHERE };
    let fine = |name: &&String| allowed.contains(&name.as_str()) || general.contains(&name.as_str());
    let mut strays: Vec<String> = imported
        .iter()
        .filter(|name| !fine(name))
        .map(|name| format!("{file}: {module} -> {name}"))
        .collect();
    if !CANDLE.iter().any(|place| file.starts_with(place)) && code(text).contains("candle_") {
        strays.push(format!("{file}: mentions candle"));
    }
    strays
}

#[test]
fn imports_flow_one_way() {
    let sources = sources("src");
    assert!(sources.len() > 50, "only {} sources were found", sources.len());
    let parts = sources.iter().filter(|(file, _)| !["lib.rs", "main.rs"].contains(&file.as_str()));
    let strays: Vec<String> = parts.flat_map(|(file, text)| strays(file, text)).collect();
    assert!(strays.is_empty(), "{}", strays.join("\n"));
    // The table names nothing that does not exist.
    for (module, _) in FLOW {
        assert!(sources.keys().any(|file| imports(file, "").0 == module), "there is no module {module}");
    }
}

#[test]
fn the_exporter_knows_neither_candle_nor_the_trainer() {
    for (file, text) in sources("export/src") {
        let code = code(&text);
        for forbidden in ["candle", "neumip::"] {
            assert!(!code.contains(forbidden), "export/src/{file} mentions {forbidden}");
        }
    }
}

#[test]
fn an_import_against_the_flow_is_found() {
    let against: [(&str, &str, &[&str]); 9] = [
        ("kernels/adam.rs", "use crate::config::Config;", &["kernels/adam.rs: kernels -> config"]),
        ("kernels/adam.rs", "use candle_core::Tensor;", &["kernels/adam.rs: mentions candle"]),
        ("query.rs", "fn f() { crate::model::device() }", &["query.rs: query -> model"]),
        (
            "dataset/read.rs",
            "use crate::{\n    error::{Error, Result},\n    model::{Networks, Tables},\n    cli,\n};",
            &["dataset/read.rs: dataset -> cli", "dataset/read.rs: dataset -> model"],
        ),
        (
            "reference/builtin/rocks.rs",
            "use super::super::super::dataset::Block;",
            &["reference/builtin/rocks.rs: reference -> dataset"],
        ),
        ("loss/mod.rs", "#[cfg(test)]\nmod tests;\nuse crate::trainer;", &["loss/mod.rs: loss -> trainer"]),
        ("metrics/mod.rs", "use neumip_export::config;", &["metrics/mod.rs: metrics -> config"]),
        ("report/page.rs", "use crate::cli;", &["report/page.rs: report -> cli"]),
        ("helpers.rs", "", &["helpers.rs: module helpers is not in the table of tests/house.rs"]),
    ];
    for (file, text, found) in against {
        assert_eq!(strays(file, text), found, "{text}");
    }
    let along = [
        ("kernels/custom_op.rs", "use candle_core::Tensor;"),
        ("kernels/adam.rs", "// crate::model\n#[cfg(test)]\nmod tests { use crate::random::Random; }"),
        (
            "dataset/read.rs",
            "use crate::{error::Result, query::{QueryBuffer, RgbImage}}; use super::block::Block;",
        ),
        (
            "trainer/mod.rs",
            "use crate::{Error, Result, dataset}; use neumip_export::{Header, config::Architecture};",
        ),
        ("reference/maps.rs", "use super::material::Material; use crate::Error;"),
    ];
    for (file, text) in along {
        assert!(strays(file, text).is_empty(), "{:?}", strays(file, text));
    }
}

#[test]
fn files_are_short() {
    let mut lengths: Vec<(usize, String)> = ["src", "export/src"]
        .into_iter()
        .flat_map(|folder| sources(folder).into_iter().map(move |(file, text)| (folder, file, text)))
        .map(|(folder, file, text)| (text.lines().count(), format!("{folder}/{file}")))
        .collect();
    lengths.sort();
    let median = lengths[lengths.len() / 2].0;
    assert!(median < MEDIAN_LINES, "the median file has {median} lines: {lengths:?}");
    let long: Vec<_> = lengths.iter().filter(|(lines, _)| *lines > MOST_LINES).collect();
    assert!(long.is_empty(), "longer than {MOST_LINES} lines: {long:?}");
}

#[test]
fn nothing_is_left_of_the_place_it_was_written_in() {
    // In two parts, so that this file is not found.
    let forbidden = [("/wo", "rk/"), ("/ro", "ot/"), ("/t", "mp"), ("/ho", "me/"), ("to", "do!")];
    let forbidden = forbidden.map(|(a, b)| format!("{a}{b}"));
    let mut bytes = 0;
    for file in repository() {
        let content = std::fs::read(root().join(&file)).unwrap();
        bytes += content.len() as u64;
        // Only text is looked at: bytes of pictures and weights spell anything.
        let Ok(text) = String::from_utf8(content) else { continue };
        for word in &forbidden {
            let line = text.lines().position(|line| line.contains(word.as_str()));
            assert_eq!(line, None, "{}: mentions {word} (lines are counted from 0)", file.display());
        }
    }
    assert!(bytes < MOST_BYTES, "the repository has {bytes} bytes");
}

/// The command lines of the fenced sh blocks of a text, comments cut off, continued lines joined.
fn shell_lines(markdown: &str) -> Vec<String> {
    let mut lines = Vec::new();
    let mut inside = false;
    let mut open = String::new();
    for line in markdown.lines() {
        if line.trim_start().starts_with("```") {
            inside = line.trim() == "```sh";
            continue;
        }
        let line = line.split(" #").next().unwrap_or_default().trim();
        if !inside || line.starts_with('#') {
            continue;
        }
        if let Some(part) = line.strip_suffix('\\') {
            open += part;
            continue;
        }
        open += line;
        // A line may chain commands.
        lines.extend(open.split("&&").map(|part| part.trim().to_string()).filter(|part| !part.is_empty()));
        open.clear();
    }
    lines
}

/// Runs a program for its help.
fn help(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).current_dir(root()).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

/// What is wrong with a command line of a page; None if its program is neither ours nor cargo, or all is well.
fn problem(line: &str) -> Option<String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let (program, words) = words.split_first()?;
    let ours = program.rsplit('/').next() == Some("neumip");
    if !ours && *program != "cargo" {
        return None;
    }
    let own: Vec<&str> = words.iter().copied().take_while(|word| *word != "--").collect();
    let Some(verb) = own.first().copied() else { return Some(format!("{line}: has no verb")) };
    // Short help: cargo shows a manual page for the long one.
    let (binary, ask) = if ours { (env!("CARGO_BIN_EXE_neumip"), "--help") } else { (env!("CARGO"), "-h") };
    let Some(text) = help(binary, &[verb, ask]) else {
        return Some(format!("{line}: there is no verb {verb}"));
    };
    let known: BTreeSet<&str> = text
        .split(|c: char| !(c.is_alphanumeric() || c == '-'))
        .filter(|word| word.starts_with("--") && word.len() > 2)
        .collect();
    let flags =
        own.iter().filter(|word| word.starts_with("--")).map(|word| word.split('=').next().unwrap_or(word));
    if let Some(flag) = flags.clone().find(|flag| !known.contains(flag)) {
        return Some(format!("{line}: {verb} has no {flag}"));
    }
    // A crate of its own has a command line of its own.
    if let Some(at) = own.iter().position(|word| *word == "--manifest-path") {
        let manifest = own.get(at + 1).map(|path| root().join(path));
        let missing = manifest.is_none_or(|path| !path.is_file());
        return missing.then(|| format!("{line}: its manifest is not there"));
    }
    // What `cargo run` hands on is a command line of ours.
    let handed = &words[own.len()..];
    match (ours, verb, handed.split_first()) {
        (false, "run", Some((_, rest))) => problem(&format!("neumip {}", rest.join(" "))),
        _ => None,
    }
}

#[test]
fn the_commands_of_the_pages_exist() {
    let readme = std::fs::read_to_string(root().join("README.md")).expect("README.md is there");
    let lines = shell_lines(&readme);
    for needed in ["cargo run --release -- demo", "cargo test --release"] {
        assert!(lines.iter().any(|line| line == needed), "README.md shows no `{needed}`: {lines:?}");
    }
    for page in repository().iter().filter(|path| path.extension().is_some_and(|e| e == "md")) {
        let lines = shell_lines(&std::fs::read_to_string(root().join(page)).unwrap());
        let problems: Vec<String> = lines.iter().filter_map(|line| problem(line)).collect();
        assert!(problems.is_empty(), "{}: {}", page.display(), problems.join("\n"));
    }
}

#[test]
fn commands_that_do_not_exist_are_found() {
    let text =
        "```sh\nneumip demo --fast # quickly\ncargo run --release -- \\\n  paint it\n```\n```json\n{}\n```\n";
    let lines = shell_lines(text);
    assert_eq!(lines, ["neumip demo --fast", "cargo run --release -- paint it"]);
    assert_eq!(problem(&lines[0]).unwrap(), "neumip demo --fast: demo has no --fast");
    assert!(problem(&lines[1]).unwrap().contains("there is no verb paint"));
    assert!(problem("cargo tset --release").unwrap().contains("there is no verb tset"));
    assert!(problem("cargo test --relase").unwrap().contains("has no --relase"));
    assert!(
        problem("cargo run --manifest-path no/Cargo.toml").unwrap().contains("its manifest is not there")
    );
    assert_eq!(problem("target/release/neumip train data --out run --set a=b"), None);
}
