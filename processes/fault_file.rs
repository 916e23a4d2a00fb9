//! Fault files: what is to go wrong in a flight, as RON.

use crate::config::{ConfigError, impossible, parse, read_text};
use ipc_types::bounds::Bounds;
use runtime::faults::Fault;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A fault file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct FaultFile {
    /// What happens, in any order.
    pub(crate) faults: Vec<Fault>,
}

impl FaultFile {
    /// Reads a fault file.
    ///
    /// # Errors
    /// It cannot be read or is none; or all that is impossible in it.
    pub(crate) fn load(path: &Path) -> Result<Self, ConfigError> {
        let label = path.display().to_string();
        let file: Self = parse(&label, &read_text(path)?)?;
        let mut bounds = Bounds::default();
        bounds.section(&format!("{label}: "), |bounds| check(&file.faults, bounds));
        impossible(bounds)?;
        Ok(file)
    }

    /// As text.
    pub(crate) fn to_ron(&self) -> String {
        // Plain structures of numbers and texts always serialise.
        ron::ser::to_string_pretty(self, ron::ser::PrettyConfig::new()).unwrap_or_else(|_| unreachable!("plain data"))
    }
}

/// Reports what is impossible among faults, each with its place in the list.
pub(crate) fn check(faults: &[Fault], bounds: &mut Bounds) {
    for (index, fault) in faults.iter().enumerate() {
        bounds.section(&format!("faults[{index}]"), |bounds| fault.check(bounds));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<FaultFile, String> {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("faults.ron");
        std::fs::write(&path, text).expect("writable");
        FaultFile::load(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn a_fault_file_is_read_and_written() {
        let text = "(faults: [(at_s: 3.0, fault: kill(process: planner)), (at_s: 4.5, fault: lose(topic: \"trajectory\", for_s: 1.0, share: 0.5)), (at_s: 5.0, fault: other_version)])";
        let file = load(text).expect("sound");
        assert_eq!(file.faults.len(), 3);
        assert_eq!(load(&file.to_ron()).expect("sound"), file);
    }

    #[test]
    fn the_example_has_every_fault_that_needs_no_special_machine() {
        let file = FaultFile::load(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/config/faults/example.ron")));
        let file = file.expect("sound");
        let mut names: Vec<_> = file.faults.iter().map(|fault| fault.fault.name()).collect();
        names.dedup();
        assert_eq!(names.len(), 19);
    }

    #[test]
    fn what_is_wrong_is_said_with_its_place() {
        for (text, expected) in [
            ("(faults: [(at_s: 3.0, fault: kill(process: pilot))])", "faults.ron:1:44"),
            ("(faults: [(at_s: 3.0, fault: explode)])", "explode"),
            ("(faults: [(at_s: 3.0, fault: kill(process: planner), for_s: 3.0)])", "for_s"),
            ("(faults: [(at_s: -3.0, fault: kill(process: planner))])", "faults[0].at_s is -3"),
            ("(faults: [(at_s: NaN, fault: kill(process: simulator))])", "the world"),
            ("(faults: [(at_s: 1.0, fault: lose(topic: \"x\", for_s: 1.0, share: 2.0))])", "share is 2"),
        ] {
            let error = load(text).expect_err(text);
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
