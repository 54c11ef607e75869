//! How many queries are outside of what a material was fitted for.

use crate::query::QueryBuffer;
use neumip_export::config::Architecture;
use serde::{Deserialize, Serialize};

/// Queries, and how many of them are outside of a domain: in anything, and in what.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Count {
    /// All of them.
    pub queries: u64,
    /// Outside in anything.
    pub outside: u64,
    /// Finer than the finest level.
    pub finer: u64,
    /// Coarser than the coarsest level.
    pub coarser: u64,
    /// Outside of the window.
    pub position: u64,
    /// Light from another direction.
    pub wi: u64,
    /// Seen from another direction.
    pub wo: u64,
}

impl Count {
    /// Counts queries; of a material without a domain none is outside.
    pub fn add(&mut self, architecture: &Architecture, queries: &QueryBuffer) {
        self.queries += queries.len() as u64;
        if architecture.domain.is_none() {
            return;
        }
        for k in 0..queries.len() {
            let out = architecture.outside(queries.u[k], queries.wi[k], queries.wo[k], queries.level[k]);
            self.outside += u64::from(out.any());
            self.finer += u64::from(out.finer);
            self.coarser += u64::from(out.coarser);
            self.position += u64::from(out.position);
            self.wi += u64::from(out.wi);
            self.wo += u64::from(out.wo);
        }
    }

    /// Adds another count.
    pub fn join(&mut self, other: &Self) {
        let pairs = [
            (&mut self.queries, other.queries),
            (&mut self.outside, other.outside),
            (&mut self.finer, other.finer),
            (&mut self.coarser, other.coarser),
            (&mut self.position, other.position),
            (&mut self.wi, other.wi),
            (&mut self.wo, other.wo),
        ];
        pairs.into_iter().for_each(|(sum, part)| *sum += part);
    }

    /// Share of all that is outside, from 0 to 1; 0 of none.
    pub fn share(&self) -> f64 {
        self.outside as f64 / self.queries.max(1) as f64
    }

    /// The count in words: how many are outside, and in what.
    pub fn described(&self) -> String {
        let Self { queries, outside, finer, coarser, position, wi, wo } = self;
        let parts = [
            (finer, "finer"),
            (coarser, "coarser"),
            (position, "elsewhere on the tile"),
            (wi, "from another light"),
            (wo, "seen from elsewhere"),
        ];
        let parts = parts.iter().filter(|(count, _)| **count > 0);
        let parts: Vec<String> = parts.map(|(count, what)| format!("{count} {what}")).collect();
        let parts = if parts.is_empty() { String::new() } else { format!(": {}", parts.join(", ")) };
        format!("{outside} of {queries} queries ({:.2} %){parts}", 100.0 * self.share())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use neumip_export::{Cone, Domain};

    #[test]
    fn queries_are_counted_by_what_they_leave() {
        let model = crate::config::Config::preset("neumip").unwrap().model;
        let mut architecture = Architecture::new(model, [16, 16]).unwrap();
        let ask = |level: f32, u: f32, wi: f32, wo: f32| {
            QueryBuffer::new(1, 1, vec![[u, 0.2]], vec![[wi, 0.0]], vec![[wo, 0.0]], vec![level]).unwrap()
        };
        let mut count = Count::default();
        count.add(&architecture, &ask(9.0, 0.9, 0.9, 0.9));
        assert_eq!(count, Count { queries: 1, ..Count::default() });

        let cone = Cone { axis: [0.0, 0.0, 1.0], cosine: 0.5 };
        architecture.domain = Some(Domain {
            scene: "near".into(),
            tile: [32, 32],
            corner: [0, 0],
            levels: [0.5, 1.5],
            wi: cone,
            wo: cone,
            floor: 0.1,
        });
        let mut all = Count::default();
        for asked in [
            ask(1.0, 0.2, 0.0, 0.0),
            ask(0.0, 0.2, 0.0, 0.0),
            ask(2.0, 0.2, 0.0, 0.0),
            ask(1.0, 0.9, 0.0, 0.0),
            ask(1.0, 0.2, 0.99, 0.0),
            ask(2.0, 0.9, 0.0, 0.99),
        ] {
            let mut count = Count::default();
            count.add(&architecture, &asked);
            all.join(&count);
        }
        let expected = Count { queries: 6, outside: 5, finer: 1, coarser: 2, position: 2, wi: 1, wo: 1 };
        assert_eq!(all, expected);
        assert!(all.described().starts_with("5 of 6 queries (83.33 %): 1 finer, 2 coarser"));
    }
}
