"""Cameras, and photographs of a surface by them."""

from dataclasses import dataclass
from typing import List

import numpy as np

from .surface import Surface

SIZE = 64
VIEWS = 32
# Of the views, each fourth is never trained on.
HELD_OUT = 4
DISTANCE = 3.2
# Focal length by the width of a picture.
FOCAL = 1.15
# A photograph's pixel is the mean of this many samples to each side.
FINER = 3
SKY = np.array([0.55, 0.65, 0.8])
# A point is seen if nothing lies further before it than this.
HIDDEN = 0.03


@dataclass(frozen=True)
class View:
    """A camera: x to the right, y down, z ahead; a place p of the world is at `rotation @ p + shift`. Square pictures
    of `size` pixels; pixel (0, 0) has its middle at (0.5, 0.5)."""

    rotation: np.ndarray
    shift: np.ndarray
    focal: float
    size: int

    def finer(self, factor: int) -> "View":
        """The same with more pixels."""
        return View(self.rotation, self.shift, self.focal * factor, self.size * factor)

    def project(self, points: np.ndarray) -> "tuple[np.ndarray, np.ndarray]":
        """[...,2] in pixels, and [...] the depths, of points [...,3]."""
        local = points @ self.rotation.T + self.shift
        return self.focal * local[..., :2] / local[..., 2:] + self.size / 2, local[..., 2]

    def rays(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """[n,3] in the world: from the camera through places of the picture, of depth 1."""
        ahead = np.stack([(x - self.size / 2) / self.focal, (y - self.size / 2) / self.focal, np.ones_like(x)], 1)
        return ahead @ self.rotation

    @property
    def centre(self) -> np.ndarray:
        """Where the camera is."""
        return -self.rotation.T @ self.shift


@dataclass(frozen=True)
class Photograph:
    """`image` [size,size,3] f32 and `depth` [size,size], infinite where the sky is."""

    view: View
    image: np.ndarray
    depth: np.ndarray

    def sees(self, points: np.ndarray) -> np.ndarray:
        """[n]: which of points [n,3] are in the picture and not hidden."""
        at, depth = self.view.project(points)
        pixel = np.floor(at).astype(int)
        inside = ((pixel >= 0) & (pixel < self.view.size)).all(1) & (depth > 0)
        x, y = np.where(inside[:, None], pixel, 0).T
        return inside & (depth < self.depth[y, x] + HIDDEN)


def looking(azimuth: float, height: float, size: int) -> View:
    """At the middle, from `height` (an angle) above the horizon."""
    away = np.array([np.cos(azimuth) * np.cos(height), np.sin(azimuth) * np.cos(height), np.sin(height)])
    right = np.cross(-away, [0, 0, 1])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(-away, right), -away])
    return View(rotation, np.array([0, 0, DISTANCE]), FOCAL * size, size)


def around(count: int = VIEWS, size: int = SIZE) -> List[View]:
    """Views on a spiral, three times around while it rises."""
    share = (np.arange(count) + 0.5) / count
    return [looking(6 * np.pi * s, np.radians(12 + 48 * s), size) for s in share]


def ranges(counts: np.ndarray) -> "tuple[np.ndarray, np.ndarray]":
    """Each index as often as its count says, and beside it 0, 1, 2..."""
    owner = np.repeat(np.arange(len(counts)), counts)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)


def photograph(surface: Surface, view: View) -> Photograph:
    """What the camera sees; a pixel's colour is a mean over it."""
    fine = view.finer(FINER)
    x, y = (np.arange(fine.size**2) % fine.size + 0.5, np.arange(fine.size**2) // fine.size + 0.5)
    face, depth = nearest(surface.corners, fine)
    seen = face >= 0
    image = np.broadcast_to(SKY, (len(face), 3)).copy()
    places = view.centre + fine.rays(x[seen], y[seen]) * depth[seen, None]
    image[seen] = surface.colours(places, face[seen])
    image = image.reshape(view.size, FINER, view.size, FINER, 3).mean((1, 3))
    middle = depth.reshape(fine.size, fine.size)[FINER // 2 :: FINER, FINER // 2 :: FINER]
    return Photograph(view, image.astype(np.float32), middle)


def nearest(corners: np.ndarray, view: View) -> "tuple[np.ndarray, np.ndarray]":
    """For each pixel's middle the triangle before all others, or -1, and its depth, or infinity. No triangle may reach
    behind the camera."""
    at, depth = view.project(corners)
    face, x, y = candidates(at, view.size)
    a, b, c = at[face].transpose(1, 0, 2)
    middle = np.stack([x, y], 1) + 0.5
    whole, off = cross(b - a, c - a), [corner - middle for corner in (a, b, c)]
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = np.stack([cross(off[k - 2], off[k - 1]) for k in range(3)], 1) / whole[:, None]
        # Inverse depth is linear on the picture.
        far = 1 / (weights / depth[face]).sum(1)
    hit = (whole != 0) & (weights >= 0).all(1)
    return foremost((y * view.size + x)[hit], face[hit], far[hit], view.size**2)


def foremost(pixel: np.ndarray, face: np.ndarray, depth: np.ndarray, pixels: int) -> "tuple[np.ndarray, np.ndarray]":
    """The least depth of each pixel, and whose it is."""
    order = np.argsort(-depth, kind="stable")
    found, least = np.full(pixels, -1), np.full(pixels, np.inf)
    # Of assignments to one place the last one stays.
    found[pixel[order]], least[pixel[order]] = face[order], depth[order]
    return found, least


def candidates(at: np.ndarray, size: int) -> "tuple[np.ndarray, np.ndarray, np.ndarray]":
    """Triangles [f,3,2] on a picture, and the pixels whose middles lie in their boxes: faces, columns, rows."""
    low = np.clip(np.ceil(at.min(1) - 0.5), 0, size).astype(int)
    high = np.clip(np.floor(at.max(1) - 0.5) + 1, 0, size).astype(int)
    wide, tall = np.maximum(high - low, 0).T
    face, place = ranges(wide * tall)
    return face, low[face, 0] + place % wide[face], low[face, 1] + place // wide[face]


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """[n]: twice the area between vectors [n,2]."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
