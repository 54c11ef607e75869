//! A scene that was opened: world, materials, light, and what is to be seen at each frame.

use super::animation;
use super::camera::Camera;
use super::environment::Environment;
use super::format::{
    DEFAULT_MATERIAL, FootprintSpec, LightSpec, MaterialSpec, PathSpec, Rgb, SceneFile, ShapeSpec,
};
use super::light::Lights;
use super::material::{Engine, Material, hex};
use super::sky;
use super::world::World;
use crate::error::{Error, Result};
use crate::reference::map_file;
use crate::srgb;
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Largest radiance of an image: the sun has 2e7 W / (m^2 sr).
const BRIGHTEST: f32 = 1e9;

/// How a scene is opened.
pub struct OpenOptions<'a> {
    /// The material of objects that name none; in place of the scene's own `default`.
    pub default_material: Option<MaterialSpec>,
    /// Seed of all samples.
    pub seed: u64,
    /// What answers for checkpoints.
    pub engine: &'a Engine<'a>,
}

/// A scene.
pub struct Scene {
    /// As it is written.
    pub file: SceneFile,
    /// The objects.
    pub world: World,
    /// Its materials; queries come in their order.
    pub materials: Vec<Material>,
    /// Seed of all samples.
    pub seed: u64,
    /// A number that tells its pictures from those of other scenes, seeds and materials.
    pub identity: String,
    environment: Option<Arc<Environment>>,
}

/// What is to be seen at a time.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The camera.
    pub camera: Camera,
    /// The lights.
    pub lights: Lights,
    /// Samples a pixel.
    pub samples: usize,
    /// Part of a pixel's footprint that a sample stands for.
    pub share: f64,
}

impl Frame {
    /// The same with so many samples a pixel; 0 leaves them. Where a sample stands for its share of the pixel, that is another.
    pub fn with_samples(mut self, samples: usize) -> Self {
        if samples > 0 {
            self.share = if self.share < 1.0 { 1.0 / samples as f64 } else { 1.0 };
            self.samples = samples;
        }
        self
    }
}

impl Scene {
    /// Opens a scene; `path` is its file, by which its errors and relative paths go.
    ///
    /// # Errors
    /// `File` or `Usage`, naming what is absent or cannot be used; `Config` for a decoder that reads the queries around each
    /// one.
    pub fn open(mut file: SceneFile, path: &Path, options: &OpenOptions) -> Result<Self> {
        let at_path = |error: Error| match error {
            error @ Error::Config { .. } => Error::file(path, error),
            other => other,
        };
        file.check().map_err(at_path)?;
        let base = path.parent().unwrap_or(Path::new(""));
        if let Some(spec) = &options.default_material {
            file.materials.insert(DEFAULT_MATERIAL.into(), spec.clone());
        }
        let used = |name: &str| file.objects.iter().any(|object| object.material == name);
        for (k, object) in file.objects.iter().enumerate() {
            let name = &object.material;
            if file.materials.contains_key(name) {
                continue;
            }
            return Err(if name == DEFAULT_MATERIAL {
                Error::usage(format!(
                    "{}: objects[{k}] has no material: name a run, bundle or checkpoint on the command line",
                    path.display()
                ))
            } else {
                Error::file(path, format!("objects[{k}].material: there is no material of the name {name}"))
            });
        }
        if options.default_material.is_some() && !used(DEFAULT_MATERIAL) {
            return Err(Error::usage(format!(
                "{}: every object names a material of its own, so none is left for the one given",
                path.display()
            )));
        }
        for frame in 0..animation::frames(&file) {
            animation::at(&file, frame).map_err(at_path)?;
        }
        let opened = file.materials.iter().filter(|(name, _)| used(name));
        let materials = opened
            .map(|(name, spec)| Material::open(name, spec, base, options.engine))
            .collect::<Result<Vec<_>>>()
            .map_err(at_path)?;
        let find = |name: &str| {
            let place = materials.iter().position(|material| material.name == name)?;
            Some((place, materials[place].needs_uv()))
        };
        let world = World::new(&file.objects, base, find).map_err(at_path)?;
        let environment = environment(&file, base)?.map(Arc::new);
        let mut scene =
            Self { file, world, materials, seed: options.seed, identity: String::new(), environment };
        scene.identity = scene.identify(base)?;
        Ok(scene)
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        animation::frames(&self.file)
    }

    /// What is to be seen at a frame.
    ///
    /// # Errors
    /// None for a scene that was opened, whose frames are known to work.
    pub fn frame(&self, index: usize) -> Result<Frame> {
        self.frame_at(index, self.frames())
    }

    /// What is to be seen at a frame of as many as are wanted on the same path; without a path it is always the same.
    ///
    /// # Errors
    /// `Config` where a camera would stand in its target between the frames that are known to work.
    pub fn frame_at(&self, index: usize, frames: usize) -> Result<Frame> {
        let path = self.file.path.clone().map(|path| PathSpec { frames, ..path });
        let file = animation::at(&SceneFile { path, ..self.file.clone() }, index)?;
        let samples = file.camera.samples;
        let share = match file.camera.footprint {
            FootprintSpec::Pixel => 1.0,
            FootprintSpec::Sample => 1.0 / samples as f64,
        };
        let lights = Lights::new(&file.lights, self.environment.as_ref());
        Ok(Frame { camera: Camera::new(&file.camera), lights, samples, share })
    }

    /// What was done to the scene's files, a line each.
    pub fn notes(&self) -> impl Iterator<Item = &String> {
        self.materials.iter().flat_map(|material| &material.notes).chain(&self.world.notes)
    }

    /// A hash of all that its pictures depend on: the file, the seed, what materials answer, what other files hold.
    fn identify(&self, base: &Path) -> Result<String> {
        let mut hash = Sha256::new();
        hash.update(env!("CARGO_PKG_VERSION"));
        hash.update(self.seed.to_le_bytes());
        // Where materials come from does not matter, and exposure changes no pixel.
        let file = SceneFile { materials: Default::default(), stops: 0.0, ..self.file.clone() };
        hash.update(serde_json::to_vec(&file).map_err(|e| Error::config("scene", e))?);
        for material in &self.materials {
            hash.update(format!("{}={}\n", material.name, material.identity));
        }
        for path in files(&self.file) {
            let path = base.join(path);
            let bytes =
                std::fs::read(&path).map_err(|e| Error::file(&path, format!("cannot be read: {e}")))?;
            hash.update(Sha256::digest(&bytes));
        }
        Ok(hex(&hash.finalize()[..16]))
    }
}

/// The meshes and images of a scene.
fn files(file: &SceneFile) -> Vec<PathBuf> {
    let meshes = file.objects.iter().filter_map(|object| match &object.shape {
        ShapeSpec::Mesh(path) => Some(path.clone()),
        _ => None,
    });
    let images = file.lights.iter().filter_map(|light| match light {
        LightSpec::Environment(light) => light.image.clone(),
        _ => None,
    });
    meshes.chain(images).collect()
}

/// The picture of a scene's environment.
fn environment(file: &SceneFile, base: &Path) -> Result<Option<Environment>> {
    let Some(light) = file.lights.iter().find_map(|light| match light {
        LightSpec::Environment(light) => Some(light),
        _ => None,
    }) else {
        return Ok(None);
    };
    if let Some(Rgb(radiance)) = light.constant {
        return Ok(Some(Environment::constant(radiance)));
    }
    let Some(image) = &light.image else {
        return Ok(light.sky.as_ref().map(sky::paint));
    };
    let path = base.join(image);
    let map = map_file::read(&path)?;
    let texels: Vec<[f32; 3]> =
        map.texels.into_iter().map(|t| if map.is_png { t.map(srgb::decode) } else { t }).collect();
    match texels.as_flattened().iter().find(|v| !(0.0..=BRIGHTEST).contains(*v)) {
        Some(v) => Err(Error::file(path, format!("holds {v}; radiance is from 0 to {BRIGHTEST}"))),
        None => Ok(Some(Environment::new(map.width, map.height, texels))),
    }
}
