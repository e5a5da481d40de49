"""Curves of the corrected metrics over noise, points removed from the input, and outliers in it."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List

from .inputs import Inputs, remaining
from .report import METHODS, Report, Scores
from .table import markdown, plain, thousandths

POINTS = 2048
POINTS_OUT = 8192
NOISE = (0.0, 0.0025, 0.005, 0.01, 0.015, 0.02)
REMOVED = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
OUTLIERS = (0.0, 0.001, 0.005, 0.01, 0.02, 0.05)

# Metric: label with unit, factor.
PANELS = {
    "chamfer": ("Chamfer distance (squared, x 1e-3)", 1000),
    "hausdorff_95": ("95th percentile of distances (x 1e-3 radii)", 1000),
    "two_sided": ("two-sided distance to the surface (x 1e-3 radii)", 1000),
    "spacing_variation": ("variation of the spacing (0: a grid)", 1),
}
AXES = {
    "noise": "noise, % of half the bounding box's diagonal",
    "removed": "input points removed, %",
    "outliers": "outliers among the input points, %",
}
STYLES = {
    "prediction": {"color": "C0", "marker": "o", "linewidth": 2, "label": "densecloud"},
    "midpoints": {"color": "C1", "marker": "s", "label": "midpoints (nothing learned)"},
    "repeat": {"color": "C2", "marker": "^", "label": "input repeated"},
    "floor": {"color": "0.4", "linestyle": "--", "label": "floor (a second sample)"},
}


@dataclass(frozen=True)
class Step:
    """One point of a curve: `sweep` is a key of AXES, `share` what the input suffered, `means` by method."""

    sweep: str
    share: float
    report: Report

    @property
    def means(self) -> Dict[str, Scores]:
        return self.report.means()


def evaluate(inputs: Inputs) -> List[Step]:
    """Scores every step of all sweeps. All clouds have the same size, so every score has the same floor."""
    wanted = inputs.references(POINTS_OUT)

    def scored(given: Path, points: int) -> Report:
        kept = inputs.out / "results"
        return inputs.program.evaluate(kept, given, wanted, inputs.meshes, inputs.shapes, POINTS_OUT / points)

    steps = [Step("noise", share, scored(inputs.sampled(POINTS, noise=share), POINTS)) for share in NOISE]
    for share in REMOVED:
        steps.append(Step("removed", share, scored(inputs.with_removed(POINTS, share), remaining(POINTS, share))))
    steps += [Step("outliers", share, scored(inputs.with_outliers(POINTS, share), POINTS)) for share in OUTLIERS]
    return steps


def as_json(steps: List[Step]) -> List[Dict[str, Any]]:
    """Means and every shape's scores; JSON has no infinity, so an infinite score is null."""

    def finite(scores: Dict[str, Scores]) -> Dict[str, Dict[str, Any]]:
        return {m: {k: v if math.isfinite(v) else None for k, v in s.items()} for m, s in scores.items()}

    return [
        {
            "sweep": step.sweep,
            "share": step.share,
            "means": finite(step.means),
            "shapes": {shape: finite(scores) for shape, scores in step.report.rows.items()},
        }
        for step in steps
    ]


def text(steps: List[Step]) -> str:
    """A table for each sweep, in Markdown."""
    shapes = len(steps[0].report.rows)
    parts = [
        f"Mean of {shapes} held-out shapes, {POINTS:,} Poisson-disk points in, {POINTS_OUT:,} out. Chamfer (squared) / "
        "95th percentile of distances / two-sided distance to the surface, x 1e-3 in radii of the reference; then the "
        "variation of the spacing (a dash: every point has a duplicate). Noise is Gaussian, by its deviation. Points "
        "are removed at random; the ratio grows from 4 to 8 to give as many points. Outliers are points that lie "
        "anywhere in the bounding box, made a fifth larger, instead of on the surface; they count in all scores.\n"
    ]
    for sweep, axis in AXES.items():
        rows = [
            [f"{step.share * 100:g}", *(cell(step.means[method]) for method in METHODS)]
            for step in steps
            if step.sweep == sweep
        ]
        parts.append(markdown([axis, *METHODS], rows))
    return "\n".join(parts)


def cell(scores: Scores) -> str:
    """The four scores of a panel each."""
    lengths = f"{thousandths(scores['hausdorff_95'], 1)} / {thousandths(scores['two_sided'], 2)}"
    return f"{thousandths(scores['chamfer'])} / {lengths}, {plain(scores['spacing_variation'])}"


def draw(steps: List[Step], out: Path) -> None:
    """A row of panels for each sweep, one panel a metric."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, rows = pyplot.subplots(len(AXES), len(PANELS), figsize=(15, 10), sharey="col")
    for row, (sweep, axis_label) in zip(rows, AXES.items()):
        of_sweep = [step for step in steps if step.sweep == sweep]
        for panel, (metric, (label, factor)) in zip(row, PANELS.items()):
            for method, style in STYLES.items():
                values = [step.means[method][metric] * factor for step in of_sweep]
                if all(map(math.isfinite, values)):
                    panel.plot([100 * step.share for step in of_sweep], values, markersize=4, **style)
            panel.set(xlabel=axis_label, title=label)
            panel.title.set_fontsize(10)
            panel.grid(alpha=0.25)
            panel.tick_params(labelleft=True)
    for panel in rows[-1]:
        # Only now, and for the column: a limit that is set ends the fitting of axes to data.
        panel.set_ylim(bottom=0)
    figure.legend(*rows[0][0].get_legend_handles_labels(), loc="lower center", ncols=len(STYLES), frameon=False)
    shapes = len(steps[0].report.rows)
    figure.suptitle(
        f"{POINTS:,} points to {POINTS_OUT:,}, mean of {shapes} held-out shapes; lower is better. "
        "Repeated input has no spacing to vary.",
        fontsize=11,
    )
    figure.tight_layout(rect=(0, 0.04, 1, 1))
    figure.savefig(out, dpi=80)
