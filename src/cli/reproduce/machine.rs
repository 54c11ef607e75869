//! Where something was measured, in words.

use std::process::Command;

/// Processor, cores, program and, where it is run inside its repository, the commit.
pub fn machine() -> String {
    let processor = std::fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| {
        let line = text.lines().find(|line| line.starts_with("model name"))?;
        Some(line.split_once(':')?.1.trim().to_string())
    });
    let processor = processor.unwrap_or_else(|| std::env::consts::ARCH.into());
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let commit = commit().map_or(String::new(), |c| format!(", commit {c}"));
    format!("{processor}, {cores} cores, neumip {}{commit}", env!("CARGO_PKG_VERSION"))
}

fn commit() -> Option<String> {
    let git = |arguments: &[&str]| {
        let output = Command::new("git").args(arguments).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_string())
    };
    // Another repository's commit would say nothing about this program.
    let root = git(&["rev-parse", "--show-toplevel"])?;
    let manifest = std::fs::read_to_string(std::path::Path::new(&root).join("Cargo.toml")).ok()?;
    if !manifest.contains("name = \"neumip\"") {
        return None;
    }
    git(&["rev-parse", "--short", "HEAD"]).filter(|commit| !commit.is_empty())
}
