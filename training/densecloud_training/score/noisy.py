"""What cleaning a noisy scan before upsampling gains: measured on held-out shapes, and drawn for a real scan."""

from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Optional

import numpy as np

from ..prepare import read_points
from .cleaning import onto_planes, roughness, without_strays
from .inputs import Inputs, write_points
from .pictures import RATIO, View, beside, find_scan
from .program import Program
from .report import Scores
from .scans import crop, read_scan
from .table import markdown, plain, thousandths

POINTS = 8192
POINTS_OUT = 32768
NOISE = (0.005, 0.01, 0.02, 0.04)
# One of each kind of held-out shape: statue, organic, mechanical, thin.
SHAPES = ("tds_plato", "cgal_bull", "vtk_gears", "ycb_scissors")
# Share of points added that lie anywhere in the bounding box.
STRAYS = 0.01

# A table by a stereo camera, the noisiest of the scans that were looked at.
VIEW = View("pcl_table_scene_mug_stereo_textured", "0,-30", "y", low=(0.0, 0.0, 0.6), size="400x330")
# Of the scan's points so many are used: more would be finer than its noise.
SCAN_POINTS = 20_000
# The program's `clean`, with these options; none for a cloud as it is.
WAYS: Dict[str, Optional[List[str]]] = {
    "as it is": None,
    "clean": [],
    "clean --smooth": ["--smooth"],
    "clean --smooth bilateral": ["--smooth=bilateral"],
    "clean --smooth wlop": ["--smooth=wlop"],
}
# What point cloud libraries have: statistical outlier removal, and each point onto the plane of its 32 nearest.
LIBRARY = "statistical outlier removal, onto planes"
WAYS_DRAWN = ("as it is", "clean --smooth")


@dataclass(frozen=True)
class Result:
    """Mean scores of one way of cleaning at one noise."""

    noise: float
    way: str
    points_in: float
    scores: Scores


def with_strays(points: np.ndarray, share: float, seed: int) -> np.ndarray:
    """The points and a share more of them, anywhere in their box."""
    random = np.random.default_rng(seed)
    strays = random.uniform(points.min(0), points.max(0), (round(share * len(points)), 3))
    return np.concatenate([points, strays])


def rows(file: Path) -> np.ndarray:
    """The points [n,3] of a text file."""
    return np.loadtxt(file, ndmin=2)[:, :3]


def cleaned(program: Program, cloud: Path, folder: Path) -> Dict[str, Path]:
    """The cloud after each way of cleaning it."""
    files = {"as it is": cloud, LIBRARY: folder / f"{cloud.stem}-library.xyz"}
    write_points(files[LIBRARY], onto_planes(without_strays(rows(cloud))))
    for number, (way, options) in enumerate(WAYS.items()):
        if options is not None:
            files[way] = folder / f"{cloud.stem}-{number}.xyz"
            program.run("clean", cloud, files[way], "--quiet", *options)
    return files


def evaluate(inputs: Inputs) -> List[Result]:
    """Cleans, upsamples to the same number of points, and scores."""
    wanted = inputs.references(POINTS_OUT)
    results = []
    for noise in NOISE:
        given = inputs.sampled(POINTS, noise=noise)
        sizes: Dict[str, List[int]] = {}
        folder = inputs.out / "noisy" / f"{noise:g}"
        folder.mkdir(parents=True, exist_ok=True)
        for number, shape in enumerate(inputs.shapes):
            cloud = folder / f"{shape}.xyz"
            write_points(cloud, with_strays(read_points(given / f"{shape}.ply"), STRAYS, number))
            for way, file in cleaned(inputs.program, cloud, folder).items():
                sizes.setdefault(way, []).append(len(rows(file)))
                dense = dense_folder(inputs, noise, way)
                dense.mkdir(parents=True, exist_ok=True)
                inputs.program.upsample(file, dense / f"{shape}.ply", "--points", POINTS_OUT)
        for way, counts in sizes.items():
            dense = dense_folder(inputs, noise, way)
            report = inputs.program.score(dense, wanted, inputs.meshes, inputs.shapes)
            results.append(Result(noise, way, sum(counts) / len(counts), report.means()["prediction"]))
    return results


def dense_folder(inputs: Inputs, noise: float, way: str) -> Path:
    """Where the dense clouds of one way of cleaning go; what they were made from goes beside it."""
    return inputs.out / "noisy" / f"{noise:g}" / way.replace(", ", "-").replace(" ", "-") / "dense"


def text(results: List[Result], shapes: List[str]) -> str:
    """The table, in Markdown; the best of each noise and column in bold."""
    metrics = ("chamfer", "hausdorff_95", "to_surface", "from_surface", "spacing_variation")
    rows = []
    for result in results:
        rivals = [r.scores for r in results if r.noise == result.noise]
        cells = []
        for metric in metrics:
            value = result.scores[metric]
            shown = plain(value) if metric == "spacing_variation" else thousandths(value, 2)
            cells.append(f"**{shown}**" if value == min(r[metric] for r in rivals) else shown)
        rows.append([f"{result.noise * 100:g} %", result.way, f"{result.points_in:,.0f}", *cells])
    header = ["noise", "before upsampling", "points in", "chamfer", "hausdorff 95", "to surface", "from surface",
              "spacing variation"]  # fmt: skip
    return (
        f"{POINTS:,} even points with noise (deviation, of half the bounding box's diagonal) and {STRAYS * 100:g} % "
        f"more anywhere in the box, upsampled to {POINTS_OUT:,}; mean of {', '.join(shapes)}. x 1e-3 in radii of the "
        "reference, chamfer squared.\n\n"
    ) + markdown(header, rows)


def draw(program: Program, scans: Path, out: Path, view: View = VIEW) -> str:
    """One strip: the scan, and what it gives when upsampled after each of WAYS_DRAWN. Gives its name and how rough each
    cloud in it is, in Markdown."""
    folder = out / "scans"
    folder.mkdir(parents=True, exist_ok=True)
    whole = crop(read_scan(find_scan(scans, view.scan)), view.low, view.high)
    random = np.random.default_rng(0)
    points = whole[np.sort(random.permutation(len(whole))[:SCAN_POINTS])]
    scan = folder / f"{view.scan}.xyz"
    write_points(scan, points)
    ways = cleaned(program, scan, folder)
    clouds, rough = [scan], [f"in the scan {roughness(points):.3g}"]
    for number, way in enumerate(WAYS_DRAWN):
        dense = folder / f"{view.scan}-{number}.ply"
        clouds.append(program.upsample(ways[way], dense, "--points", RATIO * len(points)))
        rough.append(f"{way} {roughness(read_points(dense)):.3g}")
    picture = beside(program, clouds, view, out)
    return f"{picture.name}: root mean square distance from the plane of 16 neighbours: {'; '.join(rough)}.\n"
