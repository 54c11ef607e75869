//! What the export promises, a file a promise.

mod browser;
mod bundles;
mod checkpoints;
mod graphs;
mod lobes;
mod materials;
mod plain;
mod precision;
mod shaders;
mod steps;
mod textures;
mod windows;
