use super::console::Console;
use crate::error::Result;
use clap::Args;
/// demo
#[derive(Debug, Args)]
pub struct Demo {}
impl Demo { pub fn run(self, _c: &Console) -> Result<()> { Ok(()) } }
