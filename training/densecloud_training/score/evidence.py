"""What the program's confidence goes by (`crates/cascade/src/confidence.rs`), computed again, and a logistic model.

Lengths are in the input's spacing: the mean distance to the 8 nearest others, and of that the median over a point and
its 8 nearest others.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

AROUND = 8
SHEET = 16
HALF = 0.5
NEAREST = 0.3
THINNEST = 0.02
NAMES = ("distance", "reach", "roughness", "thickness", "roughness of the input", "ratio")
# An input point that comes out as it went in, to this share of its distance to the next, was kept as an outlier.
SAME = 1e-4
STEPS = 40


def planes(points: np.ndarray, near: np.ndarray) -> "tuple[np.ndarray, np.ndarray]":
    """Of [n,k] neighbours: extent off their plane, and that as a share of their lesser extent in it."""
    sets = points[near]
    sets = sets - sets.mean(axis=1, keepdims=True)
    variances = np.linalg.eigvalsh(np.einsum("nij,nik->njk", sets, sets) / near.shape[1])
    off = np.sqrt(np.maximum(variances[:, 0], 0))
    return off, off / np.sqrt(np.maximum(variances[:, 1], 1e-300))


@dataclass(frozen=True)
class Sites:
    """An input's distinct points on surfaces: those that did not come out as they went in."""

    points: np.ndarray
    tree: cKDTree
    spacing: np.ndarray
    rough: np.ndarray
    # The root of the ratio of the result to the distinct input.
    root: float

    @classmethod
    def of(cls, source: np.ndarray, result: np.ndarray) -> "Sites":
        distinct = np.unique(source, axis=0)
        apart = cKDTree(result).query(distinct)[0] < SAME * cKDTree(distinct).query(distinct, 2)[0][:, 1]
        points = distinct[~apart]
        tree = cKDTree(points)
        distances, near = tree.query(points, SHEET + 1)
        own = distances[:, 1 : AROUND + 1].mean(axis=1)
        spacing = np.median(own[near[:, : AROUND + 1]], axis=1)
        return cls(points, tree, spacing, planes(points, near[:, 1:])[1], float(np.sqrt(len(result) / len(distinct))))

    def result_spacing(self, points: np.ndarray) -> np.ndarray:
        """The spacing that a result has at some points."""
        return self.spacing[self.tree.query(points)[1]] / self.root

    def features(self, points: np.ndarray) -> np.ndarray:
        """[n,6]: a column for each of NAMES."""
        distances, near = self.tree.query(points, AROUND)
        spacing = self.spacing[near[:, 0]]
        nearest = distances[:, 0] / spacing
        off, rough = planes(self.points, near)
        return np.stack(
            [
                nearest / (HALF + nearest),
                np.log(np.maximum(distances.mean(axis=1) / spacing, NEAREST)),
                rough,
                np.log(np.maximum(off / spacing * self.root, THINNEST)),
                self.rough[near[:, 0]],
                np.full(len(points), np.log(self.root)),
            ],
            axis=1,
        )


def fit(features: np.ndarray, within: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Constant and weights of the logistic model of [n,k] features, by Newton's method; a very small ridge keeps what
    separates the two kinds from growing without end."""
    middle, scale = features.mean(axis=0), features.std(axis=0) + 1e-9
    columns = np.hstack([np.ones((len(features), 1)), (features - middle) / scale])
    weights = weights / weights.sum()
    ridge = 1e-5 * np.diag(np.r_[0.0, np.ones(features.shape[1])])
    found = np.zeros(columns.shape[1])
    for _ in range(STEPS):
        said = 1 / (1 + np.exp(-columns @ found))
        slope = columns.T @ (weights * (within - said)) - ridge @ found
        bend = (columns * (weights * said * (1 - said))[:, None]).T @ columns + ridge
        step = np.linalg.solve(bend, slope)
        found += step
        if np.abs(step).max() < 1e-9:
            break
    slopes = found[1:] / scale
    return np.r_[found[0] - slopes @ middle, slopes]


def said(constants: np.ndarray, features: np.ndarray) -> np.ndarray:
    """The probability that the model gives."""
    return 1 / (1 + np.exp(-constants[0] - features @ constants[1:]))
