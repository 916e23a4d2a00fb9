//! Every value spreads over the window that its surface's inflation covers: columns first, then rows.
//!
//! What the far-background rule grants ends at the foot of its column: whatever stands there unseen stands on that foot, and
//! what comes near it below the ray to the foot comes near the foot and the ground before it, which were measured. Else the
//! sky above a wall would hide the wall's upper part, as it is worth less than the wall's distance. A vehicle flatter than
//! wide keeps less off the ground than off what stands on it, so that for such a one nothing ends there.
//!
//! Rows work on what the columns left. For the nearest value that loses nothing: along a row a larger value's window
//! contains a smaller one's. Lines do not depend on each other, so neither do results on the number of threads.

use crate::range_max::Cells;
use crate::tables::Radii;
use crate::transpose::transpose;
use crate::window::{Axis, Windows};
use multiversion::multiversion;

/// What gathers values that are spread over ranges of one line.
pub(crate) trait Spread: Send + Sync + std::fmt::Debug {
    /// Values kept for every place of the line.
    const VALUES: usize;
    /// For lines of a length.
    fn new(length: usize) -> Self;
    /// Spreads a value over the range of the line that two cells cover; 0 changes nothing.
    fn raise(&mut self, cells: Cells, value: u16);
    /// Writes what was gathered, zero where nothing was, and begins anew. `out` is as many lines as values are kept.
    fn finish(&mut self, out: &mut [u16]);
}

/// Scratch of the lines of one axis, for one thread.
#[derive(Debug)]
struct Worker<S> {
    spread: S,
    radius_over_depth: Vec<f32>,
    windows: Windows,
}

impl<S: Spread> Worker<S> {
    fn new(axis: &Axis) -> Self {
        Self {
            spread: S::new(axis.expanded_px()),
            radius_over_depth: vec![0.0; axis.length_px()],
            windows: Windows::new(axis.length_px()),
        }
    }
}

/// Spreads values along both axes of an image.
#[derive(Debug)]
pub(crate) struct Inflate<S> {
    column_axis: Axis,
    row_axis: Axis,
    columns: Vec<Worker<S>>,
    rows: Vec<Worker<S>>,
    /// Columns of the image, expanded; for each the lines of its values.
    spread: Vec<u16>,
    /// The same row by row: all rows of the first value, then of the second.
    sources: Vec<u16>,
    /// Rows of the expanded image; for each the lines of its values.
    inflated: Vec<u16>,
}

impl<S: Spread> Inflate<S> {
    pub(crate) fn new(column_axis: Axis, row_axis: Axis, threads: usize) -> Self {
        let spread = vec![0; S::VALUES * row_axis.length_px() * column_axis.expanded_px()];
        Self {
            columns: (0..threads).map(|_| Worker::new(&column_axis)).collect(),
            rows: (0..threads).map(|_| Worker::new(&row_axis)).collect(),
            sources: spread.clone(),
            spread,
            inflated: vec![0; S::VALUES * row_axis.expanded_px() * column_axis.expanded_px()],
            column_axis,
            row_axis,
        }
    }

    /// Spreads the values of an image, given column by column, of each the lines of its values. Returns the rows of the
    /// expanded image, likewise.
    pub(crate) fn step(&mut self, radii: &impl Radii, values: &[u16]) -> &[u16] {
        let (height, tall) = (self.column_axis.length_px(), self.column_axis.expanded_px());
        let (width, wide) = (self.row_axis.length_px(), self.row_axis.expanded_px());
        let axis = &self.column_axis;
        let share = width.div_ceil(self.columns.len());
        let parts = values.chunks(share * S::VALUES * height).zip(self.spread.chunks_mut(share * S::VALUES * tall));
        each_part(&mut self.columns, parts, |worker, (values, spread)| {
            let columns = values.chunks_exact(S::VALUES * height).zip(spread.chunks_exact_mut(S::VALUES * tall));
            for (values, spread) in columns {
                let line = |value: usize| &values[value.min(S::VALUES - 1) * height..][..height];
                spread_line(worker, axis, radii, axis.is_upright(), &[line(0), line(1), line(2)][..S::VALUES], spread);
            }
        });
        transpose(&self.spread, S::VALUES * tall, &mut self.sources);
        let (sources, axis) = (&self.sources, &self.row_axis);
        let share = tall.div_ceil(self.rows.len());
        let parts = self.inflated.chunks_mut(share * S::VALUES * wide).enumerate();
        each_part(&mut self.rows, parts, |worker, (part, inflated)| {
            for (row, inflated) in (part * share..).zip(inflated.chunks_exact_mut(S::VALUES * wide)) {
                let line = |value: usize| &sources[(value.min(S::VALUES - 1) * tall + row) * width..][..width];
                spread_line(worker, axis, radii, false, &[line(0), line(1), line(2)][..S::VALUES], inflated);
            }
        });
        &self.inflated
    }
}

/// Gives every worker its part: on this thread where there is one, else on those of the pool that this runs in.
fn each_part<S: Send, P: Send>(
    workers: &mut [Worker<S>],
    parts: impl Iterator<Item = P> + Send,
    work: impl Fn(&mut Worker<S>, P) + Sync,
) {
    match workers {
        [worker] => parts.for_each(|part| work(worker, part)),
        workers => {
            let work = &work;
            rayon::scope(|scope| {
                workers.iter_mut().zip(parts).for_each(|(worker, part)| scope.spawn(move |_| work(worker, part)));
            });
        }
    }
}

/// Spreads the values of one line and writes what is gathered to `out`. Soft values may end at their foot.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2+fma", "x86_64+sse4.1", "aarch64+neon"))]
fn spread_line<S: Spread, R: Radii>(
    worker: &mut Worker<S>,
    axis: &Axis,
    radii: &R,
    ends_soft: bool,
    sources: &[&[u16]],
    out: &mut [u16],
) {
    let Worker { spread, radius_over_depth, windows } = worker;
    for (number, values) in sources.iter().enumerate() {
        // Apart from the updates, so that the tangents vectorise.
        radii.over_depths(values, radius_over_depth);
        axis.windows(radius_over_depth, windows);
        if ends_soft {
            windows.end_soft(values, axis.margin_px());
        }
        windows.find_cells(axis.expanded_px());
        // What is the same as before has been spread already.
        let before = number.checked_sub(1).map(|before| sources[before]);
        let (begins, ends) = (&windows.begins[..values.len()], &windows.ends[..values.len()]);
        for place in 0..values.len() {
            let value = values[place];
            if before.is_none_or(|before| before[place] != value) {
                spread.raise(Cells { begin: begins[place], end: ends[place] }, value);
            }
        }
    }
    spread.finish(out);
}
