//! The same sampling, block by block and on all threads.
//!
//! What a choice changes lies within its own distance to the points before it, its radius. So far
//! from each other, choices do not depend on their order: the plain algorithm's result is the points
//! in descending order of the radius at which each is chosen, and a point may be chosen as soon as it
//! lies within no larger radius of a point that is left. Each block (a cell of a k-d tree, small enough for
//! a core's cache) goes on by itself until its next point has such a rival in a block beside it. Blocks
//! beside each other take turns, by a colouring; the others run at once.
//!
//! Exact, ties included, and the same on any number of threads.

use rayon::prelude::*;

use super::tree::{Child, Tree};
use super::{First, Item, Key, Weights};
use crate::kdtree::squared;
use crate::limit::indices;
use densecloud_cloud::Point;

/// Choices a block until which they are made one after the other: before, every block is beside every other.
const ALONE: usize = 8;
/// A turn ends where the squared radius has fallen to this share of the largest left: little is chosen
/// beyond the number wanted, and no block waits for long.
const TURN: f32 = 0.9;
/// Which blocks lie beside each other is found anew when the largest squared radius has fallen to this share.
const ANEW: f32 = 0.5;

/// As [`super::sample`], by blocks of at most `size` points.
pub(super) fn sample(
    points: &[Point],
    weights: Weights<'_>,
    count: usize,
    first: First<'_>,
    size: usize,
) -> Vec<u32> {
    // Indices alone: with their points they would take as much as the trees.
    let mut order: Vec<u32> = indices(points.len()).collect();
    let mut cells = Vec::new();
    split(points, &mut order, size, &mut cells);
    let tree = |cell: &mut [u32]| {
        let mut items: Vec<Item> = cell.iter().map(|&i| (points[i as usize], i)).collect();
        Tree::over(&mut items, weights, first.beside())
    };
    let trees: Vec<Tree> = cells.into_par_iter().map(tree).collect();
    drop(order);
    let mut blocks =
        Blocks { beside: vec![Vec::new(); trees.len()], trees: trees.into_iter().map(Some).collect() };

    let mut chosen = Vec::new();
    if let First::Point(first) = first {
        chosen.push(first);
        blocks.take_note(&[(points[first as usize], first)]);
    }
    while chosen.len() < count.min(ALONE * blocks.trees.len()) {
        let next = blocks.top().index();
        chosen.push(next);
        blocks.take_note(&[(points[next as usize], next)]);
    }
    // From here on out of order.
    let mut later: Vec<Key> = Vec::with_capacity(count + count / 8);
    let (mut colours, mut adjacent_for) = (Vec::new(), f32::INFINITY);
    loop {
        let missing = count - chosen.len();
        let top = blocks.top();
        // Whatever is left comes after the last one wanted.
        if missing == 0
            || later.len() >= missing && top < *later.select_nth_unstable_by(missing - 1, descending).1
        {
            break;
        }
        if top.distance() <= ANEW * adjacent_for {
            adjacent_for = top.distance();
            colours = blocks.meet(adjacent_for);
        }
        for colour in &colours {
            later.extend(blocks.turn(colour, top.distance()));
        }
    }
    let missing = count - chosen.len();
    later.par_sort_unstable_by(descending);
    chosen.extend(later[..missing].iter().map(|key| key.index()));
    chosen
}

fn descending(a: &Key, b: &Key) -> std::cmp::Ordering {
    b.cmp(a)
}

/// Halves the points until no more than `size` are left.
fn split<'a>(points: &[Point], order: &'a mut [u32], size: usize, cells: &mut Vec<&'a mut [u32]>) {
    if order.len() <= size {
        cells.push(order);
        return;
    }
    let middle = order.len() / 2;
    let (left, right) = super::halves(order, middle, |&i| (points[i as usize], i));
    let (mut before, mut after) = (Vec::new(), Vec::new());
    rayon::join(|| split(points, left, size, &mut before), || split(points, right, size, &mut after));
    cells.append(&mut before);
    cells.append(&mut after);
}

struct Blocks {
    /// None while its turn is on.
    trees: Vec<Option<Tree>>,
    /// For each block those that a choice in it may change, and whose choices may change it.
    beside: Vec<Vec<usize>>,
}

impl Blocks {
    /// The point farthest from all chosen ones.
    fn top(&self) -> Key {
        self.trees.iter().flatten().map(|tree| tree.all.key).max().unwrap_or(Key::NONE)
    }

    /// Tells every block of these choices.
    fn take_note(&mut self, chosen: &[Item]) {
        for tree in self.trees.iter_mut().flatten() {
            tree.take_note(chosen);
        }
    }

    /// Finds which blocks are nearer to each other than the root of `radius_squared`, and gives each a
    /// colour that none beside it has: the blocks of each colour.
    fn meet(&mut self, radius_squared: f32) -> Vec<Vec<usize>> {
        let boxes: Vec<Child> = self.trees.iter().flatten().map(|tree| tree.all).collect();
        let near = |here: &Child, other: &Child| {
            let gap = |a: usize| (here.lo[a] - other.hi[a]).max(other.lo[a] - here.hi[a]).max(0.0);
            squared(std::array::from_fn(gap)) * here.lightest.min(other.lightest) <= radius_squared
        };
        let beside = |i: usize| (0..boxes.len()).filter(|&j| j != i && near(&boxes[i], &boxes[j])).collect();
        self.beside = (0..boxes.len()).into_par_iter().map(beside).collect();
        let mut colours: Vec<Vec<usize>> = Vec::new();
        let mut colour_of = vec![usize::MAX; boxes.len()];
        for block in 0..boxes.len() {
            let free = |colour: &usize| self.beside[block].iter().all(|&b| colour_of[b] != *colour);
            let colour = (0..colours.len()).find(free).unwrap_or(colours.len());
            if colour == colours.len() {
                colours.push(Vec::new());
            }
            colours[colour].push(block);
            colour_of[block] = colour;
        }
        colours
    }

    /// The turn of `blocks`, none beside another: each chooses until its squared radius has fallen from
    /// the largest one, `top`, or it has a rival. Returns the choices.
    fn turn(&mut self, blocks: &[usize], top: f32) -> Vec<Key> {
        let mut active: Vec<(usize, Tree)> =
            blocks.iter().filter_map(|&b| Some((b, self.trees[b].take()?))).collect();
        let choices: Vec<Vec<(Point, Key)>> = active
            .par_iter_mut()
            .map(|(block, tree)| {
                let rivals = || self.beside[*block].iter().filter_map(|&b| self.trees[b].as_ref());
                let mut choices = Vec::new();
                loop {
                    let key = tree.all.key;
                    let radius = key.distance();
                    // Negative: all are chosen. (The largest one goes on even where the product is rounded up to it.)
                    if radius < 0.0 || radius <= TURN * top && radius < top {
                        return choices;
                    }
                    let (at, weight) = tree.farthest();
                    if rivals().any(|rival| rival.has_rival_of(at, weight, key)) {
                        return choices;
                    }
                    choices.push((at, key));
                    tree.choose(at, key.index());
                }
            })
            .collect();
        let mut fresh: Vec<Vec<Item>> = vec![Vec::new(); self.trees.len()];
        for ((block, tree), choices) in active.into_iter().zip(&choices) {
            self.trees[block] = Some(tree);
            fresh[block].extend(choices.iter().map(|(at, key)| (*at, key.index())));
        }
        self.trees.par_iter_mut().zip(&self.beside).for_each(|(tree, beside)| {
            if let Some(tree) = tree {
                beside.iter().for_each(|&b| tree.take_note(&fresh[b]));
            }
        });
        choices.into_iter().flatten().map(|(_, key)| key).collect()
    }
}
