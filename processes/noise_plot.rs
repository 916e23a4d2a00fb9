//! The histogram of disparity errors and the Gaussian fitted to it, as a picture.

use crate::svg;
use plotters::prelude::*;
use std::error::Error;
use std::path::Path;
use stereo_ingest::{ErrorProfile, GaussianFit};

/// Writes an SVG: density of errors in 1/16 px bins as bars, the fit as a line.
pub(crate) fn plot(path: &Path, profile: &ErrorProfile, fit: &GaussianFit) -> Result<(), Box<dyn Error>> {
    const BIN_PX: f64 = 1.0 / 16.0;
    svg::check_name(path)?;
    let reach = (fit.bias_px.abs() + 5.0 * fit.sigma_px).clamp(1.0, 4.0);
    let reach = (reach / BIN_PX).ceil() * BIN_PX;
    let (shares, beyond) = profile.histogram(BIN_PX, reach);
    // Percent in a bin to density.
    let densities: Vec<f64> = shares.iter().map(|share| share / 100.0 / BIN_PX).collect();
    let top = densities.iter().copied().fold(fit.density(fit.bias_px), f64::max) * 1.1;
    let area = SVGBackend::new(path, (800, 500)).into_drawing_area();
    area.fill(&WHITE)?;
    let caption = format!(
        "Disparity error: sigma {:.3} px, bias {:+.3} px, {} samples, {:.1} % beyond",
        fit.sigma_px, fit.bias_px, fit.samples, beyond
    );
    let mut chart = ChartBuilder::on(&area)
        .caption(caption, ("sans-serif", 20))
        .margin(12)
        .x_label_area_size(45)
        .y_label_area_size(60)
        .build_cartesian_2d(-reach..reach, 0.0..top)?;
    chart.configure_mesh().x_desc("measured - true, px").y_desc("density, 1/px").draw()?;
    let bars = densities.iter().enumerate().map(|(index, density)| {
        let left = -reach + index as f64 * BIN_PX;
        Rectangle::new([(left, 0.0), (left + BIN_PX, *density)], BLUE.mix(0.4).filled())
    });
    chart
        .draw_series(bars)?
        .label("measured")
        .legend(|(x, y)| Rectangle::new([(x, y - 5), (x + 18, y + 5)], BLUE.mix(0.4).filled()));
    let points = (0..=400).map(|step| -reach + 2.0 * reach * f64::from(step) / 400.0);
    let line = LineSeries::new(points.map(|error| (error, fit.density(error))), RED.stroke_width(2));
    chart
        .draw_series(line)?
        .label("Gaussian fit")
        .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], RED.stroke_width(2)));
    chart.configure_series_labels().background_style(WHITE.mix(0.8)).border_style(BLACK).draw()?;
    area.present().map_err(|error| format!("{}: {error}", path.display()).into())
}
