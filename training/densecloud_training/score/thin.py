"""Thin and close parts of the held-out shapes: how near the result comes to the surface there, and elsewhere."""

from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Sequence

import numpy as np
from scipy.spatial import cKDTree

from ..prepare import read_points
from .inputs import Inputs, find_mesh
from .real import midpoints, points_of
from .sheets import Triangles, read_mesh, to_other_sheet
from .table import markdown, plain
from .validation import EXACT_SEED, POINTS

RATIO = 4
# Up to how many spacings of the input another sheet is near.
NEAR = 3
BANDS = ((0, 1), (1, 2), (2, NEAR), (0, NEAR), (NEAR, np.inf))
METHODS = ("densecloud", "another sample of the surface", "midpoints", "the input repeated")

NOTE = f"""Distance from the reference to the result, mean / 95th percentile, in spacings of the input (the median \
distance to the nearest other), of the reference points of all shapes together. Another sheet: the line along a \
point's normal, to either side, meets the mesh again within {NEAR} spacings.
"""


@dataclass(frozen=True)
class Part:
    """The reference points of one shape: from the surface to its other sheet, and to each method's result, in spacings
    of the input."""

    shape: str
    apart: np.ndarray
    off: Dict[str, np.ndarray]


def spacing(points: np.ndarray) -> float:
    """The median distance to the nearest other."""
    return float(np.median(cKDTree(points).query(points, 2)[0][:, 1]))


def measured(
    shape: str, corners: np.ndarray, reference: np.ndarray, results: Dict[str, np.ndarray], unit: float
) -> Part:
    """Of a mesh's corners [f,3,3], points [n,3] of it, and results; `unit` is the spacing of the input."""
    apart = to_other_sheet(Triangles.of(corners), reference, NEAR * unit) / unit
    return Part(shape, apart, {m: cKDTree(points).query(reference)[0] / unit for m, points in results.items()})


def evaluate(inputs: Inputs) -> List[Part]:
    """All shapes, upsampled from even points."""
    given, wanted = inputs.sampled(POINTS), inputs.references(POINTS * RATIO)
    exact = inputs.sampled(POINTS * RATIO, seed=EXACT_SEED)
    parts = []
    for shape in inputs.shapes:
        file = f"{shape}.ply"
        source = read_points(given / file)
        results = (dense(inputs, given / file), read_points(exact / file), midpoints(source), source)
        corners, reference = read_mesh(find_mesh(inputs.meshes, shape)), read_points(wanted / file)
        parts.append(measured(shape, corners, reference, dict(zip(METHODS, results)), spacing(source)))
    return parts


def dense(inputs: Inputs, source: Path) -> np.ndarray:
    """What the program makes of a file."""
    folder = inputs.out / "thin"
    folder.mkdir(parents=True, exist_ok=True)
    return points_of(np.load(inputs.program.upsample(source, folder / f"{source.stem}.npy", "--ratio", RATIO)))


def inside(part: Part, band: Sequence[float]) -> np.ndarray:
    """Which points have their other sheet in a band: above its first number, up to its second; beyond NEAR, or none,
    is elsewhere."""
    return (part.apart > band[0]) & (part.apart <= band[1])


def pooled(parts: List[Part], method: str, band: Sequence[float]) -> np.ndarray:
    """The distances of all parts in a band."""
    return np.concatenate([part.off[method][inside(part, band)] for part in parts])


def scores(off: np.ndarray) -> "tuple[float, float]":
    """Mean and 95th percentile; not a number where there is none."""
    return (float(off.mean()), float(np.quantile(off, 0.95))) if len(off) else (np.nan, np.nan)


def cells(parts: List[Part], band: Sequence[float]) -> List[str]:
    """Of each method."""
    return [" / ".join(plain(value, 3) for value in scores(pooled(parts, method, band))) for method in METHODS]


def share(parts: List[Part], band: Sequence[float]) -> str:
    """Of the points, in %."""
    return plain(100 * float(np.concatenate([inside(part, band) for part in parts]).mean()), 1)


def name(band: Sequence[float]) -> str:
    return "elsewhere" if band[1] == np.inf else f"{band[0]} to {band[1]} spacings off"


def ratios(parts: List[Part]) -> List[str]:
    """How much worse each method is where another sheet is near than elsewhere, in %."""
    near, far = ([scores(pooled(parts, m, band)) for m in METHODS] for band in BANDS[-2:])
    return [" / ".join(f"{100 * (a / b - 1):+.1f}" for a, b in zip(one, other)) for one, other in zip(near, far)]


def text(parts: List[Part]) -> str:
    """The tables, in Markdown."""
    rows = [[name(band), share(parts, band), *cells(parts, band)] for band in BANDS]
    rows.append([f"up to {NEAR} spacings against elsewhere, %", "", *ratios(parts)])
    by_shape = []
    for part in sorted(parts, key=lambda part: -inside(part, BANDS[-2]).mean()):
        ours = (scores(pooled([part], METHODS[0], band)) for band in BANDS[-2:])
        both = [" / ".join(plain(value, 3) for value in pair) for pair in ours]
        by_shape.append([part.shape, share([part], BANDS[-2]), *both])
    return "\n".join(
        [
            NOTE,
            markdown(["another sheet", "share of the surface, %", *METHODS], rows),
            markdown(["shape", f"up to {NEAR} spacings, %", f"{METHODS[0]} there", "elsewhere"], by_shape),
        ]
    )
