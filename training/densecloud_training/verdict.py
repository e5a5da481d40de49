"""Whether adapted weights are better where they saw nothing: the program upsamples thinned parts of scans with both."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, List, Sequence

import numpy as np

from .own_scan import OwnScan
from .score.program import Program
from .score.real import RATIO, Truth, score, upsampled
from .score.table import markdown, plain

# Random quarters of each scan, the same ones for all weights.
THINNINGS = 5
# Better is what gains at least this share of CDH, and so many standard errors of its mean over the thinnings.
LEAST_GAIN = 0.01
ERRORS = 2.0
COLUMNS = ("CDH", "to 95 %", "from 95 %", "false L", "miss L", "thinned")

Scores = Dict[str, float]


def measure(program: Program, model: Path, scans: Sequence[OwnScan], folder: Path) -> List[Scores]:
    """The columns of `score real` for each scan and thinning, with the weights in a model folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with_model, found = replace(program, model=model), []
    for scan in scans:
        truth = Truth.of(scan.points)
        for seed in range(THINNINGS):
            kept = np.random.default_rng(seed).permutation(len(scan.points))[: len(scan.points) // RATIO]
            found.append(score(truth, kept, upsampled(with_model, scan.points[kept], folder / "held-out")))
    return found


@dataclass(frozen=True)
class Verdict:
    """Scores of the same thinnings with the weights that were there before, and with the adapted ones."""

    before: List[Scores]
    after: List[Scores]

    @property
    def gains(self) -> np.ndarray:
        """The share of CDH that each thinning gains."""
        return np.array([1 - after["CDH"] / before["CDH"] for before, after in zip(self.before, self.after)])

    @property
    def error(self) -> float:
        """The standard error of the mean gain."""
        return float(self.gains.std(ddof=1) / np.sqrt(len(self.gains)))

    @property
    def better(self) -> bool:
        """Whether the gain is larger than chance."""
        return bool(self.gains.mean() > max(LEAST_GAIN, ERRORS * self.error))

    def means(self, column: str) -> List[float]:
        """The mean of a column, before and after."""
        return [float(np.mean([row[column] for row in rows])) for rows in (self.before, self.after)]

    def __str__(self) -> str:
        rows = [
            [name, *(plain(self.means(column)[place]) for column in COLUMNS)]
            for place, name in enumerate(("before", "after"))
        ]
        gain = f"CDH gains {100 * self.gains.mean():.1f} % +- {100 * self.error:.1f} on what was held out: "
        ends = "the adapted weights are kept" if self.better else "no more than chance; the weights stay as they were"
        return markdown(["held out", *COLUMNS], rows) + "\n" + gain + ends
