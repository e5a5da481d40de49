"""Samples a folder of meshes into one compact file: `python -m densecloud_training.prepare MESHES OUT.npz`.

Each shape becomes a ladder of independent Poisson-disk samplings of 625, 1250, ... points, made by `densecloud sample`
(the program that also makes the test clouds), several shapes at a time. Coordinates are kept in 16 bits, a step of
1/32768 of the shape's radius: far below the point spacing at any level.
"""

import argparse
import csv
import json
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Dict, List, Tuple

import numpy as np

from .clouds import level_size
from .errors import InputError, run_command

MESHES = (".ply", ".off")


def read_points(path: Path) -> np.ndarray:
    """[n,3] f64 from a binary little-endian PLY whose vertices are three floats or doubles, as the sampler writes."""
    with open(path, "rb") as file:
        header: List[str] = []
        while not header or header[-1] != "end_header":
            line = file.readline()
            if not line:
                raise ValueError(f"{path}: the PLY header does not end")
            header.append(line.decode("ascii").strip())
        kinds = {"float": "<f4", "double": "<f8"}
        properties = [line.split()[1] for line in header if line.startswith("property")]
        if "format binary_little_endian 1.0" not in header or len(properties) != 3 or len(set(properties)) != 1:
            raise ValueError(f"{path}: expected a binary little-endian PLY with x, y, z only")
        return np.frombuffer(file.read(), dtype=kinds[properties[0]]).reshape(-1, 3).astype(np.float64)


def count_faces(path: Path) -> int:
    """Triangles or polygons that a PLY or OFF header announces; a measure of a mesh's detail."""
    with open(path, "rb") as file:
        if path.suffix.lower() == ".off":
            words: List[bytes] = []
            while len(words) < 4:
                line = file.readline()
                if not line:
                    raise ValueError(f"{path}: the OFF header does not end")
                words += line.split(b"#")[0].split()
            return int(words[2])
        for line in file:
            if line.startswith(b"element face"):
                return int(line.split()[2])
            if line.strip() == b"end_header":
                break
    raise ValueError(f"{path}: no faces")


def sample_shape(program: str, mesh: Path, levels: int, seed: int) -> List[np.ndarray]:
    """The ladder of one mesh as uint16 [n,3] arrays in the cube around its bounding box's middle."""
    sizes = [level_size(level) for level in range(levels)]
    with tempfile.TemporaryDirectory() as folder:
        points = [argument for size in sizes for argument in ("--points", str(size))]
        command = [program, "sample", str(mesh), f"{folder}/{{points}}.ply", *points, "--seed", str(seed)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            raise RuntimeError(f"{' '.join(command)} failed: {done.stderr.strip()}")
        clouds = [read_points(Path(folder) / f"{size}.ply") for size in sizes]
    low, high = clouds[-1].min(0), clouds[-1].max(0)
    centre = (low + high) / 2
    radius = max(np.linalg.norm(cloud - centre, axis=1).max() for cloud in clouds)
    return [np.round(((cloud - centre) / radius + 1) * (65535 / 2)).astype(np.uint16) for cloud in clouds]


def sources(folder: Path) -> Dict[str, Dict[str, str]]:
    """Source and licence of each file, from a MANIFEST.tsv beside the meshes (columns file, source, licence)."""
    manifest = folder / "MANIFEST.tsv"
    if not manifest.exists():
        return {}
    with open(manifest, newline="") as file:
        rows = list(csv.DictReader(file, delimiter="\t"))
    return {Path(row["file"]).stem: {"source": row["source"], "licence": row["licence"]} for row in rows}


def find_program(given: str) -> str:
    """The sampler: as given, beside the repository, or on the path."""
    root = Path(__file__).resolve().parents[2]
    candidates = [given] if given else [str(root / "target/release/densecloud"), "densecloud"]
    for candidate in candidates:
        found = shutil.which(candidate)
        if found:
            return found
    raise SystemExit(f"none of {candidates} found: build it with `cargo build --release`, or name it with --program")


def prepare(meshes: List[Path], program: str, levels: int, seed: int, jobs: int) -> Tuple[List[str], List[np.ndarray]]:
    """Names of the shapes that could be sampled, and one [shapes,n,3] array a level."""

    def work(item: Tuple[int, Path]):
        number, mesh = item
        try:
            return mesh, sample_shape(program, mesh, levels, seed + number)
        except (RuntimeError, ValueError, OSError) as error:
            print(f"left out: {error}", file=sys.stderr)
            return mesh, None

    ladders, names = [], []
    with ThreadPoolExecutor(jobs) as pool:
        for mesh, ladder in pool.map(work, enumerate(meshes)):
            if ladder is not None:
                names.append(mesh.stem)
                ladders.append(ladder)
                print(f"{len(ladders)}/{len(meshes)} {mesh.stem}", flush=True)
    if not ladders:
        raise SystemExit("no mesh could be sampled")
    return names, [np.stack([ladder[level] for ladder in ladders]) for level in range(levels)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", type=Path, help="a folder of .ply and .off meshes")
    parser.add_argument("out", type=Path)
    parser.add_argument("--levels", type=int, default=8, help="8: up to 80,000 points; 7 halves the file")
    parser.add_argument("--program", default="", help="the densecloud program")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    meshes = sorted(path for path in arguments.meshes.iterdir() if path.suffix.lower() in MESHES)
    if not meshes:
        raise InputError(f"{arguments.meshes} has no {' or '.join(sorted(MESHES))} files")
    program = find_program(arguments.program)
    names, levels = prepare(meshes, program, arguments.levels, arguments.seed, arguments.jobs)
    by_name = {mesh.stem: mesh for mesh in meshes}
    known = sources(arguments.meshes)
    meta = {
        "names": names,
        "faces": [count_faces(by_name[name]) for name in names],
        "sources": [known.get(name, {}) for name in names],
        "levels": [level_size(level) for level in range(arguments.levels)],
        "seed": arguments.seed,
    }
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    np.savez(arguments.out, meta=json.dumps(meta), **{f"level{k}": level for k, level in enumerate(levels)})
    print(f"{arguments.out}: {len(names)} shapes, {arguments.out.stat().st_size / 2**20:.1f} MiB")


if __name__ == "__main__":
    run_command(main)
