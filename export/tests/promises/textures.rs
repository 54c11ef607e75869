//! The EXR files hold the textures, rounded to half floats, with a whole mip chain.

use crate::materials;
use exr::prelude::{AnyChannels, Image, Layer, ReadChannels, ReadLayers};
use exr::prelude::{FlatSamples, Levels, f16, read};
use neumip_export::config::texture_name;
use neumip_export::textures::{TextureFile, texture_files};
use neumip_export::{Checkpoint, Tensor};
use std::io::Cursor;

/// A file's mip levels as \[height, width, 4\] textures, finest first.
fn levels(file: &TextureFile, bytes: &[u8]) -> Vec<Tensor> {
    let image: Image<Layer<AnyChannels<Levels<FlatSamples>>>> = read()
        .no_deep_data()
        .all_resolution_levels()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))
        .unwrap();
    let of = |name: &str| {
        let channel = image.layer_data.channel_data.list.iter().find(|c| c.name.eq(name)).unwrap();
        match &channel.sample_data {
            Levels::Mip { level_data, .. } => level_data,
            other => panic!("no mip levels: {other:?}"),
        }
    };
    let planes = ["R", "G", "B", "A"].map(of);
    (0..planes[0].len())
        .map(|level| {
            let shape = vec![(file.size[0] >> level).max(1), (file.size[1] >> level).max(1), 4];
            let columns = planes.map(|p| p[level].values_as_f32().collect::<Vec<_>>());
            let data = (0..shape[0] * shape[1]).flat_map(|i| columns.each_ref().map(|c| c[i])).collect();
            Tensor { shape, data }
        })
        .collect()
}

fn check(checkpoint: &Checkpoint, file: &TextureFile, mips: &[Tensor]) -> bool {
    let name = |level| if file.texture == "texture" { texture_name(level) } else { file.texture.clone() };
    (0..file.levels).all(|level| {
        let tensor = &checkpoint.tensors[&name(level)];
        let wanted = tensor.data.chunks(tensor.shape[2]).flat_map(|texel| {
            (0..4)
                .map(|lane| texel.get(file.first_channel + lane).map_or(0.0, |v| f16::from_f32(*v).to_f32()))
        });
        tensor.shape[..2] == mips[level].shape[..2] && wanted.eq(mips[level].data.iter().copied())
    })
}

#[test]
fn files_hold_the_rounded_textures() {
    for (name, model, resolution) in materials::cases() {
        let checkpoint = materials::checkpoint(&model, resolution, 5);
        let files = texture_files(&checkpoint).unwrap();
        assert_eq!(files, texture_files(&checkpoint).unwrap(), "{name}: not the same bytes");
        for (file, bytes) in &files {
            let mips = levels(file, bytes);
            assert_eq!(mips.len(), file.mip_levels, "{name} {}", file.file);
            assert_eq!(mips[mips.len() - 1].shape, [1, 1, 4]);
            assert!(check(&checkpoint, file, &mips), "{name} {}", file.file);
        }
        let names: Vec<&str> = files.iter().map(|(f, _)| f.file.as_str()).collect();
        let channels: usize =
            files.iter().filter(|(f, _)| f.texture == "texture").map(|(f, _)| f.channels).sum();
        assert_eq!(channels, model.texture.channels, "{name}: {names:?}");
    }
}

#[test]
fn a_changed_texel_is_noticed() {
    let (_, model, resolution) = materials::cases().remove(3);
    let mut checkpoint = materials::checkpoint(&model, resolution, 5);
    let files = texture_files(&checkpoint).unwrap();
    checkpoint.tensors.get_mut("texture.level1").unwrap().data[9] += 0.01;
    assert!(files.iter().any(|(file, bytes)| !check(&checkpoint, file, &levels(file, bytes))));
}

#[test]
fn levels_beyond_the_pyramid_are_box_averages() {
    let (_, model, _) = materials::cases().remove(6);
    let mut checkpoint = materials::checkpoint(&model, [4, 2], 5);
    let ramp = (0..24).map(|i| i as f32).collect();
    checkpoint.tensors.get_mut("texture.level0").unwrap().data = ramp;
    let (file, bytes) = texture_files(&checkpoint).unwrap().remove(0);
    assert_eq!((file.levels, file.mip_levels), (1, 3));
    let mips = levels(&file, &bytes);
    assert_eq!(mips[1].data, [4.5, 5.5, 6.5, 0.0, 16.5, 17.5, 18.5, 0.0]);
    assert_eq!(mips[2].data, [10.5, 11.5, 12.5, 0.0]);
}

#[test]
fn values_beyond_half_floats_are_named() {
    let (_, model, resolution) = materials::cases().remove(0);
    let mut checkpoint = materials::checkpoint(&model, resolution, 5);
    checkpoint.tensors.get_mut("offset.texture").unwrap().data[1] = -7e4;
    let error = texture_files(&checkpoint).unwrap_err().to_string();
    assert!(error.contains("offset.texture") && error.contains("-70000"), "{error}");
}
