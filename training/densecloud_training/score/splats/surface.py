"""A coloured mesh on coloured ground: the scene, and points of it as structure from motion finds them."""

from dataclasses import dataclass

import numpy as np

# The ground reaches this many radii of the shape to each side.
GROUND = 1.5
# Where the light comes from; what lies in the shade keeps this share of its colour.
LIGHT = np.array([0.4, -0.3, 0.866])
SHADE = 0.5
# How much likelier a point is found where the pattern is strongest than where there is none.
RICHER = 12.0
# Of the radius of the shape: noise of found points, and how far off those lie that were matched wrongly, in all
# directions.
NOISE = 0.006
WRONG = 0.1
WRONG_SHARE = 0.01


@dataclass(frozen=True)
class Surface:
    """Triangles [f,3,3] in a frame whose shape has radius 1 and stands on the ground, z up; `phase` [6,3] is the
    pattern's."""

    corners: np.ndarray
    phase: np.ndarray

    @classmethod
    def of(cls, corners: np.ndarray, seed: int) -> "Surface":
        """A mesh's corners, made one radius large, on ground of its own."""
        low, high = corners.reshape(-1, 3).min(0), corners.reshape(-1, 3).max(0)
        shape = (corners - (low + high) / 2) / (np.linalg.norm(high - low) / 2)
        phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, (6, 3))
        return cls(np.concatenate([shape, ground(float(shape[..., 2].min()))]), phase)

    def normals(self) -> np.ndarray:
        """[f,3], unit."""
        across = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)

    def areas(self) -> np.ndarray:
        """[f]."""
        across = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        return np.linalg.norm(across, axis=1) / 2

    def richness(self, points: np.ndarray) -> np.ndarray:
        """[n], 0 to 1: how strong the pattern is at places [n,3]."""
        waves = np.sin(2.5 * points + self.phase[0]).sum(1)
        return 1 / (1 + np.exp(-3 * waves))

    def colours(self, points: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """[n,3], 0 to 1: of places [n,3] on triangles; a slow change of colour, a fine pattern where it is rich, and
        light that is the same from everywhere."""
        slow = 0.5 + 0.25 * np.sin(1.7 * points @ mixing(1) + self.phase[1])
        fine = np.sin(14 * points @ mixing(2) + self.phase[2]) * np.sin(9 * points @ mixing(3) + self.phase[3])
        lit = SHADE + (1 - SHADE) * np.abs(self.normals() @ LIGHT)[faces]
        return np.clip((slow + 0.35 * self.richness(points)[:, None] * fine) * lit[:, None], 0, 1)

    def sample(self, count: int, random: np.random.Generator) -> "tuple[np.ndarray, np.ndarray]":
        """Places [count,3] on the surface and their triangles, likelier where the pattern is rich."""
        tried = 8 * count
        faces = random.choice(len(self.corners), tried, p=self.areas() / self.areas().sum())
        one, other = np.sqrt(random.random((tried, 1))), random.random((tried, 1))
        a, b, c = self.corners[faces].transpose(1, 0, 2)
        points = a * (1 - one) + b * one * (1 - other) + c * one * other
        weights = 1 + (RICHER - 1) * self.richness(points)
        chosen = random.choice(tried, count, replace=False, p=weights / weights.sum())
        return points[chosen], faces[chosen]


def ground(height: float) -> np.ndarray:
    """[2,3,3]: a square at a height, about the axis."""
    corners = GROUND * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    corners[:, 2] = height
    return corners[[[0, 1, 2], [0, 2, 3]]]


def mixing(seed: int) -> np.ndarray:
    """[3,3]: a rotation, so that patterns do not follow the axes."""
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]


def disturbed(points: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """[n,3]: with the noise of triangulation, and some that were matched wrongly."""
    wrong = random.random(len(points)) < WRONG_SHARE
    return points + random.normal(size=points.shape) * np.where(wrong, WRONG, NOISE)[:, None]
