"""A picture of the thinned scans on which the program is furthest behind doing nothing.

From left: the scan, its thinned quarter, what midpoints and the program make of that; about the place where most of the
program's points lie where the scan has none.
"""

from pathlib import Path
from typing import Dict, List, Tuple

import numpy as np
from scipy.spatial import cKDTree

from .inputs import write_points
from .pictures import COLOURS, VIEWS, View, beside
from .program import Program
from .real import Row, midpoints, points_of

CASES = 6
# Points of the scan that a picture shows, and points of the result that tell where that is.
SHOWN = 3_000
PLACE = 300
SIZE = "240x240"


def cases(rows: List[Row]) -> List[Tuple[str, str]]:
    """Scan and thinning, the worst first: by what is lost in CDH against the input repeated."""
    found: Dict[Tuple[str, str], Dict[str, float]] = {}
    for row in rows:
        found.setdefault((row.scan, row.thinning), {})[row.method] = row.scores["CDH"]
    lost = {case: scores["densecloud"] - scores["repeated"] for case, scores in found.items()}
    return sorted(lost, key=lambda case: -lost[case])[:CASES]


def draw(program: Program, rows: List[Row], out: Path) -> Path:
    """`OUT/pictures/real_worst.png`, the worst case first, from the clouds that `real.evaluate` left in `out`."""
    views = {view.scan: view for view in VIEWS}
    pictures = []
    for scan, thinning in cases(rows):
        whole, given = (np.load(out / "real" / f"{scan}-{kind}.npy") for kind in ("whole", thinning))
        made = points_of(np.load(out / "real" / f"{scan}-{thinning}-dense.npy"))
        near = around(whole, made)
        known = views.get(scan)
        view = View(f"real-{scan}-{thinning}", known.view if known else "30,30", known.up if known else "z", size=SIZE)
        clouds = []
        for kind, points in (("scan", whole), ("given", given), ("midpoints", midpoints(given)), ("made", made)):
            clouds.append(out / "real" / f"{scan}-{thinning}-{kind}.xyz")
            write_points(clouds[-1], points[near.contains(points)])
        pictures.append(beside(program, clouds, view, out))
    return stacked(pictures, out / "pictures" / "real_worst.png")


def stacked(pictures: List[Path], to: Path) -> Path:
    """One picture of some, each below the one before, in few colours."""
    from PIL import Image

    images = [Image.open(picture).convert("RGB") for picture in pictures]
    sheet = Image.new("RGB", (max(i.width for i in images), sum(i.height for i in images)))
    top = 0
    for image in images:
        sheet.paste(image, (0, top))
        top += image.height
    sheet.quantize(COLOURS, dither=Image.Dither.NONE).save(to, optimize=True)
    return to


class Ball:
    """Points about a centre."""

    def __init__(self, centre: np.ndarray, radius: float) -> None:
        self.centre, self.radius = centre, radius

    def contains(self, points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points - self.centre, axis=1) <= self.radius


def around(whole: np.ndarray, made: np.ndarray) -> Ball:
    """Where the points that were made lie furthest from the scan, in its local scale, on average over a place."""
    tree = cKDTree(whole)
    far, nearest = tree.query(made)
    local = tree.query(whole, 9)[0][:, 8]
    near = cKDTree(made).query(whole, min(PLACE, len(made)))[1]
    place = int(np.argmax((far / np.maximum(local[nearest], 1e-300))[near].mean(axis=1)))
    return Ball(whole[place], float(tree.query(whole[place], min(SHOWN, len(whole)))[0][-1]))
