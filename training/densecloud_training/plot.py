"""Draws a run's curves from its log: `python -m densecloud_training.plot RUN_OR_LOG OUT.png`."""

import argparse
import json
from pathlib import Path
from typing import Any, Dict, List

from .errors import InputError, run_command
from .train import LOG


def read_log(path: Path) -> List[Dict[str, Any]]:
    """The entries of a log file, or of the log in a run's folder."""
    path = path / LOG if path.is_dir() else path
    try:
        return [json.loads(line) for line in path.read_text().splitlines() if line.strip()]
    except ValueError as error:
        raise InputError(f"{path}: not the log of a run: {error}") from error


def relative(entries: List[Dict[str, Any]]) -> List[Dict[str, Any]]:
    """The entries with scores, each Chamfer distance over the midpoint rule's on the same patches: the controls that
    were logged last before it (a run that resumes on other data logs new ones)."""
    found, rule = [], None
    for entry in entries:
        if "controls" in entry:
            rule = entry["controls"]["midpoint"]
        if "validation" in entry and rule:
            scores = {name: score["cd"] / rule[name]["cd"] for name, score in entry["validation"].items()}
            found.append({**entry, "validation": scores})
    return found


def series(entries: List[Dict[str, Any]], key: str) -> Dict[str, Any]:
    """{name: (minutes, values)} of a table that some entries hold under `key`."""
    found: Dict[str, Any] = {}
    for entry in entries:
        for name, value in entry.get(key, {}).items():
            minutes, values = found.setdefault(name, ([], []))
            minutes.append(entry["seconds"] / 60)
            values.append(value)
    return found


def draw(entries: List[Dict[str, Any]], out: Path) -> None:
    """Two panels: training loss by ratio, and held-out Chamfer distance over that of the midpoint rule."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(12, 4.5))
    for name, (minutes, values) in sorted(series(entries, "loss").items()):
        left.plot(minutes, values, label=name, linewidth=1)
    left.set(title="training loss (Chamfer, x 1e-3)", xlabel="minutes of training", yscale="log")
    for name, (minutes, values) in series(relative(entries), "validation").items():
        style = {"even": "-", "random": "--", "noisy": ":"}.get(name.split()[0], "-")
        right.plot(minutes, values, style, label=name, linewidth=1.2)
    right.axhline(1.0, color="black", linewidth=0.8)
    right.set(title="held-out Chamfer distance / midpoint rule's", xlabel="minutes of training", ylim=(0.5, 1.5))
    starts: Dict[str, float] = {}
    for entry in entries:
        if "stage" in entry and "seconds" in entry:
            starts.setdefault(entry["stage"], entry["seconds"] / 60)
    for axis in (left, right):
        for minutes in list(starts.values())[1:]:
            axis.axvline(minutes, color="0.8", linewidth=0.8, zorder=0)
        axis.grid(alpha=0.2)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(out, dpi=90)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("out", type=Path)
    arguments = parser.parse_args()
    draw(read_log(arguments.run), arguments.out)


if __name__ == "__main__":
    run_command(main)
