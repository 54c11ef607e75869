//! The `neumip` command: parses, runs, prints the error.

use clap::Parser;
use neumip::cli::Cli;
use std::process::ExitCode;

/// glibc's allocator gives large tensors back to the system after every operation, which costs plain candle half its speed.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    match Cli::parse().run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // candle appends a backtrace to its messages where one is asked for.
            let text = error.to_string();
            eprintln!("neumip: {}", text.lines().next().unwrap_or_default());
            ExitCode::from(error.exit_code())
        }
    }
}
