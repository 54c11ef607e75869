//! The network that turns features and encodings into outputs.

mod inception;
mod mlp;

pub use inception::Inception;
pub use mlp::Mlp;

use crate::error::{Error, Result};
use crate::query::grid::Mosaic;
use candle_core::Tensor;
use neumip_export::config::{Architecture, DECODER_MLP};

/// A decoder of any kind.
pub enum Decoder {
    /// Fully connected.
    Mlp(Mlp),
    /// Convolutions over images of queries.
    Inception(Inception),
}

impl Decoder {
    /// The decoder of an architecture.
    ///
    /// # Errors
    /// What `tensor` reports.
    pub fn new(architecture: &Architecture, tensor: &dyn Fn(&str) -> Result<Tensor>) -> Result<Self> {
        Ok(match architecture.decoder_widths() {
            Some(widths) => Self::Mlp(Mlp::new(DECODER_MLP, widths.len() - 1, tensor)?),
            None => Self::Inception(Inception::new(&architecture.convolutions(), tensor)?),
        })
    }

    /// Outputs \[N, 3 or 6\] of inputs \[N, in\]; convolutions need to know how the N are laid out.
    ///
    /// # Errors
    /// `Config` for convolutions over queries that are no images, or whatever candle refuses.
    pub fn forward(&self, x: &Tensor, images: Option<Mosaic>) -> Result<Tensor> {
        match (self, images) {
            (Self::Mlp(mlp), _) => mlp.forward(x),
            (Self::Inception(inception), Some(mosaic)) => inception.forward(x, mosaic),
            (Self::Inception(_), None) => {
                Err(Error::config("queries", "are no images, which an Inception decoder reads"))
            }
        }
    }
}
