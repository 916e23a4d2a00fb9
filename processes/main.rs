//! The executable: command line → process.

use std::process::ExitCode;

fn main() -> ExitCode {
    match sparrowhawk::cli::run() {
        Ok(code) => code,
        Err(error) => {
            sparrowhawk::say::say(format_args!("{error}"));
            ExitCode::from(2)
        }
    }
}
