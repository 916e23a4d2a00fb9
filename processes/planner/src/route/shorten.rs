//! Pulls a path taut: leaves out what it need not pass, moves its corners inwards, and rounds them. Every leg of what
//! results was asked about, so clearance is what the space grants it.

use super::Space;
use ipc_types::{Point, World};

/// Times that all corners are moved and rounded.
const ROUNDS: usize = 3;
/// Shares of the way to the chord that a corner is tried to be moved by.
const MOVES: [f64; 4] = [1.0, 0.5, 0.25, 0.1];
/// Shares of its legs by which a corner is tried to be cut.
const CUTS: [f64; 3] = [0.5, 0.25, 0.1];
/// A path of more corners is not rounded any further.
const MOST_CORNERS: usize = 64;

/// Shortens a path in place; its ends stay. Asks about at most `segments` segments and returns about how many it did.
/// `spare` is what it works in.
pub fn shorten(
    path: &mut Vec<Point<World>>,
    spare: &mut Vec<Point<World>>,
    space: &mut impl Space,
    segments: u32,
) -> u32 {
    let mut asked = Asked { space, left: segments };
    leave_out(path, &mut asked);
    for _ in 0..ROUNDS {
        pull(path, &mut asked);
        leave_out(path, &mut asked);
        if path.len() < MOST_CORNERS {
            round(path, spare, &mut asked);
        }
    }
    leave_out(path, &mut asked);
    segments - asked.left
}

/// A space that answers so many questions and refuses all further ones.
struct Asked<'a, S> {
    space: &'a mut S,
    left: u32,
}

impl<S: Space> Asked<'_, S> {
    fn is_free(&mut self, from: Point<World>, to: Point<World>) -> bool {
        if self.left == 0 {
            return false;
        }
        self.left -= 1;
        self.space.is_way_free(from, to)
    }
}

/// From every place straight to the farthest one that can be reached so.
fn leave_out(path: &mut Vec<Point<World>>, asked: &mut Asked<'_, impl Space>) {
    let mut from = 0;
    while from + 2 < path.len() {
        let farthest = (from + 2..path.len()).rev().find(|&to| asked.is_free(path[from], path[to]));
        if let Some(farthest) = farthest {
            path.drain(from + 1..farthest);
        }
        from += 1;
    }
}

/// Moves every corner towards the chord between its neighbours.
fn pull(path: &mut [Point<World>], asked: &mut Asked<'_, impl Space>) {
    for corner in 1..path.len().saturating_sub(1) {
        let (before, at, after) = (path[corner - 1], path[corner], path[corner + 1]);
        let chord = after - before;
        let share = ((at - before).dot(chord) / chord.dot(chord).max(1e-12)).clamp(0.0, 1.0);
        let foot = before.lerp(after, share);
        let moved = MOVES.iter().map(|&share| at.lerp(foot, share));
        let mut may = |to: &Point<World>| asked.is_free(before, *to) && asked.is_free(*to, after);
        if let Some(moved) = moved.into_iter().find(&mut may) {
            path[corner] = moved;
        }
    }
}

/// Cuts every corner off, as far as the cut is free.
fn round(path: &mut Vec<Point<World>>, spare: &mut Vec<Point<World>>, asked: &mut Asked<'_, impl Space>) {
    spare.clear();
    spare.extend(path.first());
    for legs in path.windows(3) {
        let (before, corner, after) = (spare[spare.len() - 1], legs[1], legs[2]);
        let cuts = CUTS.iter().map(|&share| [corner.lerp(before, share), corner.lerp(after, share)]);
        match cuts.into_iter().find(|[enter, leave]| asked.is_free(*enter, *leave)) {
            Some(cut) => spare.extend(cut),
            None => spare.push(corner),
        }
    }
    spare.extend(path.last().filter(|_| path.len() > 1));
    std::mem::swap(path, spare);
}
