"""Training patches of one's own scans: a scan is thinned by its own pattern, and what was taken away is the target."""

import random
from typing import List, Optional, Tuple

import numpy as np
import torch
from scipy.spatial import cKDTree

from .own_scan import OwnScan
from .patches import Batch, Source
from .sampling import random_rotations

# A patch of a scan thinned to 1/2^4 is as far as the cascade's highest ratio reaches.
DEEPEST = 4
# How many points around a seed are thinned, in times of what an even thinning would need for a patch.
SPARE = 1.5
# Of how many times its points around a seed a scan must consist.
ROOM = 2


def around(patch: int, depth: int) -> int:
    """Points of the scan that a patch of it, thinned to 1/2^depth, is made from."""
    return int(patch * 2**depth * SPARE)


def deepest(points: int, patch: int) -> int:
    """How often a scan can be halved, so that patches of the rest are still small beside it; 0: never."""
    return max((depth for depth in range(1, DEEPEST + 1) if points >= ROOM * around(patch, depth)), default=0)


class ScanPatches:
    """Draws batches from scans: by a random thinning, or, where lines are known, every second line and place."""

    def __init__(self, scans: List[OwnScan], patch: int, margin: float, seed: int = 0, lines: float = 0.5):
        self.scans, self.patch, self.margin, self.lines = scans, patch, margin, lines
        self.trees = [cKDTree(scan.points) for scan in scans]
        self.depths = [deepest(len(scan.points), patch) for scan in scans]
        self.random = np.random.default_rng(seed)

    @property
    def levels(self) -> int:
        """The largest number of levels that can be drawn."""
        return max(self.depths)

    def draw(self, levels: int, batch: int) -> Batch:
        """Pairs of one scan and one depth: the input is thinned at least as far as the levels fill up again."""
        weights = np.array([len(s.points) * (d >= levels) for s, d in zip(self.scans, self.depths)], dtype=float)
        number = int(self.random.choice(len(self.scans), p=weights / weights.sum()))
        depth = int(self.random.integers(levels, self.depths[number] + 1))
        pairs = [self.pair(number, depth) for _ in range(batch)]
        points, reference, reach = (torch.from_numpy(np.stack(parts)).float() for parts in zip(*pairs))
        turn = random_rotations(batch, points.device)
        return Batch(points @ turn, reference @ turn, torch.ones(batch, 1), reach.view(-1, 1))

    def pair(self, number: int, depth: int) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Input [N,3] and target [R,3] in the frame of a point of the input, and how far the target reaches."""
        scan, wanted = self.scans[number], int(self.patch * (2**depth - 1) * self.margin)
        seed = int(self.random.integers(len(scan.points)))
        distances, near = self.trees[number].query(scan.points[seed], around(self.patch, depth))
        kept = self.kept_lines(scan.lines, near, seed, depth)
        if kept is None or kept.sum() < self.patch or (~kept).sum() < wanted:
            kept = self.kept_at_random(near, seed, depth)
        given, taken = np.flatnonzero(kept)[: self.patch], np.flatnonzero(~kept)[:wanted]
        offsets, radius = scan.points[near] - scan.points[seed], distances[given[-1]]
        return offsets[given] / radius, offsets[taken] / radius, np.asarray(distances[taken[-1]] / radius)

    def kept_lines(self, lines: Optional[np.ndarray], near: np.ndarray, seed: int, depth: int) -> Optional[np.ndarray]:
        """A mask of every 2nd or 4th line, and place in it, with the seed's own; None where lines are not asked for."""
        if lines is None or self.random.random() >= self.lines:
            return None
        steps = np.array([2 ** ((depth + 1) // 2), 2 ** (depth // 2)])
        return (lines[near] % steps == lines[seed] % steps).all(1)

    def kept_at_random(self, near: np.ndarray, seed: int, depth: int) -> np.ndarray:
        """A mask of one in 2^depth, the seed among them."""
        kept = np.zeros(len(near), dtype=bool)
        kept[self.random.permutation(len(near))[: len(near) >> depth]] = True
        kept[near == seed] = True
        return kept


class Mixed:
    """Batches of either source, `share` of them of the second."""

    def __init__(self, first: Source, second: Source, share: float, host: random.Random):
        self.first, self.second, self.share, self.host = first, second, share, host

    def draw(self, levels: int, batch: int) -> Batch:
        """Pairs for 2^levels times as many points, all of one source."""
        return (self.second if self.host.random() < self.share else self.first).draw(levels, batch)
