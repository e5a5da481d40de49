"""Writes a cascade's units as ONNX files: `python -m densecloud_training.export CHECKPOINT OUT_DIR`."""

import argparse
from pathlib import Path
from typing import List

import onnx
import torch

from . import network
from .onnx_unit import build_unit


def export_units(cascade: network.Cascade, folder: Path) -> List[Path]:
    """One `unit<level>.onnx` for each unit; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number, unit in enumerate(cascade.units, start=1):
        state = {name: tensor.detach().cpu().float().numpy() for name, tensor in unit.state_dict().items()}
        path = folder / f"unit{number}.onnx"
        onnx.save(build_unit(state, number, unit.k), str(path))
        paths.append(path)
    return paths


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--random", action="store_true", help="untrained weights, for tests of a runtime")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--levels", type=int, default=4)
    arguments = parser.parse_args()
    torch.manual_seed(arguments.seed)
    for path in export_units(network.Cascade(arguments.levels), arguments.out):
        print(path)


if __name__ == "__main__":
    main()
