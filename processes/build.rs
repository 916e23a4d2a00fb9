//! Puts the commit into `--version`.

use std::process::Command;

fn main() {
    let commit = Command::new("git").args(["describe", "--always", "--dirty", "--abbrev=12"]).output();
    let commit = commit.ok().filter(|output| output.status.success()).map(|output| output.stdout);
    // Built from an archive there is no commit to name.
    let commit = commit.and_then(|bytes| String::from_utf8(bytes).ok()).unwrap_or_else(|| "unknown".to_owned());
    println!("cargo::rustc-env=SPARROWHAWK_COMMIT={}", commit.trim());
    println!("cargo::rerun-if-changed=.git/HEAD");
    println!("cargo::rerun-if-changed=.git/logs/HEAD");
}
