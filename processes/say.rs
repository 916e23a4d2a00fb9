//! Messages for whoever started the program. They may be lost: a terminal that went away, or a full disk that they are written
//! to, must not end a flight, as `eprintln!` would by its panic.

use std::fmt::Arguments;
use std::io::Write;

/// Writes a line to standard error, with the program's name before it.
pub fn say(message: Arguments<'_>) {
    let _ = writeln!(std::io::stderr().lock(), "sparrowhawk: {message}");
}

/// Prints a line to standard output: `println!`, but whoever read it may have gone away, as `head` does.
macro_rules! tell {
    ($($part:tt)*) => {{
        let _ = std::io::Write::write_fmt(&mut std::io::stdout().lock(), format_args!("{}\n", format_args!($($part)*)));
    }};
}
pub(crate) use tell;
