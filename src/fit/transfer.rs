//! A smaller model that starts as what it can be of a larger one.
//!
//! Textures lose levels, channels and what lies outside of the window. Networks are rebuilt layer by layer: of each layer the
//! units that matter most to the next one are kept, and the weights into them are those that reproduce the larger model's sums
//! best (least squares) on queries of the scene, from whatever the smaller model reads there. Without training after it, this
//! is the truncated model that a fitted one is compared with.

use super::need::Need;
use crate::error::{Error, Result};
use crate::model::inputs::Inputs;
use crate::model::texture::{Sigmas, fetch_offset};
use crate::model::{Networks, Tables, Variables};
use crate::query::QueryBuffer;
use candle_core::{Device, Tensor};
use nalgebra::{DMatrix, DVector};
use neumip_export::Tensor as Stored;
use neumip_export::checkpoint::Checkpoint;
use neumip_export::config::{
    Architecture, DECODER_MLP, OFFSET_MLP, OFFSET_TEXTURE, ParallaxConfig, bias_name, texture_name,
    weight_name,
};
use std::collections::BTreeMap;

/// Ridge of the least squares, against the mean square of the inputs: sums of thousands of queries in f32 have six digits.
const RIDGE: f64 = 1e-5;

/// Tensors of `to`, on the window of `need`, made from those of a model of the whole tile, on `queries` of the tile.
///
/// # Errors
/// `Config` for a model that is no narrower version of the larger one, or has no fully connected decoder.
pub fn transfer(
    from: &Checkpoint,
    to: &Architecture,
    need: &Need,
    queries: &QueryBuffer,
) -> Result<BTreeMap<String, Stored>> {
    let large = &from.header.architecture;
    let (Some(large_widths), Some(widths)) = (large.decoder_widths(), to.decoder_widths()) else {
        return Err(Error::config("decoder", "only fully connected decoders can be narrowed"));
    };
    let local = local(need, queries);
    let whole = Reader::new(large, &from.tensors)?;
    let mut tensors = Variables::initial(to, 0, &Device::Cpu)?.to_stored()?;

    let inputs = whole.decoder_inputs(queries)?;
    let first = whole.layer(DECODER_MLP, 0)?;
    let channels = strongest(&inputs, &first, large.model.texture.channels, to.model.texture.channels);
    for (index, size) in to.level_sizes().iter().enumerate() {
        let level = to.model.texture.finest + index;
        let source = texture(from, level)?;
        let size = [size.height, size.width];
        let texture = match need.average() == Some(level) {
            true => mean(&source, size, &channels),
            false => cut(&source, need, level, size, &channels),
        };
        tensors.insert(texture_name(index), texture);
    }
    if let (ParallaxConfig::Offset(wide), ParallaxConfig::Offset(slim)) =
        (&large.model.parallax, &to.model.parallax)
    {
        let inputs = whole.offset_inputs(queries)?;
        let kept = strongest(&inputs, &whole.layer(OFFSET_MLP, 0)?, wide.channels, slim.channels);
        let stored = from.tensors.get(OFFSET_TEXTURE).ok_or_else(|| missing(OFFSET_TEXTURE))?;
        let finest = to.model.texture.finest;
        let source = halved(stored.clone(), finest.saturating_sub(large.model.texture.finest));
        tensors.insert(OFFSET_TEXTURE.into(), cut(&source, need, finest, to.finest_size(), &kept));
        let small = Reader::new(to, &tensors)?.offset_inputs(&local)?;
        // Depths count in tiles, and a window is a smaller one.
        let stretch = f64::from(wide.scale / slim.scale) * need.tile[1] as f64 / need.size[1] as f64;
        let widths = to.offset_widths().unwrap_or_default();
        let network = narrowed(&whole, OFFSET_MLP, wide.hidden.len() + 1, inputs, small, &widths, stretch)?;
        insert(&mut tensors, OFFSET_MLP, network);
    }
    let small = Reader::new(to, &tensors)?.decoder_inputs(&local)?;
    let network = narrowed(&whole, DECODER_MLP, large_widths.len() - 1, inputs, small, &widths, 1.0)?;
    insert(&mut tensors, DECODER_MLP, network);
    Ok(tensors)
}

/// Queries in the window's coordinates.
fn local(need: &Need, queries: &QueryBuffer) -> QueryBuffer {
    let domain = need.domain("", 0.0);
    let mut out = queries.clone();
    for (u, level) in out.u.iter_mut().zip(&mut out.level) {
        *u = domain.local(need.size, *u).map(|v| v - v.floor());
        *level = level.clamp(need.levels[0], need.levels[1]);
    }
    out
}

/// One layer: weights \[out, in\] and biases.
struct Layer {
    weight: DMatrix<f64>,
    bias: DVector<f64>,
}

/// What the networks of a model read.
struct Reader<'a> {
    architecture: &'a Architecture,
    tensors: &'a BTreeMap<String, Stored>,
    networks: Networks,
    tables: Tables,
}

impl<'a> Reader<'a> {
    fn new(architecture: &'a Architecture, tensors: &'a BTreeMap<String, Stored>) -> Result<Self> {
        let variables = Variables::from_stored(architecture, tensors, &Device::Cpu)?;
        let tables = Tables::new(architecture, &variables, &Sigmas::none(architecture))?;
        let networks = Networks::detached(architecture, &variables)?;
        Ok(Self { architecture, tensors, networks, tables })
    }

    fn inputs(&self, q: &QueryBuffer) -> Result<Inputs> {
        Inputs::new(self.architecture, &q.u, &q.wi, &q.wo, &q.level, &Device::Cpu)
    }

    /// What the decoder reads, a row a query.
    fn decoder_inputs(&self, queries: &QueryBuffer) -> Result<DMatrix<f64>> {
        matrix(&self.networks.decoder_inputs(&self.inputs(queries)?, &self.tables)?)
    }

    /// What the offset network reads: features, then wo.
    fn offset_inputs(&self, queries: &QueryBuffer) -> Result<DMatrix<f64>> {
        let inputs = self.inputs(queries)?;
        let features = match &self.tables.offset {
            Some(table) => fetch_offset(table, &inputs)?,
            None => None,
        };
        match features {
            Some(features) => matrix(&Tensor::cat(&[&features, &inputs.wo], 1)?),
            None => Err(Error::config("parallax", "has no offset to narrow")),
        }
    }

    fn layer(&self, prefix: &str, index: usize) -> Result<Layer> {
        let find = |name: String| {
            self.tensors.get(&name).ok_or_else(|| Error::config(name, "this tensor is missing"))
        };
        let (weight, bias) = (find(weight_name(prefix, index))?, find(bias_name(prefix, index))?);
        let values = weight.data.iter().map(|v| f64::from(*v));
        Ok(Layer {
            weight: DMatrix::from_row_iterator(weight.shape[0], weight.shape[1], values),
            bias: DVector::from_iterator(bias.data.len(), bias.data.iter().map(|v| f64::from(*v))),
        })
    }
}

fn matrix(tensor: &Tensor) -> Result<DMatrix<f64>> {
    let (rows, columns) = tensor.dims2()?;
    let values: Vec<f32> = tensor.flatten_all()?.to_vec1()?;
    Ok(DMatrix::from_row_iterator(rows, columns, values.into_iter().map(f64::from)))
}

impl Layer {
    /// Sums of all rows.
    fn sums(&self, inputs: &DMatrix<f64>) -> DMatrix<f64> {
        let mut sums = inputs * self.weight.transpose();
        for mut row in sums.row_iter_mut() {
            row += self.bias.transpose();
        }
        sums
    }

    /// The layer that comes nearest to `sums` from `inputs`.
    fn fitted(inputs: &DMatrix<f64>, sums: &DMatrix<f64>) -> Result<Self> {
        let n = inputs.ncols();
        let full = inputs.clone().insert_column(n, 1.0);
        let mut normal = full.transpose() * &full;
        let ridge = RIDGE * normal.trace() / (n + 1) as f64;
        // The bias is not held back.
        (0..n).for_each(|k| normal[(k, k)] += ridge.max(f64::MIN_POSITIVE));
        let right = full.transpose() * sums;
        let Some(factor) = normal.cholesky() else {
            return Err(Error::config(
                "transfer",
                "its least squares have no solution: a value is not finite",
            ));
        };
        let solution = factor.solve(&right);
        Ok(Self { weight: solution.rows(0, n).transpose(), bias: solution.row(n).transpose() })
    }
}

/// Of the first `features` inputs of a layer the `count` that move its sums most: variance times the square of the weights.
fn strongest(inputs: &DMatrix<f64>, layer: &Layer, features: usize, count: usize) -> Vec<usize> {
    let weight = |k: usize| inputs.column(k).variance() * layer.weight.column(k).norm_squared();
    let mut order: Vec<(f64, usize)> = (0..features).map(|k| (weight(k), k)).collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut kept: Vec<usize> = order.into_iter().take(count).map(|(_, k)| k).collect();
    kept.sort_unstable();
    kept
}

/// The layers of a narrower network of `widths` that reads `small` where the `depth` layers of the large one read `inputs`; its
/// outputs are those of the large one times `stretch`.
fn narrowed(
    large: &Reader,
    prefix: &str,
    depth: usize,
    inputs: DMatrix<f64>,
    small: DMatrix<f64>,
    widths: &[usize],
    stretch: f64,
) -> Result<Vec<Layer>> {
    let hidden = &widths[1..widths.len() - 1];
    if hidden.len() >= depth {
        return Err(Error::config(prefix, "is deeper than the model that it is to be narrowed from"));
    }
    // What every layer of the large network sums up.
    let mut sums = Vec::with_capacity(depth);
    let mut before = inputs;
    for k in 0..depth {
        sums.push(large.layer(prefix, k)?.sums(&before));
        before = sums[k].map(|v| v.max(0.0));
    }
    let mut layers = Vec::with_capacity(widths.len() - 1);
    let mut before = small;
    for (k, &width) in hidden.iter().enumerate() {
        let next = large.layer(prefix, k + 1)?;
        let active = sums[k].map(|v| v.max(0.0));
        if width > active.ncols() {
            return Err(Error::config(prefix, "is wider than the model that it is to be narrowed from"));
        }
        let kept = strongest(&active, &next, active.ncols(), width);
        let layer = Layer::fitted(&before, &sums[k].select_columns(&kept))?;
        before = layer.sums(&before).map(|v| v.max(0.0));
        layers.push(layer);
    }
    let outputs = &sums[depth - 1] * stretch;
    layers.push(Layer::fitted(&before, &outputs)?);
    Ok(layers)
}

fn insert(tensors: &mut BTreeMap<String, Stored>, prefix: &str, layers: Vec<Layer>) {
    for (k, layer) in layers.into_iter().enumerate() {
        let shape = vec![layer.weight.nrows(), layer.weight.ncols()];
        // nalgebra stores columns; its transpose's columns are the rows.
        let data = layer.weight.transpose().iter().map(|v| *v as f32).collect();
        tensors.insert(weight_name(prefix, k), Stored { shape, data });
        let data: Vec<f32> = layer.bias.iter().map(|v| *v as f32).collect();
        tensors.insert(bias_name(prefix, k), Stored { shape: vec![data.len()], data });
    }
}

fn missing(name: &str) -> Error {
    Error::config(name, "this tensor is missing")
}

/// The texture of a level of the tile, from the nearest level that the model stores.
fn texture(from: &Checkpoint, level: usize) -> Result<Stored> {
    let architecture = &from.header.architecture;
    let index = level.saturating_sub(architecture.model.texture.finest).min(architecture.levels() - 1);
    let name = texture_name(index);
    let stored = from.tensors.get(&name).ok_or_else(|| missing(&name))?;
    Ok(halved(stored.clone(), level.saturating_sub(architecture.coarsest())))
}

/// A texture at half its size, so many times: means of 2 x 2 texels.
fn halved(mut texture: Stored, times: usize) -> Stored {
    for _ in 0..times {
        let [height, width, channels] = [texture.shape[0], texture.shape[1], texture.shape[2]];
        let (h, w) = ((height / 2).max(1), (width / 2).max(1));
        let mut data = Vec::with_capacity(h * w * channels);
        for y in 0..h {
            for x in 0..w {
                for c in 0..channels {
                    let at = |dy: usize, dx: usize| {
                        let (y, x) = ((2 * y + dy).min(height - 1), (2 * x + dx).min(width - 1));
                        texture.data[(y * width + x) * channels + c]
                    };
                    data.push(0.25 * (at(0, 0) + at(0, 1) + at(1, 0) + at(1, 1)));
                }
            }
        }
        texture = Stored { shape: vec![h, w, channels], data };
    }
    texture
}

/// The window of `need` in a texture of a level, some of its channels; around its border it goes on.
fn cut(texture: &Stored, need: &Need, level: usize, size: [usize; 2], channels: &[usize]) -> Stored {
    let [height, width, all] = [texture.shape[0], texture.shape[1], texture.shape[2]];
    let corner = need.corner.map(|texel| texel >> level);
    let mut data = Vec::with_capacity(size[0] * size[1] * channels.len());
    for y in 0..size[0] {
        for x in 0..size[1] {
            let at = (corner[0] + y) % height * width + (corner[1] + x) % width;
            data.extend(channels.iter().map(|c| texture.data[at * all + c]));
        }
    }
    Stored { shape: vec![size[0], size[1], channels.len()], data }
}

/// A texture that is its own mean everywhere.
fn mean(texture: &Stored, size: [usize; 2], channels: &[usize]) -> Stored {
    let all = texture.shape[2];
    let texels = texture.data.chunks(all);
    let n = texels.len() as f32;
    let mean = |c: &usize| texture.data.iter().skip(*c).step_by(all).sum::<f32>() / n;
    let means: Vec<f32> = channels.iter().map(mean).collect();
    let data = means.iter().copied().cycle().take(size[0] * size[1] * means.len()).collect();
    Stored { shape: vec![size[0], size[1], means.len()], data }
}
