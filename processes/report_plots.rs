//! The plots of a flight's report, as SVG.

use crate::report_flight::{Doing, FlownFlight, Moment, Near};
use ground::ObstacleCells;
use ipc_types::messages::{HealthLevel, Rung};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use statrs::statistics::{Data, OrderStatistics};
use std::error::Error;

const WIDTH: u32 = 980;
const BLUE_LINE: RGBColor = RGBColor(31, 119, 180);
const RED_LINE: RGBColor = RGBColor(214, 39, 40);
const GREEN_LINE: RGBColor = RGBColor(44, 160, 44);
const ORANGE_LINE: RGBColor = RGBColor(255, 127, 14);
const GREY: RGBColor = RGBColor(120, 120, 120);
/// Points of a line, at most: more are not seen.
const POINTS: usize = 2000;
/// Seen so often, and something is there.
const SIGHTINGS: u32 = 4;
/// A process that is not heard for so long is not known to be well, s.
const SILENT_S: f64 = 0.5;
/// Times to a collision beyond are all the same, s.
const LONG_S: f64 = 10.0;

type Plot = Result<String, Box<dyn Error>>;
type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// A line with a name.
struct Line {
    name: &'static str,
    colour: RGBColor,
    points: Vec<(f64, f64)>,
}

impl Line {
    fn new(name: &'static str, colour: RGBColor, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        let points: Vec<_> = points.into_iter().filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
        // Of so many the lowest and the highest: what is short is not to be overlooked.
        let every = points.len().div_ceil(POINTS / 2).max(1);
        let ends = |part: &[(f64, f64)]| {
            let by_value = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
            let mut ends = [part.iter().min_by(by_value), part.iter().max_by(by_value)]
                .map(|end| end.copied().unwrap_or_default());
            ends.sort_by(|a, b| a.0.total_cmp(&b.0));
            ends
        };
        let points = if every == 1 { points } else { points.chunks(every).flat_map(ends).collect() };
        Self { name, colour, points }
    }
}

/// Draws into a string.
fn drawn(
    height: u32,
    draw: impl FnOnce(&DrawingArea<SVGBackend<'_>, plotters::coord::Shift>) -> Result<(), Box<dyn Error>>,
) -> Plot {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
        area.fill(&WHITE)?;
        draw(&area)?;
        area.present()?;
    }
    Ok(svg)
}

fn draw_lines<'a>(chart: &mut Chart<'a>, lines: &[Line]) -> Result<(), Box<dyn Error>> {
    for line in lines.iter().filter(|line| !line.points.is_empty()) {
        let colour = line.colour;
        chart
            .draw_series(LineSeries::new(line.points.iter().copied(), colour.stroke_width(2)))?
            .label(line.name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
    }
    if lines.iter().any(|line| !line.points.is_empty()) {
        let place = SeriesLabelPosition::UpperRight;
        chart.configure_series_labels().position(place).background_style(WHITE.mix(0.8)).border_style(GREY).draw()?;
    }
    Ok(())
}

/// Lines over flight time.
fn over_time(flight: &FlownFlight, label: &str, least: f64, lines: &[Line]) -> Plot {
    let values = || lines.iter().flat_map(|line| &line.points).map(|(_, y)| *y);
    let most = values().fold(least + 1e-3, f64::max);
    let lowest = values().fold(least, f64::min);
    drawn(260, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .x_label_area_size(40)
            .y_label_area_size(60)
            .build_cartesian_2d(0.0..flight.end_s(), lowest..lowest + 1.1 * (most - lowest))?;
        chart.configure_mesh().x_desc("flight time, s").y_desc(label).y_labels(6).draw()?;
        draw_lines(&mut chart, lines)
    })
}

/// The path from above, over what was seen.
pub(crate) fn from_above(flight: &FlownFlight) -> Plot {
    let at = |moment: &Moment| (moment.position_m[0], moment.position_m[1]);
    let side_m = ObstacleCells::SIDE_M;
    let cells = flight.obstacles.seen(SIGHTINGS).map(|[x, y]| (f64::from(x) * side_m, f64::from(y) * side_m));
    let goals = || flight.goals.iter().map(|goal| (goal.position_m[0], goal.position_m[1]));
    let places: Vec<_> = flight.track.iter().chain(&flight.truth).map(at).chain(goals()).collect();
    let range = |of: fn(&(f64, f64)) -> f64| {
        let values = || places.iter().map(of).filter(|value| value.is_finite());
        (values().fold(0.0, f64::min) - 6.0, values().fold(0.0, f64::max) + 6.0)
    };
    let ((left, right), (bottom, top)) = (range(|place| place.0), range(|place| place.1));
    // Metres are as long to the north as to the east.
    let inner = f64::from(WIDTH - 90);
    let height = (inner * (top - bottom) / (right - left)).clamp(160.0, 1400.0);
    let wide = (right - left).max((top - bottom) * inner / height);
    let middle = 0.5 * (left + right);
    let (left, right) = (middle - 0.5 * wide, middle + 0.5 * wide);
    drawn(height as u32 + 60, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .x_label_area_size(40)
            .y_label_area_size(60)
            .build_cartesian_2d(left..right, bottom..top)?;
        chart.configure_mesh().x_desc("east, m").y_desc("north, m").light_line_style(TRANSPARENT).draw()?;
        let inside = |(x, y): &(f64, f64)| (left..right).contains(x) && (bottom..top).contains(y);
        let square =
            |(x, y): (f64, f64)| Rectangle::new([(x, y), (x + side_m, y + side_m)], RGBColor(90, 60, 30).filled());
        chart.draw_series(cells.filter(inside).map(square))?;
        chart.draw_series(goals().map(|goal| Circle::new(goal, 8, ORANGE_LINE.stroke_width(3))))?;
        let lines = [
            Line { name: "flown", colour: GREEN_LINE, points: thinned(&flight.truth) },
            Line { name: "as estimated", colour: BLUE_LINE, points: thinned(&flight.track) },
        ];
        draw_lines(&mut chart, &lines)
    })
}

/// Places from above: not all of them are seen.
fn thinned(moments: &[Moment]) -> Vec<(f64, f64)> {
    let every = moments.len().div_ceil(POINTS).max(1);
    let places = moments.iter().step_by(every).chain(moments.last());
    places.map(|moment| (moment.position_m[0], moment.position_m[1])).collect()
}

/// Height over time.
pub(crate) fn altitude(flight: &FlownFlight) -> Plot {
    let height = |moments: &[Moment]| moments.iter().map(|m| (m.at_s, m.position_m[2])).collect::<Vec<_>>();
    let lines = [
        Line::new("flown", GREEN_LINE, height(&flight.truth)),
        Line::new("as estimated", BLUE_LINE, height(&flight.track)),
    ];
    over_time(flight, "height, m", 0.0, &lines)
}

/// Speed over time, and what was allowed.
pub(crate) fn speed(flight: &FlownFlight) -> Plot {
    let flown = if flight.truth.is_empty() { &flight.track } else { &flight.truth };
    let lines = [
        Line::new("allowed", RED_LINE, flown.iter().map(|m| (m.at_s, flight.allowed_mps(m.at_s)))),
        Line::new("flown", BLUE_LINE, flown.iter().map(|m| (m.at_s, m.speed_mps))),
    ];
    over_time(flight, "speed, m/s", 0.0, &lines)
}

/// Distance to what is nearest, over time.
pub(crate) fn clearance(flight: &FlownFlight) -> Plot {
    let distance = |near: &[Near]| near.iter().map(|n| (n.at_s, n.distance_m.min(30.0))).collect::<Vec<_>>();
    let lines = [
        Line::new("nearest obstacle", GREEN_LINE, distance(&flight.clearance)),
        Line::new("nearest in view, as seen", ORANGE_LINE, distance(&flight.seen)),
    ];
    over_time(flight, "distance, m", 0.0, &lines)
}

/// Time to a collision with what is nearest, if the vehicle flew towards it.
pub(crate) fn time_to_collision(flight: &FlownFlight) -> Plot {
    let time = |near: &[Near]| near.iter().map(|n| (n.at_s, n.time_to_collision_s().min(LONG_S))).collect::<Vec<_>>();
    let lines = [
        Line::new("nearest obstacle", GREEN_LINE, time(&flight.clearance)),
        Line::new("nearest in view, as seen", ORANGE_LINE, time(&flight.seen)),
    ];
    over_time(flight, "time to collision, s (10 and more: 10)", 0.0, &lines)
}

/// How old images were when something had come of them.
pub(crate) fn latencies(flight: &FlownFlight) -> Plot {
    let most_ms = flight.latencies_ms.values().flatten().copied().fold(1.0, f64::max).min(500.0);
    let bin_ms = most_ms / 100.0;
    let share = |of: &[f64]| {
        let mut bins = vec![0.0; 101];
        of.iter().for_each(|ms| bins[((ms / bin_ms).max(0.0) as usize).min(100)] += 100.0 / of.len().max(1) as f64);
        bins
    };
    let histograms: Vec<_> = flight.latencies_ms.iter().map(|(name, of)| (*name, share(of))).collect();
    let highest = histograms.iter().flat_map(|(_, bins)| bins).copied().fold(1.0, f64::max);
    drawn(260, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .x_label_area_size(40)
            .y_label_area_size(60)
            .build_cartesian_2d(0.0..most_ms, 0.0..1.1 * highest)?;
        chart.configure_mesh().x_desc("from exposure, ms").y_desc("messages, %").y_labels(6).draw()?;
        let lines: Vec<_> = histograms
            .iter()
            .zip([BLUE_LINE, GREEN_LINE, RED_LINE])
            .map(|((name, bins), colour)| {
                let steps = bins.iter().enumerate().flat_map(|(index, percent)| {
                    [index, index + 1].map(|edge| ((edge as f64 * bin_ms).min(most_ms), *percent))
                });
                Line { name, colour, points: steps.collect() }
            })
            .collect();
        draw_lines(&mut chart, &lines)
    })
}

/// Of latencies: name, median, 99th percentile, longest, ms.
pub(crate) fn latency_figures(flight: &FlownFlight) -> Vec<(&'static str, [f64; 3])> {
    let figures = |of: &Vec<f64>| {
        let mut data = Data::new(of.clone());
        [data.quantile(0.5), data.quantile(0.99), data.quantile(1.0)]
    };
    flight.latencies_ms.iter().map(|(name, of)| (*name, figures(of))).collect()
}

/// How every process did, and on which rung was flown.
pub(crate) fn health(flight: &FlownFlight) -> Plot {
    let rows = flight.health.len() + 1;
    let end_s = flight.end_s();
    let names: Vec<String> = flight.health.keys().map(ToString::to_string).chain(["ladder".to_owned()]).collect();
    drawn(28 * rows as u32 + 60, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .x_label_area_size(40)
            .y_label_area_size(110)
            .build_cartesian_2d(0.0..end_s, 0.0..rows as f64)?;
        let name = |y: &f64| match y.fract() {
            0.5 => names.iter().rev().nth(*y as usize).cloned().unwrap_or_default(),
            _ => String::new(),
        };
        chart
            .configure_mesh()
            .disable_y_mesh()
            .x_desc("flight time, s")
            .y_labels(4 * rows)
            .y_label_formatter(&name)
            .draw()?;
        for (index, history) in flight.health.values().enumerate() {
            let bottom = (rows - 1 - index) as f64;
            draw_health(&mut chart, history, end_s, bottom)?;
        }
        let ends = flight.rungs.iter().skip(1).map(|rung| rung.from_s).chain([end_s]);
        let bars =
            flight.rungs.iter().zip(ends).map(|(on, until_s)| bar(on.from_s, until_s, 0.0, rung_colour(on.rung)));
        chart.draw_series(bars)?;
        Ok(())
    })
}

/// Bars by level; a line and a mark where a successor began.
fn draw_health(chart: &mut Chart<'_>, history: &[Doing], end_s: f64, bottom: f64) -> Result<(), Box<dyn Error>> {
    // Until it was something else, or was not heard any more.
    let next = history.iter().skip(1).map(|doing| doing.from_s).chain([end_s]);
    let ends = history.iter().zip(next).map(|(doing, next)| next.min(doing.until_s + SILENT_S));
    let colour = |level| match level {
        HealthLevel::Ok => GREEN_LINE,
        HealthLevel::Degraded => ORANGE_LINE,
        HealthLevel::Faulted => RED_LINE,
    };
    chart.draw_series(
        history.iter().zip(ends).map(|(doing, until_s)| bar(doing.from_s, until_s, bottom, colour(doing.level))),
    )?;
    let restarts = history.windows(2).filter(|pair| pair[0].incarnation != pair[1].incarnation);
    chart.draw_series(restarts.map(|pair| {
        let line = [(pair[1].from_s, bottom + 0.02), (pair[1].from_s, bottom + 0.98)];
        PathElement::new(line, BLACK.stroke_width(3))
    }))?;
    Ok(())
}

fn bar(from_s: f64, until_s: f64, bottom: f64, colour: RGBColor) -> Rectangle<(f64, f64)> {
    Rectangle::new([(from_s, bottom + 0.2), (until_s, bottom + 0.8)], colour.mix(0.7).filled())
}

fn rung_colour(rung: Rung) -> RGBColor {
    match rung {
        Rung::Full => GREEN_LINE,
        Rung::SingleFrame | Rung::Slower => ORANGE_LINE,
        Rung::Hover | Rung::HandBack => RED_LINE,
    }
}
