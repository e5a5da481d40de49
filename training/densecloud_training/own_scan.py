"""A scan to adapt to: read, refused where it has nothing to teach, and divided into what is learned and held out."""

from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterator, Optional, Tuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import ks_2samp

from .errors import InputError
from .score.program import Program
from .score.real import AROUND, Truth, read, roughness

# Fewer leave no room for a patch thinned to a quarter in each part.
LEAST = 5_000
# The share of a scan that is never trained on, and the most points of it that are looked at.
HELD_OUT = 0.25
MOST_HELD_OUT = 20_000
# From this share of neighbourhoods on that are no surface (`real.roughness`) a scan teaches noise. A head of 1,400
# points has 0.7, trees from the air 0.3, points strewn in a volume 1.
NO_SURFACE = 0.9
# Points lie on a line if they are nearer to one than this share of the size of the cloud, added up as squares.
ON_A_LINE = 1e-6
# What tells a point's scan line, and its place in that; where the second is missing, the order in the file does.
LINES = ("beam", "ring", "row_index", "row", "scan_line")
PLACES = ("column", "column_index", "col")


@dataclass(frozen=True)
class OwnScan:
    """points [n,3] f64, distinct. lines [n,2] int64: a point's scan line and its place in that, each counted from 0,
    where the scan tells them."""

    name: str
    points: np.ndarray
    lines: Optional[np.ndarray] = None

    def part(self, chosen: np.ndarray) -> "OwnScan":
        """Some of its points, by index or by mask."""
        return OwnScan(self.name, self.points[chosen], None if self.lines is None else self.lines[chosen])


def load(program: Program, file: Path, folder: Path) -> OwnScan:
    """The scan in a file of any format that the program reads; `folder` takes the program's own copy."""
    table = read(program, file, folder)
    scan = OwnScan(file.stem, np.stack([table[axis] for axis in "xyz"], 1), scan_lines(table))
    check(scan, file)
    return scan


def check(scan: OwnScan, file: Path) -> None:
    """Refuses a scan that holds nothing to learn."""
    count = len(scan.points)
    if count == 1:
        raise InputError(f"{file}: all points are the same one")
    if count < LEAST:
        raise InputError(f"{file}: {count:,} distinct points; adapting needs {LEAST:,}")
    if np.linalg.matrix_rank(scan.points - scan.points.mean(0), tol=ON_A_LINE * np.ptp(scan.points, axis=0).max()) < 2:
        raise InputError(f"{file}: all points lie on a line")
    off = roughness(Truth.of(scan.points))[1]
    if off > NO_SURFACE:
        raise InputError(f"{file}: no surface around {100 * off:.0f} % of the points, so there is none to learn")


def scan_lines(table: Dict[str, np.ndarray]) -> Optional[np.ndarray]:
    """[n,2] of a table of attributes; None where none of them tells lines of at least two points on average."""
    line = next((numbered(table[name]) for name in LINES if name in table), None)
    if line is None or not 4 <= line.max() + 1 <= len(line) // 2:
        return None
    place = next((numbered(table[name]) for name in PLACES if name in table), None)
    return np.stack([line, order_within(line) if place is None else place], 1)


def numbered(values: np.ndarray) -> np.ndarray:
    """The same values, counted from 0."""
    return np.unique(values, return_inverse=True)[1].reshape(-1).astype(np.int64)


def order_within(line: np.ndarray) -> np.ndarray:
    """How many earlier points are on the same line."""
    order = np.argsort(line, kind="stable")
    first = np.searchsorted(line[order], line[order])
    place = np.empty(len(line), dtype=np.int64)
    place[order] = np.arange(len(line)) - first
    return place


def divide(scan: OwnScan) -> Tuple[OwnScan, OwnScan]:
    """What is trained on, and what is not: a quarter beyond a plane, the one of four whose points lie as densely as
    the others."""
    local = cKDTree(scan.points).query(scan.points, AROUND + 1)[0][:, AROUND]
    beyond = min(quarters(scan.points), key=lambda mask: ks_2samp(local[mask], local[~mask]).statistic)
    return scan.part(~beyond), scan.part(nearest_to_middle(scan.points, np.flatnonzero(beyond)))


def quarters(points: np.ndarray) -> Iterator[np.ndarray]:
    """Masks of the quarter that lies furthest in each direction of the two long axes of the cloud. Along the short one
    it would often be the floor alone."""
    centred = points - points.mean(0)
    axes = np.linalg.eigh(centred.T @ centred)[1].T[1:]
    for along in (sign * centred @ axis for axis in axes for sign in (1, -1)):
        mask = np.zeros(len(points), dtype=bool)
        mask[np.argsort(along, kind="stable")[-int(len(points) * HELD_OUT) :]] = True
        yield mask


def nearest_to_middle(points: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Of some points at most MOST_HELD_OUT, those nearest to their median."""
    far = np.linalg.norm(points[chosen] - np.median(points[chosen], axis=0), axis=1)
    return np.sort(chosen[np.argsort(far, kind="stable")[:MOST_HELD_OUT]])
