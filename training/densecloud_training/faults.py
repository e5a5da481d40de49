"""What sensors do to points, beside the way they sample: noise, coarse depth, outliers, holes.

Points are [B,N,3] about the origin and scale [B,1,1] their patch's radius; `share` is how many patches it happens to.
"""

from typing import Tuple

import torch

from .sampling import FAR, directions

# The most holes of a patch, and within which part of it their centres lie.
HOLES = 3
HOLES_WITHIN = 0.8
SMALLEST_HOLE = 0.3


def some_patches(count: int, share: float, device: torch.device) -> torch.Tensor:
    """[B,1,1] bool."""
    return torch.rand(count, 1, 1, device=device) < share


def noised(points: torch.Tensor, scale: torch.Tensor, share: float, most: float, power: float) -> torch.Tensor:
    """Gaussian noise of a deviation of up to `most` radii, u^power of it for an even u, cut at three times that."""
    count, device = len(points), points.device
    noisy = some_patches(count, share, device)
    sigma = noisy * most * torch.rand(count, 1, 1, device=device).pow(power)
    return points + torch.randn_like(points).clamp_(-3, 3) * sigma * scale


def quantised(points: torch.Tensor, scale: torch.Tensor, share: float, most: float) -> torch.Tensor:
    """Depth in steps of up to `most` radii along one direction."""
    count, device = len(points), points.device
    along = directions(count, device)
    step = most * scale * torch.rand(count, 1, 1, device=device).clamp_min(0.01)
    depth = points @ along
    shift = (torch.round(depth / step) * step - depth) * some_patches(count, share, device)
    return points + shift * along.transpose(1, 2)


def outliers(points: torch.Tensor, scale: torch.Tensor, share: float, most: float) -> Tuple[torch.Tensor, torch.Tensor]:
    """Moves up to `most` of the points to anywhere in the patch's ball; also gives a mask [B,N] of which."""
    count, device = len(points), points.device
    part = most * torch.rand(count, 1, 1, device=device) * some_patches(count, share, device)
    moved = torch.rand(*points.shape[:2], 1, device=device) < part
    ways = torch.nn.functional.normalize(torch.randn_like(points), dim=-1)
    anywhere = ways * scale * torch.rand(*points.shape[:2], 1, device=device).pow(1 / 3)
    return torch.where(moved, anywhere, points), moved.squeeze(-1)


def without_holes(kept: torch.Tensor, offsets: torch.Tensor, rows: torch.Tensor, most: float) -> None:
    """Takes one to three balls of up to `most` radii out of what is `kept` [B,D] of the patches `rows`, in place."""
    if not len(rows):
        return
    there, left = offsets[rows], kept[rows]
    near = left & (there.square().sum(-1) < HOLES_WITHIN**2)
    order = torch.rand(near.shape, device=near.device).masked_fill(~near, -FAR)
    centres = there.gather(1, order.topk(HOLES, dim=1)[1].unsqueeze(-1).expand(-1, -1, 3))
    radii = most * (SMALLEST_HOLE + (1 - SMALLEST_HOLE) * torch.rand(len(rows), HOLES, device=near.device))
    radii[:, 1:] *= torch.rand(len(rows), HOLES - 1, device=near.device) < 0.5
    for number in range(HOLES):
        distances = (there - centres[:, number : number + 1]).square().sum(-1)
        left &= distances >= radii[:, number : number + 1].square()
    kept[rows] = left
