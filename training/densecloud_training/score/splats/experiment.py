"""Scenes x seeds x ways to make the seeds denser, and the table."""

import hashlib
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Dict, List, Sequence

import numpy as np
import torch
from scipy.spatial import cKDTree

from ..inputs import Inputs, find_mesh
from ..real import midpoint_pairs
from ..sheets import read_mesh
from ..table import markdown, plain
from .colmap import Found, read_points, write_model, write_points
from .fit import Check, Fit
from .gaussians import Seeds
from .surface import Surface, disturbed
from .view import DISTANCE, FOCAL, HELD_OUT, SIZE, Photograph, around, photograph

# Held-out shapes, of which the network has seen none: a bust, an animal, a machine part.
SHAPES = ("tds_plato", "cgal_bull", "vtk_gears")
SEEDS = 2
STEPS = 400
POINTS = 500
RATIO = 4
# Structure from motion keeps a point that so many views see.
SEEN_BY = 3
SPARSE = "sparse"
OURS = "densecloud"
# And whether Gaussians are cloned and split on the way.
ARMS = (
    (SPARSE, False),
    (OURS, False),
    ("midpoints", False),
    ("copies", False),
    ("exact", False),
    (SPARSE, True),
    (OURS, True),
)
# Shares of the schedule that the curve shows.
SHOWN = (0.1, 0.3, 1.0)

NOTE = f"""{POINTS} points as structure from motion finds them (more where the pattern is rich, noise, 1 % wrong), \
seen by at least {SEEN_BY} views, and {RATIO} times as many, themselves among them: densecloud, by the program with \
`--keep-input`; midpoints, of each point and its nearest ones; copies, each moved at random by half the distance to \
its nearest. Exact: as many points of the true surface, as uneven, with their true colours. {SIZE} x {SIZE} pixels, \
24 views to train on, 8 held out. Mean and standard deviation over scenes and seeds; the gain is over the sparse \
seeds of the same scene and seed, with how often it is above zero. Equal time: scores when as many seconds of \
processor time have gone as the sparse seeds take for all steps.
"""


@dataclass(frozen=True)
class Run:
    """One optimisation: its scene (shape and seed), its seeds' way, and its scores on the way."""

    scene: str
    arm: str
    densify: bool
    checks: List[Check]

    def at_step(self, step: float) -> "tuple[float, float]":
        """PSNR and SSIM after so many steps; between checks in a straight line."""
        return self.between([check.step for check in self.checks], step)

    def at_time(self, seconds: float) -> "tuple[float, float]":
        """The same after so much time; the last where it ended before."""
        return self.between([check.seconds for check in self.checks], seconds)

    def between(self, places: Sequence[float], place: float) -> "tuple[float, float]":
        scores = ([check.psnr for check in self.checks], [check.ssim for check in self.checks])
        return tuple(float(np.interp(place, places, values)) for values in scores)  # type: ignore


def found_by_motion(surface: Surface, photographs: List[Photograph], random: np.random.Generator) -> Found:
    """POINTS points as structure from motion would find them."""
    points, faces, seen = visible(surface, photographs, POINTS, random)
    moved = disturbed(points, random)
    errors = np.linalg.norm(moved - points, axis=1) * FOCAL * SIZE / DISTANCE
    return Found(Seeds(moved, surface.colours(points, faces)), errors, seen)


def visible(
    surface: Surface, photographs: List[Photograph], count: int, random: np.random.Generator
) -> "tuple[np.ndarray, np.ndarray, np.ndarray]":
    """`count` places that SEEN_BY views see, their triangles, and [views,count] which see them. Fails with a ValueError
    where most of the surface is hidden."""
    points, faces = surface.sample(4 * count, random)
    seen = np.stack([photograph.sees(points) for photograph in photographs])
    chosen = np.flatnonzero(seen.sum(0) >= SEEN_BY)[:count]
    if len(chosen) < count:
        raise ValueError("three quarters of the surface are hidden: no scene to look at from all around")
    return points[chosen], faces[chosen], seen[:, chosen]


def halfway(seeds: Seeds) -> Seeds:
    """The midpoint rule, colours and all."""
    pairs = midpoint_pairs(seeds.points)
    middles = (np.concatenate([values, values[pairs].mean(1)]) for values in seeds)
    return Seeds(*middles)


def copied(seeds: Seeds, random: np.random.Generator) -> Seeds:
    """Each point, and RATIO - 1 beside it."""
    reach = cKDTree(seeds.points).query(seeds.points, 2)[0][:, 1:] / 2
    beside = [seeds.points + reach * random.normal(size=seeds.points.shape) for _ in range(RATIO - 1)]
    return Seeds(np.concatenate([seeds.points, *beside]), np.tile(seeds.colours, (RATIO, 1)))


def scene(inputs: Inputs, shape: str, seed: int) -> "tuple[List[Photograph], Dict[str, Path]]":
    """Photographs of a shape, and a points3D.bin for each way to seed."""
    surface = Surface.of(read_mesh(find_mesh(inputs.meshes, shape)), seed)
    photographs, random = [photograph(surface, view) for view in around()], np.random.default_rng(seed)
    trained = [photograph for k, photograph in enumerate(photographs) if k % HELD_OUT]
    found = found_by_motion(surface, trained, random)
    folder = inputs.out / "splats" / f"{shape}-{seed}"
    sparse = write_model(folder, trained, found)
    truth, faces, _ = visible(surface, trained, RATIO * POINTS, random)
    ways = {
        "midpoints": halfway(found.seeds),
        "copies": copied(found.seeds, random),
        "exact": Seeds(truth, surface.colours(truth, faces)),
    }
    files = {arm: write_points(folder / arm / "points3D.bin", seeds) for arm, seeds in ways.items()}
    dense = folder / OURS / "points3D.bin"
    dense.parent.mkdir(exist_ok=True)
    inputs.program.upsample(sparse, dense, "--ratio", RATIO, "--keep-input")
    return photographs, {SPARSE: sparse, OURS: dense, **files}


def run(kept: Path, name: str, arm: str, densify: bool, file: Path, photographs: List[Photograph], steps: int) -> Run:
    """One optimisation; its scores are kept under a name that tells the seeds and the schedule."""
    key = hashlib.sha256(file.read_bytes() + f"{densify} {steps}".encode()).hexdigest()[:16]
    result = kept / f"{name}-{key}.json"
    if not result.exists():
        print(f"{name}: {arm}{', densification' if densify else ''}", file=sys.stderr, flush=True)
        trained = [photograph for k, photograph in enumerate(photographs) if k % HELD_OUT]
        checks = Fit(read_points(file), trained, steps, densify, seed=0).run(photographs[::HELD_OUT])
        kept.mkdir(parents=True, exist_ok=True)
        partial = result.with_name(f".{result.name}")
        partial.write_text(json.dumps([asdict(check) for check in checks]))
        partial.replace(result)
    return Run(name, arm, densify, [Check(**check) for check in json.loads(result.read_text())])


def evaluate(inputs: Inputs, seeds: int, steps: int) -> List[Run]:
    """All runs, on one thread: times are to be compared."""
    torch.set_num_threads(1)
    runs = []
    for seed in range(seeds):
        for shape in inputs.shapes:
            photographs, files = scene(inputs, shape, seed)
            for arm, densify in ARMS:
                kept, name = inputs.out / "splats" / "runs", f"{shape}-{seed}"
                runs.append(run(kept, name, arm, densify, files[arm], photographs, steps))
    return runs


def gains(scores: np.ndarray, base: np.ndarray) -> str:
    """Mean and spread of the differences of PSNR, and how many are above zero; nothing for the base itself."""
    more = (scores - base)[:, 0]
    if not more.any():
        return "-"
    return f"{more.mean():+.2f} ± {more.std():.2f}, {(more > 0).sum()} of {len(more)}"


def both(scores: np.ndarray) -> str:
    """PSNR and SSIM of [n,2], mean and spread."""
    (noise, alike), (noise_off, alike_off) = scores.mean(0), scores.std(0)
    return f"{noise:.2f} ± {noise_off:.2f} / {alike:.3f} ± {alike_off:.3f}"


def row(runs: List[Run], base: List[Run]) -> List[str]:
    """One way to seed, beside the sparse seeds of the same scenes."""
    ends, base_ends = (np.array([r.at_step(r.checks[-1].step) for r in group]) for group in (runs, base))
    timed = np.array([r.at_time(b.checks[-1].seconds) for r, b in zip(runs, base)])
    count, seconds = (np.mean([getattr(r.checks[-1], name) for r in runs]) for name in ("gaussians", "seconds"))
    curve = [plain(np.mean([r.at_step(share * r.checks[-1].step)[0] for r in runs]), 2) for share in SHOWN[:-1]]
    cells = [
        f"{count:,.0f}",
        f"{seconds:.1f}",
        *curve,
        both(ends),
        gains(ends, base_ends),
        both(timed),
        gains(timed, base_ends),
    ]
    return ["yes" if runs[0].densify else "no", runs[0].arm, *cells]


def text(runs: List[Run]) -> str:
    """The table, in Markdown."""
    steps, rows = runs[0].checks[-1].step, []
    for arm, densify in ARMS:
        own, base = ([r for r in runs if r.arm == name and r.densify == densify] for name in (arm, SPARSE))
        rows.append(row(own, base))
    header = ["densification", "seeds", "Gaussians at the end", "seconds"]
    header += [f"PSNR after {share * steps:,.0f} steps" for share in SHOWN[:-1]]
    header += [f"PSNR / SSIM after {steps:,}", "gain, dB", "PSNR / SSIM at equal time", "gain, dB"]
    return f"{NOTE}\n{markdown(header, rows)}"
