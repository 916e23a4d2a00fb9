//! The executable: command line → process.

use std::process::ExitCode;

fn main() -> ExitCode {
    match sparrowhawk::cli::run() {
        Ok(code) => code,
        Err(error) => {
            eprintln!("sparrowhawk: {error}");
            ExitCode::from(2)
        }
    }
}
