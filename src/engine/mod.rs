//! The fused engine: a material answered and differentiated tile by tile, every intermediate value in a core's cache.
//!
//! ```text
//! Plan ─ what is computed: rows of a tile, encodings, output
//! Networks ─ weights packed for the instruction set        Textures ─ tables that lookups read
//!   │                                                        │
//! Tile ─ forward: offset, lookup, encoding, decoder, output; backward: the same in reverse
//!   │
//!   ├──── Canvas ─ images of tiles, for a decoder that reads neighbours
//! FusedMaterial ─ answers query buffers                     Batch ─ loss and gradients of a training step
//! ```

mod backward;
mod batch;
mod images;
mod material;
mod networks;
mod plan;
mod studio;
#[cfg(test)]
mod tests;
mod textures;
mod tile;

pub use batch::{Batch, Loss, Sums};
pub use material::{FusedMaterial, Prepared};
pub use networks::Networks;
pub(crate) use networks::inception_shape;
pub use plan::{Order, Plan};
pub use textures::{Table, Textures};
