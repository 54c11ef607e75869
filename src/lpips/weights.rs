//! The weights' file: safetensors of f32, for n from 1 to 5
//!
//! ```text
//! conv<n>.weight    [out, in, k, k]   in is 3, then the last stage's out; k is odd
//! conv<n>.bias      [out]
//! linear<n>.weight  [out]             what a channel's difference counts
//! ```

use super::STAGES;
use crate::error::{Error, Result};
use candle_core::{Device, Tensor};
use safetensors::{Dtype, SafeTensors};
use std::path::Path;

/// Most bytes that are read: AlexNet's have 10 million.
const MOST_BYTES: u64 = 1 << 28;
/// Largest kernel and width; more is no such network.
const MOST_KERNEL: usize = 63;
const MOST_CHANNELS: usize = 1 << 14;

/// One stage.
#[derive(Clone, Debug)]
pub(super) struct Stage {
    /// \[out, in, kernel, kernel\].
    pub(super) weight: Tensor,
    /// \[1, out, 1, 1\].
    pub(super) bias: Tensor,
    /// \[1, out, 1, 1\].
    pub(super) linear: Tensor,
    pub(super) kernel: usize,
}

/// Reads and checks all of them.
pub(super) fn read(path: &Path) -> Result<Vec<Stage>> {
    let failed = |problem: String| Error::file(path, problem);
    let length = std::fs::metadata(path).map_err(|e| failed(format!("cannot be read: {e}")))?.len();
    if length > MOST_BYTES {
        return Err(failed(format!("has {length} bytes, more than weights of LPIPS: name another file")));
    }
    let bytes = std::fs::read(path).map_err(|e| failed(format!("cannot be read: {e}")))?;
    let file = SafeTensors::deserialize(&bytes).map_err(|e| {
        failed(format!("is not a safetensors file ({e}): scripts/lpips_weights.py makes one"))
    })?;
    let mut channels = 3;
    let mut stages = Vec::with_capacity(STAGES);
    for n in 1..=STAGES {
        let (shape, weight) = tensor(&file, &format!("conv{n}.weight")).map_err(failed)?;
        let &[out, inputs, kernel, other] = &shape[..] else {
            return Err(failed(format!("conv{n}.weight is {shape:?}, not [out, in, k, k]")));
        };
        let fits = inputs == channels && kernel == other && kernel % 2 == 1;
        if !fits || kernel > MOST_KERNEL || !(1..=MOST_CHANNELS).contains(&out) {
            return Err(failed(format!(
                "conv{n}.weight is {shape:?}, not [out, {channels}, k, k] with an odd k"
            )));
        }
        let per_channel = |name: String| -> Result<Tensor> {
            let (shape, values) = tensor(&file, &name).map_err(failed)?;
            if shape != [out] {
                return Err(failed(format!("{name} is {shape:?}, not [{out}] as conv{n}.weight has it")));
            }
            Ok(Tensor::from_vec(values, (1, out, 1, 1), &Device::Cpu)?)
        };
        stages.push(Stage {
            bias: per_channel(format!("conv{n}.bias"))?,
            linear: per_channel(format!("linear{n}.weight"))?,
            weight: Tensor::from_vec(weight, (out, inputs, kernel, kernel), &Device::Cpu)?,
            kernel,
        });
        channels = out;
    }
    Ok(stages)
}

/// Shape and values of a tensor, or what is wrong with it.
fn tensor(file: &SafeTensors, name: &str) -> std::result::Result<(Vec<usize>, Vec<f32>), String> {
    let view = file
        .tensor(name)
        .map_err(|_| format!("has no tensor {name}: scripts/lpips_weights.py makes a file that has it"))?;
    if view.dtype() != Dtype::F32 {
        return Err(format!("{name} is of {:?}, not F32", view.dtype()));
    }
    let values: Vec<f32> =
        view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    match values.iter().position(|v| !v.is_finite()) {
        Some(k) => Err(format!("value {k} of {name} is not finite")),
        None => Ok((view.shape().to_vec(), values)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    type Parts = BTreeMap<String, (Vec<usize>, Vec<f32>)>;
    type Change = fn(&mut Parts);

    fn parts() -> Parts {
        let mut parts = Parts::new();
        let mut inputs = 3;
        for (n, kernel) in [(1, 11), (2, 5), (3, 3), (4, 3), (5, 1)] {
            let out = 2 + n;
            let mut put = |name: String, shape: Vec<usize>| {
                let values = vec![0.5; shape.iter().product()];
                parts.insert(name, (shape, values));
            };
            put(format!("conv{n}.weight"), vec![out, inputs, kernel, kernel]);
            put(format!("conv{n}.bias"), vec![out]);
            put(format!("linear{n}.weight"), vec![out]);
            inputs = out;
        }
        parts
    }

    fn read_parts(parts: &Parts) -> Result<Vec<Stage>> {
        let bytes: BTreeMap<_, Vec<u8>> = parts
            .iter()
            .map(|(name, (_, values))| (name, values.iter().flat_map(|v| v.to_le_bytes()).collect()))
            .collect();
        let views = parts.iter().map(|(name, (shape, _))| {
            let view = safetensors::tensor::TensorView::new(Dtype::F32, shape.clone(), &bytes[name]);
            (name, view.unwrap())
        });
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.safetensors");
        std::fs::write(&path, safetensors::serialize(views, None).unwrap()).unwrap();
        read(&path)
    }

    #[test]
    fn shapes_follow_from_the_file() {
        let stages = read_parts(&parts()).unwrap();
        assert_eq!(stages.iter().map(|stage| stage.kernel).collect::<Vec<_>>(), [11, 5, 3, 3, 1]);
        assert_eq!(stages[4].weight.dims(), [7, 6, 1, 1]);
        assert_eq!(stages[4].linear.dims(), [1, 7, 1, 1]);
    }

    #[test]
    fn a_bad_file_is_one_line_that_names_the_tensor() {
        let changes: [(&str, Change); 6] = [
            ("has no tensor linear3.weight", |p| drop(p.remove("linear3.weight"))),
            ("conv2.weight is [4, 9, 5, 5]", |p| {
                p.insert("conv2.weight".into(), (vec![4, 9, 5, 5], vec![0.0; 900]));
            }),
            ("conv4.weight is [6, 5, 2, 2]", |p| {
                p.insert("conv4.weight".into(), (vec![6, 5, 2, 2], vec![0.0; 120]));
            }),
            ("conv1.weight is [0, 3, 11, 11]", |p| {
                p.insert("conv1.weight".into(), (vec![0, 3, 11, 11], vec![]));
            }),
            ("conv5.bias is [3]", |p| drop(p.insert("conv5.bias".into(), (vec![3], vec![0.0; 3])))),
            ("value 2 of conv1.bias is not finite", |p| p.get_mut("conv1.bias").unwrap().1[2] = f32::NAN),
        ];
        for (expected, change) in changes {
            let mut parts = parts();
            change(&mut parts);
            let error = read_parts(&parts).unwrap_err().to_string();
            assert!(error.contains(expected) && !error.contains('\n'), "{error}");
        }
        let missing = read(Path::new("no-such.safetensors")).unwrap_err().to_string();
        assert!(missing.starts_with("no-such.safetensors: cannot be read"), "{missing}");
        let other = read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml")).unwrap_err().to_string();
        assert!(other.contains("is not a safetensors file"), "{other}");
    }
}
