//! The patches of one level: which points each holds, and which patch owns each point.

use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use super::sites::Sites;
use super::{CascadeError, CascadeOptions, Observer, Stage, share};
use densecloud_cloud::Point;
use densecloud_geometry::{KdTree, Neighbour, Rng};

/// A point that lies in no patch may join one whose seed is no further from it than this many times the furthest of its points.
const WIDER: f32 = 1.25;
/// Patches that are looked at for such a point.
const HOSTS: usize = 6;
/// One in so many places of a patch, the outermost, may be given to others.
const OUTER: usize = 4;

/// Overlapping patches that cover a level's input.
///
/// Each point is owned by one patch, the one in which it lies most central. Rows of a feature table are numbered so
/// that those of one owner follow each other: each patch writes one run of the table, and no two share a row.
#[derive(Debug)]
pub struct Patches {
    /// Points in every patch.
    size: usize,
    /// `[H, size]` point indices, nearest to the seed first.
    members: Vec<u32>,
    /// Places before this one are kept in every patch: see [`Patches::kept`].
    inner: usize,
    /// For each patch, the range of rows that its own points have in the feature table.
    row_starts: Vec<usize>,
    /// For each point its row in the feature table.
    rows: Vec<u32>,
    /// The level's points.
    pub(crate) sites: Arc<Sites>,
    /// For each point, the patch that owns it.
    owners: Vec<u32>,
}

impl Patches {
    /// About `overlap * n / patch_size` patches of the `patch_size` nearest points to seeds chosen
    /// by farthest point sampling, in the `local` spacing where that is given, plus what it takes to cover every point. A point
    /// that is little further from a seed than the patch reaches comes in its last place. A cloud no larger than a patch is
    /// one patch.
    pub(super) fn cover(
        sites: &Arc<Sites>,
        local: Option<&[f32]>,
        patch_size: usize,
        settings: &CascadeOptions,
        random: &mut Rng,
        level: usize,
        observer: &dyn Observer,
    ) -> Result<Self, CascadeError> {
        let Sites { points, tree, .. } = &**sites;
        let size = patch_size.min(points.len());
        observer.begin(level, Stage::Seeds);
        let seeds = if size == points.len() {
            // More would be the same patch over again.
            vec![0]
        } else {
            let count = (settings.overlap * points.len() as f64 / patch_size as f64).ceil() as usize;
            let first = random.below(points.len() as u64) as usize;
            share::sample(points, local, count.clamp(1, points.len()), first)
        };
        if observer.cancelled() {
            return Err(CascadeError::Cancelled);
        }
        observer.begin(level, Stage::Patches);
        let mut members = vec![0; seeds.len() * size];
        members.par_chunks_exact_mut(size).zip(&seeds).for_each_init(Vec::new, |found, (patch, &seed)| {
            nearest(tree, points[seed as usize], patch, found);
        });
        admit(points, &seeds, size, &mut members);
        add_uncovered(points, tree, size, &mut members);
        let inner = (settings.inner * size as f64).ceil() as usize;
        Ok(Self::own(Arc::clone(sites), size, inner, members))
    }

    /// How many there are, at least one.
    #[must_use]
    pub fn count(&self) -> usize {
        self.row_starts.len() - 1
    }

    /// Points in every patch.
    #[must_use]
    pub fn size(&self) -> usize {
        self.size
    }

    /// The row of point `i` in the feature table.
    #[must_use]
    pub fn row(&self, i: usize) -> usize {
        self.rows[i] as usize
    }

    /// The rows of the points that patch `p` owns.
    #[must_use]
    pub fn rows_of(&self, p: usize) -> Range<usize> {
        self.row_starts[p]..self.row_starts[p + 1]
    }

    /// The points of patch `p`, nearest to its seed first; last a few, if any, that would lie in no patch.
    #[must_use]
    pub fn members(&self, p: usize) -> &[u32] {
        &self.members[p * self.size..][..self.size]
    }

    /// Places in patch `p` of the points that it owns, in the order of their rows.
    pub fn owned(&self, p: usize) -> impl Iterator<Item = usize> {
        let members = self.members(p).iter().enumerate();
        members.filter(move |(_, i)| self.owners[**i as usize] == p as u32).map(|(place, _)| place)
    }

    /// Places in patch `p` whose outputs are merged: the inner share nearest to the seed, where the
    /// unit sees neighbours on all sides, and those that the patch owns, so that every point is
    /// kept somewhere.
    pub fn kept(&self, p: usize) -> impl Iterator<Item = usize> {
        let members = self.members(p).iter().enumerate();
        members
            .filter(move |(place, i)| *place < self.inner || self.owners[**i as usize] == p as u32)
            .map(|(place, _)| place)
    }

    /// What the next level needs: each point's row. The rest is freed.
    pub(crate) fn into_rows(self) -> Vec<u32> {
        self.rows
    }

    /// A point belongs to the patch in which it lies most central: the one whose seed has it as the
    /// earliest neighbour, the first such patch where several do.
    fn own(sites: Arc<Sites>, size: usize, inner: usize, members: Vec<u32>) -> Self {
        let points = sites.points.len();
        let mut owners = vec![0; points];
        let mut places = vec![u32::MAX; points];
        for (patch, members) in members.chunks_exact(size).enumerate() {
            for (place, &i) in members.iter().enumerate() {
                if (place as u32) < places[i as usize] {
                    places[i as usize] = place as u32;
                    owners[i as usize] = patch as u32;
                }
            }
        }
        let mut rows = vec![0; points];
        let mut row_starts = vec![0];
        let mut next = 0;
        for (patch, members) in members.chunks_exact(size).enumerate() {
            for &i in members {
                if owners[i as usize] == patch as u32 {
                    rows[i as usize] = next;
                    next += 1;
                }
            }
            row_starts.push(next as usize);
        }
        Self { size, members, inner, row_starts, rows, sites, owners }
    }
}

fn nearest(tree: &KdTree, centre: Point, patch: &mut [u32], found: &mut Vec<Neighbour>) {
    tree.nearest(centre, patch.len(), found);
    for (member, neighbour) in patch.iter_mut().zip(&*found) {
        *member = neighbour.index;
    }
}

/// Lets points that lie in no patch take the places of others that lie in several: an uneven cloud has some that are among the
/// nearest of no seed, though little further from one than the points of its patch. A patch of its own for each few of them
/// would be a tenth more work and more.
fn admit(points: &[Point], seeds: &[u32], size: usize, members: &mut [u32]) {
    let mut times = vec![0_u32; points.len()];
    members.iter().for_each(|&i| times[i as usize] += 1);
    let centres: Vec<Point> = seeds.iter().map(|&i| points[i as usize]).collect();
    let (tree, mut found) = (KdTree::new(&centres), Vec::new());
    for i in (0..points.len()).filter(|&i| times[i] == 0).collect::<Vec<_>>() {
        tree.nearest(points[i], HOSTS, &mut found);
        for host in &found {
            let patch = &mut members[host.index as usize * size..][..size];
            let reach = distance_squared(points[patch[size - 1] as usize], centres[host.index as usize]);
            let outer = size - size / OUTER;
            let Some(place) = (outer..size).rev().find(|&k| times[patch[k] as usize] > 1) else { continue };
            if host.distance_squared <= WIDER * WIDER * reach {
                times[patch[place] as usize] -= 1;
                patch[place..].rotate_left(1);
                patch[size - 1] = i as u32;
                times[i] = 1;
                break;
            }
        }
    }
}

fn distance_squared(p: Point, q: Point) -> f32 {
    (0..3).map(|a| (p[a] - q[a]).powi(2)).sum()
}

/// Adds a patch around the first point that lies in none, until every point lies in one.
fn add_uncovered(points: &[Point], tree: &KdTree, size: usize, members: &mut Vec<u32>) {
    let mut covered = vec![false; points.len()];
    for &i in &*members {
        covered[i as usize] = true;
    }
    let mut found = Vec::new();
    for i in 0..points.len() {
        if covered[i] {
            continue;
        }
        let start = members.len();
        members.resize(start + size, 0);
        nearest(tree, points[i], &mut members[start..], &mut found);
        // Among more than `size` points in one place the seed itself may be crowded out.
        if !members[start..].contains(&(i as u32)) {
            members[start + size - 1] = i as u32;
        }
        for &j in &members[start..] {
            covered[j as usize] = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Silent;

    fn cloud(n: u64) -> Vec<Point> {
        let mut random = Rng::new(n);
        (0..n).map(|_| std::array::from_fn(|_| random.f64() as f32)).collect()
    }

    fn cover(points: &[Point], overlap: f64) -> Patches {
        of(points, &CascadeOptions { overlap, ..CascadeOptions::default() })
    }

    fn of(points: &[Point], settings: &CascadeOptions) -> Patches {
        let sites = Arc::new(Sites::new(points.to_vec()));
        Patches::cover(&sites, None, 32, settings, &mut Rng::new(1), 0, &Silent).unwrap()
    }

    #[test]
    fn every_point_lies_in_a_patch_and_is_owned_once() {
        for (n, overlap) in [(20, 3.0), (32, 3.0), (33, 3.0), (500, 1.0), (500, 3.0), (2000, 1.0)] {
            let points = cloud(n);
            let patches = cover(&points, overlap);
            let mut rows: Vec<u32> = patches.rows.clone();
            rows.sort_unstable();
            assert!(rows.iter().copied().eq(0..n as u32), "rows are a permutation, n = {n}");
            for p in 0..patches.count() {
                let found = patches.owned(p).map(|place| patches.row(patches.members(p)[place] as usize));
                assert!(found.eq(patches.rows_of(p)));
            }
        }
    }

    #[test]
    fn far_groups_are_covered_although_no_seed_falls_on_them() {
        // With one patch a seed for 400 points only the dense group would be seen.
        let mut points = cloud(400);
        points.extend(cloud(5).iter().map(|p| p.map(|c| c + 50.0)));
        let patches = cover(&points, 1.0);
        for i in 0..points.len() as u32 {
            assert!(patches.members.contains(&i), "point {i} lies in no patch");
        }
    }

    #[test]
    fn an_uneven_cloud_takes_few_patches_that_have_no_seed() {
        let mut random = Rng::new(3);
        // Ever denser to one side, by 10,000 from end to end, and as dense everywhere.
        for power in [3, 0] {
            let mut at = || {
                let (x, y) = (random.f64(), random.f64());
                [x.powi(1 + power) as f32, (y * x.powi(power)) as f32, 0.0]
            };
            let points: Vec<Point> = (0..4000).map(|_| at()).collect();
            let sites = Arc::new(Sites::new(points));
            let local = share::Neighbourhoods::of(&sites, &mut None, None).unwrap().spacing;
            let settings = CascadeOptions::default();
            let patches =
                Patches::cover(&sites, Some(&local), 32, &settings, &mut Rng::new(0), 0, &Silent).unwrap();
            assert!(patches.count() <= 252, "{} patches, 250 seeds", patches.count());
        }
    }

    #[test]
    fn a_cloud_no_larger_than_a_patch_is_one_patch() {
        for n in [9, 31, 32] {
            let patches = cover(&cloud(n), 3.0);
            assert_eq!((patches.count(), patches.size), (1, n as usize));
        }
    }

    #[test]
    fn what_is_kept_holds_every_point() {
        let points = cloud(500);
        for (inner, at_least) in [(0.0, 0), (0.5, 16), (1.0, 32)] {
            let settings = CascadeOptions { inner, ..CascadeOptions::default() };
            let patches = of(&points, &settings);
            let mut seen = vec![false; points.len()];
            for p in 0..patches.count() {
                let kept: Vec<usize> = patches.kept(p).collect();
                assert!(kept.iter().copied().take(at_least).eq(0..at_least), "the inner places are kept");
                assert!(patches.owned(p).all(|place| kept.contains(&place)));
                assert!(inner > 0.0 || patches.owned(p).eq(kept.iter().copied()), "nothing else is kept");
                kept.iter().for_each(|&place| seen[patches.members(p)[place] as usize] = true);
            }
            assert!(seen.iter().all(|s| *s), "a point goes without, inner = {inner}");
        }
    }

    #[test]
    fn owners_are_the_most_central_patches() {
        let points = cloud(300);
        let patches = cover(&points, 3.0);
        for i in 0..300_u32 {
            let place = |p: usize| patches.members(p).iter().position(|&m| m == i);
            let best = (0..patches.count()).filter_map(|p| Some((place(p)?, p))).min().unwrap();
            assert_eq!(patches.owners[i as usize] as usize, best.1);
        }
    }
}
