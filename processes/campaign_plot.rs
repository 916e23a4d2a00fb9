//! Success against speed, or against the density of trees, as a picture.

use crate::campaign::{Row, success_bounds};
use plotters::prelude::*;
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use supervisor::Outcome;

/// What success is drawn against.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Against {
    Speed,
    Density,
}

impl Against {
    fn of(self, row: &Row) -> f64 {
        match self {
            Self::Speed => row.cruise_mps,
            Self::Density => row.trees_per_m2,
        }
    }

    /// The other one, which tells lines apart.
    fn name_of_other(self, row: &Row) -> String {
        match self {
            Self::Speed => format!("{} trees/m²", row.trees_per_m2),
            Self::Density => format!("{} m/s", row.cruise_mps),
        }
    }
}

/// A share of flights, in percent, with what it may be.
#[derive(Clone, Copy, Debug)]
struct Share {
    at: f64,
    percent: f64,
    bounds: [f64; 2],
}

const COLOURS: [RGBColor; 6] = [
    RGBColor(31, 119, 180),
    RGBColor(214, 39, 40),
    RGBColor(44, 160, 44),
    RGBColor(148, 103, 189),
    RGBColor(255, 127, 14),
    BLACK,
];

/// Writes an SVG: the share that arrived, with 95 % confidence, against speed where speeds differ, else against density;
/// against speed also the speed √(2·a·R) from which the vehicle can just stop within what its sensor sees.
pub(crate) fn plot(path: &Path, rows: &[&Row], braking_limit_mps: f64) -> Result<(), Box<dyn Error>> {
    let differ = |against: Against| rows.iter().any(|row| against.of(row).to_bits() != against.of(rows[0]).to_bits());
    let against = if !differ(Against::Speed) && differ(Against::Density) { Against::Density } else { Against::Speed };
    let lines = shares(rows, against);
    let most = lines.values().flatten().map(|share| share.at).fold(0.0, f64::max);
    let right = 1.05 * if against == Against::Speed { most.max(braking_limit_mps) } else { most };
    let area = SVGBackend::new(path, (860, 520)).into_drawing_area();
    area.fill(&WHITE)?;
    let (caption, label) = match against {
        Against::Speed => ("Flights that arrive, by highest speed", "highest speed, m/s"),
        Against::Density => ("Flights that arrive, by density of the forest", "trees per m²"),
    };
    let mut chart = ChartBuilder::on(&area)
        .caption(caption, ("sans-serif", 20))
        .margin(12)
        .x_label_area_size(45)
        .y_label_area_size(60)
        .build_cartesian_2d(0.0..right.max(1e-3), 0.0..105.0)?;
    chart.configure_mesh().x_desc(label).y_desc("arrived, %").draw()?;
    for (index, (name, shares)) in lines.iter().enumerate() {
        let colour = COLOURS[index % COLOURS.len()];
        chart
            .draw_series(LineSeries::new(shares.iter().map(|share| (share.at, share.percent)), colour.stroke_width(2)))?
            .label(name.as_str())
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
        chart.draw_series(shares.iter().map(|share| Circle::new((share.at, share.percent), 4, colour.filled())))?;
        let bars = shares.iter().map(|share| share.bounds.map(|bound| (share.at, bound)));
        chart.draw_series(bars.map(|bar| PathElement::new(bar, colour.mix(0.5))))?;
    }
    if against == Against::Speed {
        let limit = [(braking_limit_mps, 0.0), (braking_limit_mps, 105.0)];
        chart
            .draw_series(std::iter::once(PathElement::new(limit, BLACK.mix(0.6).stroke_width(2))))?
            .label(format!("√(2·a·R) = {braking_limit_mps:.1} m/s"))
            .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], BLACK.mix(0.6).stroke_width(2)));
    }
    let place = SeriesLabelPosition::LowerLeft;
    chart.configure_series_labels().position(place).background_style(WHITE.mix(0.8)).border_style(BLACK).draw()?;
    area.present().map_err(|error| format!("{}: {error}", path.display()).into())
}

/// The lines: what differs but in what they are drawn against.
fn shares(rows: &[&Row], against: Against) -> BTreeMap<String, Vec<Share>> {
    let mut groups: BTreeMap<String, BTreeMap<u64, Vec<&Row>>> = BTreeMap::new();
    for &row in rows {
        let name = format!("{}, {}, {}", row.flight(), row.world, against.name_of_other(row));
        // Positive floats order as their bits do.
        groups.entry(name).or_default().entry(against.of(row).to_bits()).or_default().push(row);
    }
    let share = |(at, rows): (u64, Vec<&Row>)| {
        let arrived = rows.iter().filter(|row| row.outcome == Outcome::Arrived).count();
        let bounds = success_bounds(arrived, rows.len()).map(|bound| 100.0 * bound);
        Share { at: f64::from_bits(at), percent: 100.0 * arrived as f64 / rows.len() as f64, bounds }
    };
    groups.into_iter().map(|(name, points)| (name, points.into_iter().map(share).collect())).collect()
}
