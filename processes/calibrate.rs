//! `sparrowhawk calibrate`: cameras from chessboards, and how far off disparities are.

use crate::config::VehicleConfig;
use crate::noise_plot::plot;
use crate::say::{say, tell};
use clap::Args;
use indicatif::ProgressBar;
use ipc_types::StereoRig;
use ipc_types::bounds::Bounds;
use serde::Serialize;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use stereo_ingest::calibration::{
    Board, BoardFinder, BoardView, Rectification, Rectifier, Solution, StereoCalibration, calibrate, check,
};
use stereo_ingest::{Calibration, Config, ErrorProfile, GaussianFit, Matcher, StereoPair, load_disparity};

/// Options of the command.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Examples:
  sparrowhawk calibrate --left l/*.png --right r/*.png --board 9x6 --square 0.025 --out calibration.ron --plot noise.svg
  sparrowhawk calibrate --left l/*.png --right r/*.png --board 9x6 --square 0.025 --calib camchain.yaml --write my/vehicles/scout.ron
  sparrowhawk calibrate --left im0.png --right im1.png --ground-truth disp0.pfm --calib calib.txt --plot noise.svg")]
pub(crate) struct CalibrateArguments {
    /// Left images, in the order of the right ones.
    #[arg(long, value_name = "FILE", num_args = 1.., required = true)]
    left: Vec<PathBuf>,
    /// Right images.
    #[arg(long, value_name = "FILE", num_args = 1.., required = true)]
    right: Vec<PathBuf>,
    /// Inner corners of the chessboard: columns x rows, one of them even.
    #[arg(long, value_name = "CxR", value_parser = parse_board, required_unless_present = "ground_truth", requires = "square")]
    board: Option<(usize, usize)>,
    /// Side of a square, m.
    #[arg(long, value_name = "M")]
    square: Option<f64>,
    /// True disparities of each left image instead of a board: 16-bit PNG (px × 256) or PFM. The pairs are rectified.
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with = "board")]
    ground_truth: Vec<PathBuf>,
    /// With a board: check this calibration instead of solving for one. With true disparities: gives distances.
    #[arg(long, value_name = "FILE|FOLDER")]
    calib: Option<PathBuf>,
    /// Disparities searched; enough for what is nearest if not given.
    #[arg(long, value_name = "PX")]
    max_disparity: Option<u32>,
    /// Write the calibration (RON).
    #[arg(long, value_name = "FILE.ron")]
    out: Option<PathBuf>,
    /// Plot the histogram of disparity errors and the fitted Gaussian.
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Write the standard deviation to this vehicle's noise.sigma_px, measured with its own matching method. Everything
    /// else in the file stays.
    #[arg(long, value_name = "VEHICLE.ron")]
    write: Option<PathBuf>,
    /// Write the figures to this file (JSON).
    #[arg(long, value_name = "FILE")]
    summary: Option<PathBuf>,
}

fn parse_board(text: &str) -> Result<(usize, usize), String> {
    let numbers = text.split_once(['x', 'X']).and_then(|(a, b)| Some((a.trim().parse().ok()?, b.trim().parse().ok()?)));
    numbers.ok_or_else(|| format!("is \"{text}\", expected columns x rows of inner corners, 9x6 say"))
}

/// What was found.
#[derive(Debug, Serialize)]
struct CalibrateSummary {
    #[serde(skip_serializing_if = "Option::is_none")]
    cameras: Option<CameraFigures>,
    /// Pixels with a truth that were not matched, percent.
    unmatched_percent: f64,
    all: GaussianFit,
    by_distance: Vec<DistanceFigures>,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct CameraFigures {
    boards: usize,
    /// Root mean square reprojection error, px.
    rms_px: f64,
    /// Vertical distance of corresponding corners after rectification, px.
    mean_vertical_px: f64,
    largest_vertical_px: f64,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct DistanceFigures {
    least_disparity_px: f32,
    largest_disparity_px: f32,
    /// Where the rig is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    from_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    to_m: Option<f64>,
    fit: GaussianFit,
}

/// Parts of equal size that the samples are split into by distance.
const PARTS: usize = 4;

pub(crate) fn run(arguments: &CalibrateArguments) -> Result<ExitCode, Box<dyn Error>> {
    if arguments.left.len() != arguments.right.len() {
        let (left, right) = (arguments.left.len(), arguments.right.len());
        return Err(format!("{left} left and {right} right images; expected as many of each, in the same order").into());
    }
    let (cameras, rig, profile) = match arguments.board {
        Some(board) => from_boards(arguments, board)?,
        None => from_truth(arguments)?,
    };
    let all = profile.fit().ok_or_else(|| {
        format!(
            "{} disparities could be compared, {} pixels were unmatched; expected at least 30",
            profile.samples.len(),
            profile.unmatched
        )
    })?;
    let by_distance = profile.fit_by_disparity(PARTS).into_iter().map(|(least, largest, fit)| {
        let distance = |disparity: f32| rig.map(|rig| rig.depth_m(f64::from(disparity)));
        DistanceFigures {
            least_disparity_px: least,
            largest_disparity_px: largest,
            from_m: distance(largest),
            to_m: distance(least),
            fit,
        }
    });
    let unmatched_percent = 100.0 * profile.unmatched as f64 / (profile.unmatched + profile.samples.len()) as f64;
    let summary = CalibrateSummary { cameras, unmatched_percent, all, by_distance: by_distance.collect() };
    print(&summary, &profile);
    if let Some(path) = &arguments.plot {
        plot(path, &profile, &summary.all)?;
        tell!("plot                   {}", path.display());
    }
    if let Some(path) = &arguments.write {
        write_sigma(path, summary.all.sigma_px)?;
    }
    if let Some(path) = &arguments.summary {
        std::fs::write(path, serde_json::to_string_pretty(&summary)?)
            .map_err(|error| format!("{}: {error}", path.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

impl CalibrateArguments {
    /// The dense matcher, with a range that reaches far enough; with the vehicle's method where its noise is asked for. Its
    /// filters are for flight: a board of blank squares would not pass them.
    fn matcher(&self, largest_px: f64, width_px: u32) -> Result<Config, Box<dyn Error>> {
        let max_disparity_px = self.range(largest_px, width_px)?;
        Ok(match &self.write {
            Some(vehicle) => {
                Config { method: VehicleConfig::load(vehicle)?.stereo.method, ..Config::dense(max_disparity_px) }
            }
            None => Config::dense(max_disparity_px),
        })
    }

    /// The range asked for, or the smallest one that reaches 2 px beyond the largest disparity.
    fn range(&self, largest_px: f64, width_px: u32) -> Result<u32, String> {
        let fits = |range: &u32| f64::from(*range) > largest_px + 2.0;
        let range = self.max_disparity.or_else(|| Config::RANGES.into_iter().find(fits));
        match range {
            Some(range) if Config::RANGES.contains(&range) && range < width_px => Ok(range),
            Some(range) => {
                Err(format!("--max-disparity {range}: allowed are {:?}, below the image's width", Config::RANGES))
            }
            None => Err(format!(
                "the nearest thing has a disparity of {largest_px:.1} px; at most {:?} can be matched",
                Config::RANGES.last()
            )),
        }
    }
}

type Found = (Option<CameraFigures>, Option<StereoRig>, ErrorProfile);

/// Boards: cameras solved for or checked, disparities compared with the boards' planes.
fn from_boards(arguments: &CalibrateArguments, (columns, rows): (usize, usize)) -> Result<Found, Box<dyn Error>> {
    let square_m = arguments.square.filter(|square| (0.001..=10.0).contains(square));
    let board = Board { columns, rows, square_m: square_m.ok_or("--square must be 0.001 to 10 m")? };
    let (pairs, views) = find_boards(arguments, &board)?;
    let size = (pairs[0].width_px, pairs[0].height_px);
    let given = arguments.calib.as_deref().map(|path| Calibration::load(path, Some(size))).transpose()?;
    let solution = match given {
        Some(Calibration::Raw(raw)) => check(&board, &views, &raw)?,
        Some(Calibration::Rectified(_)) => {
            return Err("--calib is of rectified images; expected one of raw images, as the boards are".into());
        }
        None => calibrate(&board, &views, size)?,
    };
    let mut bounds = Bounds::default();
    solution.calibration.check(&mut bounds);
    let violations = bounds.into_violations();
    if !violations.is_empty() {
        return Err(format!("the boards lead to impossible cameras: {}", violations.join("; ")).into());
    }
    let rectification = solution.calibration.rectify()?;
    let (rig, turn) = (rectification.rig, rectification.left_turn());
    let (mean, largest) = vertical(&views, &solution.calibration, &rectification);
    let figures = CameraFigures {
        boards: views.len(),
        rms_px: solution.rms_px,
        mean_vertical_px: mean,
        largest_vertical_px: largest,
    };
    let rectifier = Rectifier::new(&solution.calibration, &rectification);
    let mut profile = ErrorProfile::default();
    let nearest = (0..views.len()).flat_map(|view| solution.distances(&board, view)).fold(f64::INFINITY, f64::min);
    let config = arguments.matcher(rig.disparity_px(nearest), rig.width_px)?;
    let mut matcher = Matcher::new(&rig, config);
    let mut disparity = vec![0; rig.pixels()];
    for (index, pair) in pairs.iter().enumerate() {
        let mut rectified = [vec![0; rig.pixels()], vec![0; rig.pixels()]];
        for (camera, (raw, out)) in pair.pixels.chunks(rig.pixels()).zip(&mut rectified).enumerate() {
            rectifier.remap(camera, raw, out);
        }
        matcher.step(&rectified[0], &rectified[1], &mut disparity)?;
        profile.add_board(&board, &solution, index, &rig, &turn, &disparity);
    }
    if let Some(path) = &arguments.out {
        write_calibration(path, &solution)?;
    }
    print_cameras(&solution, &rig);
    Ok((Some(figures), Some(rig), profile))
}

/// The pairs in which both cameras see the whole board.
fn find_boards(
    arguments: &CalibrateArguments,
    board: &Board,
) -> Result<(Vec<StereoPair>, Vec<BoardView>), Box<dyn Error>> {
    let mut finder = BoardFinder::new(board.columns, board.rows)?;
    let (mut pairs, mut views): (Vec<StereoPair>, Vec<BoardView>) = (Vec::new(), Vec::new());
    let progress = ProgressBar::new(arguments.left.len() as u64);
    for (left, right) in arguments.left.iter().zip(&arguments.right) {
        let pair = StereoPair::load(left, right)?;
        let (width, height) = (pair.width_px as usize, pair.height_px as usize);
        if pairs.first().is_some_and(|first| (first.width_px, first.height_px) != (pair.width_px, pair.height_px)) {
            return Err(format!("{}: is {width} x {height} px, the first pair has another size", left.display()).into());
        }
        let mut side = |image: &[u8], path: &Path| -> Result<_, Box<dyn Error>> {
            let found = finder.find(image, width, height).map_err(|error| format!("{}: {error}", path.display()))?;
            if found.is_none() {
                progress.suspend(|| {
                    say(format_args!(
                        "{}: no whole board of {} x {} corners, left out",
                        path.display(),
                        board.columns,
                        board.rows
                    ));
                });
            }
            Ok(found)
        };
        let (left_image, right_image) = pair.pixels.split_at(width * height);
        if let (Some(left), Some(right)) = (side(left_image, left)?, side(right_image, right)?) {
            views.push(BoardView { left, right });
            pairs.push(pair);
        }
        progress.inc(1);
    }
    progress.finish_and_clear();
    if pairs.is_empty() {
        return Err(format!("no board of {} x {} inner corners in any pair", board.columns, board.rows).into());
    }
    Ok((pairs, views))
}

/// Mean and largest vertical distance of corresponding corners after rectification, px.
fn vertical(views: &[BoardView], calibration: &StereoCalibration, rectification: &Rectification) -> (f64, f64) {
    let (mut sum, mut largest, mut count) = (0.0, 0.0_f64, 0);
    for (left, right) in views.iter().flat_map(|view| view.left.iter().zip(&view.right)) {
        let rows = (rectification.rectified(calibration, 0, *left), rectification.rectified(calibration, 1, *right));
        if let (Some(left), Some(right)) = rows {
            let off = (left[1] - right[1]).abs();
            (sum, largest, count) = (sum + off, largest.max(off), count + 1);
        }
    }
    (sum / f64::from(count.max(1)), largest)
}

/// Rectified pairs with true disparities.
fn from_truth(arguments: &CalibrateArguments) -> Result<Found, Box<dyn Error>> {
    if arguments.ground_truth.len() != arguments.left.len() {
        let (truths, pairs) = (arguments.ground_truth.len(), arguments.left.len());
        return Err(
            format!("{truths} ground truths for {pairs} pairs; expected as many of each, in the same order").into()
        );
    }
    let mut profile = ErrorProfile::default();
    let mut rig = None;
    for ((left, right), truth) in arguments.left.iter().zip(&arguments.right).zip(&arguments.ground_truth) {
        let pair = StereoPair::load(left, right)?;
        let (width_px, height_px) = (pair.width_px, pair.height_px);
        rig = match arguments
            .calib
            .as_deref()
            .map(|path| Calibration::load(path, Some((width_px, height_px))))
            .transpose()?
        {
            Some(Calibration::Rectified(rig)) => Some(rig),
            Some(Calibration::Raw(_)) => {
                return Err("--calib is of raw images; expected one of a rectified pair".into());
            }
            None => None,
        };
        let (cx_px, cy_px) = (f64::from(width_px) / 2.0, f64::from(height_px) / 2.0);
        let any = StereoRig { width_px, height_px, focal_px: 500.0, cx_px, cy_px, baseline_m: 0.1, doffs_px: 0.0 };
        let mut disparity = vec![0; any.pixels()];
        let (left_image, right_image) = pair.pixels.split_at(any.pixels());
        let truth = load_disparity(truth, width_px, height_px)?;
        let nearest = truth.iter().flatten().copied().fold(0.0, f32::max);
        let config = arguments.matcher(nearest.into(), width_px)?;
        Matcher::new(&any, config).step(left_image, right_image, &mut disparity)?;
        profile.add_image(&truth, &disparity);
    }
    Ok((None, rig, profile))
}

fn print_cameras(solution: &Solution, rig: &StereoRig) {
    for (name, lens) in [("left camera", &solution.calibration.left), ("right camera", &solution.calibration.right)] {
        let ([fx, fy], [cx, cy]) = (lens.focal_px, lens.centre_px);
        tell!("{name:<22} focal length {fx:.2}, {fy:.2} px, centre {cx:.2}, {cy:.2} px");
        tell!("                       {:.5?}", lens.distortion);
    }
    tell!(
        "rectified              focal length {:.4} px, centre {:.4}, {:.4} px, baseline {:.6} m",
        rig.focal_px,
        rig.cx_px,
        rig.cy_px,
        rig.baseline_m
    );
}

fn print(summary: &CalibrateSummary, profile: &ErrorProfile) {
    if let Some(cameras) = &summary.cameras {
        tell!("boards                 {} seen whole by both cameras", cameras.boards);
        tell!("reprojection error     {:.3} px root mean square", cameras.rms_px);
        tell!(
            "rows after rectifying  {:.3} px apart in the mean, {:.3} px at most",
            cameras.mean_vertical_px,
            cameras.largest_vertical_px
        );
    }
    let line = |name: String, fit: &GaussianFit| {
        tell!(
            "{name:<30} sigma {:.3} px, bias {:+.3} px, {:.1} % outliers, {} samples",
            fit.sigma_px,
            fit.bias_px,
            fit.outliers_percent,
            fit.samples
        );
    };
    tell!("unmatched              {:.1} %", summary.unmatched_percent);
    for part in &summary.by_distance {
        let name = match (part.from_m, part.to_m) {
            (Some(from), Some(to)) => format!("  {from:.2} to {to:.2} m"),
            _ => format!("  {:.1} to {:.1} px", part.least_disparity_px, part.largest_disparity_px),
        };
        line(name, &part.fit);
    }
    line("disparity error".to_owned(), &summary.all);
    let (shares, beyond) = profile.histogram(0.125, 1.0);
    for (index, share) in shares.iter().enumerate() {
        tell!(
            "  {:+.3} px {:>5.1} % {}",
            -1.0 + 0.125 * (index as f64 + 0.5),
            share,
            "#".repeat(share.round() as usize)
        );
    }
    tell!("  beyond   {beyond:>5.1} %");
}

fn write_calibration(path: &Path, solution: &Solution) -> Result<(), Box<dyn Error>> {
    let text = ron::ser::to_string_pretty(&solution.calibration, ron::ser::PrettyConfig::default())?;
    let head = format!(
        "// Raw stereo pair; on {} chessboards its reprojection error is {:.3} px.\n",
        solution.views(),
        solution.rms_px
    );
    std::fs::write(path, head + &text + "\n").map_err(|error| format!("{}: {error}", path.display()).into())
}

/// Replaces the number after `sigma_px:`, so that comments and order stay.
fn write_sigma(path: &Path, sigma_px: f64) -> Result<(), Box<dyn Error>> {
    let text = std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
    let mut places = text.match_indices("sigma_px:").map(|(at, key)| at + key.len());
    let (Some(place), None) = (places.next(), places.next()) else {
        return Err(format!("{}: expected one \"sigma_px:\" in it", path.display()).into());
    };
    let start = place + text[place..].len() - text[place..].trim_start().len();
    let end = start + text[start..].find(|c: char| !c.is_ascii_digit() && !".+-eE".contains(c)).unwrap_or(0);
    let before: f64 =
        text[start..end].parse().map_err(|_| format!("{}: no number after \"sigma_px:\"", path.display()))?;
    let written = format!("{}{:.2}{}", &text[..start], sigma_px.max(0.01), &text[end..]);
    std::fs::write(path, written).map_err(|error| format!("{}: {error}", path.display()))?;
    tell!("written                {}: sigma_px {before} → {:.2}", path.display(), sigma_px.max(0.01));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_number_is_replaced() {
        let folder = tempfile::tempdir().expect("writable");
        let path = folder.path().join("vehicle.ron");
        std::fs::write(&path, "( noise: ( // stereo\n sigma_px: 0.4,  // px\n lambda: 3.0 ) )").expect("writable");
        write_sigma(&path, 0.2345).expect("written");
        let text = std::fs::read_to_string(&path).expect("readable");
        assert_eq!(text, "( noise: ( // stereo\n sigma_px: 0.23,  // px\n lambda: 3.0 ) )");
        std::fs::write(&path, "(a: 1)").expect("writable");
        assert!(write_sigma(&path, 0.2).is_err());
    }

    #[test]
    fn boards_are_columns_by_rows() {
        assert_eq!(parse_board("9x6"), Ok((9, 6)));
        assert!(parse_board("9").is_err() && parse_board("9xa").is_err());
    }
}
