"""Held-out shapes, beside the controls: a table of means, and where the network does not earn its keep."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List

import numpy as np

from ..prepare import read_points
from .inputs import Inputs
from .report import CONTROLS, METHODS, Report, Scores
from .table import markdown, plain, published, thousandths

POINTS = 2048
# Of a sample of the surface that is neither an input nor a reference.
EXACT_SEED = 2


@dataclass(frozen=True)
class Setting:
    """One kind of input, and how much denser it is to become."""

    name: str
    ratio: int
    method: str = "poisson"
    noise: float = 0.0
    # Whether the network must be better than the controls on every shape.
    must: bool = False


SETTINGS = (
    Setting("4x, even input", 4, must=True),
    Setting("4x, random input", 4, method="uniform"),
    Setting("4x, even input with 1 % noise", 4, noise=0.01, must=True),
    Setting("16x, even input", 16),
)

HEADER = ["input", "method", "CD / HD / P2F", "chamfer", "hausdorff 95", "to surface", "from surface", "two-sided",
          "spacing variation"]  # fmt: skip
NOTE = """All but the spacing variation x 1e-3. CD / HD / P2F as published (each cloud scaled by itself; the first two \
squared). The others are corrected: one scale for both clouds, lengths in radii of the reference, `chamfer` squared; \
`two-sided` is the mean of the distances to and from the surface. Spacing variation: 0 is a grid, and a dash stands \
for clouds whose points all have duplicates. Noise: Gaussian, its deviation as a share of half the diagonal of the \
bounding box.
"""

# What must be better than both controls: name, and the metric. `cd` and `chamfer` are taken above the floor.
CHECKS: Dict[str, str] = {
    "excess CD": "cd",
    "excess chamfer": "chamfer",
    "two-sided distance": "two_sided",
    "spacing variation": "spacing_variation",
}


@dataclass(frozen=True)
class Loss:
    """A control that is as good as the network, or better, on one shape."""

    shape: str
    check: str
    control: str
    ours: float
    theirs: float


def value(scores: Dict[str, Scores], method: str, metric: str) -> float:
    """A method's score in a check: above the floor for squared distances to the reference, which even a perfect cloud
    has."""
    floor = scores["floor"][metric] if metric in ("cd", "chamfer") else 0.0
    return scores[method][metric] - floor


def losses(report: Report) -> List[Loss]:
    """Every shape, check and control in which the network is not better.

    Repeating the input has no spacing variation (every point has a duplicate): that counts as infinite, the worst there
    is, and its distance *to* the surface of 0 counts for half of its two-sided distance."""
    found = []
    for shape, scores in report.rows.items():
        for check, metric in CHECKS.items():
            ours = value(scores, "prediction", metric)
            for control in CONTROLS:
                theirs = value(scores, control, metric)
                if math.isnan(ours) or not ours < theirs:
                    found.append(Loss(shape, check, control, ours, theirs))
    return found


def means_rows(name: str, report: Report) -> List[List[str]]:
    """The rows of one setting in the table of means."""
    rows = []
    for method, scores in report.means().items():
        lengths = ("hausdorff_95", "to_surface", "from_surface", "two_sided")
        rows.append([
            name if method == METHODS[0] else "",
            method,
            published(scores["cd"], scores["hd"], scores["p2f"]),
            thousandths(scores["chamfer"]),
            *(thousandths(scores[metric], 2) for metric in lengths),
            plain(scores["spacing_variation"]),
        ])  # fmt: skip
    return rows


def counts_row(setting: Setting, report: Report) -> List[str]:
    """Of how many shapes each check holds against both controls, and of how many all do."""
    lost = losses(report)
    total = len(report.rows)
    cells = [total - len({loss.shape for loss in lost if loss.check == check}) for check in CHECKS]
    cells.append(total - len({loss.shape for loss in lost}))
    must = "must" if setting.must else ""
    return [setting.name, must, *(f"{cell} of {total}" for cell in cells)]


def published_cd(prediction: np.ndarray, reference: np.ndarray, centroid: np.ndarray) -> float:
    """The published Chamfer distance, x 1, of [n,3] to [m,3], the prediction scaled about `centroid` instead of its own
    mean. Brute force: O(n m) time."""

    def scaled(points: np.ndarray, middle: np.ndarray) -> np.ndarray:
        points = points - middle
        return points / np.sqrt((points**2).sum(1).max())

    def one_way(p: np.ndarray, q: np.ndarray) -> float:
        squares = [((a**2).sum(1)[:, None] + (q**2).sum(1) - 2 * a @ q.T).min(1) for a in np.array_split(p, 16)]
        return float(np.maximum(np.concatenate(squares), 0).mean())

    p, q = scaled(prediction, centroid), scaled(reference, reference.mean(0))
    return one_way(p, q) + one_way(q, p)


def centroid_alone(given: Path, exact: Path, reference: Path, shape: str) -> float:
    """What the input's centroid costs in the published Chamfer distance, if all else is perfect: that of an exact
    sample of the surface, scaled about the input's centroid, above that of the same sample scaled about its own."""
    points = read_points(exact / f"{shape}.ply")
    wanted = read_points(reference / f"{shape}.ply")
    middle = read_points(given / f"{shape}.ply").mean(0)
    return published_cd(points, wanted, middle) - published_cd(points, wanted, points.mean(0))


def losses_table(report: Report, alone: Dict[str, float]) -> str:
    """One row for each shape that loses a check; in a cell our score against the better control's, and its name. Last
    what the input's centroid costs `alone`."""
    found: Dict[str, Dict[str, Loss]] = {}
    for loss in losses(report):
        cells = found.setdefault(loss.shape, {})
        if loss.check not in cells or loss.theirs < cells[loss.check].theirs:
            cells[loss.check] = loss

    def cell(loss: Loss) -> str:
        show = plain if CHECKS[loss.check] == "spacing_variation" else thousandths
        return f"{show(loss.ours)} against {show(loss.theirs)} ({loss.control})"

    rows = [
        [shape, *(cell(cells[c]) if c in cells else "" for c in CHECKS), thousandths(alone[shape])]
        for shape, cells in found.items()
    ]
    return markdown(["shape", *CHECKS, "an exact sample about the input's centroid"], rows)


def text(reports: Dict[Setting, Report], alone: Dict[Setting, Dict[str, float]]) -> str:
    """The whole of it, in Markdown."""
    shapes = len(next(iter(reports.values())).rows)
    parts = [f"Mean of {shapes} held-out shapes, {POINTS:,} points in.\n", NOTE]
    parts.append(markdown(HEADER, [row for s, report in reports.items() for row in means_rows(s.name, report)]))
    parts.append(
        'Shapes on which the network is better than both controls (repeated input, midpoints), by column; "must" '
        "marks the inputs on which it has to be on every shape. Excess: above the floor. Repeated input has no spacing "
        "variation and counts as worse than any; its distance to the surface of 0 is half of its two-sided distance.\n"
    )
    counts = [counts_row(setting, report) for setting, report in reports.items()]
    parts.append(markdown(["input", "", *CHECKS, "all"], counts))
    for setting, report in reports.items():
        if setting.must and losses(report):
            parts.append(f"Where it is not, {setting.name} (network against the better control; x 1e-3 but for the "
                         "spacing variation; last the excess CD of points that lie exactly and evenly on the surface, "
                         "when they are scaled about the input's centroid instead of their own):\n")  # fmt: skip
            parts.append(losses_table(report, alone[setting]))
    return "\n".join(parts)


def centroids_alone(inputs: Inputs, reports: Dict[Setting, Report]) -> Dict[Setting, Dict[str, float]]:
    """`centroid_alone` of every shape that loses a check in a setting in which it must not."""
    alone: Dict[Setting, Dict[str, float]] = {}
    for setting, report in reports.items():
        shapes = {loss.shape for loss in losses(report)} if setting.must else set()
        if not shapes:
            continue
        given = inputs.sampled(POINTS, setting.method, setting.noise)
        wanted = inputs.references(POINTS * setting.ratio)
        exact = inputs.sampled(POINTS * setting.ratio, seed=EXACT_SEED)
        alone[setting] = {shape: centroid_alone(given, exact, wanted, shape) for shape in sorted(shapes)}
    return alone


def evaluate(inputs: Inputs) -> Dict[Setting, Report]:
    """Scores every setting."""
    reports = {}
    for setting in SETTINGS:
        given = inputs.sampled(POINTS, setting.method, setting.noise)
        wanted = inputs.references(POINTS * setting.ratio)
        kept = inputs.out / "results"
        reports[setting] = inputs.program.evaluate(
            kept, given, wanted, inputs.meshes, inputs.shapes, float(setting.ratio)
        )
    return reports
