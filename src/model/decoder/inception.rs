//! The Inception decoder (paper, section 3.3) over periodic images, channels last.
//!
//! A convolution is one product of shifted copies side by side with its weight: faster here than candle's `conv2d`, whose
//! gradient takes several times longer still. The maximum is one of shifted copies too: the gradient of `max_pool2d` is wrong
//! where windows overlap.

use crate::error::Result;
use crate::query::grid::Mosaic;
use candle_core::Tensor;
use neumip_export::config::Convolution;

/// Convolutions of a module: its four paths, two of which reduce first.
const OF_MODULE: usize = 6;

/// The network.
pub struct Inception {
    first: Layer,
    modules: Vec<[Layer; OF_MODULE]>,
    last: Layer,
}

struct Layer {
    /// Rows and columns of the kernel.
    side: usize,
    /// \[out, in, side, side\], as the variable has it: its values change between steps.
    weight: Tensor,
    bias: Tensor,
}

impl Layer {
    fn new(shape: &Convolution, tensor: &dyn Fn(&str) -> Result<Tensor>) -> Result<Self> {
        let [(weight, _), (bias, _)] = shape.tensors();
        Ok(Self { side: shape.side, weight: tensor(&weight)?, bias: tensor(&bias)? })
    }

    /// \[n, h, w, in\] -> \[n, h, w, out\].
    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let (n, h, w, _) = x.dims4()?;
        let columns = match self.side {
            1 => x.clone(),
            side => {
                let around = wrapped(&wrapped(x, 1, side / 2)?, 2, side / 2)?;
                let shifted = (0..side * side)
                    .map(|k| Ok(around.narrow(1, k / side, h)?.narrow(2, k % side, w)?))
                    .collect::<Result<Vec<_>>>()?;
                Tensor::cat(&shifted, 3)?
            }
        };
        let inputs = columns.dims()[3];
        let weight = self.weight.permute((2, 3, 1, 0))?.contiguous()?.reshape((inputs, ()))?;
        let out = columns.reshape((n * h * w, inputs))?.matmul(&weight)?.broadcast_add(&self.bias)?;
        Ok(out.reshape((n, h, w, ()))?)
    }
}

/// A periodic axis with `margin` more entries at both ends.
fn wrapped(x: &Tensor, axis: usize, margin: usize) -> Result<Tensor> {
    let n = x.dims()[axis];
    let mut parts = Vec::new();
    // Margins may be longer than the axis.
    let mut at = (n - margin % n) % n;
    let mut rest = n + 2 * margin;
    while rest > 0 {
        let length = rest.min(n - at);
        parts.push(x.narrow(axis, at, length)?);
        rest -= length;
        at = 0;
    }
    Ok(Tensor::cat(&parts, axis)?)
}

/// Largest of the 3 x 3 around every pixel \[n, h, w, c\].
fn largest(x: &Tensor) -> Result<Tensor> {
    let along = |x: &Tensor, axis: usize| -> Result<Tensor> {
        let around = wrapped(x, axis, 1)?;
        let part = |start: usize| around.narrow(axis, start, x.dims()[axis]);
        Ok(part(0)?.maximum(&part(1)?)?.maximum(&part(2)?)?)
    };
    along(&along(x, 1)?, 2)
}

impl Inception {
    /// The network of convolutions in the order of the architecture.
    ///
    /// # Errors
    /// What `tensor` reports.
    pub fn new(convolutions: &[Convolution], tensor: &dyn Fn(&str) -> Result<Tensor>) -> Result<Self> {
        let layer = |k: usize| Layer::new(&convolutions[k], tensor);
        let module = |m: usize| -> Result<[Layer; OF_MODULE]> {
            let at = 1 + m * OF_MODULE;
            Ok([layer(at)?, layer(at + 1)?, layer(at + 2)?, layer(at + 3)?, layer(at + 4)?, layer(at + 5)?])
        };
        let modules = (convolutions.len() - 2) / OF_MODULE;
        Ok(Self {
            first: layer(0)?,
            modules: (0..modules).map(module).collect::<Result<_>>()?,
            last: layer(convolutions.len() - 1)?,
        })
    }

    /// Outputs \[N, out\] of inputs \[N, in\] that are the samples of `mosaic` in its order.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn forward(&self, x: &Tensor, mosaic: Mosaic) -> Result<Tensor> {
        let Mosaic { down, across, height, width } = mosaic;
        let images = x.reshape((down, height, across, width, ()))?.transpose(1, 2)?.contiguous()?;
        let images = images.reshape((down * across, height, width, ()))?;
        let mut x = self.first.forward(&images)?.relu()?;
        for [one, to_three, three, to_five, five, most] in &self.modules {
            let three = three.forward(&to_three.forward(&x)?.relu()?)?;
            let five = five.forward(&to_five.forward(&x)?.relu()?)?;
            x = Tensor::cat(&[one.forward(&x)?, three, five, most.forward(&largest(&x)?)?], 3)?.relu()?;
        }
        let out = self.last.forward(&x)?.reshape((down, across, height, width, ()))?;
        Ok(out.transpose(1, 2)?.contiguous()?.reshape((mosaic.samples(), ()))?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};
    use candle_core::{Device, Var};
    use neumip_export::config::InceptionConfig;

    /// Gradients in f32 against differences of an f32 sum.
    const TOLERANCE: f64 = 2e-2;
    /// Hardly a maximum changes its place within it, and an f32 sum still has digits of the difference.
    const STEP: f64 = 2e-2;
    const SEED: u64 = 1;

    #[test]
    fn axes_wrap_any_number_of_times() {
        let x = Tensor::new(&[[0f32, 1.0, 2.0]], &Device::Cpu).unwrap();
        for (margin, expected) in [
            (1, vec![2.0, 0.0, 1.0, 2.0, 0.0]),
            (4, vec![2.0, 0.0, 1.0, 2.0, 0.0, 1.0, 2.0, 0.0, 1.0, 2.0, 0.0]),
        ] {
            let found = wrapped(&x, 1, margin).unwrap().squeeze(0).unwrap().to_vec1::<f32>().unwrap();
            assert_eq!(found, expected);
        }
    }

    #[test]
    fn the_largest_of_overlapping_windows_has_the_right_gradient() {
        // 8 is the largest of all nine windows around it, and of no other.
        let mut values = vec![0f32; 36];
        values[14] = 8.0;
        let x = Var::from_vec(values, (1, 6, 6, 1), &Device::Cpu).unwrap();
        let sum = largest(&x).unwrap().sum_all().unwrap();
        assert_eq!(sum.to_scalar::<f32>().unwrap(), 72.0);
        let gradient = sum.backward().unwrap().get(&x).unwrap().flatten_all().unwrap();
        assert_eq!(gradient.to_vec1::<f32>().unwrap()[14], 9.0);
    }

    #[test]
    fn gradients_are_the_slopes_of_the_outputs() {
        let config = InceptionConfig { width: 9, modules: 2, paths: [3, 3, 2, 1], reduce: [4, 2] };
        let convolutions = config.convolutions(5, 3);
        // All is positive, so that no ReLU is shut or bends within a step: what those do, the engines' tests compare.
        let drawn = std::cell::Cell::new(0);
        let random = |shape: &[usize]| {
            let mut numbers = Random::new(SEED, Stream::Probe, drawn.replace(drawn.get() + 1));
            let values: Vec<f32> =
                (0..shape.iter().product()).map(|_| 0.02 + 0.2 * numbers.uniform()).collect();
            Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
        };
        let variables: Vec<(String, Var)> = convolutions
            .iter()
            .flat_map(Convolution::tensors)
            .map(|(name, shape)| (name, Var::from_tensor(&random(&shape)).unwrap()))
            .collect();
        let mosaic = Mosaic { down: 2, across: 2, height: 4, width: 3 };
        let x = Var::from_tensor(&random(&[mosaic.samples(), 5])).unwrap();
        let coefficients = random(&[mosaic.samples(), 3]);
        let named = |name: &str| {
            let (_, var) = variables.iter().find(|(n, _)| n == name).unwrap();
            Ok(var.as_tensor().clone())
        };
        // Once for all: it follows its variables.
        let network = Inception::new(&convolutions, &named).unwrap();
        let sum = || (network.forward(&x, mosaic).unwrap() * &coefficients).unwrap().sum_all().unwrap();
        let store = sum().backward().unwrap();
        for (name, var) in variables.iter().map(|(n, v)| (n.as_str(), v)).chain([("input", &x)]) {
            let gradient = store.get(var).unwrap();
            let length =
                f64::from(gradient.sqr().unwrap().sum_all().unwrap().to_scalar::<f32>().unwrap()).sqrt();
            let direction = (gradient / length).unwrap();
            let home = var.as_tensor().copy().unwrap();
            let at = |step: f64| {
                var.set(&(&home + (&direction * step).unwrap()).unwrap()).unwrap();
                f64::from(sum().to_scalar::<f32>().unwrap())
            };
            let slope = (at(STEP) - at(-STEP)) / (2.0 * STEP);
            var.set(&home).unwrap();
            assert!((slope - length).abs() < TOLERANCE * length, "{name}: {slope} {length}");
            assert!((slope - 1.1 * length).abs() > TOLERANCE * length, "{name}");
        }
    }
}
