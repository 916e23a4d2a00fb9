//! Places, pairs and the like on the command line.

/// So many numbers, separated by commas.
pub(crate) fn parse_numbers<const COUNT: usize>(text: &str) -> Result<[f64; COUNT], String> {
    let expected = || format!("is \"{text}\", expected {COUNT} numbers, separated by commas");
    let values: Result<Vec<f64>, _> = text.split(',').map(|value| value.trim().parse()).collect();
    values.map_err(|_| expected())?.try_into().map_err(|_| expected())
}
