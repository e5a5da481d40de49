"""The upsampling unit and the cascade of units (method of "Patch-based Progressive 3D Point Set Upsampling").

Shapes: B patches of N points; C = 264 feature channels. Coordinates are in the patch's own frame (`normalise`).
"""

from typing import Callable, NamedTuple, Optional, Sequence, Tuple

import torch
from torch import nn
from torch.nn import functional

from .edge import EdgeBlock, nearest_in_features, nearest_others

PATCH = 312
K = 32
# Nearest by what: "features" (each block's own input), "space" (coordinates in the first block, then features), or
# "space-shared" (coordinates in all blocks: one search a patch).
NEIGHBOURS = "features"
BLOCK_CHANNELS = 24
GROWTH = 12
BLOCKS = 4
CODES = (-0.2, 0.2)
SKIP_NEIGHBOURS = 5
SKIP_FACTOR = 0.2
HIDDEN = (128, 128, 64)

BLOCK_OUT = 3 * GROWTH + BLOCK_CHANNELS
CHANNELS = BLOCK_CHANNELS + BLOCKS * BLOCK_OUT
PARAMETERS_PER_UNIT = 76_027


class Previous(NamedTuple):
    """What a unit sees of the level before it.

    features: [M,C], one row for each input point of the previous level (after that level's own skip).
    indices: [B,N,5] int64 rows of `features`, the spatially nearest of each point.
    distances: [B,N,5] their squared spatial distances, in any unit that is constant within a patch.
    """

    features: torch.Tensor
    indices: torch.Tensor
    distances: torch.Tensor


class UnitOutput(NamedTuple):
    """dense: [B,2N,3], the N points with code -0.2, then the N with +0.2. features: [B,N,C] after the skip."""

    dense: torch.Tensor
    features: torch.Tensor


class Unit(nn.Module):
    """One upsampling unit: N points in, 2N points out; 76,027 parameters."""

    def __init__(self, k: int = K, neighbours: str = NEIGHBOURS):
        super().__init__()
        self.neighbours = neighbours
        self.lift = nn.Linear(3, BLOCK_CHANNELS)
        widths = [BLOCK_CHANNELS + i * BLOCK_OUT for i in range(1, BLOCKS)]
        self.squeezes = nn.ModuleList([nn.Linear(width, BLOCK_CHANNELS) for width in widths])
        self.blocks = nn.ModuleList([EdgeBlock(BLOCK_CHANNELS, GROWTH, k) for _ in range(BLOCKS)])
        sizes = [CHANNELS + 1, *HIDDEN, 3]
        self.expand = nn.ModuleList([nn.Linear(i, o) for i, o in zip(sizes, sizes[1:])])
        for module in self.modules():
            if isinstance(module, nn.Linear):
                nn.init.xavier_uniform_(module.weight)
                nn.init.zeros_(module.bias)

    @property
    def k(self) -> int:
        return self.blocks[0].k

    def forward(self, points: torch.Tensor, previous: Optional[Previous] = None) -> UnitOutput:
        features = self.extract(points)
        if previous is not None:
            features = skip(features, previous)
        return UnitOutput(self.upsample(points, features), features)

    def extract(self, points: torch.Tensor) -> torch.Tensor:
        """[B,N,3] -> [B,N,C]."""
        first, later = self.given_neighbours(points, nearest_others)
        features = self.lift(points)
        features = torch.cat([self.blocks[0](features, first), features], dim=-1)
        for squeeze, block in zip(self.squeezes, self.blocks[1:]):
            features = torch.cat([block(functional.relu(squeeze(features)), later), features], dim=-1)
        return features

    def given_neighbours(self, points: torch.Tensor, search: Callable) -> Tuple[Optional[torch.Tensor], ...]:
        """Indices for the first block and for the others; None where a block searches among its own features."""
        if self.neighbours == "features":
            return None, None
        spatial = search(points, self.k)
        return spatial, spatial if self.neighbours == "space-shared" else None

    def upsample(self, points: torch.Tensor, features: torch.Tensor) -> torch.Tensor:
        """Two copies of every point, each moved by its own residual: [B,N,3] and [B,N,C] -> [B,2N,3].

        The copies differ by one input channel (the code), so the first layer's product is shared by both.
        """
        first, *others = self.expand
        shared = functional.linear(features, first.weight[:, :-1], first.bias)
        hidden = torch.cat([shared + code * first.weight[:, -1] for code in CODES], dim=1)
        for layer in others:
            hidden = layer(functional.relu(hidden))
        return hidden + torch.cat([points, points], dim=1)

    def plain(self, points: torch.Tensor, previous: Optional[Previous] = None) -> UnitOutput:
        """The definition without any shortcut; equal to `forward`, for the tests."""
        first, later = self.given_neighbours(points, nearest_in_features)
        features = self.lift(points)
        features = torch.cat([self.blocks[0].plain(features, first), features], dim=-1)
        for squeeze, block in zip(self.squeezes, self.blocks[1:]):
            features = torch.cat([block.plain(functional.relu(squeeze(features)), later), features], dim=-1)
        if previous is not None:
            features = skip(features, previous)
        copies = []
        for code in CODES:
            hidden = torch.cat([features, torch.full_like(features[..., :1], code)], dim=-1)
            for layer in self.expand[:-1]:
                hidden = functional.relu(layer(hidden))
            copies.append(points + self.expand[-1](hidden))
        return UnitOutput(torch.cat(copies, dim=1), features)


def skip(features: torch.Tensor, previous: Previous) -> torch.Tensor:
    """Adds the bilateral mean of the previous level's features to each point's own (factor 0.2).

    w = exp(-2 d_s/h_s) exp(-2 d_f/h_f), normalised to sum 1: a softmax of the exponents, which cannot underflow to
    0/0. The weights carry no gradient, the features they average do.
    """
    batch, points, neighbours = previous.indices.shape
    flat = previous.features.index_select(0, previous.indices.reshape(-1))
    others = flat.view(batch, points, neighbours, -1)
    with torch.no_grad():
        spatial = previous.distances
        featural = (others - features.unsqueeze(2)).square().sum(-1)
        weights = torch.softmax(-2 * (relative(spatial) + relative(featural)), dim=-1)
    return features + SKIP_FACTOR * (weights.unsqueeze(-1) * others).sum(2)


def relative(distances: torch.Tensor) -> torch.Tensor:
    """[B,N,5] squared distances over their patch's width h: the mean over points of the smallest one.

    Where h is 0 (every point coincides with a previous one) all weight goes to distances of 0, as in the limit.
    """
    width = distances.min(-1)[0].mean(-1)
    return distances / width.clamp_min(1e-10).view(-1, 1, 1)


class Cascade(nn.Module):
    """Units for 2x, 4x, 8x, ...; weights are not shared. `variants.build_cascade` makes other kinds."""

    def __init__(
        self, levels: int = 4, k: int = K, neighbours: str = NEIGHBOURS, units: Optional[Sequence[Unit]] = None
    ):
        super().__init__()
        self.units = nn.ModuleList([Unit(k, neighbours) for _ in range(levels)] if units is None else units)


class Frame(NamedTuple):
    """A patch's own frame: centroid [B,1,3] and the largest distance to it [B,1,1]."""

    centre: torch.Tensor
    radius: torch.Tensor

    def undo(self, points: torch.Tensor) -> torch.Tensor:
        return points * self.radius + self.centre

    def apply(self, points: torch.Tensor) -> torch.Tensor:
        return (points - self.centre) / self.radius


def normalise(points: torch.Tensor):
    """[B,N,3] -> the same points in the unit sphere, and the frame that undoes it."""
    centre = points.mean(1, keepdim=True)
    radius = (points - centre).norm(dim=-1).max(1)[0].clamp_min(1e-12).view(-1, 1, 1)
    frame = Frame(centre, radius)
    return frame.apply(points), frame
