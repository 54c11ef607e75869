//! The one kernel file that knows candle: in-place optimiser updates on variables' own storage.
//!
//! candle's elementwise path would allocate a tensor for each of some ten intermediate results a step.

use super::adam;
use candle_core::{CpuStorage, InplaceOp2, InplaceOp3, Layout, Result, Tensor};

fn slice<'a>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [f32]> {
    match (storage, layout.contiguous_offsets()) {
        (CpuStorage::F32(values), Some((start, end))) => Ok(&values[start..end]),
        _ => candle_core::bail!("an optimiser update needs contiguous f32 tensors"),
    }
}

fn slice_mut<'a>(storage: &'a mut CpuStorage, layout: &Layout) -> Result<&'a mut [f32]> {
    match (storage, layout.contiguous_offsets()) {
        (CpuStorage::F32(values), Some((start, end))) => Ok(&mut values[start..end]),
        _ => candle_core::bail!("an optimiser update needs contiguous f32 tensors"),
    }
}

struct Moment {
    beta: f32,
    squared: bool,
}

impl InplaceOp2 for Moment {
    fn name(&self) -> &'static str {
        "adam-moment"
    }

    fn cpu_fwd(&self, m: &mut CpuStorage, ml: &Layout, g: &CpuStorage, gl: &Layout) -> Result<()> {
        adam::moment(slice_mut(m, ml)?, slice(g, gl)?, self.beta, self.squared);
        Ok(())
    }
}

struct Apply(adam::Update);

impl InplaceOp3 for Apply {
    fn name(&self) -> &'static str {
        "adam-apply"
    }

    fn cpu_fwd(
        &self,
        theta: &mut CpuStorage,
        layout: &Layout,
        m: &CpuStorage,
        ml: &Layout,
        v: &CpuStorage,
        vl: &Layout,
    ) -> Result<()> {
        self.0.apply(slice_mut(theta, layout)?, slice(m, ml)?, slice(v, vl)?);
        Ok(())
    }
}

/// One Adam update of `theta` and its two moments, in place: on the CPU through [`adam`], elsewhere by tensor expressions.
///
/// # Errors
/// Whatever candle refuses, such as tensors of different shapes.
pub fn adam_step(
    theta: &candle_core::Var,
    first: &candle_core::Var,
    second: &candle_core::Var,
    gradient: &Tensor,
    betas: [f64; 2],
    update: adam::Update,
) -> Result<()> {
    let gradient = gradient.contiguous()?;
    if theta.device().is_cpu() {
        let moment = |beta: f64, squared| Moment { beta: beta as f32, squared };
        first.as_tensor().inplace_op2(&gradient, &moment(betas[0], false))?;
        second.as_tensor().inplace_op2(&gradient, &moment(betas[1], true))?;
        return theta.as_tensor().inplace_op3(first.as_tensor(), second.as_tensor(), &Apply(update));
    }
    let mix = |old: &Tensor, new: Tensor, beta: f64| ((old * beta)? + (new * (1.0 - beta))?)?.detach().copy();
    first.set(&mix(first.as_tensor(), gradient.clone(), betas[0])?)?;
    second.set(&mix(second.as_tensor(), gradient.sqr()?, betas[1])?)?;
    let root = (second.as_tensor().sqrt()? * f64::from(update.root_correction))?;
    let change = (first.as_tensor() / (root + f64::from(update.epsilon))?)?;
    theta.set(&(theta.as_tensor() - (change * f64::from(update.rate))?)?.detach().copy()?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Var};

    #[test]
    fn shapes_that_do_not_fit_and_strided_gradients() {
        let device = Device::Cpu;
        let var = |n: f32| Var::from_tensor(&Tensor::full(n, (2, 3), &device).unwrap()).unwrap();
        let (theta, m, v) = (var(1.0), var(0.0), var(0.0));
        let gradient = Tensor::arange(0f32, 6.0, &device).unwrap().reshape((3, 2)).unwrap().t().unwrap();
        let update = adam::Update::new(0.1, 0.9, 0.999, 1e-8, 1);
        adam_step(&theta, &m, &v, &gradient, [0.9, 0.999], update).unwrap();
        let after: Vec<f32> = theta.as_tensor().flatten_all().unwrap().to_vec1().unwrap();
        assert_eq!(after[0], 1.0);
        assert!(after[1..].iter().all(|x| (x - 0.9).abs() < 1e-5), "{after:?}");
    }
}
