//! The repository's own rules, checked.

use std::fs;
use std::path::{Path, PathBuf};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("readable").flatten() {
        let path = entry.path();
        if path.is_dir() && path.file_name().is_some_and(|name| name != "target") {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

fn all_sources() -> Vec<PathBuf> {
    let mut found = Vec::new();
    ["ipc-types", "processes", "tests"].iter().for_each(|folder| sources(&root().join(folder), &mut found));
    found
}

/// Workspace crates that a manifest's [dependencies] name.
fn dependencies(manifest: &Path, crates: &[String]) -> Vec<String> {
    let text = fs::read_to_string(manifest).expect("readable");
    let section = text.split("[dependencies]").nth(1).unwrap_or("");
    let section = section.split("\n[").next().unwrap_or("");
    let names = section.lines().filter_map(|line| line.split(['.', ' ', '=']).next());
    names.filter(|name| crates.iter().any(|known| known == name)).map(str::to_owned).collect()
}

/// `ipc-types ← pure cores ← shells (which use runtime) ← sparrowhawk`: one direction only.
#[test]
fn crates_depend_on_each_other_in_one_direction_only() {
    let processes: Vec<String> = fs::read_dir(root().join("processes"))
        .expect("readable")
        .flatten()
        .filter(|entry| entry.path().is_dir())
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    let mut crates = processes.clone();
    crates.push("ipc-types".to_owned());
    assert!(dependencies(&root().join("ipc-types/Cargo.toml"), &crates).is_empty());
    for process in &processes {
        let found = dependencies(&root().join("processes").join(process).join("Cargo.toml"), &crates);
        // The map's query type is a library type that the planner shares with the memory process, the encoding is a library,
        // and the ground speaks as the bridge does.
        let allowed: &[&str] = match process.as_str() {
            "runtime" => &["ipc-types"],
            "planner" => &["ipc-types", "runtime", "memory"],
            "encoding" => &["ipc-types"],
            "recorder" | "bridge" => &["ipc-types", "runtime", "encoding"],
            "ground" => &["ipc-types", "encoding", "bridge"],
            _ => &["ipc-types", "runtime"],
        };
        for dependency in found {
            assert!(allowed.contains(&dependency.as_str()), "{process} must not depend on {dependency}");
        }
    }
}

#[test]
fn only_the_runtime_knows_iceoryx2_and_only_it_is_unsafe() {
    for path in all_sources() {
        let text = fs::read_to_string(&path).expect("readable");
        let relative = path.strip_prefix(root()).expect("inside").display().to_string();
        if relative.starts_with("processes/runtime/") || relative == "tests/tidy.rs" {
            continue;
        }
        assert!(!text.contains("iceoryx2::"), "{relative} knows iceoryx2");
        let is_unsafe = ["unsafe {", "unsafe fn", "unsafe impl"].iter().any(|word| text.contains(word));
        let may = relative.starts_with("ipc-types/") || relative.ends_with("/simd.rs");
        assert!(may || !is_unsafe, "{relative} is unsafe");
    }
}

#[test]
fn every_file_says_what_it_is_and_stays_readable() {
    for path in all_sources() {
        let text = fs::read_to_string(&path).expect("readable");
        assert!(text.starts_with("//!"), "{} does not say what it is", path.display());
        let lines = text.lines().count();
        assert!(lines <= 500, "{} has {lines} lines", path.display());
    }
}

#[test]
fn the_top_level_is_fixed() {
    let allowed = [
        ".ci",
        ".git",
        ".gitignore",
        "ARCHITECTURE.md",
        "CHANGELOG.md",
        "Cargo.lock",
        "Cargo.toml",
        "LICENSE-APACHE",
        "LICENSE-MIT",
        "README.md",
        "config",
        "deploy",
        "ipc-types",
        "processes",
        "runs",
        "rustfmt.toml",
        "target",
        "tests",
    ];
    for entry in fs::read_dir(root()).expect("readable").flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        assert!(allowed.contains(&name.as_str()), "{name} does not belong at the top level");
    }
}

/// A reader of the output that has gone away, as `head` does, must not end a program by the panic of `println!`.
#[test]
fn what_is_printed_cannot_panic() {
    for entry in fs::read_dir(root().join("processes")).expect("readable").flatten() {
        let is_build_script = entry.file_name() == "build.rs";
        if !entry.path().is_file() || is_build_script {
            continue;
        }
        let text = fs::read_to_string(entry.path()).expect("readable");
        let is_print = |line: &&str| ["print!(", "println!("].iter().any(|print| line.contains(print));
        let prints = text.lines().filter(is_print);
        assert_eq!(prints.count(), 0, "{}: tell! instead of println!", entry.path().display());
    }
}
