//! The promises of neumip, a file each.

mod dataset;
mod model;
mod reference;
