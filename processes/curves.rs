//! `sparrowhawk curves`: what a vote weighs by disparity, as a plot: the probability mass (DROAN, Fig. 3.13) and the
//! confidence (Fig. 3.14).

use crate::say::tell;
use crate::svg;
use clap::Args;
use ipc_types::StereoRig;
use ipc_types::bounds::Bounds;
use ipc_types::noise::NoiseModel;
use memory::probability_mass;
use plotters::prelude::*;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use stereo_ingest::Calibration;

/// Depths that are marked, m: those of Fig. 3.12.
const MARKS_M: [f64; 2] = [50.0, 5.0];

/// Confidence of a disparity (f·b/z, px): C = (d − σ)/d (eq. 3.9), 0 below σ.
fn confidence(rig: &StereoRig, noise: &NoiseModel, d: f64) -> f64 {
    let sigma_px = f64::from(noise.at(d as f32, rig.focal_baseline_px_m() as f32));
    ((d - sigma_px) / d).max(0.0)
}

/// Options of the command.
#[derive(Clone, Debug, Args)]
pub(crate) struct CurvesArguments {
    /// The rectified camera: a rig (RON), or a calibration as `stereo --calib` takes it.
    #[arg(long, value_name = "FILE")]
    rig: PathBuf,
    /// Radius of the vehicle, m.
    #[arg(long, value_name = "M")]
    radius: f32,
    /// Standard deviation of disparity, px.
    #[arg(long, value_name = "PX", default_value_t = 0.5)]
    sigma: f32,
    /// Where to draw.
    #[arg(long, value_name = "FILE.svg")]
    out: PathBuf,
}

pub(crate) fn curves(arguments: &CurvesArguments) -> Result<ExitCode, Box<dyn Error>> {
    let (rig, _) = Calibration::load(&arguments.rig, None)?.rectify()?;
    let (sigma_px, radius_m) = (arguments.sigma, arguments.radius);
    // The schedule of lambda has no part in a vote.
    let noise = NoiseModel { sigma_px, sigma_m: 0.0, lambda_near: 1.0, lambda_far: 1.0, near_px: 100.0, far_px: 10.0 };
    let mut bounds = Bounds::default();
    noise.check(&mut bounds, &rig);
    bounds.range("radius", radius_m, 0.05..=5.0);
    let violations = bounds.into_violations();
    if !violations.is_empty() {
        return Err(violations.join("\n").into());
    }
    plot(&arguments.out, &rig, &noise, radius_m)?;
    for depth_m in MARKS_M {
        let d = rig.focal_baseline_px_m() / depth_m;
        let (mass, trust) = (probability_mass(&rig, &noise, radius_m, d), confidence(&rig, &noise, d));
        tell!("at {depth_m:>4} m              {d:.2} px: mass {mass:.4}, confidence {trust:.4}");
    }
    tell!("written                {}", arguments.out.display());
    Ok(ExitCode::SUCCESS)
}

/// Writes an SVG.
fn plot(path: &Path, rig: &StereoRig, noise: &NoiseModel, radius_m: f32) -> Result<(), Box<dyn Error>> {
    svg::check_name(path)?;
    let most_px = (rig.focal_baseline_px_m() / 4.0).max(10.0);
    let area = SVGBackend::new(path, (900, 520)).into_drawing_area();
    area.fill(&WHITE)?;
    let caption = format!(
        "Mass within {radius_m} m and confidence; f = {} px, b = {} m, sigma = {} px",
        rig.focal_px, rig.baseline_m, noise.sigma_px
    );
    let mut chart = ChartBuilder::on(&area)
        .caption(caption, ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(45)
        .y_label_area_size(60)
        .build_cartesian_2d(0.0..most_px, 0.0..1.05)?;
    chart.configure_mesh().x_desc("f b / depth, px").y_desc("probability mass, confidence").draw()?;
    let points = |value: &dyn Fn(f64) -> f64| {
        (1..=600).map(|step| most_px * f64::from(step) / 600.0).map(|d| (d, value(d))).collect::<Vec<_>>()
    };
    let mass = points(&|d| probability_mass(rig, noise, radius_m, d));
    let trust = points(&|d| confidence(rig, noise, d));
    for (name, line, colour) in [("probability mass (Fig. 3.13)", mass, BLUE), ("confidence (Fig. 3.14)", trust, RED)] {
        chart
            .draw_series(LineSeries::new(line, colour.stroke_width(2)))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
    }
    for depth_m in MARKS_M {
        let d = rig.focal_baseline_px_m() / depth_m;
        if d < most_px {
            chart.draw_series(LineSeries::new([(d, 0.0), (d, 1.05)], BLACK.mix(0.4)))?;
            let label = format!("{depth_m} m: {d:.2} px");
            chart.draw_series([Text::new(label, (d + most_px * 0.005, 0.06), ("sans-serif", 14))])?;
        }
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::MiddleRight)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK)
        .draw()?;
    area.present().map_err(|error| format!("{}: {error}", path.display()).into())
}
