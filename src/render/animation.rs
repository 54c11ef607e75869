//! What moves: camera and lights at a frame, between keys.
//!
//! Directions turn on arcs, distances and fields of view change by equal factors in equal times. Without jerks means
//! cubic pieces (Catmull and Rom 1974) through the keys that start and end at rest.

use super::format::{Interpolation, KeySpec, LightSpec, PathSpec, SceneFile};
use crate::error::{Error, Result};
use glam::DVec3;

/// Cosine of the angle between two directions from which no arc leads to the other: they are opposite.
const OPPOSITE: f64 = -0.9999;
/// Least distance of a camera from its target.
const NEAREST: f64 = 1e-6;

/// Number of frames.
pub fn frames(file: &SceneFile) -> usize {
    file.path.as_ref().map_or(1, |path| path.frames)
}

/// The scene at a frame, without its path.
///
/// # Errors
/// `Config`, naming the keys between which a direction would have to turn by half a circle, or at which the camera stands
/// in its target.
pub fn at(file: &SceneFile, frame: usize) -> Result<SceneFile> {
    let mut scene = SceneFile { path: None, ..file.clone() };
    let Some(path) = &file.path else { return Ok(scene) };
    let time = if path.frames > 1 { frame as f64 / (path.frames - 1) as f64 } else { 0.0 };
    let camera = &mut scene.camera;

    let targets = track(path, |key| key.target.map(DVec3::from));
    let target = |time| position(&targets, time, path.interpolation);
    let fixed = DVec3::from(camera.target);
    let aim = target(time).unwrap_or(fixed);
    let mut away = Vec::new();
    for (when, origin) in track(path, |key| key.origin.map(DVec3::from)) {
        let offset = origin - target(when).unwrap_or(fixed);
        if offset.length() < NEAREST {
            return Err(Error::config("path.keys", format!("at {when} the camera stands in its target")));
        }
        away.push((when, offset));
    }
    if let Some(offset) = around(&away, time, path.interpolation, "origin")? {
        camera.origin = (aim + offset).into();
    }
    camera.target = aim.into();
    // A field of view changes as its picture's width does.
    let widths = track(path, |key| key.fov.map(|fov| DVec3::splat((0.5 * fov.to_radians()).tan().ln())));
    if let Some(width) = position(&widths, time, path.interpolation) {
        camera.fov = 2.0 * width.x.exp().atan().to_degrees();
    }
    if (DVec3::from(camera.origin) - aim).length() < NEAREST {
        return Err(Error::config("path.keys", format!("at {time:.3} the camera stands in its target")));
    }

    for light in &mut scene.lights {
        let name = light.name().to_string();
        let keys = track(path, |key| key.lights.get(&name).copied().map(DVec3::from));
        match light {
            LightSpec::Directional(light) => {
                let field = format!("lights.{name}");
                if let Some(direction) = around(&keys, time, path.interpolation, &field)? {
                    light.direction = direction.into();
                }
            }
            LightSpec::Point(light) => {
                if let Some(place) = position(&keys, time, path.interpolation) {
                    light.position = place.into();
                }
            }
            LightSpec::Environment(light) => {
                let turns = track(path, |key| key.rotate.map(DVec3::splat));
                if let Some(turn) = position(&turns, time, path.interpolation) {
                    light.rotate = turn.x;
                }
            }
        }
    }
    Ok(scene)
}

/// Times and values of the keys that have one.
fn track(path: &PathSpec, value: impl Fn(&KeySpec) -> Option<DVec3>) -> Vec<(f64, DVec3)> {
    let last = path.keys.len().saturating_sub(1).max(1) as f64;
    let keys = path.keys.iter().enumerate();
    keys.filter_map(|(k, key)| Some((key.at.unwrap_or(k as f64 / last), value(key)?))).collect()
}

/// The keys around a time, and how far it is from the first to the second, 0 to 1.
fn between(keys: &[(f64, DVec3)], time: f64) -> Option<(usize, usize, f64)> {
    let after = keys.partition_point(|(when, _)| *when <= time);
    match (after, keys.len()) {
        (_, 0) => None,
        (0, _) => Some((0, 0, 0.0)),
        (after, count) if after == count => Some((count - 1, count - 1, 0.0)),
        (after, _) => {
            let (a, b) = (keys[after - 1].0, keys[after].0);
            Some((after - 1, after, (time - a) / (b - a)))
        }
    }
}

/// A value at a time; None without keys.
fn position(keys: &[(f64, DVec3)], time: f64, interpolation: Interpolation) -> Option<DVec3> {
    let (a, b, part) = between(keys, time)?;
    let (from, to) = (keys[a].1, keys[b].1);
    if interpolation == Interpolation::Linear || a == b {
        return Some(from.lerp(to, part));
    }
    // At rest at both ends; elsewhere as fast as from the key before to the key after.
    let span = keys[b].0 - keys[a].0;
    let speed = |k: usize| match (k.checked_sub(1), keys.get(k + 1)) {
        (Some(before), Some((when, after))) => (*after - keys[before].1) * (span / (when - keys[before].0)),
        _ => DVec3::ZERO,
    };
    Some(from.hermite_to(to, speed(a), speed(b), part))
}

trait Hermite {
    /// The cubic from here to `to` that starts and ends with these slopes.
    fn hermite_to(self, to: Self, leave: Self, arrive: Self, t: f64) -> Self;
}

impl Hermite for DVec3 {
    fn hermite_to(self, to: Self, leave: Self, arrive: Self, t: f64) -> Self {
        let (t2, t3) = (t * t, t * t * t);
        self * (2.0 * t3 - 3.0 * t2 + 1.0)
            + leave * (t3 - 2.0 * t2 + t)
            + to * (3.0 * t2 - 2.0 * t3)
            + arrive * (t3 - t2)
    }
}

/// A direction with a length at a time: turned on an arc, the length by equal factors; None without keys.
fn around(
    keys: &[(f64, DVec3)],
    time: f64,
    interpolation: Interpolation,
    field: &str,
) -> Result<Option<DVec3>> {
    let units: Vec<(f64, DVec3)> = keys.iter().map(|(t, v)| (*t, v.normalize_or(DVec3::Z))).collect();
    let lengths: Vec<(f64, DVec3)> = keys.iter().map(|(t, v)| (*t, DVec3::splat(v.length().ln()))).collect();
    if let Some(pair) = units.windows(2).find(|pair| pair[0].1.dot(pair[1].1) < OPPOSITE) {
        let problem = format!(
            "{field} at {} and at {} are opposite directions: a key between them says which way to turn",
            pair[0].0, pair[1].0
        );
        return Err(Error::config("path.keys", problem));
    }
    let Some((a, b, part)) = between(&units, time) else { return Ok(None) };
    let direction = match interpolation {
        Interpolation::Linear => {
            let (from, to) = (units[a].1, units[b].1);
            let angle = from.angle_between(to);
            if angle > f64::EPSILON.sqrt() {
                (from * ((1.0 - part) * angle).sin() + to * (part * angle).sin()) / angle.sin()
            } else {
                to
            }
        }
        Interpolation::Smooth => position(&units, time, interpolation).unwrap_or(DVec3::Z),
    };
    let length = position(&lengths, time, interpolation).map_or(1.0, |length| length.x.exp());
    Ok(Some(direction.normalize_or(units[a].1) * length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// Arcs and logarithms in f64.
    const ROUNDING: f64 = 1e-9;

    fn scene(path: &str) -> SceneFile {
        let text = format!(
            r#"{{"version": 1, "objects": [{{"shape": "plane"}}], "path": {path},
                "lights": [{{"directional": {{"name": "sun", "direction": [0, 0, 1]}}}}]}}"#
        );
        SceneFile::from_json(&text, Path::new("moving.json")).unwrap()
    }

    #[test]
    fn a_zoom_is_by_equal_factors_and_a_light_turns_on_an_arc() {
        let file = scene(
            r#"{"frames": 5, "keys": [{"origin": [0, -4, 4], "lights": {"sun": [0, 0, 2]}},
                {"origin": [0, -1, 1], "fov": 30, "lights": {"sun": [3, 0, 0]}}]}"#,
        );
        for frame in 0..5 {
            let scene = at(&file, frame).unwrap();
            let distance = DVec3::from(scene.camera.origin).length();
            let exact = 32f64.sqrt() * 0.25f64.powf(frame as f64 / 4.0);
            assert!((distance - exact).abs() < ROUNDING, "{distance} {exact}");
            assert!((scene.camera.fov - 30.0).abs() < ROUNDING && scene.path.is_none());
            let LightSpec::Directional(light) = &scene.lights[0] else { panic!() };
            let angle = DVec3::from(light.direction).angle_between(DVec3::Z).to_degrees();
            assert!((angle - 22.5 * frame as f64).abs() < 1e-6, "{angle}");
        }
    }

    #[test]
    fn smooth_paths_rest_at_their_ends_and_pass_their_keys() {
        let keys = [(0.0, DVec3::ZERO), (0.5, DVec3::X), (1.0, DVec3::new(1.0, 1.0, 0.0))];
        let at = |time| position(&keys, time, Interpolation::Smooth).unwrap();
        assert!((at(0.5) - DVec3::X).length() < ROUNDING && (at(1.0) - keys[2].1).length() < ROUNDING);
        let speed = |time: f64| (at(time + 5e-4) - at(time - 5e-4)).length() / 1e-3;
        assert!(speed(1e-3) < 0.05 && speed(0.999) < 0.05 && speed(0.5) > 1.0);
        let linear = |time| position(&keys, time, Interpolation::Linear).unwrap();
        assert!((linear(0.25).x - 0.5).abs() < ROUNDING && linear(-1.0) == DVec3::ZERO);
    }

    #[test]
    fn a_half_turn_is_refused() {
        let file = scene(
            r#"{"frames": 3, "keys": [{"lights": {"sun": [1, 0, 0]}}, {"lights": {"sun": [-1, 0, 0]}}]}"#,
        );
        let problem = at(&file, 1).unwrap_err().to_string();
        assert!(problem.contains("lights.sun") && problem.contains("opposite"), "{problem}");
        let file = scene(r#"{"frames": 3, "keys": [{"origin": [1, 0, 0], "target": [1, 0, 0]}]}"#);
        assert!(at(&file, 1).unwrap_err().to_string().contains("stands in its target"));
    }
}
