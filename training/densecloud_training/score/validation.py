"""Held-out shapes, beside the controls: a table of means, and where the network does not earn its keep."""

import math
from dataclasses import dataclass
from typing import Dict, List

from .inputs import Inputs
from .report import CONTROLS, METHODS, Report, Scores
from .table import markdown, plain, published, thousandths

POINTS = 2048


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


def losses_table(report: Report) -> str:
    """One row for each shape that loses a check; in a cell our score against the better control's, and its name."""
    found: Dict[str, Dict[str, Loss]] = {}
    for loss in losses(report):
        cells = found.setdefault(loss.shape, {})
        if loss.check not in cells or loss.theirs < cells[loss.check].theirs:
            cells[loss.check] = loss

    def cell(loss: Loss) -> str:
        show = plain if CHECKS[loss.check] == "spacing_variation" else thousandths
        return f"{show(loss.ours)} against {show(loss.theirs)} ({loss.control})"

    rows = [[shape, *(cell(cells[c]) if c in cells else "" for c in CHECKS)] for shape, cells in found.items()]
    return markdown(["shape", *CHECKS], rows)


def text(reports: Dict[Setting, Report]) -> str:
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
                         "spacing variation):\n")  # fmt: skip
            parts.append(losses_table(report))
    return "\n".join(parts)


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
