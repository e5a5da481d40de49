"""Places where a shape is no plane to its sampling: thin walls, sheets that nearly touch, tips and edges."""

from typing import List, Tuple

import torch

from .clouds import Clouds

# Points of a shape that are looked at, and neighbours of each in a cloud of four times as many points: about as far as
# two spacings apart, so that two sheets nearer than that are seen together.
LOOKED_AT = 256
NEIGHBOURS = 48
DENSER = 2


class ThinPlaces:
    """Draws places of all shapes, the likelier the less flat their neighbourhood at a level's spacing is."""

    def __init__(self, clouds: Clouds, windows: int):
        highest = len(clouds.levels) - 1
        self.places: List[torch.Tensor] = []
        self.weights: List[torch.Tensor] = []
        for window in range(min(windows, highest + 1)):
            coarse, fine = clouds.levels[window], clouds.levels[min(window + DENSER, highest)]
            places = coarse[:, :: max(1, coarse.shape[1] // LOOKED_AT)]
            self.places.append(places)
            flat = torch.stack([thickness(some, cloud) for some, cloud in zip(places, fine)])
            self.weights.append(flat * clouds.weights.unsqueeze(1))

    def draw(self, window: int, count: int) -> Tuple[torch.Tensor, torch.Tensor]:
        """Shapes [count] and places on them [count,3]."""
        places = self.places[window]
        chosen = torch.multinomial(self.weights[window].flatten(), count, replacement=True)
        return chosen // places.shape[1], places.flatten(0, 1)[chosen]


def thickness(places: torch.Tensor, cloud: torch.Tensor) -> torch.Tensor:
    """[P]: the smallest variance of each place's neighbourhood in a cloud [D,3] over the middle one; 0 is flat."""
    near = torch.cdist(places, cloud).topk(min(NEIGHBOURS, len(cloud)), largest=False)[1]
    offsets = cloud[near] - cloud[near].mean(1, keepdim=True)
    spread = torch.linalg.eigvalsh(offsets.transpose(1, 2) @ offsets)
    return (spread[:, 0] / spread[:, 1].clamp_min(1e-12)).clamp(0, 1)
