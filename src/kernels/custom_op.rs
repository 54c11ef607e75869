//! The one kernel file that knows candle: slices of tensors' own storage, and optimiser updates in place.
//!
//! candle's elementwise path would allocate a tensor for each of some ten intermediate results a step.

use super::adam::{self, Update};
use super::simd::Isa;
use super::smooth::compact;
use candle_core::{CpuStorage, InplaceOp1, Layout, Result, Storage, Tensor, Var};
use std::cell::Cell;

/// Offsets of a tensor's values in its storage.
fn range(layout: &Layout) -> Result<std::ops::Range<usize>> {
    match layout.contiguous_offsets() {
        Some((start, end)) => Ok(start..end),
        None => candle_core::bail!("a kernel needs contiguous tensors"),
    }
}

fn refused<T>(storage: &CpuStorage) -> Result<T> {
    candle_core::bail!(
        "a kernel needs tensors of f32, not {:?}",
        candle_core::backend::BackendStorage::dtype(storage)
    )
}

/// Runs `f` on the values of a contiguous f32 tensor on the CPU. The tensor cannot be written meanwhile: `f` must not try
/// to.
///
/// # Errors
/// Any other tensor.
pub fn with_slice<R>(tensor: &Tensor, f: impl FnOnce(&[f32]) -> R) -> Result<R> {
    let (storage, layout) = tensor.storage_and_layout();
    match &*storage {
        Storage::Cpu(CpuStorage::F32(values)) => Ok(f(&values[range(layout)?])),
        Storage::Cpu(other) => refused(other),
        _ => candle_core::bail!("a kernel needs tensors on the CPU"),
    }
}

/// Runs `f` on the values of several contiguous f32 tensors on the CPU, in place and at once. None of them can be read
/// or written otherwise meanwhile: `f` must not try to.
///
/// # Errors
/// Any other tensor, or two that share their storage.
pub fn with_slices_mut<R, const N: usize>(
    tensors: [&Tensor; N],
    f: impl FnOnce([&mut [f32]; N]) -> R,
) -> Result<R> {
    distinct(&tensors)?;
    let (mut f, mut result) = (Some(f), None);
    hold(&tensors, Vec::with_capacity(N), &mut |slices| {
        if let (Ok(slices), Some(f)) = (<[&mut [f32]; N]>::try_from(slices), f.take()) {
            result = Some(f(slices));
        }
    })?;
    result.ok_or_else(|| candle_core::Error::Msg("an operation in place was not run".into()))
}

/// Refuses tensors that share a storage, whose lock would be waited for forever.
fn distinct(tensors: &[&Tensor]) -> Result<()> {
    let place = |tensor: &Tensor| std::ptr::from_ref::<Storage>(&tensor.storage_and_layout().0).addr();
    let mut places: Vec<usize> = tensors.iter().map(|tensor| place(tensor)).collect();
    places.sort_unstable();
    if places.windows(2).any(|pair| pair[0] == pair[1]) {
        candle_core::bail!("two tensors of an operation in place share their storage");
    }
    Ok(())
}

type Use<'a> = &'a mut dyn for<'x> FnMut(Vec<&'x mut [f32]>);
type Held<'a> = (Vec<&'a mut [f32]>, Use<'a>);

/// Borrows the values of `tensors` one inside the other, after those already `held`, and uses them all.
fn hold(tensors: &[&Tensor], held: Vec<&mut [f32]>, f: Use) -> Result<()> {
    match tensors.split_first() {
        Some((tensor, rest)) => tensor.inplace_op1(&Hold { rest, with: Cell::new(Some((held, f))) }),
        None => {
            f(held);
            Ok(())
        }
    }
}

/// The step of [`hold`] that candle calls with one tensor's storage. Candle passes the operation by shared reference and
/// once, so what it consumes is taken out of a cell.
struct Hold<'a> {
    rest: &'a [&'a Tensor],
    with: Cell<Option<Held<'a>>>,
}

impl InplaceOp1 for Hold<'_> {
    fn name(&self) -> &'static str {
        "kernel-in-place"
    }

    fn cpu_fwd(&self, storage: &mut CpuStorage, layout: &Layout) -> Result<()> {
        let CpuStorage::F32(values) = storage else {
            return refused(storage);
        };
        let Some((held, f)) = self.with.take() else {
            candle_core::bail!("an operation in place was run twice");
        };
        let mut held: Vec<&mut [f32]> = held;
        held.push(&mut values[range(layout)?]);
        hold(self.rest, held, f)
    }
}

/// A gradient in the memory of the host.
#[derive(Debug)]
pub enum HostGradient<'a> {
    /// As many floats as the variable has.
    Dense(&'a [f32]),
    /// Texels of `stride` floats, of which the first `channels` count. An update that succeeds leaves 0 everywhere.
    Padded {
        /// \[texels, stride\].
        values: &'a mut [f32],
        /// Floats a texel.
        stride: usize,
        /// Channels of the variable.
        channels: usize,
    },
}

/// One Adam update of `theta` and its two moments, in place: on the CPU through [`adam`], elsewhere by tensor expressions.
///
/// # Errors
/// Tensors of different shapes or that share storage, an instruction set that this machine has not, and whatever candle
/// refuses.
pub fn adam_step(
    theta: &Var,
    first: &Var,
    second: &Var,
    gradient: &Tensor,
    betas: [f64; 2],
    update: Update,
) -> Result<()> {
    if gradient.shape() != theta.shape() {
        candle_core::bail!("a gradient {:?} of a variable {:?}", gradient.shape(), theta.shape());
    }
    let gradient = gradient.contiguous()?;
    if theta.device().is_cpu() {
        // Its lock is held while the variables' are taken.
        distinct(&[&gradient, theta.as_tensor(), first.as_tensor(), second.as_tensor()])?;
        return with_slice(&gradient, |gradient| {
            adam_step_host(theta, first, second, betas, update, HostGradient::Dense(gradient))
        })?;
    }
    let mix = |old: &Tensor, new: Tensor, beta: f64| ((old * beta)? + (new * (1.0 - beta))?)?.detach().copy();
    first.set(&mix(first.as_tensor(), gradient.clone(), betas[0])?)?;
    second.set(&mix(second.as_tensor(), gradient.sqr()?, betas[1])?)?;
    let root = (second.as_tensor().sqrt()? * f64::from(update.root_correction))?;
    let change = (first.as_tensor() / (root + f64::from(update.epsilon))?)?;
    theta.set(&(theta.as_tensor() - (change * f64::from(update.rate))?)?.detach().copy()?)
}

/// [`adam_step`] by a gradient in the memory of the host: on the CPU one pass over everything, elsewhere it is sent to the
/// variable's device.
///
/// # Errors
/// As [`adam_step`], and a gradient that does not fit the variable.
pub fn adam_step_host(
    theta: &Var,
    first: &Var,
    second: &Var,
    betas: [f64; 2],
    update: Update,
    gradient: HostGradient,
) -> Result<()> {
    let elements = theta.elem_count();
    let fits = match &gradient {
        HostGradient::Dense(values) => values.len() == elements,
        HostGradient::Padded { values, stride, channels } => {
            let (stride, channels) = (*stride, *channels);
            let texels = elements.checked_div(channels).unwrap_or(0);
            channels <= stride && texels * channels == elements && texels * stride == values.len()
        }
    };
    if !fits || first.shape() != theta.shape() || second.shape() != theta.shape() {
        candle_core::bail!("a gradient or moments that do not fit a variable {:?}", theta.shape());
    }
    if theta.device().is_cpu() {
        let isa = Isa::chosen().map_err(candle_core::Error::wrap)?;
        let betas = betas.map(|beta| beta as f32);
        return with_slices_mut(
            [theta.as_tensor(), first.as_tensor(), second.as_tensor()],
            |[theta, first, second]| match gradient {
                HostGradient::Dense(values) => adam::step(isa, theta, first, second, values, betas, update),
                HostGradient::Padded { values, stride, channels } => {
                    adam::step_padded(isa, theta, first, second, values, stride, channels, betas, update);
                }
            },
        );
    }
    let to_device = |values: &[f32]| {
        let tensor = Tensor::from_slice(values, theta.shape(), theta.device())?;
        adam_step(theta, first, second, &tensor, betas, update)
    };
    match gradient {
        HostGradient::Dense(values) => to_device(values),
        HostGradient::Padded { values, stride, channels } => {
            let mut dense = vec![0.0; elements];
            compact(values, stride, channels, &mut dense);
            to_device(&dense)?;
            values.fill(0.0);
            Ok(())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{DType, Device};

    /// A handful of f32 roundings of values near 1.
    const ROUNDING: f32 = 1e-5;
    const BETAS: [f64; 2] = [0.9, 0.999];

    fn full(value: f32, shape: (usize, usize)) -> Var {
        Var::from_tensor(&Tensor::full(value, shape, &Device::Cpu).unwrap()).unwrap()
    }

    fn values(var: &Var) -> Vec<f32> {
        with_slice(var.as_tensor(), <[f32]>::to_vec).unwrap()
    }

    fn update() -> Update {
        Update::new(0.1, BETAS[0], BETAS[1], 1e-8, 1)
    }

    #[test]
    fn slices_are_the_tensors_own_values() {
        let (a, b) = (full(1.0, (2, 3)), full(2.0, (1, 4)));
        let sum = with_slices_mut([a.as_tensor(), b.as_tensor()], |[a, b]| {
            a[4] = 5.0;
            b[0] = 7.0;
            a.iter().chain(&*b).sum::<f32>()
        });
        assert_eq!(sum.unwrap(), 5.0 + 5.0 + 7.0 + 6.0);
        assert_eq!(values(&a), [1.0, 1.0, 1.0, 1.0, 5.0, 1.0]);
        assert_eq!(values(&b), [7.0, 2.0, 2.0, 2.0]);
        assert_eq!(with_slices_mut([], |[]| 3).unwrap(), 3);
        let second_row = a.as_tensor().narrow(0, 1, 1).unwrap();
        assert_eq!(with_slice(&second_row, |row| row.len()).unwrap(), 3);
    }

    #[test]
    fn tensors_that_are_no_slices_are_refused_before_anything_changes() {
        let a = full(1.0, (2, 3));
        let turned = a.as_tensor().t().unwrap();
        let double = Tensor::zeros(3, DType::F64, &Device::Cpu).unwrap();
        let refused =
            |b: &Tensor| with_slices_mut([a.as_tensor(), b], |[a, _]| a[0] = 9.0).unwrap_err().to_string();
        assert!(with_slice(&turned, |_| ()).unwrap_err().to_string().contains("contiguous"));
        assert!(with_slice(&double, |_| ()).unwrap_err().to_string().contains("f32, not F64"));
        assert!(refused(&double).contains("f32, not F64"));
        assert!(refused(&full(0.0, (2, 3)).as_tensor().t().unwrap()).contains("contiguous"));
        for same in [a.as_tensor(), &turned, &a.as_tensor().flatten_all().unwrap()] {
            assert!(refused(same).contains("share"));
        }
        assert_eq!(values(&a), [1.0; 6]);
    }

    #[test]
    fn strided_padded_and_dense_gradients_move_the_same_and_others_are_refused() {
        let run = |step: &dyn Fn(&Var, &Var, &Var) -> Result<()>| {
            let (theta, m, v) = (full(1.0, (2, 3)), full(0.0, (2, 3)), full(0.0, (2, 3)));
            step(&theta, &m, &v).unwrap();
            [values(&theta), values(&m), values(&v)]
        };
        let row_major = [0.0f32, 2.0, 4.0, 1.0, 3.0, 5.0];
        let strided = Tensor::arange(0f32, 6.0, &Device::Cpu).unwrap().reshape((3, 2)).unwrap().t().unwrap();
        let by_tensor = run(&|t, m, v| adam_step(t, m, v, &strided, BETAS, update()));
        let by_dense =
            run(&|t, m, v| adam_step_host(t, m, v, BETAS, update(), HostGradient::Dense(&row_major)));
        let by_padded = run(&|t, m, v| {
            let mut padded = [f32::NAN; 16];
            padded[..3].copy_from_slice(&row_major[..3]);
            padded[8..11].copy_from_slice(&row_major[3..]);
            let gradient = HostGradient::Padded { values: &mut padded, stride: 8, channels: 3 };
            adam_step_host(t, m, v, BETAS, update(), gradient)?;
            assert_eq!(padded, [0.0; 16]);
            Ok(())
        });
        assert!(by_tensor == by_dense && by_dense == by_padded);
        let [theta, m, v] = &by_tensor;
        let expected = |i: usize, g: f32| [if i == 0 { 1.0 } else { 0.9 }, 0.1 * g, 0.001 * g * g];
        let off = |moved: f32| {
            let each = row_major.iter().enumerate().map(|(i, g)| {
                let expected = expected(i, g + moved);
                [theta[i], m[i], v[i]].iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
            });
            each.fold(0.0, f32::max)
        };
        assert!(off(0.0) < ROUNDING && off(0.01) > ROUNDING);

        let (theta, m, v) = (full(1.0, (2, 3)), full(0.0, (2, 3)), full(0.0, (3, 2)));
        let zeros = |n: usize| vec![0.0f32; n];
        assert!(adam_step_host(&theta, &m, &v, BETAS, update(), HostGradient::Dense(&zeros(6))).is_err());
        assert!(adam_step_host(&theta, &m, &m, BETAS, update(), HostGradient::Dense(&zeros(6))).is_err());
        let v = full(0.0, (2, 3));
        assert!(adam_step_host(&theta, &m, &v, BETAS, update(), HostGradient::Dense(&zeros(5))).is_err());
        for (n, stride, channels) in [(15, 8, 3), (16, 8, 4), (6, 2, 3), (6, 0, 0)] {
            let mut values = zeros(n);
            let gradient = HostGradient::Padded { values: &mut values, stride, channels };
            assert!(adam_step_host(&theta, &m, &v, BETAS, update(), gradient).is_err());
        }
        let shared = theta.as_tensor().copy().unwrap();
        assert!(adam_step(&theta, &m, &v, &shared, BETAS, update()).is_ok());
        assert!(adam_step(&theta, &m, &v, theta.as_tensor(), BETAS, update()).is_err());
        let wrong = Tensor::zeros((3, 2), DType::F32, &Device::Cpu).unwrap();
        assert!(adam_step(&theta, &m, &v, &wrong, BETAS, update()).is_err());
    }
}
