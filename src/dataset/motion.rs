//! Sequences of views in which one thing moves a little from frame to frame, for `flicker`.
//!
//! The middle of each is NeuMIP's scene with the tilted light. In `light-arc` the light and in `camera-arc` the camera
//! goes on a great circle through the normal, upwards to grazing; in `zoom` the camera comes closer. Its distance
//! shrinks by a constant factor a frame, and the step is that of the arcs: in all three what moves covers `step` times
//! its distance.
//!
//! Noise must not count as motion. A pixel draws the same random numbers in every frame, and as many of them, so that
//! much of the noise cancels; and each frame is rendered in two halves that have no numbers in common, from which
//! `flicker` estimates what it needs without bias. What is left would matter: of a degree's motion at 64 sub-samples 4 to
//! 17 % was noise on metal rings and rocks, and half on fibres.

use super::scene::{Camera, SCENES, Scene};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Names of the sequences.
pub const SEQUENCES: [&str; 3] = ["light-arc", "camera-arc", "zoom"];
/// Longest arc: from the scenes' 45 degrees, half of it leads to 75.
const LONGEST: f64 = 60.0;
/// Numbers of frames have three digits.
const MOST_FRAMES: usize = 1000;

/// How much there is of each sequence.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Motion {
    /// Frames of a sequence, at least 2.
    pub frames: usize,
    /// Degrees from frame to frame.
    pub step: f32,
}

impl Motion {
    /// Checks every bound.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn validate(&self) -> Result<()> {
        if !(2..=MOST_FRAMES).contains(&self.frames) {
            let problem = format!("{} frames are not 2 to {MOST_FRAMES}", self.frames);
            return Err(Error::config("motion.frames", problem));
        }
        let most = LONGEST / (self.frames - 1) as f64;
        if !(self.step > 0.0 && f64::from(self.step) <= most) {
            let problem = format!(
                "{} degrees: {} frames need more than 0 and at most {most:.3}, an arc of {LONGEST} degrees",
                self.step, self.frames
            );
            return Err(Error::config("motion.step", problem));
        }
        Ok(())
    }

    /// The scene of a frame of the sequence at a place in [`SEQUENCES`].
    pub fn scene(&self, sequence: usize, frame: usize) -> Scene {
        let degrees = f64::from(self.step) * (frame as f64 - 0.5 * self.frames.saturating_sub(1) as f64);
        let name = SEQUENCES[sequence.min(SEQUENCES.len() - 1)];
        let mut scene = SCENES[1].clone();
        match name {
            "light-arc" => scene.tilt += degrees,
            "camera-arc" => scene.camera.tilt += degrees,
            _ => scene.camera.distance = Camera::NEUMIP.distance * (-degrees.to_radians()).exp(),
        }
        Scene { name: format!("{name}-{frame:03}").into(), ..scene }
    }
}

/// Halves of a frame.
pub(crate) const HALVES: usize = 2;

/// Name among the views of a picture of a sequence: frame after frame, its two halves.
pub(crate) fn picture_name(sequence: &str, picture: usize) -> String {
    format!("{sequence}-{:03}-{}", picture / HALVES, if picture.is_multiple_of(HALVES) { 'a' } else { 'b' })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The middle of an arc is where it should be to the rounding of a step of f32.
    const ROUNDING: f64 = 1e-6;

    #[test]
    fn sequences_are_centred_and_move_by_equal_steps() {
        let motion = Motion { frames: 5, step: 2.0 };
        motion.validate().unwrap();
        for (place, sequence) in SEQUENCES.into_iter().enumerate() {
            let scenes: Vec<Scene> = (0..5).map(|frame| motion.scene(place, frame)).collect();
            assert_eq!(scenes[3].name, format!("{sequence}-003"));
            assert_eq!(Scene { name: SCENES[1].name.clone(), ..scenes[2].clone() }, SCENES[1]);
            for pair in scenes.windows(2) {
                let [a, b] = [&pair[0], &pair[1]];
                let moved = [
                    b.tilt - a.tilt,
                    b.camera.tilt - a.camera.tilt,
                    (a.camera.distance / b.camera.distance).ln().to_degrees(),
                ];
                for (k, moved) in moved.into_iter().enumerate() {
                    assert!(
                        (moved - if k == place { 2.0 } else { 0.0 }).abs() < ROUNDING,
                        "{sequence} {moved}"
                    );
                }
            }
        }
    }

    #[test]
    fn arcs_end_above_the_horizon() {
        let say = |frames, step| Motion { frames, step }.validate().map_err(|e| e.to_string());
        assert!(say(61, 1.0).is_ok() && say(2, 60.0).is_ok());
        for frames in [0, 1, 1001] {
            assert!(say(frames, 0.01).unwrap_err().starts_with("motion.frames: "));
        }
        for (frames, step) in [(62, 1.0), (2, 61.0), (8, 0.0), (8, -1.0), (8, f32::NAN)] {
            assert!(say(frames, step).unwrap_err().starts_with("motion.step: "));
        }
    }
}
