//! Batch Informed Trees (Gammell, Srinivasa and Barfoot, ICRA 2015, Algorithms 1 to 3), to be improved bit by bit.
//!
//! A tree grows from the start through batches of places, over ways in the order of the length of the path that they
//! may be part of, and asks about a way only when its turn comes. Once there is a path, only places that a shorter one
//! could lead through are drawn, and what could not be part of one is dropped.
//!
//! What the paper leaves open: before there is a path, places are drawn from spheroids that widen from batch to batch,
//! as paths of forests are hardly longer than straight ones; the sequence is Halton's, so equal questions have equal
//! answers; and the search may begin with a path, as the one being flown, of which it keeps what is still free.

use super::endpoint::{REACH_M, nearest_free};
use super::informed::{Halton, Informed};
use super::{SearchConfig, Space};
use ipc_types::limits::Fence;
use ipc_types::{Point, World};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};
use std::hash::{BuildHasherDefault, DefaultHasher};

/// Index of the start among the places.
const START: u32 = 0;
/// Index of the goal.
const GOAL: u32 = 1;
/// The start's parent.
const NONE: u32 = u32::MAX;
/// How much longer than straight the first spheroid's paths are, share ...
const FIRST_SHARE: f64 = 0.01;
/// ... and m. Every further one allows double.
const FIRST_M: f64 = 0.5;
/// So often at most: a fence of a hundred kilometres is wholly inside then.
const MOST_WIDENINGS: u32 = 20;
/// What is less is rounding, m: a way that is shorter by no more is not shorter.
const LEAST_M: f64 = 1e-9;
/// Places drawn for every one that is wanted, at most.
const TRIES: u32 = 20;
/// More than the radius below which random geometric graphs fall apart, share.
const RADIUS_SHARE: f64 = 1.1;
/// A path that is no longer than this beyond the straight one cannot be improved, share.
const STRAIGHT_SHARE: f64 = 1e-4;

/// Why there is nothing to search for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// A coordinate is not a number.
    #[error("start or goal is not finite")]
    NotFinite,
    /// The start lies deep in what is occupied.
    #[error("no free place within 8 m of the start")]
    NoStart,
    /// So does the goal.
    #[error("no free place within 8 m of the goal")]
    NoGoal,
}

#[derive(Clone, Copy, Debug)]
struct Place {
    at: Point<World>,
    /// Length of the tree's path to here, m; infinite where there is none.
    to_come_m: f64,
    parent: u32,
    /// Never changes, unlike the index.
    id: u32,
    is_new: bool,
    /// Whether ways from here to all of its neighbours were considered.
    is_expanded: bool,
}

/// A way of the queue: the shortest path that it may be part of, then the path to its end; both as bits of positive
/// floats, which order as the floats do.
type Way = Reverse<(u64, u64, u32, u32)>;

/// The search. Made once, for many goals: what it works in is kept.
#[derive(Clone, Debug)]
pub struct BitStar {
    config: SearchConfig,
    fence: Fence,
    informed: Informed,
    halton: Halton,
    places: Vec<Place>,
    next_id: u32,
    /// Places to be expanded, by the shortest path through them.
    vertices: BinaryHeap<Reverse<(u64, u32)>>,
    ways: BinaryHeap<Way>,
    /// What was answered about ways, by the ids of their ends.
    answers: HashMap<(u32, u32), bool, BuildHasherDefault<DefaultHasher>>,
    /// Ways from the place being expanded.
    near: Vec<(f64, u32)>,
    /// What is moved along with its parent.
    moved: Vec<u32>,
    indices: Vec<u32>,
    widenings: u32,
    radius_m: f64,
    asked: u32,
    path: Vec<Point<World>>,
    /// The start that was asked for, where the vehicle is, free or not.
    wanted_start: Point<World>,
}

impl BitStar {
    /// A search that has searched for nothing.
    pub fn new(config: SearchConfig, fence: Fence) -> Self {
        let most = config.places as usize + 2;
        let ways = most * config.neighbours as usize;
        Self {
            config,
            fence,
            informed: Informed::new(Point::ZERO, Point::ZERO),
            halton: Halton::default(),
            places: Vec::with_capacity(most),
            next_id: 0,
            vertices: BinaryHeap::with_capacity(2 * most),
            ways: BinaryHeap::with_capacity(ways),
            answers: HashMap::with_capacity_and_hasher(ways, BuildHasherDefault::default()),
            near: Vec::with_capacity(most),
            moved: Vec::with_capacity(most),
            indices: Vec::with_capacity(most),
            widenings: 0,
            radius_m: 0.0,
            asked: 0,
            path: Vec::with_capacity(most),
            wanted_start: Point::ZERO,
        }
    }

    /// Begins a search. Ends that are not free or outside the fence are replaced by the nearest that are. `known` is a
    /// path that may still be good for something, from near the start to near the goal; its ends are left out.
    ///
    /// # Errors
    /// There is no such end.
    pub fn begin(
        &mut self,
        space: &mut impl Space,
        start: Point<World>,
        goal: Point<World>,
        known: &[Point<World>],
    ) -> Result<(), Refused> {
        self.path.clear();
        self.places.clear();
        self.vertices.clear();
        self.ways.clear();
        self.answers.clear();
        (self.halton, self.next_id, self.widenings, self.asked) = (Halton::default(), 0, 0, 0);
        if !start.is_finite() || !goal.is_finite() {
            return Err(Refused::NotFinite);
        }
        self.wanted_start = start;
        let is_near = |place: &Point<World>| place.distance(start) <= REACH_M;
        let start = nearest_free(space, &self.fence, start).filter(is_near).ok_or(Refused::NoStart)?;
        let goal = nearest_free(space, &self.fence, goal).ok_or(Refused::NoGoal)?;
        self.informed = Informed::new(start, goal);
        self.add(start);
        self.add(goal);
        (self.places[0].to_come_m, self.places[0].is_new) = (0.0, false);
        if self.may_go(space, START, GOAL) {
            self.connect(START, GOAL);
        } else {
            self.adopt(space, known);
        }
        // The first batch queues the tree, with a radius of its own.
        self.vertices.clear();
        Ok(())
    }

    /// Where the path ends: the goal that was asked for, or the nearest free place.
    pub fn goal(&self) -> Point<World> {
        self.informed.goal
    }

    /// Length of the shortest path so far, m; infinite without one.
    pub fn length_m(&self) -> f64 {
        self.places.get(GOAL as usize).map_or(f64::INFINITY, |goal| goal.to_come_m)
    }

    /// Segments asked about since the search began.
    pub fn asked(&self) -> u32 {
        self.asked
    }

    /// The shortest path so far, from start to goal; empty without one. Where the start that was asked for is not free
    /// it is the first place all the same: the vehicle is there, and must leave.
    pub fn path(&mut self) -> &[Point<World>] {
        self.path.clear();
        if self.length_m().is_finite() {
            let mut index = GOAL;
            while index != NONE {
                let place = self.places[index as usize];
                self.path.push(place.at);
                index = place.parent;
            }
            let start = self.wanted_start;
            if self.path.last().is_some_and(|first| first.distance(start) > 0.0) {
                self.path.push(start);
            }
            self.path.reverse();
        }
        &self.path
    }

    /// Searches on, until `segments` more were asked about. Every batch asks about places besides, 20 times its size at
    /// most. Returns whether more would be of use.
    pub fn improve(&mut self, space: &mut impl Space, segments: u32) -> bool {
        let most = self.asked.saturating_add(segments);
        while self.asked < most {
            self.expand_promising();
            let shortest_m = self.length_m();
            let way = self.ways.pop().filter(|Reverse((through, ..))| f64::from_bits(*through) < shortest_m);
            match way {
                Some(Reverse((.., from, to))) => self.try_way(space, from, to),
                None if self.next_batch(space) => {}
                None => return false,
            }
        }
        true
    }

    /// Adds a place.
    fn add(&mut self, at: Point<World>) -> u32 {
        let index = self.places.len() as u32;
        let (id, to_come_m) = (self.next_id, f64::INFINITY);
        self.places.push(Place { at, to_come_m, parent: NONE, id, is_new: true, is_expanded: false });
        self.next_id += 1;
        index
    }

    /// Keeps of a path what is free and makes places of the rest.
    fn adopt(&mut self, space: &mut impl Space, known: &[Point<World>]) {
        let most = self.config.places as usize / 2;
        let mut last = START;
        let mut is_whole = true;
        for &at in known.iter().take(most).skip(1).take(known.len().saturating_sub(2)) {
            // Places of a path that coincide would be each other's neighbours at no distance.
            let is_new = self.places.iter().all(|place| place.at.distance(at) > LEAST_M);
            if !at.is_finite() || !self.fence.contains(at) || !is_new {
                continue;
            }
            let place = self.add(at);
            is_whole = is_whole && self.may_go(space, last, place);
            if is_whole {
                self.connect(last, place);
                last = place;
            }
        }
        if is_whole && last != START && self.may_go(space, last, GOAL) {
            self.connect(last, GOAL);
        }
    }

    /// Asks about a way, unless that is known.
    fn may_go(&mut self, space: &mut impl Space, from: u32, to: u32) -> bool {
        let (a, b) = (&self.places[from as usize], &self.places[to as usize]);
        let key = (a.id.min(b.id), a.id.max(b.id));
        let (places, asked) = ((a.at, b.at), &mut self.asked);
        *self.answers.entry(key).or_insert_with(|| {
            *asked += 1;
            space.is_way_free(places.0, places.1)
        })
    }

    /// Makes one place the other's parent, by a way that is free.
    fn connect(&mut self, from: u32, to: u32) {
        let (parent, child) = (self.places[from as usize], self.places[to as usize]);
        let to_come_m = parent.to_come_m + parent.at.distance(child.at);
        let place = &mut self.places[to as usize];
        (place.to_come_m, place.parent) = (to_come_m, from);
        if child.to_come_m.is_finite() {
            self.move_children(to, child.to_come_m - to_come_m);
        }
        if to != GOAL {
            self.queue(to);
        }
    }

    /// Everything that hangs on a place comes nearer by as much as it did.
    fn move_children(&mut self, place: u32, by_m: f64) {
        self.moved.clear();
        self.moved.push(place);
        while let Some(parent) = self.moved.pop() {
            for (index, child) in self.places.iter_mut().enumerate() {
                if child.parent == parent {
                    child.to_come_m -= by_m;
                    self.moved.push(index as u32);
                }
            }
        }
    }

    /// To be expanded when its turn comes.
    fn queue(&mut self, index: u32) {
        let place = &self.places[index as usize];
        let through_m = place.to_come_m + place.at.distance(self.informed.goal);
        self.vertices.push(Reverse((through_m.to_bits(), index)));
    }

    /// Expands places as long as one of them may give a better way than the best in the queue.
    fn expand_promising(&mut self) {
        while let Some(&Reverse((through, index))) = self.vertices.peek() {
            let better = self.ways.peek().is_none_or(|Reverse((best, ..))| through <= *best);
            if !better || f64::from_bits(through) >= self.length_m() {
                return;
            }
            self.vertices.pop();
            self.expand(index);
        }
    }

    /// Queues the ways from a place to its neighbours that may be part of a shorter path.
    fn expand(&mut self, from: u32) {
        let vertex = self.places[from as usize];
        let shortest_m = self.length_m();
        self.near.clear();
        for (index, place) in self.places.iter().enumerate() {
            let way_m = vertex.at.distance(place.at);
            let is_old = vertex.is_expanded && !place.is_new;
            if index as u32 == from || way_m > self.radius_m || is_old || place.parent == from {
                continue;
            }
            let through_m = vertex.to_come_m + way_m + place.at.distance(self.informed.goal);
            if through_m < shortest_m && vertex.to_come_m + way_m < place.to_come_m {
                self.near.push((through_m, index as u32));
            }
        }
        let most = self.config.neighbours as usize;
        if self.near.len() > most {
            self.near.select_nth_unstable_by(most, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            self.near.truncate(most);
        }
        for &(through_m, to) in &self.near {
            let come_m = vertex.to_come_m + vertex.at.distance(self.places[to as usize].at);
            self.ways.push(Reverse((through_m.to_bits(), come_m.to_bits(), from, to)));
        }
        self.places[from as usize].is_expanded = true;
    }

    /// The best way of the queue: asked about only if it would still improve something.
    fn try_way(&mut self, space: &mut impl Space, from: u32, to: u32) {
        let (a, b) = (self.places[from as usize], self.places[to as usize]);
        let come_m = a.to_come_m + a.at.distance(b.at);
        let is_shorter = come_m < b.to_come_m - LEAST_M && come_m + b.at.distance(self.informed.goal) < self.length_m();
        if is_shorter && self.may_go(space, from, to) {
            self.connect(from, to);
        }
    }

    /// Drops what is of no use, draws more places, and queues the tree anew. Returns false when that would not help.
    fn next_batch(&mut self, space: &mut impl Space) -> bool {
        let shortest_m = self.length_m();
        if self.informed.least_m * (1.0 + STRAIGHT_SHARE) >= shortest_m {
            return false;
        }
        self.prune(shortest_m);
        let room = (self.config.places as usize + 2).saturating_sub(self.places.len());
        if room == 0 {
            return false;
        }
        let has_path = shortest_m.is_finite();
        let most_m = if has_path { shortest_m } else { self.widened_m() };
        for place in &mut self.places {
            // A wider spheroid may have a larger radius: old neighbours are looked at again, and known answers used.
            (place.is_new, place.is_expanded) = (false, place.is_expanded && has_path);
        }
        let added = self.draw(space, most_m, room.min(self.config.batch as usize));
        self.vertices.clear();
        self.ways.clear();
        for index in 0..self.places.len() as u32 {
            if index != GOAL && self.places[index as usize].to_come_m.is_finite() {
                self.queue(index);
            }
        }
        // Where nothing is free, nothing more is drawn, however wide the spheroid.
        added > 0 || (!has_path && self.widenings <= MOST_WIDENINGS)
    }

    /// Length of the paths that the next batch is drawn for, m, while there is none.
    fn widened_m(&mut self) -> f64 {
        let least_m = self.informed.least_m;
        let beyond_m = (FIRST_SHARE * least_m + FIRST_M) * 2.0_f64.powi(self.widenings.min(MOST_WIDENINGS) as i32);
        self.widenings += 1;
        least_m + beyond_m
    }

    /// Draws places through which a path of `most_m` can lead, and sets the radius for all. Returns how many.
    fn draw(&mut self, space: &mut impl Space, most_m: f64, count: usize) -> usize {
        let sides = [0, 1, 2].map(|axis| self.fence.most_m[axis] - self.fence.least_m[axis]);
        let (box_m3, spheroid_m3) = (sides.iter().product::<f64>(), self.informed.volume_m3(most_m));
        let (mut drawn, mut added) = (0, 0);
        while added < count && drawn < TRIES * self.config.batch {
            drawn += 1;
            let at = if spheroid_m3 < box_m3 {
                self.informed.place(self.halton.in_ball(), most_m)
            } else {
                let share = self.halton.in_cube();
                Point::from_array([0, 1, 2].map(|axis| self.fence.least_m[axis] + share[axis] * sides[axis]))
            };
            if self.fence.contains(at) && self.informed.through_m(at) < most_m && space.is_free(at) {
                self.add(at);
                added += 1;
            }
        }
        let free_m3 = spheroid_m3.min(box_m3) * (added.max(1)) as f64 / f64::from(drawn.max(1));
        let count = self.places.len() as f64;
        let ball_m3 = 4.0 / 3.0 * std::f64::consts::PI;
        // Karaman and Frazzoli 2011, for three dimensions.
        let share = (4.0 / 3.0 * free_m3 / ball_m3 * count.ln() / count).cbrt();
        self.radius_m = 2.0 * RADIUS_SHARE * share;
        added
    }

    /// Drops all that no shorter path can lead through, and unties what hung on it.
    fn prune(&mut self, shortest_m: f64) {
        if shortest_m.is_infinite() {
            return;
        }
        self.indices.clear();
        let mut kept = 0;
        for index in 0..self.places.len() {
            // The path itself stays, whatever rounding says.
            let keeps = index <= GOAL as usize || self.informed.through_m(self.places[index].at) <= shortest_m + 1e-9;
            self.indices.push(if keeps { kept } else { NONE });
            if keeps {
                self.places[kept as usize] = self.places[index];
                kept += 1;
            }
        }
        self.places.truncate(kept as usize);
        for place in &mut self.places {
            let parent = self.indices.get(place.parent as usize).copied().unwrap_or(NONE);
            place.parent = parent;
        }
        self.untie();
    }

    /// Places whose way to the start is gone belong to the tree no more.
    fn untie(&mut self) {
        loop {
            let mut changed = false;
            for index in START as usize + 1..self.places.len() {
                let place = self.places[index];
                let parent = self.places.get(place.parent as usize);
                let hangs = parent.is_some_and(|parent| parent.to_come_m.is_finite());
                if place.to_come_m.is_finite() && !hangs {
                    let place = &mut self.places[index];
                    (place.to_come_m, place.parent, place.is_expanded) = (f64::INFINITY, NONE, false);
                    changed = true;
                }
            }
            if !changed {
                return;
            }
        }
    }
}
