//! The camera and what moves, as they are written.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A camera: square pixels, pixel centres at a half, rows from the top.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraSpec {
    /// Where it stands.
    pub origin: [f64; 3],
    /// What it looks at.
    pub target: [f64; 3],
    /// What is up in the picture; z if it is not stated, y where the camera looks along z.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub up: Option<[f64; 3]>,
    /// Horizontal field of view in degrees.
    pub fov: f64,
    /// Columns.
    pub width: usize,
    /// Rows; as many as columns if it is not stated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height: Option<usize>,
    /// Stratified samples a pixel; a single one is at the pixel's centre.
    pub samples: usize,
    /// What a sample's level stands for.
    pub footprint: FootprintSpec,
}

/// What the level of a sample stands for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FootprintSpec {
    /// The pixel, whatever the number of samples: levels do not depend on it, and samples blur a little more.
    #[default]
    Pixel,
    /// The sample's share of the pixel: sharper, and more samples are needed.
    Sample,
}

impl Default for CameraSpec {
    /// NeuMIP's: at distance 2.3, tilted 45 degrees towards -y, field of view 45 degrees.
    fn default() -> Self {
        let away = 2.3 * std::f64::consts::FRAC_1_SQRT_2;
        Self {
            origin: [0.0, -away, away],
            target: [0.0; 3],
            up: None,
            fov: 45.0,
            width: 512,
            height: None,
            samples: 16,
            footprint: FootprintSpec::Pixel,
        }
    }
}

/// Frames and the keys between which things move.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PathSpec {
    /// Number of frames.
    pub frames: usize,
    /// Frames a second of the animation.
    #[serde(default = "fps")]
    pub fps: u16,
    /// How things move between keys.
    #[serde(default)]
    pub interpolation: Interpolation,
    /// The keys, in time.
    pub keys: Vec<KeySpec>,
}

/// How things move between keys.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Interpolation {
    /// At one speed from key to key.
    #[default]
    Linear,
    /// Without jerks: they start and end slowly, and pass the keys between without stopping.
    Smooth,
}

/// What is known at a time; what a key leaves out is interpolated between the keys that have it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct KeySpec {
    /// From 0, the first frame, to 1, the last; if no key has one they are evenly spaced.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at: Option<f64>,
    /// The camera's origin. It goes around its target on an arc, and nears it by equal factors in equal times.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub origin: Option<[f64; 3]>,
    /// The camera's target.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<[f64; 3]>,
    /// The camera's field of view.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fov: Option<f64>,
    /// Directions of directional lights and positions of points, by name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub lights: BTreeMap<String, [f64; 3]>,
    /// Turn of the environment in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotate: Option<f64>,
}

fn fps() -> u16 {
    12
}
