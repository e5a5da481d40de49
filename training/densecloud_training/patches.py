"""Training patches: drawn, thinned, cropped and augmented in batches on the device that trains.

Nothing here waits for the device: choices that decide shapes (window, kinds) come from Python's generator, all others
from the device's own.
"""

import random
from typing import NamedTuple, Optional, Protocol, Tuple

import torch

from .clouds import Clouds, level_size
from .config import Data
from .faults import noised, outliers, quantised, without_holes
from .sampling import FAR, KINDS, directions, random_rotations
from .thin import ThinPlaces

# How far from its seed a patch may be cut, in patch radii.
MOST_CUT_AT = 0.7


class Batch(NamedTuple):
    """Patches in the frame of their seed: radius about 1, seed at the origin.

    points [B,N,3]; reference [B,R,3] clean, the nearest ones of the seed; input_radius, reference_radius [B,1]: how far
    the crops reach. strays [B,N]: input points that lie on no surface, so that nothing is asked of what they become.
    """

    points: torch.Tensor
    reference: torch.Tensor
    input_radius: torch.Tensor
    reference_radius: torch.Tensor
    strays: Optional[torch.Tensor] = None


class Source(Protocol):
    """What batches come from."""

    def draw(self, levels: int, batch: int) -> Batch:
        """Pairs for 2^levels times as many points."""


def nearest_of_seed(distances: torch.Tensor, cloud: torch.Tensor, count: int):
    """The `count` points of each item nearest to its seed, with all of their columns, and the radius [B,1] they reach.
    distances [B,D] squared."""
    values, indices = distances.topk(min(count, distances.shape[1]), dim=1, largest=False, sorted=False)
    points = cloud.gather(1, indices.unsqueeze(-1).expand(-1, -1, cloud.shape[-1]))
    return points, values.max(1, keepdim=True)[0].sqrt()


def distances_of(cloud: torch.Tensor, seeds: torch.Tensor, kept: torch.Tensor) -> torch.Tensor:
    """[B,D]: squared distances of points [B,D,3] to the seeds [B,1,3]; FAR where a point is not kept."""
    return (cloud - seeds).square().sum(-1).masked_fill(~kept, FAR)


class PatchSource:
    """Draws batches from the clouds of a set of shapes."""

    def __init__(self, clouds: Clouds, data: Data, patch: int, host: random.Random):
        self.clouds, self.data, self.patch, self.host = clouds, data, patch, host
        self.thin = ThinPlaces(clouds, len(data.windows)) if data.thin_share else None

    def draw(self, levels: int, batch: int) -> Batch:
        """Pairs for 2^levels times as many points."""
        highest = len(self.clouds.levels) - 1 - levels
        windows = self.data.windows[: highest + 1]
        window = self.host.choices(range(len(windows)), windows)[0]
        kinds = self.host.choices(list(self.data.kinds), list(self.data.kinds.values()), k=batch)
        groups = [self.group(kind, kinds.count(kind), window, levels) for kind in self.data.kinds if kind in kinds]
        return self.augment(Batch(*(torch.cat(parts) for parts in zip(*(group[:4] for group in groups)))))

    def group(self, kind: str, count: int, window: int, levels: int) -> Batch:
        """`count` patches whose input is sampled in one way, in their seed's frame, without augmentation."""
        source_level = window if kind == "poisson" else self.dense_level(window, levels)
        reference_level = self.reference_level(window, levels)
        shapes, seeds = self.places(count, window, source_level)
        source, dense = (self.clouds.levels[level][shapes] for level in (source_level, reference_level))
        radius = self.clouds.spread[shapes].view(-1, 1, 1) * (self.patch / level_size(window)) ** 0.5
        wanted = int(self.patch * 2 ** (reference_level - window) * self.data.reference_margin)
        offsets = (source - seeds) / radius
        kept = self.seen(kind, offsets, 2 ** (source_level - window))
        there = self.cut(kept, offsets, (dense - seeds) / radius, wanted)
        centres = self.centres(source, offsets, kept, radius)
        points, reached = nearest_of_seed(distances_of(source, centres, kept), source, self.patch)
        reference, reach = nearest_of_seed(distances_of(dense, centres, there), dense, wanted)
        scale = reached.unsqueeze(-1)
        ones = torch.ones_like(reached)
        return Batch((points - centres) / scale, (reference - centres) / scale, ones, reach / reached)

    def places(self, count: int, window: int, level: int) -> Tuple[torch.Tensor, torch.Tensor]:
        """The shapes [count] that patches are drawn from, and where on them [count,1,3]."""
        clouds = self.clouds.levels[level]
        shapes = torch.multinomial(self.clouds.weights, count, replacement=True)
        picks = torch.randint(clouds.shape[1], (count,), device=shapes.device)
        seeds = clouds[shapes, picks]
        rows = self.some(self.data.thin_share, count)
        if len(rows):
            shapes[rows], seeds[rows] = self.thin.draw(window, len(rows))
        return shapes, seeds.unsqueeze(1)

    def seen(self, kind: str, offsets: torch.Tensor, every: int) -> torch.Tensor:
        """A mask [B,D] of the points that are the input, about one in `every`. offsets [B,D,3] in patch radii."""
        count, points = offsets.shape[:2]
        # Where a sensor would have seen too few points for a patch: as many, from everywhere.
        spare = (torch.arange(points, device=offsets.device) % every == 0).expand(count, -1)
        kept = spare.clone() if kind == "poisson" else KINDS[kind](offsets, 1 / every)
        without_holes(kept, offsets, self.some(self.data.holes_share, count), self.data.holes_most)
        return torch.where((kept.sum(1) >= self.patch).unsqueeze(1), kept, spare)

    def cut(self, kept: torch.Tensor, offsets: torch.Tensor, dense: torch.Tensor, wanted: int) -> torch.Tensor:
        """Ends the surface of some patches, input and reference, at a plane beside the seed: an open border. Takes it
        out of `kept` [B,D]; returns a mask [B,R] of what is left of the reference."""
        left = torch.ones(dense.shape[:2], dtype=torch.bool, device=kept.device)
        rows = self.some(self.data.cut_share, len(kept))
        if len(rows):
            normal = directions(len(rows), kept.device)
            limit = MOST_CUT_AT * torch.rand(len(rows), 1, device=kept.device)
            here = kept[rows] & ((offsets[rows] @ normal).squeeze(-1) <= limit)
            there = (dense[rows] @ normal).squeeze(-1) <= limit
            # Too little may be left of a small shape; then it stays whole.
            whole = ((here.sum(1) < self.patch) | (there.sum(1) < wanted)).unsqueeze(1)
            kept[rows], left[rows] = torch.where(whole, kept[rows], here), there | whole
        return left

    def centres(
        self, source: torch.Tensor, offsets: torch.Tensor, kept: torch.Tensor, radius: torch.Tensor
    ) -> torch.Tensor:
        """[B,1,3]: the input point nearest to each seed, as at inference, or beside it, as `seed_jitter` says."""
        nearest = offsets.square().sum(-1).masked_fill(~kept, FAR).argmin(1)
        centres = source.gather(1, nearest.view(-1, 1, 1).expand(-1, -1, 3))
        if self.data.seed_jitter:
            centres = centres + self.data.seed_jitter * radius * torch.randn_like(centres)
        return centres

    def some(self, share: float, count: int) -> torch.Tensor:
        """Indices of a random choice among `count` patches, each with the probability `share`."""
        chosen = sum(self.host.random() < share for _ in range(count)) if share else 0
        return torch.randperm(count, device=self.clouds.device)[:chosen] if chosen else torch.arange(0)

    def dense_level(self, window: int, levels: int) -> int:
        """The ladder level that uneven inputs are thinned from: much denser, and not the reference itself."""
        level = min(window + 4, len(self.clouds.levels) - 1)
        return level - 1 if level == self.reference_level(window, levels) else level

    def reference_level(self, window: int, levels: int) -> int:
        """The ladder level of the reference: 2^levels times the input's points, and denser where the ladder allows."""
        return min(window + levels + self.data.reference_extra, len(self.clouds.levels) - 1)

    def augment(self, batch: Batch) -> Batch:
        """Rotation, scale, and what a sensor does to the input alone."""
        count, device, data = len(batch.points), batch.points.device, self.data
        turn = random_rotations(count, device)
        low, high = data.scale
        scale = low + (high - low) * torch.rand(count, 1, 1, device=device)
        points, reference = (batch.points @ turn) * scale, (batch.reference @ turn) * scale
        points = noised(points, scale, data.noise_share, data.noise_most, data.noise_power)
        if data.quantised_share:
            points = quantised(points, scale, data.quantised_share, data.quantised_most)
        strays = None
        if data.outlier_share:
            points, strays = outliers(points, scale, data.outlier_share, data.outlier_most)
        flat = scale.squeeze(-1)
        return Batch(points, reference, batch.input_radius * flat, batch.reference_radius * flat, strays)
