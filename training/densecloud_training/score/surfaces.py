"""Whether denser clouds give better surfaces: meshes of held-out shapes, from sparse clouds and from upsampled ones."""

from dataclasses import dataclass
from pathlib import Path
from typing import List

from .inputs import Inputs
from .report import Scores
from .table import markdown, thousandths

POINTS = 2048
RATIO = 8
NOISE = (0.0, 0.01)
# Even points of each mesh and of the truth, which distances are measured between.
SAMPLES = 40_000
# One of each kind of held-out shape: statue, organic, mechanical, thin.
SHAPES = ("tds_plato", "cgal_bull", "vtk_gears", "ycb_scissors")
METRICS = ("to_surface", "from_surface", "hausdorff_95")


@dataclass(frozen=True)
class Result:
    """Scores of the meshes of one kind of cloud at one noise, a line a shape."""

    noise: float
    cloud: str
    shape: str
    scores: Scores


def evaluate(inputs: Inputs) -> List[Result]:
    """Makes the meshes, and measures samples of them against the true ones."""
    truth = inputs.references(SAMPLES)
    results = []
    for noise in NOISE:
        sparse = inputs.sampled(POINTS, noise=noise)
        for cloud in ("sparse", f"upsampled {RATIO}x"):
            folder = inputs.out / "surfaces" / f"{noise:g}" / cloud.replace(" ", "-")
            folder.mkdir(parents=True, exist_ok=True)
            for shape in inputs.shapes:
                given = sparse / f"{shape}.ply"
                if cloud != "sparse":
                    given = inputs.program.upsample(given, folder / f"{shape}-dense.ply", "--ratio", RATIO)
                sampled(inputs, given, folder, shape)
            report = inputs.program.score(folder / "samples", truth, inputs.meshes, inputs.shapes)
            results += [Result(noise, cloud, shape, report.rows[shape]["prediction"]) for shape in inputs.shapes]
    return results


def sampled(inputs: Inputs, cloud: Path, folder: Path, shape: str) -> None:
    """A cloud's mesh, and points of it."""
    mesh, samples = folder / f"{shape}-mesh.ply", folder / "samples" / f"{shape}.ply"
    inputs.program.run("mesh", cloud, mesh, "--quiet")
    samples.unlink(missing_ok=True)
    inputs.program.sample(mesh, samples, SAMPLES, 0)


def text(results: List[Result]) -> str:
    """The table, in Markdown; the better of each pair in bold."""
    rows = []
    for result in results:
        pair = [r.scores for r in results if (r.noise, r.shape) == (result.noise, result.shape)]
        cells = []
        for metric in METRICS:
            value = result.scores[metric]
            shown = thousandths(value, 2)
            cells.append(f"**{shown}**" if value == min(scores[metric] for scores in pair) else shown)
        rows.append([f"{result.noise * 100:g} %", result.shape, result.cloud, *cells])
    header = ["noise", "shape", "mesh of", "to the true surface", "from it", "hausdorff 95"]
    return (
        f"Meshes of {POINTS:,} even points with noise (deviation, of half the bounding box's diagonal), and of {RATIO} "
        f"times as many; {SAMPLES:,} even points of each against the true mesh. x 1e-3 in radii of the shape.\n\n"
    ) + markdown(header, sorted(rows, key=lambda row: (row[0], row[1])))
