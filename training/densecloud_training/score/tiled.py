"""The same clouds in one piece and in tiles: whether the columns of `validation` and of `real` tell them apart."""

from dataclasses import replace
from pathlib import Path
from typing import Dict, List

import numpy as np

from .inputs import Inputs
from .program import Program
from .real import SCANS, Truth, at_random, read, score, upsampled
from .table import markdown, plain, published, thousandths

POINTS = 60_000
RATIO = 4
TILES = (1, 7, 60)
# What is shown beside them: as much may differ by chance.
SEEDS = (1, 2)
# A few of each: a cloud in 60 tiles is five times as much work.
SHAPES = 4
SCANNED = ("pdal_autzen_trim", "pump_tls", "ouster_os1_128")
COLUMNS = ("CDH", "from 95 %", "false 2", "false L", "miss 1", "miss L", "thinned", "variation")
NOTE = f"""{POINTS:,} points, {RATIO} times as many out. A seed chooses among equally good results: what two of them \
differ by is chance. Tiles have 1,000 points at least, and four times as many around them then. Of scans a random \
quarter is upsampled back.
"""


def ways(points: int) -> Dict[str, List[str]]:
    """Options by name: so many tiles, and other seeds in one piece."""
    size = lambda tiles: ["--tile-points", str(max(1000, -(-points // tiles)))]  # noqa: E731
    ways = {f"{tiles} tiles" if tiles > 1 else "whole": size(tiles) for tiles in TILES}
    ways.update({f"whole, seed {seed}": [*size(1), "--seed", str(seed)] for seed in SEEDS})
    return ways


def shapes(inputs: Inputs) -> List[List[str]]:
    """Rows of means over the shapes, sampled at random."""
    given, reference = inputs.sampled(POINTS, method="uniform"), inputs.references(POINTS * RATIO)
    rows = []
    for way, options in ways(POINTS).items():
        folder = inputs.out / "tiles" / way.replace(" ", "-").replace(",", "")
        folder.mkdir(parents=True, exist_ok=True)
        for shape in inputs.shapes:
            inputs.program.upsample(given / f"{shape}.ply", folder / f"{shape}.ply", "--ratio", RATIO, *options)
        mean = inputs.program.score(folder, reference, inputs.meshes, inputs.shapes).means()["prediction"]
        corrected = [thousandths(mean[metric], 4) for metric in ("chamfer", "hausdorff_95", "two_sided")]
        rows.append(
            [way, published(mean["cd"], mean["hd"], mean["p2f"]), *corrected, plain(mean["spacing_variation"], 4)]
        )
    return rows


def scans(program: Program, folders: List[Path], out: Path) -> List[List[str]]:
    """Rows of each scan that is there, a random quarter of which is upsampled back."""
    rows: List[List[str]] = []
    for scan in SCANS:
        found = [folder / scan.file for folder in folders if (folder / scan.file).exists()]
        name = Path(scan.file).stem
        if not found or name not in SCANNED:
            continue
        table = read(program, found[0], out / "real")
        whole = np.stack([table[axis] for axis in "xyz"], 1)
        truth = Truth.of(whole)
        kept = at_random(truth.points)
        for number, (way, options) in enumerate(ways(len(kept)).items()):
            one = replace(program, options=[*program.options, *options])
            columns = score(truth, kept, upsampled(one, truth.points[kept], out / "tiles" / f"{name}-{number}"))
            rows.append([name, way, *(plain(columns[column], 3) for column in COLUMNS)])
    return rows


def text(of_shapes: List[List[str]], of_scans: List[List[str]]) -> str:
    """Both tables, in Markdown."""
    header = ["result", "CD / HD / P2F", "chamfer", "hausdorff 95", "two-sided", "spacing variation"]
    return "\n".join([NOTE, markdown(header, of_shapes), markdown(["scan", "result", *COLUMNS], of_scans)])
