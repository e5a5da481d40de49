"""How well `--spacing` and `--density` are met: measured on held-out shapes by the program's own `inspect`."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Tuple

from .inputs import Inputs, find_mesh
from .program import Program
from .table import markdown

SIZES = (3000, 20_000)
METHODS = ("poisson", "uniform")
# So many even points show all of a held-out shape's surface.
WHOLE = 80_000
RATIO = 4.0
WITHIN = 0.05


@dataclass(frozen=True)
class Result:
    """What one kind of input came to: shape -> share by which the wish was missed."""

    method: str
    points: int
    spacing: Dict[str, float]
    density: Dict[str, float]


def inspect(program: Program, cloud: Path) -> Dict[str, float]:
    """What `inspect` measures."""
    return json.loads(program.run("inspect", cloud, "--json"))


def evaluate(inputs: Inputs, out: Path) -> List[Result]:
    """Asks for half of the input's spacing, and for four times its density, and looks at what comes."""
    program, results = inputs.program, []
    areas = {}
    for shape in inputs.shapes:
        whole = program.sample(find_mesh(inputs.meshes, shape), out / "targets" / f"{shape}-{WHOLE}.ply", WHOLE, 1)
        areas[shape] = inspect(program, whole)["area"]
    for method in METHODS:
        for points in SIZES:
            found: Tuple[Dict[str, float], Dict[str, float]] = ({}, {})
            for shape in inputs.shapes:
                cloud = out / "targets" / f"{shape}-{method}-{points}.ply"
                program.sample(find_mesh(inputs.meshes, shape), cloud, points, 0, "--method", method)
                spacing = 0.885 * (areas[shape] / points / RATIO) ** 0.5
                dense = program.upsample(cloud, out / "targets" / "dense.ply", "--spacing", spacing)
                found[0][shape] = inspect(program, dense)["mean_spacing"] / spacing - 1
                density = RATIO * points / areas[shape]
                dense = program.upsample(cloud, out / "targets" / "dense.ply", "--density", density)
                found[1][shape] = inspect(program, dense)["points"] / areas[shape] / density - 1
            results.append(Result(method, points, *found))
    return results


def text(results: List[Result]) -> str:
    """The table."""
    header = ["input", "spacing reached, against that asked for", "density", f"within {WITHIN:.0%}", "furthest off"]
    rows = []
    for result in results:
        furthest = sorted(result.density.items(), key=lambda item: -abs(item[1]))[:2]
        within = [sum(abs(v) <= WITHIN for v in values.values()) for values in (result.spacing, result.density)]
        rows.append([
            f"{result.points:,} {'even' if result.method == 'poisson' else 'random'} points",
            spread(result.spacing),
            spread(result.density),
            f"{within[0]} and {within[1]} of {len(result.spacing)}",
            ", ".join(f"{shape} {value:+.1%}" for shape, value in furthest),
        ])  # fmt: skip
    return markdown(header, rows)


def spread(values: Dict[str, float]) -> str:
    """Lowest, median and highest."""
    ordered = sorted(values.values())
    return f"{ordered[0]:+.1%} to {ordered[-1]:+.1%}, median {ordered[len(ordered) // 2]:+.1%}"
