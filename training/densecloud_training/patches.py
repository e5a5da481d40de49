"""Training patches: drawn, thinned, cropped and augmented in batches on the device that trains.

Nothing here waits for the device: choices that decide shapes (window, kinds) come from Python's generator, all others
from the device's own.
"""

import random
from typing import List, NamedTuple, Protocol

import torch

from .clouds import Clouds, level_size
from .config import Data

# A depth image around the seed: this many pixels a side, and a patch radius. A patch of even points has about 10 points
# a radius; slopes take some away, so pixels are finer.
SCAN_GRID = 104
SCAN_PIXELS_PER_RADIUS = 13
FAR = 1e9


class Batch(NamedTuple):
    """Patches in the frame of their seed: radius about 1, seed at the origin.

    points [B,N,3]; reference [B,R,3] clean, the nearest ones of the seed; input_radius, reference_radius [B,1]: how far
    the crops reach.
    """

    points: torch.Tensor
    reference: torch.Tensor
    input_radius: torch.Tensor
    reference_radius: torch.Tensor


class Source(Protocol):
    """What batches come from."""

    def draw(self, levels: int, batch: int) -> Batch:
        """Pairs for 2^levels times as many points."""


def nearest_of_seed(distances: torch.Tensor, cloud: torch.Tensor, count: int):
    """The `count` points of each item nearest to its seed, and the radius [B,1] they reach. distances [B,D] squared."""
    values, indices = distances.topk(min(count, distances.shape[1]), dim=1, largest=False, sorted=False)
    points = cloud.gather(1, indices.unsqueeze(-1).expand(-1, -1, 3))
    return points, values.max(1, keepdim=True)[0].sqrt()


class PatchSource:
    """Draws batches from the clouds of a set of shapes."""

    def __init__(self, clouds: Clouds, data: Data, patch: int, host: random.Random):
        self.clouds, self.data, self.patch, self.host = clouds, data, patch, host

    def draw(self, levels: int, batch: int) -> Batch:
        """Pairs for 2^levels times as many points."""
        highest = len(self.clouds.levels) - 1 - levels
        windows = self.data.windows[: highest + 1]
        window = self.host.choices(range(len(windows)), windows)[0]
        kinds = self.host.choices(list(self.data.kinds), list(self.data.kinds.values()), k=batch)
        groups = [self.group(kind, kinds.count(kind), window, levels) for kind in self.data.kinds if kind in kinds]
        return self.augment(Batch(*(torch.cat(parts) for parts in zip(*groups))))

    def group(self, kind: str, count: int, window: int, levels: int) -> Batch:
        """`count` patches whose input is sampled in one way, in their seed's frame, without augmentation."""
        clouds = self.clouds
        shapes = torch.multinomial(clouds.weights, count, replacement=True)
        source_level = window if kind == "poisson" else self.dense_level(window, levels)
        source = clouds.levels[source_level][shapes]
        picks = torch.randint(source.shape[1], (count, 1, 1), device=source.device)
        seeds = source.gather(1, picks.expand(-1, -1, 3))
        offsets = source - seeds
        distances = offsets.square().sum(-1)
        if kind != "poisson":
            share = level_size(window) / level_size(source_level)
            radius = clouds.spread[shapes].view(-1, 1, 1) * (self.patch / level_size(window)) ** 0.5
            distances = distances.masked_fill(~KINDS[kind](offsets / radius, share), FAR)
            # The seed is a point of the input, as at inference.
            nearest = distances.argmin(1).view(-1, 1, 1).expand(-1, -1, 3)
            kept, seeds = distances < FAR, source.gather(1, nearest)
            distances = (source - seeds).square().sum(-1).masked_fill(~kept, FAR)
        points, radius = nearest_of_seed(distances, source, self.patch)
        reference_level = self.reference_level(window, levels)
        dense = clouds.levels[reference_level][shapes]
        wanted = int(self.patch * 2 ** (reference_level - window) * self.data.reference_margin)
        reference, reach = nearest_of_seed((dense - seeds).square().sum(-1), dense, wanted)
        scale = radius.unsqueeze(-1)
        return Batch((points - seeds) / scale, (reference - seeds) / scale, torch.ones_like(radius), reach / radius)

    def dense_level(self, window: int, levels: int) -> int:
        """The ladder level that uneven inputs are thinned from: much denser, and not the reference itself."""
        level = min(window + 4, len(self.clouds.levels) - 1)
        return level - 1 if level == self.reference_level(window, levels) else level

    def reference_level(self, window: int, levels: int) -> int:
        """The ladder level of the reference: 2^levels times the input's points, and denser where the ladder allows."""
        return min(window + levels + self.data.reference_extra, len(self.clouds.levels) - 1)

    def augment(self, batch: Batch) -> Batch:
        """Rotation, scale, and noise on the input alone."""
        count, device = len(batch.points), batch.points.device
        turn = random_rotations(count, device)
        low, high = self.data.scale
        scale = low + (high - low) * torch.rand(count, 1, 1, device=device)
        points, reference = (batch.points @ turn) * scale, (batch.reference @ turn) * scale
        noisy = torch.rand(count, 1, 1, device=device) < self.data.noise_share
        sigma = noisy * self.data.noise_most * torch.rand(count, 1, 1, device=device).pow(self.data.noise_power)
        noise = torch.randn_like(points).clamp_(-3, 3) * sigma * scale
        flat = scale.squeeze(-1)
        return Batch(points + noise, reference, batch.input_radius * flat, batch.reference_radius * flat)


def random_rotations(count: int, device: torch.device) -> torch.Tensor:
    """[count,3,3], uniform over rotations (from uniform unit quaternions)."""
    w, x, y, z = torch.nn.functional.normalize(torch.randn(count, 4, device=device), dim=1).unbind(1)
    rows: List[torch.Tensor] = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, 1).view(count, 3, 3)


def directions(count: int, device: torch.device) -> torch.Tensor:
    """[count,3,1] random unit vectors."""
    return torch.nn.functional.normalize(torch.randn(count, 3, 1, device=device), dim=1)


def thin_random(offsets: torch.Tensor, share: float) -> torch.Tensor:
    """Uniform random sampling: every point is kept with the same probability. offsets [B,D,3] in patch radii."""
    return torch.rand(offsets.shape[:2], device=offsets.device) < share


def thin_ramp(offsets: torch.Tensor, share: float) -> torch.Tensor:
    """Density rises along a random direction, by up to e^2.4 across a patch."""
    count, device = len(offsets), offsets.device
    slope = 1.2 * torch.rand(count, 1, device=device)
    along = (offsets @ directions(count, device)).squeeze(-1).clamp(-1.5, 1.5)
    return torch.rand(along.shape, device=device) < share * torch.exp(slope * along)


def thin_stripes(offsets: torch.Tensor, share: float) -> torch.Tensor:
    """Scan lines: points lie in parallel sheets, denser along them than across."""
    count, device = len(offsets), offsets.device
    spacing = 0.15 + 0.15 * torch.rand(count, 1, device=device)
    phase = (offsets @ directions(count, device)).squeeze(-1) / spacing + torch.rand(count, 1, device=device)
    width = 0.25
    inside = (phase - phase.floor()) < width
    return inside & (torch.rand(phase.shape, device=device) < share / width)


def thin_scan(offsets: torch.Tensor, share: float) -> torch.Tensor:
    """A single view: of all points behind one pixel only the nearest is seen (slopes get sparse, backs vanish)."""
    count, device = len(offsets), offsets.device
    turned = offsets @ random_rotations(count, device)
    pixels = torch.floor(turned[..., :2] * SCAN_PIXELS_PER_RADIUS).long() + SCAN_GRID // 2
    inside = ((pixels >= 0) & (pixels < SCAN_GRID)).all(-1)
    cells = (pixels[..., 0] * SCAN_GRID + pixels[..., 1]).masked_fill(~inside, SCAN_GRID * SCAN_GRID)
    depth = turned[..., 2]
    nearest = torch.full((count, SCAN_GRID * SCAN_GRID + 1), -FAR, device=device)
    nearest = nearest.scatter_reduce(1, cells, depth, reduce="amax", include_self=True)
    return inside & (depth >= nearest.gather(1, cells))


KINDS = {"random": thin_random, "ramp": thin_ramp, "stripes": thin_stripes, "scan": thin_scan}
