"""Real scans, thinned to a quarter and upsampled back: how near the points come that were taken away.

A dense scan stands for the truth, as far as its own noise lets it. Its points that are kept say nothing of a method
that copies them, so only those that were taken away are looked for. Lengths are in the scan's median spacing; columns
with an `L` are in its local scale, the distance to the 8th neighbour, since scan lines lie far apart in one
direction.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Dict, List, Optional

import numpy as np
from scipy.spatial import cKDTree

from .program import Program
from .range_image import range_image
from .table import markdown, plain

RATIO = 4
# Points of a scan that are looked at: those nearest to one of its points.
MOST = 40_000
# The neighbour that tells a local scale.
AROUND = 8
# Neighbours that the midpoint rule joins a point to.
JOINED = 7
# Of how many neighbours roughness is taken, and from which share of the middle axis on they are no surface.
SHEET = 32
NO_SURFACE = 0.35

Thinning = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Scan:
    """A scan: its file, and where its sensor stood if it stood inside."""

    file: str
    sensor: Optional[List[float]] = None
    # Attributes that tell a point's scan line, and its place in that.
    lines: Optional[List[str]] = None


SCANS = (
    Scan("ouster_os1_128.ply", [0, 0, 0], ["beam", "column"]),
    Scan("ouster_os0_128.ply", [0, 0, 0], ["beam", "column"]),
    Scan("ouster_map.ply"),
    Scan("pump_tls.e57", None, ["row_index", "column_index"]),
    Scan("pdal_autzen_trim.laz"),
    Scan("cgal_building.ply"),
    Scan("cgal_oni.pwn"),
    Scan("pcl_room_scan1.pcd"),
    Scan("pcl_lamppost.pcd"),
    Scan("pcl_milk.pcd"),
    Scan("pcl_region_growing_tutorial.pcd"),
    Scan("pcl_table_scene_mug_stereo_textured.pcd"),
)

HEADER = ["scan", "thinning", "method", "CDH", "to 95 %", "from 95 %", "false 1", "false 2", "false L", "miss 1",
          "miss L", "thinned", "variation"]  # fmt: skip
NOTE = """CDH: mean distance from the points that were taken away to the result, and from the result to the scan, \
added. `to 95 %` and `from 95 %`: the 95th percentiles of these. False: share of the result, %, further from the scan \
than 1 or 2 spacings, or than its local scale (L). Miss: share of the scan, %, further from the result. Thinned: share \
of the input's points, %, whose 8th neighbour in the result is further off than their 8th neighbour in the input was. \
Variation: of the distances to the nearest other, in the local scale. Repeated: the input itself, do nothing. \
Midpoints: the input, and the middles between each point and its nearest ones. Range image: the input, and what lies \
between neighbours of the image that the sensor saw, whose ranges differ by no more than a tenth; it knows lines, \
places and where the sensor stood, and has fewer points than the others. Resampled: as many points as \
the scan has, on the surface of the *whole* scan, which no method may see: what a surface can reach here.
"""


@dataclass(frozen=True)
class Truth:
    """A scan's points and what they are measured in."""

    points: np.ndarray
    tree: cKDTree
    spacing: float
    local: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray) -> "Truth":
        tree = cKDTree(points)
        distances = tree.query(points, AROUND + 1)[0]
        return cls(points, tree, float(np.median(distances[:, 1])), distances[:, AROUND])


def cropped(points: np.ndarray, seed: int = 5) -> np.ndarray:
    """Indices of the points nearest to one of them, at most MOST."""
    if len(points) <= MOST:
        return np.arange(len(points))
    middle = points[np.random.default_rng(seed).integers(len(points))]
    return np.sort(cKDTree(points).query(middle, MOST)[1])


def at_random(points: np.ndarray) -> np.ndarray:
    """A quarter, each as likely as the others."""
    return np.random.default_rng(3).permutation(len(points))[: len(points) // RATIO]


def evenly(points: np.ndarray) -> np.ndarray:
    """A quarter by farthest point sampling."""
    chosen = np.zeros(len(points) // RATIO, dtype=np.int64)
    nearest = np.full(len(points), np.inf)
    for i in range(1, len(chosen)):
        offset = points - points[chosen[i - 1]]
        np.minimum(nearest, np.einsum("ij,ij->i", offset, offset), out=nearest)
        chosen[i] = int(np.argmax(nearest))
    return chosen


def by_range(sensor: List[float]) -> Thinning:
    """A quarter, the fewer the further from the sensor."""

    def thin(points: np.ndarray) -> np.ndarray:
        far = np.linalg.norm(points - np.asarray(sensor), axis=1)
        likely = 1 / np.maximum(far, np.quantile(far, 0.02))
        # Efraimidis and Spirakis: the largest of such numbers are a weighted sample.
        keys = np.random.default_rng(3).random(len(points)) ** (likely.mean() / likely)
        return np.argsort(-keys)[: len(points) // RATIO]

    return thin


def by_lines(line: np.ndarray, place: np.ndarray) -> Thinning:
    """Every second line, and every second point of these."""
    kept = np.flatnonzero((line.astype(np.int64) % 2 == 0) & (place.astype(np.int64) % 2 == 0))
    return lambda _: kept


def midpoint_pairs(kept: np.ndarray) -> np.ndarray:
    """[m,2]: the pairs of each point and its nearest ones, those of the very nearest first; with the points themselves
    RATIO times as many."""
    neighbours = cKDTree(kept).query(kept, JOINED + 1)[1][:, 1:]
    own = np.arange(len(kept))
    pairs = np.concatenate([np.sort(np.stack([own, theirs], 1), 1) for theirs in neighbours.T])
    _, first = np.unique(pairs, axis=0, return_index=True)
    return pairs[np.sort(first)][: len(kept) * (RATIO - 1)]


def midpoints(kept: np.ndarray) -> np.ndarray:
    """The points, and the middles between each and its nearest ones."""
    pairs = midpoint_pairs(kept)
    return np.concatenate([kept, (kept[pairs[:, 0]] + kept[pairs[:, 1]]) / 2])


def along_range_image(scan: Scan, table: Dict[str, np.ndarray]) -> np.ndarray:
    """The control that knows the sensor. A scan with rows and columns has it at its origin unless it says otherwise."""
    line, place = (table[name].astype(np.int64) for name in scan.lines or [])
    points = np.stack([table[axis] for axis in "xyz"], 1)
    return range_image(points, line, place, np.asarray(scan.sensor or [0, 0, 0], dtype=np.float64))


def score(truth: Truth, kept: np.ndarray, result: np.ndarray) -> Dict[str, float]:
    """All columns for one result. `kept` are indices."""
    taken = np.ones(len(truth.points), dtype=bool)
    taken[kept] = False
    source = truth.points[kept]
    tree = cKDTree(result)
    to_result = tree.query(truth.points)[0]
    to_truth, nearest = truth.tree.query(result)
    before = cKDTree(source).query(source, AROUND + 1)[0][:, AROUND]
    # The input's points need not be in the result: no point of that is the point itself.
    after = tree.query(source, AROUND)[0][:, AROUND - 1]
    others = tree.query(result, AROUND + 1)[0]
    relative = others[:, 1] / np.maximum(others[:, AROUND], 1e-300)
    spacing, local = truth.spacing, truth.local
    share = lambda mask: 100 * float(mask.mean())  # noqa: E731
    return {
        "CDH": float(to_result[taken].mean() + to_truth.mean()) / spacing,
        "to 95 %": float(np.quantile(to_result[taken], 0.95)) / spacing,
        "from 95 %": float(np.quantile(to_truth, 0.95)) / spacing,
        "false 1": share(to_truth > spacing),
        "false 2": share(to_truth > 2 * spacing),
        "false L": share(to_truth > local[nearest]),
        "miss 1": share(to_result > spacing),
        "miss L": share(to_result > local),
        # Rounding must not count.
        "thinned": share(after > before * (1 + 1e-6)),
        "variation": float(relative.std() / max(relative.mean(), 1e-300)),
    }


def roughness(truth: Truth) -> "tuple[float, float]":
    """Root mean square distance off the plane of 32 neighbours in spacings (median over the scan), and the share of
    points whose neighbours are no surface."""
    chosen = np.random.default_rng(1).permutation(len(truth.points))[:2000]
    near = truth.points[truth.tree.query(truth.points[chosen], min(SHEET, len(truth.points)))[1]]
    near = near - near.mean(axis=1, keepdims=True)
    axes = np.linalg.eigvalsh(np.einsum("nij,nik->njk", near, near) / near.shape[1])
    off = np.sqrt(np.maximum(axes[:, 0], 0)) / truth.spacing
    rough = np.sqrt(np.maximum(axes[:, 0], 0)) > NO_SURFACE * np.sqrt(np.maximum(axes[:, 1], 1e-300))
    return float(np.median(off)), float(rough.mean())


@dataclass(frozen=True)
class Row:
    """One method on one thinning of one scan."""

    scan: str
    thinning: str
    method: str
    scores: Dict[str, float]


def thinnings(scan: Scan, table: Dict[str, np.ndarray], chosen: np.ndarray) -> Dict[str, Thinning]:
    """All that the scan allows."""
    found: Dict[str, Thinning] = {"random": at_random, "even": evenly}
    if scan.sensor is not None:
        found["range"] = by_range(scan.sensor)
    if scan.lines and all(name in table for name in scan.lines):
        line, place = (table[name][chosen] for name in scan.lines)
        found["lines"] = by_lines(line, place)
    return found


def evaluate(program: Program, folders: List[Path], out: Path, only: List[str]) -> "tuple[List[Row], List[List[str]]]":
    """Scores every scan that is there, and tells what each is like."""
    rows, facts = [], []
    for scan in SCANS:
        found = [folder / scan.file for folder in folders if (folder / scan.file).exists()]
        name = Path(scan.file).stem
        if not found or (only and name not in only):
            continue
        table = read(program, found[0], out / "real")
        whole = np.stack([table[axis] for axis in "xyz"], 1)
        chosen = cropped(whole)
        truth = Truth.of(whole[chosen])
        rough, no_surface = roughness(truth)
        resampled = upsampled(program, truth.points, out / "real" / f"{name}-whole", ratio=1)
        facts.append([name, f"{len(truth.points):,}", f"{truth.spacing:.3g}", plain(rough), plain(100 * no_surface, 1)])
        for thinning, thin in thinnings(scan, table, chosen).items():
            kept = thin(truth.points)
            source = truth.points[kept]
            results = {"repeated": source, "midpoints": midpoints(source)}
            if thinning == "lines":
                results["range image"] = along_range_image(scan, {name: table[name][chosen][kept] for name in table})
            results["densecloud"] = upsampled(program, source, out / "real" / f"{name}-{thinning}")
            results["resampled"] = resampled
            rows += [Row(name, thinning, method, score(truth, kept, points)) for method, points in results.items()]
    return rows, facts


def upsampled(program: Program, source: np.ndarray, place: Path, ratio: int = RATIO) -> np.ndarray:
    """What the program makes of an array; both are left beside each other."""
    given, made = place.with_suffix(".npy"), place.with_name(place.name + "-dense.npy")
    np.save(given, source)
    program.upsample(given, made, "--ratio", ratio)
    return points_of(np.load(made))


def points_of(array: np.ndarray) -> np.ndarray:
    """[n,3] f64 of a table, or of a structure with the fields x, y and z."""
    if array.dtype.names is None:
        return array[:, :3].astype(np.float64)
    return np.stack([array[axis] for axis in "xyz"], 1).astype(np.float64)


def read(program: Program, file: Path, kept: Path) -> Dict[str, np.ndarray]:
    """The columns of a scan's distinct points: the program reads every format. Kept as NumPy's, once."""
    kept.mkdir(parents=True, exist_ok=True)
    converted = kept / f"{file.stem}.npy"
    if not (converted.exists() and converted.stat().st_mtime_ns >= file.stat().st_mtime_ns):
        program.run("upsample", file, converted, "--ratio", 1, "--keep-input", "--no-polish", "--quiet")
    array = np.load(converted)
    points = points_of(array)
    _, first = np.unique(points, axis=0, return_index=True)
    first.sort()
    columns = {axis: points[first, a] for a, axis in enumerate("xyz")}
    for name in array.dtype.names or ():
        columns.setdefault(name, array[name][first])
    return columns


def text(rows: List[Row], facts: List[List[str]]) -> str:
    """The table of all rows, how often the program is ahead, and what the scans are like."""
    cells = [[row.scan, row.thinning, row.method, *(plain(row.scores[name]) for name in HEADER[3:])] for row in rows]
    counted = []
    cases = {(row.scan, row.thinning): {} for row in rows}
    for row in rows:
        cases[row.scan, row.thinning][row.method] = row.scores["CDH"]
    for control in ("repeated", "midpoints", "range image", "resampled"):
        both = [(case["densecloud"], case[control]) for case in cases.values() if control in case]
        if both:
            ahead = sum(ours < theirs for ours, theirs in both)
            means = [plain(float(mean)) for mean in np.mean(both, axis=0)]
            counted.append([control, f"{ahead} of {len(both)}", *means])
    worst = max((row.scores["thinned"] for row in rows if row.method == "densecloud"), default=0.0)
    return "\n".join(
        [
            NOTE,
            markdown(HEADER, cells),
            markdown(["control", "CDH is better than its", "mean CDH", "its mean"], counted),
            f"Thinned at most: {plain(worst)} %.\n",
            markdown(["scan", "points", "spacing", "off the plane of 32, in spacings", "no surface, %"], facts),
        ]
    )
