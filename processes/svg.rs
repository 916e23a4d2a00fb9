//! Plots are SVG, and their files are named so.

use std::error::Error;
use std::path::Path;

/// Refuses a name that does not end in `.svg`.
pub(crate) fn check_name(path: &Path) -> Result<(), Box<dyn Error>> {
    match path.extension().is_some_and(|extension| extension == "svg") {
        true => Ok(()),
        false => Err(format!("{}: plots are SVG; expected a name that ends in .svg", path.display()).into()),
    }
}
