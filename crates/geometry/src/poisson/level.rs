//! One level: a sparse grid of trilinear elements, the samples in its cells, and its linear system.

use rayon::prelude::*;

use super::Samples;
use super::grid::{self, Key, NONE, bits, place, step};

/// The stiffness of two corners of a cube of side one that differ in 0, 1, 2 or 3 coordinates.
const STIFFNESS: [f64; 4] = [1.0 / 3.0, 0.0, -1.0 / 12.0, -1.0 / 12.0];
/// How much the samples' own places count against their normals, per cell's side.
const SCREENING: f64 = 4.0;
/// Rows a task.
const CHUNK: usize = 2048;
const MOST_STEPS: usize = 80;
/// Where a level's system counts as solved: the residual against that at the start.
const SOLVED: f64 = 1e-4;

/// A grid and what is known at its nodes.
pub(super) struct Level {
    /// Side of a cell.
    pub(super) side: f64,
    pub(super) cells: Vec<Key>,
    pub(super) nodes: Vec<Key>,
    /// The 27 nodes about each node.
    pub(super) around: Vec<[u32; 27]>,
    /// The eight cells about each node: that of bits `c` lies on the other side for each bit that is not set.
    touching: Vec<[u32; 8]>,
    /// The samples by cells, and where each cell's begin.
    order: Vec<u32>,
    starts: Vec<u32>,
    /// Whether all nodes have a say; else only those in the middle of eight cells.
    whole: bool,
}

impl Level {
    pub(super) fn new(side: f64, cells: Vec<Key>, samples: &Samples, whole: bool) -> Self {
        let nodes = grid::corners(&cells);
        let about: [i64; 27] = std::array::from_fn(|n| {
            let n = n as i64;
            step([n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1])
        });
        let around = grid::find(&nodes, &nodes, about);
        let touching = grid::find(&nodes, &cells, std::array::from_fn(|c| step(bits(c).map(|bit| bit - 1))));
        let (order, starts) = by_cell(samples, side, &cells);
        Self { side, cells, nodes, around, touching, order, starts, whole }
    }

    fn is_free(&self, node: usize) -> bool {
        self.whole || !self.touching[node].contains(&NONE)
    }

    /// For each node what `part` makes of each of the cells about it and of which of its corners the node is.
    fn gather<T: Send, F: Fn(&mut T, usize, usize) + Sync>(&self, zero: fn() -> T, part: F) -> Vec<T> {
        let of = |cells: &[u32; 8]| {
            let mut sum = zero();
            for (c, cell) in cells.iter().enumerate().filter(|(_, cell)| **cell != NONE) {
                part(&mut sum, *cell as usize, 7 - c);
            }
            sum
        };
        self.touching.par_iter().with_min_len(CHUNK).map(of).collect()
    }

    fn samples_in(&self, cell: usize) -> &[u32] {
        &self.order[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    /// The samples' normals times their areas, spread over the nodes of this level, of those samples that belong to it.
    pub(super) fn spread(&self, samples: &Samples, level: u8) -> Vec<[f64; 3]> {
        self.gather(
            || [0.0; 3],
            |sum, cell, corner| {
                for &i in self.samples_in(cell).iter().filter(|i| samples.levels[**i as usize] == level) {
                    let share = self.shares(samples, i, cell)[corner] / self.side.powi(3);
                    let normal = samples.normals[i as usize];
                    for a in 0..3 {
                        sum[a] += share * samples.areas[i as usize] * f64::from(normal[a]);
                    }
                }
            },
        )
    }

    /// What each corner of a cell has of a sample in it.
    fn shares(&self, samples: &Samples, sample: u32, cell: usize) -> [f64; 8] {
        let low = grid::coordinates(self.cells[cell]);
        let t: [f64; 3] = std::array::from_fn(|a| {
            (samples.places[sample as usize][a] / self.side - f64::from(low[a])).clamp(0.0, 1.0)
        });
        std::array::from_fn(|c| {
            let bits = bits(c);
            (0..3).map(|a| if bits[a] == 1 { t[a] } else { 1.0 - t[a] }).product()
        })
    }

    /// The divergence of a field as the right side of the system: its product with each node's gradient.
    pub(super) fn divergence(&self, field: &[[f64; 3]]) -> Vec<f64> {
        let ends = self.corners_of_cells();
        self.gather(
            || 0.0,
            |sum, cell, corner| {
                for (c, &node) in ends[cell].iter().enumerate() {
                    let apart = bits(corner ^ c);
                    for (a, along) in field[node as usize].iter().enumerate() {
                        let sign = if bits(corner)[a] == 1 { 0.5 } else { -0.5 };
                        let others =
                            (0..3).filter(|b| *b != a).map(|b| if apart[b] == 0 { 2.0 } else { 1.0 });
                        let mass: f64 = others.map(|m: f64| m * self.side / 6.0).product();
                        *sum += sign * mass * along;
                    }
                }
            },
        )
    }

    /// The nodes at each cell's corners.
    pub(super) fn corners_of_cells(&self) -> Vec<[u32; 8]> {
        grid::find(&self.cells, &self.nodes, std::array::from_fn(|c| step(bits(c))))
    }

    /// The system's rows: how steep the function is, and how far from zero at the samples.
    fn rows(&self, samples: &Samples) -> Vec<[f32; 27]> {
        let screening = SCREENING / self.side;
        let rows = self.gather(
            || [0.0; 27],
            |row: &mut [f64; 27], cell, corner| {
                let mut weights = [0.0; 8];
                for &i in self.samples_in(cell) {
                    let shares = self.shares(samples, i, cell);
                    let own = screening * samples.areas[i as usize] * shares[corner];
                    (0..8).for_each(|c| weights[c] += own * shares[c]);
                }
                for (c, weight) in weights.iter().enumerate() {
                    let (from, to) = (bits(corner), bits(c));
                    let stiff = STIFFNESS[(corner ^ c).count_ones() as usize] * self.side;
                    row[place(std::array::from_fn(|a| to[a] - from[a]))] += weight + stiff;
                }
            },
        );
        rows.into_par_iter().map(|row| row.map(|c| c as f32)).collect()
    }

    /// Adds to the values what makes them fulfil the system best.
    pub(super) fn solve(&self, samples: &Samples, right: &[f64], values: &mut [f64]) {
        let system = System { rows: self.rows(samples), level: self };
        let product = system.times(values);
        let residual: Vec<f64> =
            (0..values.len()).map(|n| if self.is_free(n) { right[n] - product[n] } else { 0.0 }).collect();
        let added = system.conjugate_gradients(residual);
        values.iter_mut().zip(added).for_each(|(value, added)| *value += added);
    }
}

/// The samples in the order of their cells, and where each cell's begin.
fn by_cell(samples: &Samples, side: f64, cells: &[Key]) -> (Vec<u32>, Vec<u32>) {
    let cell_of = |place: &[f64; 3]| grid::key(place.map(|c| (c / side) as u32));
    let mut keyed: Vec<(Key, u32)> =
        samples.places.par_iter().enumerate().map(|(i, p)| (cell_of(p), i as u32)).collect();
    keyed.par_sort_unstable();
    let start = |cell: &Key| keyed.partition_point(|(key, _)| key < cell) as u32;
    let mut starts: Vec<u32> = cells.par_iter().map(start).collect();
    starts.push(keyed.len() as u32);
    (keyed.into_iter().map(|(_, i)| i).collect(), starts)
}

/// A level's linear system, over the nodes that are free.
struct System<'a> {
    rows: Vec<[f32; 27]>,
    level: &'a Level,
}

impl System<'_> {
    /// The product with a vector at the free nodes, zero at the others.
    fn times(&self, x: &[f64]) -> Vec<f64> {
        let row = |node: usize| {
            if !self.level.is_free(node) {
                return 0.0;
            }
            let pairs = self.rows[node].iter().zip(&self.level.around[node]);
            pairs.filter(|(_, n)| **n != NONE).map(|(w, n)| f64::from(*w) * x[*n as usize]).sum()
        };
        (0..x.len()).into_par_iter().with_min_len(CHUNK).map(row).collect()
    }

    /// The solution for a right side, from zero, with the diagonal as preconditioner.
    fn conjugate_gradients(&self, mut residual: Vec<f64>) -> Vec<f64> {
        let diagonal = |(r, row): (&f64, &[f32; 27])| r / f64::from(row[13]);
        let scaled = |residual: &[f64]| residual.iter().zip(&self.rows).map(diagonal).collect::<Vec<f64>>();
        let mut x = vec![0.0; residual.len()];
        let mut direction = scaled(&residual);
        let mut size = dot(&residual, &direction);
        let enough = size * SOLVED * SOLVED;
        for _ in 0..MOST_STEPS {
            if size <= enough {
                break;
            }
            let product = self.times(&direction);
            let length = size / dot(&direction, &product);
            add(&mut x, length, &direction);
            add(&mut residual, -length, &product);
            let next = scaled(&residual);
            let new_size = dot(&residual, &next);
            let turn = new_size / size;
            direction.iter_mut().zip(&next).for_each(|(d, n)| *d = n + turn * *d);
            size = new_size;
        }
        x
    }
}

/// In parts that do not depend on the number of threads.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let part = |(a, b): (&[f64], &[f64])| a.iter().zip(b).map(|(a, b)| a * b).sum();
    let parts: Vec<f64> = a.par_chunks(CHUNK).zip(b.par_chunks(CHUNK)).map(part).collect();
    parts.iter().sum()
}

fn add(to: &mut [f64], times: f64, what: &[f64]) {
    to.iter_mut().zip(what).for_each(|(to, what)| *to += times * what);
}
