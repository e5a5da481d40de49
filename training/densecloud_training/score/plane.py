"""What the columns of `real` say of a perfect result: scans of a plane, by how even and how noisy they are.

A scan's points stand for the truth, so whatever lies between them is counted as false, and the input repeated is never
that. Where the truth is known, the part of CDH that no method can avoid is, too.
"""

from typing import Dict, List

import numpy as np
from scipy.spatial import cKDTree

from .real import RATIO, Truth, at_random, midpoints, score
from .table import markdown, plain

POINTS = 16_000
# Deviations across the plane, in the mean spacing.
NOISE = (0.0, 0.2, 0.4, 0.6, 0.8)
COLUMNS = ("CDH", "false 2", "miss L")
NOTE = f"""A plane of {POINTS:,} points, a random quarter of them as input. Noise: across the plane, its deviation in \
mean spacings. Perfect: as many points as the scan has, evenly on the plane itself.
"""


def even(points: int, random: np.random.Generator, steps: int = 60) -> np.ndarray:
    """[points,2] on a torus of that area, pushed apart."""
    side = np.sqrt(points)
    at = random.random((points, 2)) * side
    for _ in range(steps):
        others = cKDTree(at, boxsize=side).query(at, 7)[1][:, 1:]
        apart = at[:, None] - at[others]
        apart -= side * np.round(apart / side)
        far = np.linalg.norm(apart, axis=2, keepdims=True) + 1e-9
        at = (at + (apart / far * np.maximum(0, 1.05 - far) / RATIO).sum(axis=1)) % side
    return at


def scores(evenly: bool, noise: float, points: int = POINTS) -> Dict[str, Dict[str, float]]:
    """By method, the columns of one scan."""
    random = np.random.default_rng(0)
    flat = even(points, random) if evenly else random.random((points, 2)) * np.sqrt(points)
    scan = np.column_stack([flat, noise * random.standard_normal(points)])
    kept = at_random(scan)
    perfect = np.column_stack([even(points, random), np.zeros(points)])
    results = {"repeated": scan[kept], "midpoints": midpoints(scan[kept]), "perfect": perfect}
    truth = Truth.of(scan)
    return {method: score(truth, kept, result) for method, result in results.items()}


def text() -> str:
    """The table of all scans."""
    rows: List[List[str]] = []
    for evenly in (False, True):
        for noise in NOISE:
            found = scores(evenly, noise)
            cells = [" / ".join(plain(found[m][column]) for column in COLUMNS) for m in found]
            rows.append(["even" if evenly else "random", plain(noise, 1), *cells])
    return "\n".join([NOTE, markdown(["scan", "noise", *(f"{m}: {' / '.join(COLUMNS)}" for m in found)], rows)])
