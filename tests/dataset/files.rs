//! What lies in a finished folder: no value that is not finite, a contact sheet, progress that adds up.

use super::*;
use exr::prelude::read_all_flat_layers_from_file;
use neumip::dataset::contact_sheet;
use safetensors::{Dtype, SafeTensors};

/// Where a file holds a value that is not finite, by the file's own format.
fn not_finite(path: &Path) -> Vec<String> {
    let name = path.file_name().unwrap().to_str().unwrap();
    let mut found = Vec::new();
    if name.ends_with(".exr") {
        for layer in read_all_flat_layers_from_file(path).unwrap().layer_data {
            for channel in &layer.channel_data.list {
                if channel.sample_data.values_as_f32().any(|v| !v.is_finite()) {
                    found.push(format!("{name}: {}", channel.name));
                }
            }
        }
    } else if name.ends_with(".safetensors") {
        let bytes = std::fs::read(path).unwrap();
        for (tensor, view) in SafeTensors::deserialize(&bytes).unwrap().tensors() {
            let words = view.data().as_chunks::<4>().0;
            let bad = words.iter().any(|word| !f32::from_le_bytes(*word).is_finite());
            if view.dtype() == Dtype::F32 && bad {
                found.push(format!("{name}: {tensor}"));
            }
        }
    } else if name.ends_with(".json") {
        // A number that is not finite is written as null.
        let text = std::fs::read_to_string(path).unwrap().replace("\"noise\": null", "");
        if ["null", "NaN", "inf"].iter().any(|word| text.contains(word)) {
            found.push(name.to_string());
        }
    }
    found
}

#[test]
fn no_file_holds_a_value_that_is_not_finite() {
    for config in [
        small(),
        GenerateConfig { regime: Regime::Slices(3), noise: Some(0.02), grazing_floor: 1.0, ..small() },
    ] {
        let folder = tempfile::tempdir().unwrap();
        make(folder.path(), &config);
        let scan = || -> Vec<String> {
            contents(folder.path()).keys().flat_map(|name| not_finite(&folder.path().join(name))).collect()
        };
        assert_eq!(contents(folder.path()).len(), if config.noise.is_none() { 21 } else { 15 });
        assert_eq!(scan(), Vec::<String>::new());
        // A single value in each kind of file is found.
        let path = folder.path().join("train-00000.safetensors");
        let mut bytes = std::fs::read(&path).unwrap();
        let last = SafeTensors::deserialize(&bytes).unwrap().tensor("wi").unwrap().data().as_ptr_range().end;
        let at = last as usize - bytes.as_ptr() as usize - 4;
        bytes[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        std::fs::write(&path, bytes).unwrap();
        exr::prelude::write_rgb_file(folder.path().join("train-00000.exr"), 4, 4, |x, y| {
            (if (x, y) == (1, 2) { f32::NEG_INFINITY } else { 1.0 }, 1.0, 1.0)
        })
        .unwrap();
        let found = scan();
        assert_eq!(found.len(), 2, "{found:?}");
        assert_eq!(found[0], "train-00000.exr: R");
    }
}

#[test]
fn a_contact_sheet_shows_every_part() {
    let folder = tempfile::tempdir().unwrap();
    let data = make(folder.path(), &small());
    let bytes = std::fs::read(folder.path().join(CONTACT_SHEET)).unwrap();
    assert_eq!(bytes, contact_sheet(&data).unwrap());
    assert!(bytes.len() <= 1 << 20);
    let sheet = image::load_from_memory(&bytes).unwrap().to_rgb8();
    // Views and slices in rows of 256, coarser levels and training patches in rows of 126, 4 pixels between.
    assert_eq!(sheet.dimensions(), (6 * 260 + 4, 2 * 260 + 2 * 130 + 4));
    let ground = |x: u32, y: u32| sheet.get_pixel(x, y).0 == [32; 3];
    // Two views, five slices, three coarser levels, twelve training patches.
    let shown =
        |y: u32, pitch: u32| (0..1560 / pitch).filter(|k| !ground(4 + k * pitch + pitch / 3, y)).count();
    assert_eq!([shown(130, 260), shown(390, 260), shown(590, 130), shown(720, 130)], [2, 5, 3, 12]);
    let white = sheet.pixels().flat_map(|p| p.0).filter(|v| *v == 255).count();
    assert!(white > 0 && white < sheet.as_raw().len() / 50, "{white}");

    // Without views and tests there is less to show, and a lost sheet is no damage.
    let fewer = GenerateConfig { view_size: 0, test_pairs: 0, ..small() };
    let data = make(&folder.path().join("fewer"), &fewer);
    let sheet = image::load_from_memory(&contact_sheet(&data).unwrap()).unwrap();
    assert_eq!(sheet.height(), 134);
    std::fs::remove_file(folder.path().join("fewer").join(CONTACT_SHEET)).unwrap();
    Dataset::open(folder.path().join("fewer")).unwrap();
}

#[test]
fn noise_alone_does_not_make_a_sheet_large() {
    let folder = tempfile::tempdir().unwrap();
    let loud = Smooth { noise: 0.5, poison: false };
    let config = GenerateConfig {
        samples: 50_000,
        spp: 1,
        held_out_spp: 1,
        view_size: 256,
        lights: (0..12).map(|k| [20.0, 10.0 * k as f32]).collect(),
        offgrid_samples: 0,
        grazing_samples: 0,
        ..GenerateConfig::new(128)
    };
    generate(&loud, &config, folder.path(), Existing::Refuse, &mut go).unwrap();
    let bytes = std::fs::metadata(folder.path().join(CONTACT_SHEET)).unwrap().len();
    assert!((200_000..=1 << 20).contains(&bytes), "{bytes}");
}

#[test]
fn rays_and_samples_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let mut last = None;
    generate(&NOISY, &small(), folder.path(), Existing::Refuse, &mut |progress| {
        last = Some(progress);
        ControlFlow::Continue(())
    })
    .unwrap();
    let last = last.unwrap();
    assert_eq!(last.done, last.total);
    let data = Dataset::open(folder.path()).unwrap();
    let train = data.split(SplitName::Train).unwrap().info().samples();
    assert_eq!(last.rays, 3 * (train * 16 + (last.total - train) * 64));
}

#[test]
fn a_description_of_an_older_version_is_read() {
    let folder = tempfile::tempdir().unwrap();
    make(folder.path(), &small());
    let path = folder.path().join(MANIFEST);
    let mut value: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let generation = value["generation"].as_object_mut().unwrap();
    for field in ["lights", "noise", "most_spp", "grazing_floor"] {
        generation.remove(field).unwrap();
    }
    std::fs::write(&path, value.to_string()).unwrap();
    let data = Dataset::open(folder.path()).unwrap();
    let config = data.manifest().generation.clone().unwrap();
    // What it was made with: no floor, NeuMIP's lights.
    assert_eq!(config, GenerateConfig { grazing_floor: 0.0, ..small() });
    let refused = generate(&NOISY, &small(), folder.path(), Existing::Resume, &mut go).unwrap_err();
    assert!(refused.to_string().contains("generation.grazing_floor differs"), "{refused}");
}
