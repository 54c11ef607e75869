//! Bounds of a scene's fields.

use super::{CameraSpec, LightSpec, ObjectSpec, PathSpec, Rgb, SceneFile};
use crate::error::{Error, Result};
use std::fmt::Display;

/// Largest coordinate, distance and radiance: what is computed from them stays far inside f32.
const MOST: f64 = 1e6;
/// Least length of a direction and least scale: shorter ones are taken for 0.
const LEAST: f64 = 1e-6;
/// Most pixels of a frame, and its longest side.
const MOST_PIXELS: usize = 1 << 26;
const MOST_SIDE: usize = 16_384;
/// Most samples a pixel: the longest sequence of `sobol_burley`.
const MOST_SAMPLES: usize = 1 << 16;
/// Frames have numbers of four digits.
const MOST_FRAMES: usize = 10_000;
const MOST_KEYS: usize = 1000;
const MOST_OBJECTS: usize = 4096;
const MOST_LIGHTS: usize = 64;
/// Cosine of the angle within which the camera's up counts as its line of sight.
const ALONG: f64 = 1.0 - 1e-9;

/// Checks a scene.
pub(super) fn scene(file: &SceneFile) -> Result<()> {
    for (name, material) in &file.materials {
        let field = format!("materials.{name}");
        ensure(!name.is_empty() && name.chars().all(|c| !c.is_control()), "materials", || {
            "a name is empty or has control characters".into()
        })?;
        material.source().map_err(|problem| Error::config(&field, problem))?;
        if let Some(Rgb(albedo)) = material.lambert {
            ensure(albedo.iter().all(|v| (0.0..=1.0).contains(v)), &format!("{field}.lambert"), || {
                format!("{albedo:?}: an albedo is from 0 to 1")
            })?;
        }
    }
    count("objects", file.objects.len(), 1, MOST_OBJECTS)?;
    for (k, each) in file.objects.iter().enumerate() {
        object(each, &format!("objects[{k}]"))?;
    }
    count("lights", file.lights.len(), 1, MOST_LIGHTS)?;
    for (k, each) in file.lights.iter().enumerate() {
        light(each, &format!("lights[{k}]"))?;
        if file.lights[..k].iter().any(|other| other.name() == each.name()) {
            let problem =
                format!("there are two lights of the name {}; give them different ones", each.name());
            return Err(Error::config(format!("lights[{k}].name"), problem));
        }
        let environment = |light: &LightSpec| matches!(light, LightSpec::Environment(_));
        ensure(
            !environment(each) || !file.lights[..k].iter().any(environment),
            &format!("lights[{k}]"),
            || "is a second environment; a scene has one".into(),
        )?;
    }
    camera(&file.camera)?;
    if let Some(motion) = &file.path {
        path(motion, &file.lights)?;
    }
    ensure(file.bounces <= 1, "bounces", || format!("{}: 0 and 1 work", file.bounces))?;
    ensure((-16.0..=16.0).contains(&file.stops), "stops", || format!("{}: -16 to 16 work", file.stops))
}

fn object(object: &ObjectSpec, field: &str) -> Result<()> {
    vector(object.translate, &format!("{field}.translate"))?;
    vector(object.rotate, &format!("{field}.rotate"))?;
    let scale = object.scale.0;
    ensure(scale.iter().all(|s| (LEAST..=MOST).contains(&s.abs())), &format!("{field}.scale"), || {
        format!("{scale:?}: {LEAST} to {MOST} work")
    })?;
    let tiling = object.tiling;
    ensure(tiling.iter().all(|t| (LEAST..=MOST).contains(t)), &format!("{field}.tiling"), || {
        format!("{tiling:?}: {LEAST} to {MOST} work")
    })
}

fn light(light: &LightSpec, field: &str) -> Result<()> {
    match light {
        LightSpec::Directional(light) => {
            direction(light.direction, &format!("{field}.directional.direction"))?;
            radiance(light.irradiance, &format!("{field}.directional.irradiance"))
        }
        LightSpec::Point(light) => {
            vector(light.position, &format!("{field}.point.position"))?;
            radiance(light.intensity, &format!("{field}.point.intensity"))
        }
        LightSpec::Environment(light) => {
            let field = format!("{field}.environment");
            let stated =
                [light.image.is_some(), light.constant.is_some(), light.sky.is_some()].map(usize::from);
            ensure(stated.iter().sum::<usize>() == 1, &field, || {
                "state one of image, constant and sky".into()
            })?;
            number(light.rotate, &format!("{field}.rotate"))?;
            ensure((0.0..=MOST).contains(&light.scale), &format!("{field}.scale"), || {
                format!("{}: 0 to {MOST} work", light.scale)
            })?;
            if let Some(constant) = light.constant {
                radiance(constant, &format!("{field}.constant"))?;
            }
            let Some(sky) = &light.sky else { return Ok(()) };
            for (name, colour) in [
                ("zenith", sky.zenith),
                ("horizon", sky.horizon),
                ("ground", sky.ground),
                ("sun_irradiance", sky.sun_irradiance),
            ] {
                radiance(colour, &format!("{field}.sky.{name}"))?;
            }
            direction(sky.sun, &format!("{field}.sky.sun"))?;
            ensure((0.25..=45.0).contains(&sky.sun_radius), &format!("{field}.sky.sun_radius"), || {
                format!("{}: 0.25 to 45 degrees work; a smaller sun is a directional light", sky.sun_radius)
            })
        }
    }
}

fn camera(camera: &CameraSpec) -> Result<()> {
    eye(camera.origin, camera.target, camera.up, "camera")?;
    field_of_view(camera.fov, "camera.fov")?;
    let height = camera.height.unwrap_or(camera.width);
    count("camera.width", camera.width, 1, MOST_SIDE)?;
    count("camera.height", height, 1, MOST_SIDE)?;
    ensure(camera.width * height <= MOST_PIXELS, "camera.width", || {
        format!("{} x {height} are more than {MOST_PIXELS} pixels", camera.width)
    })?;
    count("camera.samples", camera.samples, 1, MOST_SAMPLES)
}

/// A camera's origin, target and up.
fn eye(origin: [f64; 3], target: [f64; 3], up: Option<[f64; 3]>, field: &str) -> Result<()> {
    vector(origin, &format!("{field}.origin"))?;
    vector(target, &format!("{field}.target"))?;
    let sight = [0, 1, 2].map(|c| target[c] - origin[c]);
    ensure(length(sight) >= LEAST, &format!("{field}.target"), || "is where the camera stands".into())?;
    let Some(up) = up else { return Ok(()) };
    direction(up, &format!("{field}.up"))?;
    let along = (0..3).map(|c| sight[c] * up[c]).sum::<f64>() / (length(sight) * length(up));
    ensure(along.abs() < ALONG, &format!("{field}.up"), || "lies along the line of sight".into())
}

fn path(path: &PathSpec, lights: &[LightSpec]) -> Result<()> {
    count("path.frames", path.frames, 1, MOST_FRAMES)?;
    count("path.fps", usize::from(path.fps), 1, 240)?;
    count("path.keys", path.keys.len(), 1, MOST_KEYS)?;
    let timed = path.keys.iter().filter(|key| key.at.is_some()).count();
    ensure(timed == 0 || timed == path.keys.len(), "path.keys", || {
        format!("{timed} of {} keys have a time (at); state all or none", path.keys.len())
    })?;
    let mut before = -1.0;
    for (k, key) in path.keys.iter().enumerate() {
        let field = format!("path.keys[{k}]");
        if let Some(at) = key.at {
            ensure(at > before && (0.0..=1.0).contains(&at), &format!("{field}.at"), || {
                format!("{at}: times go up from 0 to 1")
            })?;
            before = at;
        }
        for (name, value) in [("origin", key.origin), ("target", key.target)] {
            value.map_or(Ok(()), |value| vector(value, &format!("{field}.{name}")))?;
        }
        key.fov.map_or(Ok(()), |fov| field_of_view(fov, &format!("{field}.fov")))?;
        key.rotate.map_or(Ok(()), |turn| number(turn, &format!("{field}.rotate")))?;
        let environment = lights.iter().any(|light| matches!(light, LightSpec::Environment(_)));
        ensure(key.rotate.is_none() || environment, &format!("{field}.rotate"), || {
            "turns the environment, and the scene has none".into()
        })?;
        for (name, value) in &key.lights {
            let field = format!("{field}.lights.{name}");
            match lights.iter().find(|light| light.name() == name) {
                Some(LightSpec::Directional(_)) => direction(*value, &field)?,
                Some(LightSpec::Point(_)) => vector(*value, &field)?,
                Some(LightSpec::Environment(_)) => {
                    return Err(Error::config(field, "is an environment; turn it by rotate"));
                }
                None => return Err(Error::config(field, "there is no light of this name")),
            }
        }
    }
    Ok(())
}

fn field_of_view(fov: f64, field: &str) -> Result<()> {
    ensure((0.01..=175.0).contains(&fov), field, || format!("{fov}: 0.01 to 175 degrees work"))
}

fn vector(v: [f64; 3], field: &str) -> Result<()> {
    ensure(v.iter().all(|x| x.abs() <= MOST), field, || format!("{v:?}: -{MOST} to {MOST} work"))
}

fn number(x: f64, field: &str) -> Result<()> {
    ensure(x.abs() <= MOST, field, || format!("{x}: -{MOST} to {MOST} work"))
}

fn direction(v: [f64; 3], field: &str) -> Result<()> {
    vector(v, field)?;
    ensure(length(v) >= LEAST, field, || format!("{v:?} has no length"))
}

fn radiance(Rgb(v): Rgb, field: &str) -> Result<()> {
    ensure(v.iter().all(|x| (0.0..=MOST as f32).contains(x)), field, || format!("{v:?}: 0 to {MOST} work"))
}

fn count(field: &str, value: usize, least: usize, most: usize) -> Result<()> {
    ensure((least..=most).contains(&value), field, || format!("{value}: {least} to {most} work"))
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn ensure(holds: bool, field: &(impl Display + ?Sized), problem: impl FnOnce() -> String) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::config(field.to_string(), problem())) }
}
