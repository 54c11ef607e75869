//! The neural material in candle, on any candle device: encoding, parallax, texture pyramid, decoder, output.

pub mod decoder;
pub mod inputs;
pub mod material;
pub mod output;
pub mod parallax;
pub mod texture;
pub mod variables;

pub use inputs::Inputs;
pub use material::NeuralMaterial;
pub use texture::Tables;
pub use variables::Variables;

use crate::error::Result;
use candle_core::{Device, Tensor};
use decoder::{Decoder, Mlp};
use neumip_export::config::{Architecture, OFFSET_MLP};

/// The networks of a model, reading variables (or plain tensors) that someone else owns.
/// Textures are given to [`Networks::forward`], since training reads them smoothed.
pub struct Networks {
    /// What is built.
    pub architecture: Architecture,
    offset: Option<Mlp>,
    decoder: Decoder,
}

impl Networks {
    /// The networks over `variables`.
    ///
    /// # Errors
    /// `Config` if a variable is missing.
    pub fn new(architecture: &Architecture, variables: &Variables) -> Result<Self> {
        Self::reading(architecture, &|name| Ok(variables.get(name)?.as_tensor().clone()))
    }

    /// The networks over the values of `variables`: what they compute keeps no graph.
    ///
    /// # Errors
    /// `Config` if a variable is missing.
    pub fn detached(architecture: &Architecture, variables: &Variables) -> Result<Self> {
        Self::reading(architecture, &|name| Ok(variables.get(name)?.as_detached_tensor()))
    }

    fn reading(architecture: &Architecture, tensor: &dyn Fn(&str) -> Result<Tensor>) -> Result<Self> {
        let offset = match architecture.offset_widths() {
            Some(widths) => Some(Mlp::new(OFFSET_MLP, widths.len() - 1, tensor)?),
            None => None,
        };
        let decoder = Decoder::new(architecture, tensor)?;
        Ok(Self { architecture: architecture.clone(), offset, decoder })
    }

    /// RGB \[N, 3\] of N queries, not clamped.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn forward(&self, inputs: &Inputs, tables: &Tables) -> Result<Tensor> {
        let x = self.decoder_inputs(inputs, tables)?;
        output::rgb(&self.decoder.forward(&x, inputs.images)?, &self.architecture.model.output)
    }

    /// What the decoder reads of N queries \[N, inputs\]: features first, then the encoding.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn decoder_inputs(&self, inputs: &Inputs, tables: &Tables) -> Result<Tensor> {
        let position =
            parallax::shifted(&self.architecture.model.parallax, self.offset.as_ref(), inputs, tables)?;
        let features = texture::fetch(&tables.pyramid, &position, &inputs.levels)?;
        Ok(match &inputs.encoding {
            Some(encoding) => Tensor::cat(&[&features, encoding], 1)?,
            None => features,
        })
    }
}

/// The device of a name: `cpu`, `cuda`, `cuda:N`, `metal` or `metal:N`.
///
/// # Errors
/// `Usage` for an unknown name or a device this build or machine does not have.
pub fn device(name: &str) -> Result<Device> {
    use crate::error::Error;
    let (kind, ordinal) = name.split_once(':').unwrap_or((name, "0"));
    let ordinal: usize =
        ordinal.parse().map_err(|_| Error::usage(format!("--device {name}: no such device")))?;
    match kind {
        "cpu" => Ok(Device::Cpu),
        "cuda" => Device::new_cuda(ordinal).map_err(|e| Error::usage(format!("--device {name}: {e}"))),
        "metal" => Device::new_metal(ordinal).map_err(|e| Error::usage(format!("--device {name}: {e}"))),
        _ => Err(Error::usage(format!("--device {name}: use cpu, cuda:N or metal:N"))),
    }
}
