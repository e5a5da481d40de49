"""What libraries have for a noisy scan, as a control: statistical outlier removal, and points onto local planes."""

from typing import Tuple

import numpy as np
import torch

# Rows of a table of distances that are held at a time.
CHUNK = 256


def nearest(points: np.ndarray, k: int) -> Tuple[np.ndarray, np.ndarray]:
    """Distances and indices [n,k] of each point's k nearest others, by brute force: seconds for 20,000 points."""
    # In f32 about the middle: a scan may lie far from the origin.
    cloud = torch.from_numpy(np.ascontiguousarray(points - points.mean(0))).float()
    found = [
        torch.cdist(part, cloud, compute_mode="donot_use_mm_for_euclid_dist").topk(k + 1, largest=False)
        for part in cloud.split(CHUNK)
    ]
    # The first is the point itself, or a duplicate of it, which is as good.
    return torch.cat([f.values for f in found])[:, 1:].numpy(), torch.cat([f.indices for f in found])[:, 1:].numpy()


def without_strays(points: np.ndarray, k: int = 8, deviations: float = 2.0) -> np.ndarray:
    """Without the points whose mean distance to their k nearest is more than so many standard deviations above the
    cloud's mean of it."""
    distances = nearest(points, k)[0].mean(axis=1)
    return points[distances <= distances.mean() + deviations * distances.std()]


def onto_planes(points: np.ndarray, k: int = 32) -> np.ndarray:
    """Each point moved onto the plane that fits its k nearest best: noise across the surface shrinks, and so do edges
    finer than the k points' patch."""
    heights, normals = above_planes(points, k)
    return points - heights[:, None] * normals


def roughness(points: np.ndarray, k: int = 16, count: int = 9000, seed: int = 0) -> float:
    """Root mean square distance of points from the planes of their k nearest, in the cloud's unit. Of `count` of the
    points drawn at random: only clouds of the same density compare."""
    drawn = points[np.random.default_rng(seed).permutation(len(points))[:count]]
    return float(np.sqrt((above_planes(drawn, k)[0] ** 2).mean()))


def above_planes(points: np.ndarray, k: int) -> Tuple[np.ndarray, np.ndarray]:
    """Signed distance of each point from the plane that fits its k nearest best, and the plane's normal."""
    around = points[nearest(points, k)[1]]
    middle = around.mean(axis=1)
    spread = around - middle[:, None]
    normals = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))[1][:, :, 0]
    return np.einsum("ni,ni->n", points - middle, normals), normals
