//! The network on a rectangle as it comes, zeros around it: what a convolution does unless told otherwise.

use crate::engine::inception_shape;
use crate::error::{Error, Result};
use crate::kernels::inception::{Border, Images, Network, Room};
use crate::kernels::simd::Isa;
use crate::model::decoder::Mlp;
use crate::model::texture::{Sigmas, fetch};
use crate::model::{Inputs, Tables, Variables, output, parallax};
use crate::query::{QueryBuffer, above_horizon};
use candle_core::{Device, Tensor};
use neumip_export::Checkpoint;
use neumip_export::config::{Architecture, DecoderConfig, OFFSET_MLP};

/// An Inception model without a rule for the border.
pub struct Padded {
    architecture: Architecture,
    tables: Tables,
    offset: Option<Mlp>,
    network: Network,
}

impl Padded {
    /// The model of a checkpoint.
    ///
    /// # Errors
    /// `Config` if a tensor does not fit, or the decoder is of another kind.
    pub fn new(checkpoint: &Checkpoint) -> Result<Self> {
        let architecture = checkpoint.header.architecture.clone();
        let DecoderConfig::Inception(config) = &architecture.model.decoder else {
            return Err(Error::config("decoder.kind", "is not inception"));
        };
        let shape = inception_shape(&architecture, config);
        let mut weights: Vec<(&[f32], &[f32])> = Vec::new();
        for convolution in architecture.convolutions() {
            let [(weight, _), (bias, _)] = convolution.tensors();
            weights.push((&checkpoint.tensor(&weight)?.data, &checkpoint.tensor(&bias)?.data));
        }
        let network = Network::new(Isa::chosen()?, &shape, &weights)?;
        let variables = Variables::from_stored(&architecture, &checkpoint.tensors, &Device::Cpu)?;
        let offset = match architecture.offset_widths() {
            Some(widths) => Some(Mlp::new(OFFSET_MLP, widths.len() - 1, &|name| {
                Ok(variables.get(name)?.as_detached_tensor())
            })?),
            None => None,
        };
        let tables = Tables::new(&architecture, &variables, &Sigmas::none(&architecture))?;
        Ok(Self { architecture, tables, offset, network })
    }

    /// The answers to a buffer as one image with this border.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn answers(&self, queries: &QueryBuffer, border: Border) -> Result<Vec<[f32; 3]>> {
        let QueryBuffer { u, wi, wo, level, .. } = queries;
        let inputs = Inputs::new(&self.architecture, u, wi, wo, level, &Device::Cpu)?;
        let model = &self.architecture.model;
        let position = parallax::shifted(&model.parallax, self.offset.as_ref(), &inputs, &self.tables)?;
        let features = fetch(&self.tables.pyramid, &position, &inputs.levels)?;
        let all = match &inputs.encoding {
            Some(encoding) => Tensor::cat(&[&features, encoding], 1)?,
            None => features,
        };
        let all: Vec<f32> = all.flatten_all()?.to_vec1()?;
        let outputs = self.architecture.decoder_outputs();
        let mut raw = vec![0.0; queries.len() * outputs];
        let images = Images::new(1, queries.height(), queries.width(), border)?;
        self.network.forward(images, &all, &mut Room::default(), &mut raw);
        let raw = Tensor::from_vec(raw, (queries.len(), outputs), &Device::Cpu)?;
        let rgb: Vec<f32> = output::rgb(&raw, &model.output)?.flatten_all()?.to_vec1()?;
        let lit = |k: usize| above_horizon(wi[k]) && above_horizon(wo[k]);
        let pixels = rgb.as_chunks::<3>().0.iter().enumerate();
        Ok(pixels
            .map(|(k, p)| if lit(k) { p.map(|v| if v < 0.0 { 0.0 } else { v }) } else { [0.0; 3] })
            .collect())
    }
}

/// The rectangle of a buffer at a row and a column, and where its queries are in the whole.
///
/// # Errors
/// `Config` if it is not inside.
pub fn cut(whole: &QueryBuffer, at: [usize; 2], size: [usize; 2]) -> Result<(QueryBuffer, Vec<usize>)> {
    if at[0] + size[0] > whole.height() || at[1] + size[1] > whole.width() {
        return Err(Error::config("queries", "the rectangle is not inside"));
    }
    let row = |i: usize| (at[0] + i) * whole.width() + at[1];
    let places: Vec<usize> = (0..size[0]).flat_map(|i| row(i)..row(i) + size[1]).collect();
    let pick = |pairs: &[[f32; 2]]| places.iter().map(|k| pairs[*k]).collect();
    let level = places.iter().map(|k| whole.level[*k]).collect();
    let part = QueryBuffer::new(size[0], size[1], pick(&whole.u), pick(&whole.wi), pick(&whole.wo), level)?;
    Ok((part, places))
}
