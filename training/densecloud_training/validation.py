"""Scores on held-out shapes: the same patches for every checkpoint, with rules that learn nothing beside them."""

import random
from dataclasses import replace
from functools import cached_property
from typing import Dict, Iterator, List, Sequence, Tuple

import torch

from .clouds import Clouds
from .config import Config, Data
from .levels import Result, Step, run_levels
from .loss import nearest_distances
from .network import Cascade
from .patches import Batch, PatchSource

MIDPOINT_NEIGHBOURS = 8
# Input kinds scored apart: even and clean, uneven and clean, even with noise of about half a point spacing.
CASES = {
    "even": ({"poisson": 1.0}, 0.0),
    "random": ({"random": 1.0}, 0.0),
    "noisy": ({"poisson": 1.0}, 0.04),
}


class Validation:
    """Fixed patches of whole held-out shapes; their references are 2^extra times as dense as the prediction."""

    def __init__(self, clouds: Clouds, config: Config, patches: int = 16, seed: int = 7, extra: int = 0):
        self.config, self.seed = config, seed
        self.batches: Dict[str, List[Batch]] = {}
        even = clouds._replace(weights=torch.ones_like(clouds.weights))
        with forked(seed, clouds.device):
            for case, (kinds, noise) in CASES.items():
                data = Data(
                    windows=[0.0, 1.0, 1.0],
                    kinds=kinds,
                    noise_share=float(noise > 0),
                    noise_most=noise,
                    noise_power=0.0,
                    scale=[1.0, 1.0],
                    reference_margin=config.data.reference_margin,
                    reference_extra=extra,
                    seed_pull=config.data.seed_pull,
                )
                host = random.Random(seed)
                source = PatchSource(even, data, config.patch, host)
                self.batches[case] = [source.draw(level, patches) for level in range(1, config.levels + 1)]

    @cached_property
    def controls(self) -> Dict[str, Dict[str, Dict[str, float]]]:
        """Scores of the rules that learn nothing."""
        rules = {"midpoint": midpoint, "repeat": repeat}
        return {name: self.scores([rule] * self.config.levels) for name, rule in rules.items()}

    def of_cascade(self, cascade: Cascade, levels: int) -> Dict[str, Dict[str, float]]:
        """Scores of the first `levels` units."""
        return self.scores(list(cascade.units)[:levels])

    @torch.no_grad()
    def scores(self, steps: Sequence[Step]) -> Dict[str, Dict[str, float]]:
        """{"even 2x": {"cd": .., "hd": ..}}: mean over patches of the two-way mean, and of the larger directed
        maximum, of squared nearest distances, x 1e3, patch radius 1; borders left out."""
        table = {}
        for name, result in self.results(steps):
            nearest = nearest_distances(result.prediction, result.reference)
            there = nearest.to_reference * result.prediction_inside
            back = nearest.to_prediction * result.reference_inside
            means = there.sum(1) / result.prediction_inside.sum(1).clamp_min(1)
            means = means + back.sum(1) / result.reference_inside.sum(1).clamp_min(1)
            worst = torch.maximum(there.max(1)[0], back.max(1)[0])
            table[name] = {"cd": 1e3 * means.mean().item(), "hd": 1e3 * worst.mean().item()}
        return table

    @torch.no_grad()
    def results(self, steps: Sequence[Step]) -> Iterator[Tuple[str, Result]]:
        """("even 2x", what the steps make of those patches), for each case and each level that the steps reach."""
        clean = replace(self.config.data, level_noise=0.0)
        for case, batches in self.batches.items():
            for level, batch in enumerate(batches[: len(steps)], start=1):
                with forked(self.seed + level, batch.points.device):
                    result = run_levels(steps[:level], batch, clean)
                yield f"{case} {2**level}x", result


class forked:
    """Runs a block on its own random numbers, so that scoring does not change what training draws next."""

    def __init__(self, seed: int, device: torch.device):
        self.seed = seed
        self.fork = torch.random.fork_rng(devices=[device] if device.type == "cuda" else [])

    def __enter__(self):
        self.fork.__enter__()
        torch.manual_seed(self.seed)

    def __exit__(self, *exception):
        return self.fork.__exit__(*exception)


def repeat(points: torch.Tensor, previous=None):
    """Each point twice."""
    return torch.cat([points, points], dim=1), None


def midpoint(points: torch.Tensor, previous=None):
    """The points, and as many midpoints of neighbours, chosen by farthest point sampling."""
    batch, count, _ = points.shape
    indices = torch.cdist(points, points).topk(MIDPOINT_NEIGHBOURS + 1, largest=False)[1][..., 1:]
    neighbours = points.gather(1, indices.reshape(batch, -1, 1).expand(-1, -1, 3)).view(batch, count, -1, 3)
    middles = ((points.unsqueeze(2) + neighbours) / 2).reshape(batch, -1, 3)
    nearest = torch.cdist(middles, points).min(2)[0]
    chosen = [points]
    for _ in range(count):
        pick = nearest.argmax(1).view(-1, 1, 1).expand(-1, -1, 3)
        point = middles.gather(1, pick)
        chosen.append(point)
        nearest = torch.minimum(nearest, (middles - point).norm(dim=-1))
    return torch.cat(chosen, dim=1), None
