//! What is still to be spread from, nearest first but for what shares a bucket.
//!
//! A queue for values that hardly ever fall below what was taken out last (Dial 1969): putting in and taking out cost the same
//! however many there are. Whoever uses it must bear a little disorder.

/// Least width of a bucket, m: half of what a free cell costs.
const WIDTH_M: f32 = 0.2;
/// So many; what is beyond the last shares it, and what is below the first.
const COUNT: usize = 4096;
/// End of a chain.
const NONE: u32 = u32::MAX;

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(crate) struct Buckets {
    /// Of every bucket the entry put in last.
    heads: Vec<u32>,
    entries: Vec<Entry>,
    /// Where the first bucket begins, m, and buckets to the metre.
    least_m: f32,
    per_m: f32,
    /// Buckets before this one are empty.
    first: usize,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    place: u32,
    value_m: f32,
    next: u32,
}

impl Buckets {
    /// With room for so many entries.
    pub(crate) fn new(entries: usize) -> Self {
        Self { heads: vec![NONE; COUNT], entries: Vec::with_capacity(entries), least_m: 0.0, per_m: 0.0, first: COUNT }
    }

    /// Takes all out, and begins anew with values from `least_m` on, most of which lie within `span_m`.
    pub(crate) fn begin(&mut self, least_m: f32, span_m: f32) {
        self.least_m = least_m;
        self.per_m = 1.0 / WIDTH_M.max(span_m / COUNT as f32);
        self.heads.fill(NONE);
        self.entries.clear();
        self.first = COUNT;
    }

    /// How many were put in.
    #[cfg(test)]
    pub(crate) fn count(&self) -> usize {
        self.entries.len()
    }

    pub(crate) fn push(&mut self, place: usize, value_m: f32) {
        let bucket = (((value_m - self.least_m) * self.per_m) as usize).min(COUNT - 1);
        let entry = Entry { place: place as u32, value_m, next: self.heads[bucket] };
        self.heads[bucket] = self.entries.len() as u32;
        self.entries.push(entry);
        self.first = self.first.min(bucket);
    }

    /// A place and the value it was put in with, of the least bucket that is not empty.
    pub(crate) fn pop(&mut self) -> Option<(usize, f32)> {
        let skipped = self.heads.get(self.first..)?.iter().position(|&head| head != NONE)?;
        self.first += skipped;
        let Entry { place, value_m, next } = self.entries[self.heads[self.first] as usize];
        self.heads[self.first] = next;
        Some((place as usize, value_m))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn all_that_is_put_in_comes_out_in_the_order_of_buckets() {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(3);
        let mut buckets = Buckets::new(100);
        for (least_m, span_m) in [(0.0, 100.0), (1e4, 100.0), (50.0, 2000.0)] {
            buckets.begin(least_m, span_m);
            let width_m = WIDTH_M.max(span_m / COUNT as f32);
            let mut values: Vec<f32> = (0..100).map(|_| least_m + random.random_range(0.0..1.1 * span_m)).collect();
            values.extend([least_m - 3.0, least_m, f32::MAX, f32::INFINITY]);
            values.iter().enumerate().for_each(|(place, &value)| buckets.push(place, value));
            let (mut out, mut before) = (Vec::new(), least_m);
            while let Some((place, value)) = buckets.pop() {
                assert_eq!(value, values[place]);
                let is_last = value > least_m + COUNT as f32 * width_m - 1.0;
                assert!(value > before - 1.01 * width_m || is_last || value < least_m, "{before} {value}");
                before = value.max(least_m);
                out.push(place);
            }
            out.sort_unstable();
            assert_eq!(out, (0..values.len()).collect::<Vec<_>>());
            // What is less than what came out last is next.
            buckets.push(0, least_m + 7.0);
            buckets.push(1, least_m + 3.0);
            assert_eq!(buckets.pop(), Some((1, least_m + 3.0)));
            buckets.push(2, least_m + 1.0);
            assert_eq!(buckets.pop(), Some((2, least_m + 1.0)));
            buckets.begin(least_m, span_m);
            assert_eq!(buckets.pop(), None);
        }
    }
}
