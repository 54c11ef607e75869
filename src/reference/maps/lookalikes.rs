//! Which files of a folder could be the map that is missing.

use std::path::Path;

/// Names that are offered, and directory entries that are looked at: enough for a set of maps, and no more than one
/// line holds.
const MOST_OFFERED: usize = 5;
const MOST_ENTRIES: usize = 4096;

/// What texture sites call a field.
fn words(field: &str) -> &'static [&'static str] {
    match field {
        "height" => &["height", "disp", "bump", "depth"],
        "base_colour" => &["colour", "color", "albedo", "diff", "base", "_col"],
        "roughness" => &["rough", "_rgh"],
        "metalness" => &["metal", "_met"],
        "specular" => &["spec"],
        "normal" => &["norm", "_nor", "_nrm"],
        "opacity" => &["opac", "alpha", "mask", "transp"],
        _ => &[],
    }
}

/// Maps beside the file at `path` whose names fit the field, as the end of a sentence; empty if there are none.
pub(super) fn lookalikes(path: &Path, field: &str) -> String {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let Ok(entries) = std::fs::read_dir(folder) else { return String::new() };
    let mut names: Vec<String> = entries
        .take(MOST_ENTRIES)
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| fits(name, field))
        .collect();
    names.sort();
    match names.len() {
        0 => String::new(),
        1..=MOST_OFFERED => format!("; that folder has {}", names.join(", ")),
        more => {
            format!("; that folder has {} and {} more", names[..MOST_OFFERED].join(", "), more - MOST_OFFERED)
        }
    }
}

fn fits(name: &str, field: &str) -> bool {
    let lower = name.to_ascii_lowercase();
    let is_map = [".png", ".exr"].iter().any(|end| lower.ends_with(end));
    is_map && !name.chars().any(char::is_control) && words(field).iter().any(|word| lower.contains(word))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_texture_sites_are_known() {
        for (name, field) in [
            ("Bricks076_4K_Roughness.png", "roughness"),
            ("rock_wall_rough_2k.exr", "roughness"),
            ("Bricks076_4K_Color.png", "base_colour"),
            ("rock_wall_diff_2k.png", "base_colour"),
            ("rock_wall_nor_gl_2k.exr", "normal"),
            ("Bricks076_4K_Displacement.png", "height"),
            ("Metal032_1K_Metalness.png", "metalness"),
        ] {
            assert!(fits(name, field), "{name}");
            assert!(!fits(name, "opacity") && !fits(&name.replace('.', "_"), field), "{name}");
        }
    }

    #[test]
    fn few_are_offered_in_order() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("absent.png");
        assert_eq!(lookalikes(&missing, "roughness"), "");
        for k in (0..7).rev() {
            std::fs::write(folder.path().join(format!("rough{k}.png")), "").unwrap();
        }
        let offered = lookalikes(&missing, "roughness");
        assert!(offered.ends_with("rough0.png, rough1.png, rough2.png, rough3.png, rough4.png and 2 more"));
        assert_eq!(lookalikes(&missing, "height"), "");
        assert_eq!(lookalikes(&folder.path().join("no folder/absent.png"), "height"), "");
    }
}
