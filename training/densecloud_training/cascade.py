"""Runs a cascade on a whole cloud in plain PyTorch: the baseline for speed, and a second opinion on the Rust program.

`python -m densecloud_training.cascade CHECKPOINT IN.xyz OUT.xyz --ratio 16`. Each level: seeds by farthest point
sampling, patches of the nearest neighbours, the unit, the inner outputs merged and sampled by farthest point sampling.
"""

import argparse
import math
import time
from pathlib import Path
from typing import Dict, NamedTuple, Optional, Tuple

import numpy as np
import torch

from . import checkpoint as checkpoints
from .errors import InputError, run_command
from .network import PATCH, SKIP_NEIGHBOURS, Cascade, Previous, normalise

OVERLAP = 2.0
INNER = 0.3
# Distances computed at once: bounds the memory of brute-force neighbour searches.
TABLE = 1 << 24


class Level(NamedTuple):
    """What a level leaves to the next: its input points [n,3] and their features [n,C]."""

    points: torch.Tensor
    features: torch.Tensor


class Rules(NamedTuple):
    """How a level is run: patches per point, the share of a patch that is merged, the sampler, patches at once."""

    overlap: float = OVERLAP
    inner: float = INNER
    fps: str = "plain"
    batch: int = 16


DEFAULT_RULES = Rules()


class Times:
    """Seconds by stage."""

    def __init__(self):
        self.seconds: Dict[str, float] = {}
        self.last = time.perf_counter()

    def add(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self.last
        self.last = now


def nearest(points: torch.Tensor, cloud: torch.Tensor, k: int) -> Tuple[torch.Tensor, torch.Tensor]:
    """The k nearest of `cloud` [n,3] for each of `points` [m,3]: squared distances and indices [m,k], nearest first."""
    rows = max(1, TABLE // len(cloud))
    found = [torch.cdist(part, cloud, compute_mode="donot_use_mm_for_euclid_dist").topk(k, largest=False)
             for part in points.split(rows)]  # fmt: skip
    return torch.cat([f[0] for f in found]).square(), torch.cat([f[1] for f in found])


def farthest_point_sampling(points: torch.Tensor, count: int, method: str) -> torch.Tensor:
    """`count` indices, the first being 0; each next is the point farthest from those chosen.

    `tensor` and `plain` are quadratic: the first as PyTorch code for point clouds usually has it, the second the same
    with NumPy's in-place operations.
    """
    if method == "fpsample":
        import fpsample

        height = max(1, min(7, int(math.log2(max(2, len(points) / 100)))))
        chosen = fpsample.bucket_fps_kdline_sampling(points.numpy(), count, h=height, start_idx=0)
        return torch.from_numpy(chosen.astype(np.int64))
    if method == "tensor":
        return tensor_sampling(points, count)
    columns = points.numpy().T.copy()
    chosen = np.zeros(count, dtype=np.int64)
    distances = np.full(columns.shape[1], np.inf, dtype=np.float32)
    for i in range(1, count):
        offsets = columns - columns[:, chosen[i - 1]][:, None]
        np.minimum(distances, np.einsum("ij,ij->j", offsets, offsets), out=distances)
        chosen[i] = distances.argmax()
    return torch.from_numpy(chosen)


def tensor_sampling(points: torch.Tensor, count: int) -> torch.Tensor:
    """Farthest point sampling in whole-tensor operations, with a mask for what came nearer."""
    chosen = torch.zeros(count, dtype=torch.long)
    distances = torch.full((len(points),), math.inf)
    for i in range(1, count):
        to_last = ((points - points[chosen[i - 1]]) ** 2).sum(-1)
        nearer = to_last < distances
        distances[nearer] = to_last[nearer]
        chosen[i] = distances.argmax()
    return chosen


def cover(points: torch.Tensor, seeds: torch.Tensor, size: int) -> torch.Tensor:
    """[H,size] point indices: the patches of the seeds, and of points that none of these holds, nearest first."""
    patches = nearest(points[seeds], points, size)[1]
    covered = torch.zeros(len(points), dtype=torch.bool)
    covered[patches.reshape(-1)] = True
    while not covered.all():
        missed = (~covered).nonzero()[:1, 0]
        patch = nearest(points[missed], points, size)[1]
        # Among many coinciding points a seed may miss its own patch; it must be in.
        patch[0, -1] = torch.where((patch == missed).any(), patch[0, -1], missed[0])
        covered[patch.reshape(-1)] = True
        patches = torch.cat([patches, patch])
    return patches


def most_central(patches: torch.Tensor, count: int) -> torch.Tensor:
    """For each point, its place in the flattened patches where it is the earliest neighbour of the seed."""
    members, size = patches.reshape(-1), patches.shape[1]
    place = torch.arange(size).repeat(len(patches))
    # Later writes win: written from the outermost place to the innermost, and from the last patch to the first.
    order = torch.argsort(place * len(patches) + torch.arange(len(patches)).repeat_interleave(size), descending=True)
    owner = np.empty(count, dtype=np.int64)
    owner[members[order].numpy()] = order.numpy()
    return torch.from_numpy(owner)


def inner_part(dense: torch.Tensor, owners: torch.Tensor, patches: int, size: int, inner: float) -> torch.Tensor:
    """The outputs [H,2N,3] that are merged, [m,3]: of each patch those of its `inner` share of points nearest to the
    seed, and of every input point those of the patch where it is most central, so that none goes without."""
    if inner >= 1:
        return dense.reshape(-1, 3)
    by_point = dense.view(patches, 2, size, 3).transpose(1, 2).reshape(patches * size, 2, 3)
    wanted = (torch.arange(size) < inner * size).repeat(patches)
    wanted[owners] = True
    return by_point[wanted].reshape(-1, 3)


@torch.no_grad()
def run_level(
    unit, points: torch.Tensor, previous: Optional[Level], rules: "Rules", times: Times
) -> Tuple[torch.Tensor, Level]:
    """[n,3] -> [2n,3], and what the next level needs."""
    size = min(PATCH, len(points))
    if size <= unit.k:
        raise InputError(f"{len(points)} points are too few: a patch needs more than {unit.k}")
    seeds = farthest_point_sampling(points, max(1, math.ceil(rules.overlap * len(points) / PATCH)), rules.fps)
    times.add("seeds")
    patches = cover(points, seeds, size)
    around = nearest(points, previous.points, SKIP_NEIGHBOURS) if previous else None
    times.add("patches")
    dense, features = [], []
    for part in patches.split(rules.batch):
        normal, frame = normalise(points[part])
        skip = Previous(previous.features, around[1][part], around[0][part]) if previous else None
        output = unit(normal, skip)
        dense.append(frame.undo(output.dense))
        features.append(output.features.reshape(-1, output.features.shape[-1]))
    times.add("units")
    owners = most_central(patches, len(points))
    merged = inner_part(torch.cat(dense), owners, len(patches), size, rules.inner)
    owned = torch.cat(features)[owners]
    kept = farthest_point_sampling(merged, 2 * len(points), rules.fps)
    times.add("resample")
    return merged[kept], Level(points, owned)


def upsample(
    cascade: Cascade, cloud: np.ndarray, ratio: float, rules: Rules = DEFAULT_RULES
) -> Tuple[np.ndarray, Times]:
    """round(ratio * n) points from n. Beyond the trained ratio the last unit repeats."""
    centre = cloud.mean(0)
    scale = np.linalg.norm(cloud - centre, axis=1).max() or 1.0
    points = torch.from_numpy(((cloud - centre) / scale).astype(np.float32))
    wanted, times, previous = round(ratio * len(cloud)), Times(), None
    level = 0
    while len(points) < wanted:
        unit = cascade.units[min(level, len(cascade.units) - 1)]
        points, previous = run_level(unit, points, previous, rules, times)
        level += 1
    if len(points) > wanted:
        points = points[farthest_point_sampling(points, wanted, rules.fps)]
        times.add("resample")
    return points.numpy().astype(np.float64) * scale + centre, times


def read_points(path: Path) -> np.ndarray:
    """[n,3]: the first three columns of a text file."""
    try:
        with open(path) as file:
            return np.loadtxt(file, ndmin=2, usecols=(0, 1, 2))
    except ValueError as error:
        raise InputError(f"{path}: not columns of numbers, x y z a line: {error}") from error


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkpoint", type=Path, help="a checkpoint, or the folder of a run or a model")
    parser.add_argument("input", type=Path, help="text: x y z a line")
    parser.add_argument("output", type=Path)
    parser.add_argument("--ratio", type=float, default=4.0)
    parser.add_argument("--overlap", type=float, default=OVERLAP)
    parser.add_argument("--inner", type=float, default=INNER, help="share of a patch, around its seed, merged")
    parser.add_argument("--threads", type=int, default=0, help="0: as PyTorch decides")
    parser.add_argument("--batch", type=int, default=16, help="patches at once")
    parser.add_argument(
        "--fps",
        choices=["plain", "tensor", "fpsample"],
        default="plain",
        help="fpsample: the package's C++ one; tensor: PyTorch's usual form of the plain one",
    )
    arguments = parser.parse_args()
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    cascade, _, _ = checkpoints.load_cascade(arguments.checkpoint)
    cloud = read_points(arguments.input)
    start = time.perf_counter()
    rules = Rules(arguments.overlap, arguments.inner, arguments.fps, arguments.batch)
    dense, times = upsample(cascade, cloud, arguments.ratio, rules)
    total = time.perf_counter() - start
    np.savetxt(arguments.output, dense, fmt="%.7g")
    for stage, seconds in times.seconds.items():
        print(f"{stage:10} {seconds:8.3f} s  {100 * seconds / total:5.1f} %")
    print(f"{'total':10} {total:8.3f} s  {len(cloud)} -> {len(dense)} points, {torch.get_num_threads()} threads")


if __name__ == "__main__":
    run_command(main)
