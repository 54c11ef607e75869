//! The parameters of a model as named candle variables, in a fixed order.

use crate::error::{Error, Result};
use crate::random::{Random, Stream};
use candle_core::{CpuStorage, Device, Storage, Tensor, Var};
use neumip_export::Tensor as StoredTensor;
use neumip_export::config::{Architecture, OFFSET_TEXTURE};
use std::collections::BTreeMap;
use std::ops::{Deref, Range};

/// Named variables in the order of [`Architecture::tensors`].
pub struct Variables(Vec<(String, Var)>);

impl Variables {
    /// Fresh variables: textures N(0, init_std), offset texture 0, layers uniform in +-1/sqrt(inputs) as PyTorch's.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn initial(architecture: &Architecture, seed: u64, device: &Device) -> Result<Self> {
        let mut all = Vec::new();
        let mut fan_in = 1;
        for (index, (name, shape)) in architecture.tensors().into_iter().enumerate() {
            let mut random = Random::new(seed, Stream::Weights, index as u64);
            let n: usize = shape.iter().product();
            if matches!(shape.len(), 2 | 4) {
                fan_in = shape[1..].iter().product();
            }
            let bound = 1.0 / (fan_in as f32).sqrt();
            let values: Vec<f32> = match shape.len() {
                3 if name == OFFSET_TEXTURE => vec![0.0; n],
                3 => (0..n).map(|_| architecture.model.texture.init_std * random.normal()).collect(),
                _ => (0..n).map(|_| bound * (2.0 * random.uniform() - 1.0)).collect(),
            };
            all.push((name, Var::from_vec(values, shape, device)?));
        }
        Ok(Self(all))
    }

    /// Variables with stored values; every tensor of the architecture must be there with its shape.
    ///
    /// # Errors
    /// `Config`, naming the tensor.
    pub fn from_stored(
        architecture: &Architecture,
        stored: &BTreeMap<String, StoredTensor>,
        device: &Device,
    ) -> Result<Self> {
        let mut all = Vec::new();
        for (name, shape) in architecture.tensors() {
            match stored.get(&name) {
                Some(t) if t.shape == shape => {
                    all.push((name, Var::from_vec(t.data.clone(), shape, device)?));
                }
                Some(t) => {
                    return Err(Error::config(name, format!("has shape {:?}, not {shape:?}", t.shape)));
                }
                None => return Err(Error::config(name, "this tensor is missing")),
            }
        }
        Ok(Self(all))
    }

    /// Variables of the same names and shapes, all 0.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn zeros_like(&self) -> Result<Self> {
        let zeros = |(name, var): &(String, Var)| Ok((name.clone(), Var::from_tensor(&var.zeros_like()?)?));
        Ok(Self(self.0.iter().map(zeros).collect::<Result<_>>()?))
    }

    /// A variable by name.
    ///
    /// # Errors
    /// `Config` if there is none of that name.
    pub fn get(&self, name: &str) -> Result<&Var> {
        self.0
            .iter()
            .find(|(n, _)| n == name)
            .map(|(_, v)| v)
            .ok_or_else(|| Error::config(name, "this tensor is missing"))
    }

    /// A variable's values, where it is on the CPU.
    ///
    /// # Errors
    /// `Config` if there is none of that name, or its values are not in host memory.
    pub fn values(&self, name: &str) -> Result<Values<'_>> {
        let (storage, layout) = self.get(name)?.as_tensor().storage_and_layout();
        match (&*storage, layout.contiguous_offsets()) {
            (Storage::Cpu(CpuStorage::F32(_)), Some((start, end))) => {
                Ok(Values { storage: Box::new(storage), range: start..end })
            }
            _ => Err(Error::config(name, "its values are not in host memory")),
        }
    }

    /// Names and variables in order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Var)> {
        self.0.iter().map(|(n, v)| (n.as_str(), v))
    }

    /// All values, copied to the host.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn to_stored(&self) -> Result<BTreeMap<String, StoredTensor>> {
        self.iter().map(|(name, var)| Ok((name.to_string(), to_stored(var.as_tensor())?))).collect()
    }
}

/// One tensor, copied to the host.
///
/// # Errors
/// Whatever candle refuses.
pub fn to_stored(tensor: &Tensor) -> Result<StoredTensor> {
    Ok(StoredTensor { shape: tensor.dims().to_vec(), data: tensor.flatten_all()?.to_vec1()? })
}

/// A variable's values on the CPU, borrowed; nothing may change the variable meanwhile.
pub struct Values<'a> {
    storage: Box<dyn Deref<Target = Storage> + 'a>,
    range: Range<usize>,
}

impl Values<'_> {
    /// The values, row-major.
    pub fn slice(&self) -> &[f32] {
        match &**self.storage {
            Storage::Cpu(CpuStorage::F32(all)) => &all[self.range.clone()],
            _ => &[],
        }
    }
}

/// True for the name of a texture, false for a network's weight or bias.
pub fn is_texture(name: &str) -> bool {
    name == OFFSET_TEXTURE || name.starts_with("texture.")
}
