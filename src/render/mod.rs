//! Pictures of scenes: objects, lights and cameras around materials that answer queries.
//!
//! ```text
//! format ─ scene.json      animation ─ the scene at a frame
//!   │
//! world (shape, mesh), light (environment, sky), camera, material ─ what was opened: scene
//!   │
//! trace ─ rays and what they meet; directions ─ where to look for light
//!   │
//! asked ─ a query buffer for each material, and how its answers become radiance      demand ─ a sample of all of them
//!   │
//! picture ─ a frame in batches      folder, frame_file, compare ─ what becomes of it
//! ```
//!
//! On a curved surface a material is asked in the tangent plane of the point: its own relief is bent with the surface, but
//! not stretched at its bends, and sees neither the horizon of the bent surface nor its own silhouette.

pub mod animation;
pub mod asked;
pub mod builtin;
pub mod camera;
pub mod compare;
pub mod demand;
pub mod directions;
pub mod environment;
mod fitted;
pub mod folder;
pub mod format;
pub mod frame_file;
pub mod light;
pub mod material;
pub mod mesh;
pub mod picture;
pub mod scene;
pub mod shape;
pub mod sky;
pub mod trace;
pub mod world;

pub use asked::Asked;
pub use demand::{Demand, Sample};
pub use directions::{Cosine, Directions, Lobes, View};
pub use fitted::directions_of;
pub use format::SceneFile;
pub use material::{Material, Model};
pub use picture::{Cost, Picture, Progress};
pub use scene::{Frame, OpenOptions, Scene};
