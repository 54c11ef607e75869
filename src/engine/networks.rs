//! Weights of the two networks, packed for the instruction set.

use super::plan::Plan;
use crate::error::Result;
use crate::kernels::inception::{Network, Shape};
use crate::kernels::mlp::Packed;
use crate::kernels::simd::Isa;
use neumip_export::config::{
    Architecture, DECODER_MLP, DecoderConfig, InceptionConfig, OFFSET_MLP, bias_name, weight_name,
};

/// The networks, ready for tiles.
#[derive(Clone, Debug)]
pub struct Networks {
    pub(super) offset: Vec<Packed>,
    pub(super) decoder: Vec<Packed>,
    /// The decoder, where it reads neighbours.
    pub(super) inception: Option<Network>,
    /// What of the decoder's first layer does not depend on wi, and what does, where the order of rows is light-last.
    pub(super) first: Option<(Packed, Packed)>,
    /// Transposed layers, for training.
    pub(super) offset_back: Vec<Packed>,
    pub(super) decoder_back: Vec<Packed>,
}

/// Values of a tensor by name.
pub type Values<'a> = &'a dyn Fn(&str) -> Result<Vec<f32>>;

impl Networks {
    /// The networks for answering; the plan's order is light-last.
    ///
    /// # Errors
    /// What `values` reports.
    pub fn answering(plan: &Plan, values: Values) -> Result<Self> {
        let mut this = Self::forward(plan, values, None)?;
        if this.inception.is_some() {
            return Ok(this);
        }
        let (weight, bias) = (values(&weight_name(DECODER_MLP, 0))?, values(&bias_name(DECODER_MLP, 0))?);
        let columns = plan.columns();
        let part = |of: &[usize]| Packed::layer(plan.isa, &weight, &bias, of.iter().copied());
        this.first = Some((part(&columns[..plan.wi.start]), part(&columns[plan.wi.clone()])));
        Ok(this)
    }

    /// Weights and biases of a decoder that reads neighbours.
    pub(super) fn convolved(&self) -> usize {
        self.inception.as_ref().map_or(0, |network| network.shape().parameters())
    }

    /// The networks for training.
    ///
    /// # Errors
    /// What `values` reports.
    pub fn training(plan: &Plan, values: Values) -> Result<Self> {
        let mut this = Self::forward(plan, values, Some(plan.channels()))?;
        let back = |prefix: &str, layers: &[Packed], learned: usize| -> Result<Vec<Packed>> {
            let one = |(i, layer): (usize, &Packed)| {
                let weight = values(&weight_name(prefix, i))?;
                // Of the first layer only the texture's features have anything to learn.
                let of = if i == 0 { learned } else { layer.inputs() };
                Ok(Packed::transposed(plan.isa, &weight, layer.outputs(), 0..of))
            };
            layers.iter().enumerate().map(one).collect()
        };
        this.decoder_back = back(DECODER_MLP, &this.decoder, plan.channels())?;
        if let Some((channels, _)) = plan.offset {
            this.offset_back = back(OFFSET_MLP, &this.offset, channels)?;
        }
        Ok(this)
    }

    /// Outputs of the decoder's first layer.
    pub(super) fn first_outputs(&self) -> usize {
        self.decoder.first().map_or(0, Packed::outputs)
    }

    /// `learned` inputs of a decoder that reads neighbours get gradients.
    fn forward(plan: &Plan, values: Values, learned: Option<usize>) -> Result<Self> {
        let architecture = &plan.architecture;
        let offset = match architecture.offset_widths() {
            Some(widths) => layers(plan.isa, OFFSET_MLP, widths.len() - 1, None, values)?,
            None => Vec::new(),
        };
        let count = architecture.decoder_widths().map_or(0, |widths| widths.len() - 1);
        let decoder = layers(plan.isa, DECODER_MLP, count, Some(plan.columns()), values)?;
        let inception = match &architecture.model.decoder {
            DecoderConfig::Mlp { .. } => None,
            DecoderConfig::Inception(config) => {
                Some(convolutions(plan.isa, architecture, config, values, learned)?)
            }
        };
        let (offset_back, decoder_back) = (Vec::new(), Vec::new());
        Ok(Self { offset, decoder, inception, first: None, offset_back, decoder_back })
    }
}

/// The shape of an Inception decoder's network.
pub(crate) fn inception_shape(architecture: &Architecture, config: &InceptionConfig) -> Shape {
    Shape {
        inputs: architecture.decoder_inputs(),
        width: config.width,
        modules: config.modules,
        paths: config.paths,
        reduce: config.reduce,
        outputs: architecture.decoder_outputs(),
    }
}

fn convolutions(
    isa: Isa,
    architecture: &Architecture,
    config: &InceptionConfig,
    values: Values,
    learned: Option<usize>,
) -> Result<Network> {
    let shape = inception_shape(architecture, config);
    let tensors = architecture.convolutions().into_iter().flat_map(|c| c.tensors());
    let tensors: Vec<Vec<f32>> = tensors.map(|(name, _)| values(&name)).collect::<Result<_>>()?;
    let weights: Vec<(&[f32], &[f32])> = tensors.chunks(2).map(|pair| (&pair[0][..], &pair[1][..])).collect();
    match learned {
        Some(learned) => Network::learning(isa, &shape, learned, &weights),
        None => Network::new(isa, &shape, &weights),
    }
}

fn layers(
    isa: Isa,
    prefix: &str,
    count: usize,
    mut columns: Option<Vec<usize>>,
    values: Values,
) -> Result<Vec<Packed>> {
    (0..count)
        .map(|i| {
            let (weight, bias) = (values(&weight_name(prefix, i))?, values(&bias_name(prefix, i))?);
            let of = columns.take().unwrap_or_else(|| (0..weight.len() / bias.len().max(1)).collect());
            Ok(Packed::layer(isa, &weight, &bias, of))
        })
        .collect()
}
