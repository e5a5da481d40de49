"""Scores read from `densecloud evaluate --json`."""

import math
from dataclasses import dataclass
from typing import Any, Dict, List

METHODS = ("prediction", "floor", "repeat", "midpoints")
CONTROLS = ("repeat", "midpoints")

# The published block, then the corrected one: lengths in radii of the reference, `chamfer` squared. `two_sided` is the
# mean of `to_surface` and `from_surface`. Infinite spacing variation: every point has a duplicate.
METRICS = (
    "cd",
    "hd",
    "p2f",
    "chamfer",
    "hausdorff_95",
    "to_surface",
    "from_surface",
    "two_sided",
    "spacing_variation",
)
Scores = Dict[str, float]


@dataclass(frozen=True)
class Report:
    """Scores of one evaluation: `rows[shape][method][metric]`, raw values (not times 1000)."""

    rows: Dict[str, Dict[str, Scores]]

    def means(self) -> Dict[str, Scores]:
        """The plain mean over the shapes, for each method: {method: scores}."""
        methods = [m for m in METHODS if all(m in of_shape for of_shape in self.rows.values())]
        return {method: mean([of_shape[method] for of_shape in self.rows.values()]) for method in methods}


def mean(scores: List[Scores]) -> Scores:
    """The mean of each metric; infinite where one is."""
    return {metric: sum(s[metric] for s in scores) / len(scores) for metric in METRICS}


def parse(report: Dict[str, Any]) -> Report:
    """A report from the parsed JSON. Fails with a ValueError on what is not one, or was made without a mesh."""
    rows: Dict[str, Dict[str, Scores]] = {}
    try:
        for row in report["rows"]:
            rows.setdefault(row["shape"], {})[row["method"]] = scores(row)
    except (KeyError, TypeError) as error:
        raise ValueError(f"not a report of `densecloud evaluate --mesh ... --json`: {error!r}") from error
    if not rows:
        raise ValueError("the report has no rows")
    return Report(rows)


def scores(row: Dict[str, Any]) -> Scores:
    """The scores of one row of the JSON."""
    published, corrected = row["published"], row["corrected"]
    variation = corrected["spacing_variation"]
    return {
        "cd": float(published["chamfer"]),
        "hd": float(published["hausdorff"]),
        "p2f": float(published["point_to_face"]),
        "chamfer": float(corrected["chamfer"]),
        "hausdorff_95": float(corrected["hausdorff_95"]),
        "to_surface": float(corrected["to_surface"]),
        "from_surface": float(corrected["from_surface"]),
        "two_sided": (corrected["to_surface"] + corrected["from_surface"]) / 2,
        "spacing_variation": math.inf if variation is None else float(variation),
    }


def average(first: Report, others: List[Report]) -> Report:
    """`first` with each prediction's scores averaged with those that `others`, of the same shapes, have."""
    rows = {}
    for shape, methods in first.rows.items():
        found = [methods["prediction"], *(other.rows[shape]["prediction"] for other in others)]
        rows[shape] = {**methods, "prediction": mean(found)}
    return Report(rows)
