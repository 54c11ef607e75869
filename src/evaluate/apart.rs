//! Errors of a fitted material on the queries that it was fitted for and on the others, apart.

use super::refusal;
use crate::dataset::{Dataset, SplitName};
use crate::error::Result;
use crate::metrics::{ErrorSum, Errors};
use crate::outside::Count;
use crate::query::{QueryBuffer, Reflectance};
use neumip_export::config::Architecture;
use serde::Serialize;

/// A split of a dataset as a fitted material sees it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Apart {
    /// Split, `views/NAME` for a view.
    pub split: String,
    /// How many of its queries are outside of what the material was fitted for.
    #[serde(flatten)]
    pub count: Count,
    /// Errors on the queries that are not, if there are any.
    pub errors_inside: Option<Errors>,
    /// Errors on those that are, if there are any.
    pub errors_outside: Option<Errors>,
}

#[derive(Default)]
struct Sums {
    count: Count,
    /// Inside, outside.
    errors: [ErrorSum; 2],
}

impl Sums {
    fn add(
        &mut self,
        architecture: &Architecture,
        q: &QueryBuffer,
        answer: &[[f32; 3]],
        reference: &[[f32; 3]],
    ) {
        self.count.add(architecture, q);
        let outside = |k: usize| architecture.outside(q.u[k], q.wi[k], q.wo[k], q.level[k]).any();
        let outside: Vec<bool> = (0..q.len()).map(outside).collect();
        for (sum, side) in self.errors.iter_mut().zip([false, true]) {
            let of = |pixels: &[[f32; 3]]| -> Vec<[f32; 3]> {
                pixels.iter().zip(&outside).filter(|(_, o)| **o == side).map(|(p, _)| *p).collect()
            };
            sum.add(&of(answer), &of(reference));
        }
    }

    fn apart(self, split: String) -> Apart {
        let [errors_inside, errors_outside] = self.errors.map(|sum| (sum.pixels() > 0).then(|| sum.errors()));
        Apart { split, count: self.count, errors_inside, errors_outside }
    }
}

/// Every split and view by what is inside of a material's domain and what is not; nothing for one without a domain.
///
/// # Errors
/// As [`super::error_table`].
pub fn apart_table(
    answerer: &dyn Reflectance,
    architecture: &Architecture,
    data: &Dataset,
    splits: &[SplitName],
) -> Result<Vec<Apart>> {
    let mut table = Vec::new();
    if architecture.domain.is_none() {
        return Ok(table);
    }
    for &name in splits {
        if refusal(answerer, data, name)?.is_some() {
            continue;
        }
        let split = data.split(name)?;
        let mut sums = Sums::default();
        for file in 0..split.files() {
            for block in split.read_file(file)? {
                let queries = block.queries(data.resolution());
                sums.add(architecture, &queries, &answerer.evaluate(&queries)?.pixels, &block.target());
            }
        }
        table.push(sums.apart(name.as_str().into()));
    }
    for view in &data.manifest().views {
        let (queries, reference) = data.read_view(&view.name)?;
        let mut sums = Sums::default();
        sums.add(architecture, &queries, &answerer.evaluate(&queries)?.pixels, &reference.pixels);
        table.push(sums.apart(format!("views/{}", view.name)));
    }
    Ok(table)
}
