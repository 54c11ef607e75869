//! Weights of the two networks, packed for the instruction set.

use super::plan::Plan;
use crate::error::Result;
use crate::kernels::mlp::Packed;
use crate::kernels::simd::Isa;
use neumip_export::config::{DECODER_MLP, OFFSET_MLP, bias_name, weight_name};

/// The networks, ready for tiles.
#[derive(Clone, Debug)]
pub struct Networks {
    pub(super) offset: Vec<Packed>,
    pub(super) decoder: Vec<Packed>,
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
        let mut this = Self::forward(plan, values)?;
        let (weight, bias) = (values(&weight_name(DECODER_MLP, 0))?, values(&bias_name(DECODER_MLP, 0))?);
        let columns = plan.columns();
        let part = |of: &[usize]| Packed::layer(plan.isa, &weight, &bias, of.iter().copied());
        this.first = Some((part(&columns[..plan.wi.start]), part(&columns[plan.wi.clone()])));
        Ok(this)
    }

    /// The networks for training.
    ///
    /// # Errors
    /// What `values` reports.
    pub fn training(plan: &Plan, values: Values) -> Result<Self> {
        let mut this = Self::forward(plan, values)?;
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

    fn forward(plan: &Plan, values: Values) -> Result<Self> {
        let architecture = &plan.architecture;
        let offset = match architecture.offset_widths() {
            Some(widths) => layers(plan.isa, OFFSET_MLP, widths.len() - 1, None, values)?,
            None => Vec::new(),
        };
        let count = architecture.decoder_widths().map_or(0, |widths| widths.len() - 1);
        let decoder = layers(plan.isa, DECODER_MLP, count, Some(plan.columns()), values)?;
        Ok(Self { offset, decoder, first: None, offset_back: Vec::new(), decoder_back: Vec::new() })
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
