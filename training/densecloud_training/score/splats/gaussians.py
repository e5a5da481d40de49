"""Gaussians in space: from seeds, and as a camera sees them."""

from typing import Dict, NamedTuple

import numpy as np
import torch
from scipy.spatial import cKDTree

from .composite import composite
from .view import SKY, View

# Added to each variance on a picture, in square pixels: no Gaussian is smaller than a pixel.
BLUR = 0.3
NEAREST = 0.2
# The constant spherical harmonic, by which colours are stored.
HARMONIC = 0.28209479177387814
OPACITY = 0.1

Gaussians = Dict[str, torch.Tensor]


class Seeds(NamedTuple):
    """Points [n,3] and their colours [n,3], 0 to 1."""

    points: np.ndarray
    colours: np.ndarray


class Seen(NamedTuple):
    """On a picture: middles [n,2] and the inverse covariances [n,3] in pixels, and depths [n]."""

    centre: torch.Tensor
    conic: torch.Tensor
    depth: torch.Tensor


def from_seeds(seeds: Seeds) -> Gaussians:
    """As the paper begins: balls as large as the root mean square distance to the three nearest, hardly opaque."""
    square = cKDTree(seeds.points).query(seeds.points, 4)[0][:, 1:] ** 2
    size = np.log(np.sqrt(np.maximum(square.mean(1), 1e-7)))
    count = len(seeds.points)
    return {
        "position": torch.tensor(seeds.points, dtype=torch.float32),
        "scale": torch.tensor(size, dtype=torch.float32)[:, None].repeat(1, 3),
        "rotation": torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
        "opacity": torch.full((count,), float(np.log(OPACITY / (1 - OPACITY)))),
        "colour": torch.tensor((seeds.colours - 0.5) / HARMONIC, dtype=torch.float32),
    }


def rotations(quaternions: torch.Tensor) -> torch.Tensor:
    """[n,3,3] of [n,4], the real part first, of any length."""
    w, x, y, z = (quaternions / quaternions.norm(dim=1, keepdim=True)).unbind(1)
    rows = [
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack([torch.stack(row, 1) for row in rows], 1)


def project(gaussians: Gaussians, view: View) -> Seen:
    """Zwicker's approximation: the projection is taken as linear about each middle."""
    turn = torch.as_tensor(view.rotation, dtype=gaussians["position"].dtype)
    local = gaussians["position"] @ turn.T + torch.as_tensor(view.shift, dtype=turn.dtype)
    x, y, z = local.unbind(1)
    depth = z.clamp(min=NEAREST)
    centre = torch.stack([x, y], 1) * (view.focal / depth)[:, None] + view.size / 2
    # Beyond the picture's border the approximation would stretch without bounds.
    edge = 1.3 * view.size / (2 * view.focal)
    across, down = (x / depth).clamp(-edge, edge), (y / depth).clamp(-edge, edge)
    flat = (turn[None, :2] - torch.stack([across, down], 1)[..., None] * turn[2]) * (view.focal / depth)[:, None, None]
    half = flat @ (rotations(gaussians["rotation"]) * gaussians["scale"].exp()[:, None])
    xx, yy = (half * half).sum(2).add(BLUR).unbind(1)
    xy = (half[:, 0] * half[:, 1]).sum(1)
    return Seen(centre, torch.stack([yy, -xy, xx], 1) / (xx * yy - xy * xy)[:, None], z)


def colours(gaussians: Gaussians) -> torch.Tensor:
    """[n,3]."""
    return (HARMONIC * gaussians["colour"] + 0.5).clamp(min=0)


def render(gaussians: Gaussians, view: View, seen: Seen) -> torch.Tensor:
    """[size,size,3], the sky behind all; `seen` is `project` of the same."""
    depth = seen.depth.detach().numpy()
    order = np.argsort(depth, kind="stable")
    order = order[depth[order] > NEAREST]
    opacity = torch.sigmoid(gaussians["opacity"])
    return composite(seen.centre, seen.conic, opacity, colours(gaussians), order, view.size, SKY)
