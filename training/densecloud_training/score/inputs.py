"""Clouds sampled from meshes, and clouds with holes: the same seeds give the same clouds."""

from dataclasses import dataclass
from pathlib import Path
from typing import Callable, List

import numpy as np

from ..prepare import MESHES, read_points
from .program import Program

# Inputs and references must be independent samples of the surface.
INPUT_SEED = 0
REFERENCE_SEED = 1


@dataclass(frozen=True)
class Inputs:
    """Clouds of some shapes of a folder of meshes, made when first asked for, in folders `OUT/inputs/KIND`."""

    program: Program
    meshes: Path
    out: Path
    shapes: List[str]

    def sampled(self, points: int, method: str = "poisson", noise: float = 0.0, seed: int = INPUT_SEED) -> Path:
        """A folder with a sample of every shape. Noise: the deviation, as a share of half the bounding box's
        diagonal."""
        folder = self.out / "inputs" / kind(points, method, noise, seed)
        for shape in self.shapes:
            options = ["--method", method, "--noise", noise]
            self.program.sample(find_mesh(self.meshes, shape), folder / f"{shape}.ply", points, seed, *options)
        return folder

    def references(self, points: int) -> Path:
        """A folder with a Poisson-disk sample of every shape, independent of the inputs."""
        return self.sampled(points, seed=REFERENCE_SEED)

    def with_removed(self, points: int, share: float) -> Path:
        """A folder with even samples, a random share of whose points is missing."""
        return self.spoilt(points, share, "removed", remove)

    def with_outliers(self, points: int, share: float) -> Path:
        """A folder with even samples, a random share of whose points is anywhere in the bounding box, made a fifth
        larger, instead."""
        return self.spoilt(points, share, "outliers", strew)

    def spoilt(
        self, points: int, share: float, name: str, spoil: Callable[[np.ndarray, float, int], np.ndarray]
    ) -> Path:
        """A folder with even samples to each of which something was done, by its number as the seed."""
        whole = self.sampled(points)
        if share == 0:
            return whole
        folder = self.out / "inputs" / f"{whole.name}-{name}-{share:g}"
        folder.mkdir(parents=True, exist_ok=True)
        for number, shape in enumerate(self.shapes):
            source, file = whole / f"{shape}.ply", folder / f"{shape}.xyz"
            if not (file.exists() and file.stat().st_mtime_ns >= source.stat().st_mtime_ns):
                write_points(file, spoil(read_points(source), share, number))
        return folder


def kind(points: int, method: str, noise: float, seed: int) -> str:
    """The name of a folder of samples."""
    return f"{method}-{points}" + (f"-noise-{noise:g}" if noise else "") + (f"-seed-{seed}" if seed else "")


def find_mesh(meshes: Path, shape: str) -> Path:
    """The file of a shape, whatever its extension."""
    for extension in MESHES:
        file = meshes / f"{shape}{extension}"
        if file.exists():
            return file
    raise SystemExit(f"{meshes} has no mesh named {shape}: the held-out shapes are listed in validation.txt")


def remaining(points: int, share: float) -> int:
    """How many of `points` are left when a share is removed."""
    return points - round(points * share)


def remove(points: np.ndarray, share: float, seed: int) -> np.ndarray:
    """[n,3] without a random share of its rows, the others in their order. With the same seed, what a smaller share
    removes a larger one removes too."""
    if not 0 <= share < 1:
        raise ValueError(f"the share to remove must be at least 0 and below 1, not {share}")
    order = np.random.default_rng(seed).permutation(len(points))
    return points[np.sort(order[: remaining(len(points), share)])]


def strew(points: np.ndarray, share: float, seed: int) -> np.ndarray:
    """[n,3] with a random share of its rows anywhere in the bounding box, made a fifth larger about its middle. With
    the same seed, those of a smaller share are among those of a larger one, in the same places."""
    if not 0 <= share <= 1:
        raise ValueError(f"the share of outliers must be from 0 to 1, not {share}")
    random = np.random.default_rng(seed)
    low, high = points.min(0), points.max(0)
    chosen = random.permutation(len(points))[: round(share * len(points))]
    moved = points.copy()
    moved[chosen] = (low + high) / 2 + 0.6 * (high - low) * random.uniform(-1, 1, (len(points), 3))[: len(chosen)]
    return moved


def write_points(file: Path, points: np.ndarray) -> None:
    """A text file of coordinates; f64 values survive."""
    partial = file.with_name(f".{file.name}")
    np.savetxt(partial, points, fmt="%.17g")
    partial.replace(file)
