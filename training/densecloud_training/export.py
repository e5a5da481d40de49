"""Writes a trained cascade as a model folder: `python -m densecloud_training.export RUN OUT_DIR`.

The folder gets one ONNX file a unit, the model card, the checkpoint that training can go on from, and the log with its
curves. `--random` writes unit files of an untrained cascade instead, for tests of a runtime.
"""

import argparse
import shutil
from pathlib import Path
from typing import List, Optional

import onnx
import torch

from . import checkpoint as checkpoints
from . import network
from .card import write_card
from .config import Switches
from .errors import InputError, run_command
from .onnx_unit import build_unit
from .plot import draw, read_log
from .train import LOG


def export_units(cascade: network.Cascade, folder: Path) -> List[Path]:
    """One `unit<level>.onnx` for each unit; returns their paths. Refuses units that compute something else than the
    graph does: they would load, run, and be wrong."""
    for unit in cascade.units:
        if type(unit) is not network.Unit:
            raise InputError(
                f"units with {getattr(unit, 'switches', type(unit).__name__)} cannot be written: the ONNX graph is "
                "that of the plain unit. Train without these settings of [unit], or run this checkpoint in PyTorch"
            )
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number, unit in enumerate(cascade.units, start=1):
        state = {name: tensor.detach().cpu().float().numpy() for name, tensor in unit.state_dict().items()}
        path = folder / f"unit{number}.onnx"
        onnx.save(build_unit(state, number, unit.k, unit.neighbours), str(path))
        paths.append(path)
    return paths


def export_model(run: Path, folder: Path, name: str) -> Path:
    """The model folder of a run; returns its card."""
    cascade, state, trained = checkpoints.load_cascade(run)
    units = export_units(cascade, folder)
    log = read_log(run) if (run / LOG).exists() else []
    card = write_card(folder, name, units, state, trained, log)
    shutil.copyfile(run / checkpoints.FILE, folder / checkpoints.FILE)
    if log:
        shutil.copyfile(run / LOG, folder / LOG)
        draw(log, folder / "training.png")
    return card


def main(values: Optional[List[str]] = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, nargs="?", help="folder of a run: checkpoint.pt and log.jsonl")
    parser.add_argument("out", type=Path)
    parser.add_argument("--name", default="default", help="the model's name in its card")
    parser.add_argument("--random", action="store_true", help="untrained units only")
    parser.add_argument("--seed", type=int, default=0, help="of --random")
    parser.add_argument("--levels", type=int, default=4, help="of --random")
    parser.add_argument("--k", type=int, default=network.K, help="neighbours of --random")
    parser.add_argument("--neighbours", default=network.NEIGHBOURS, choices=Switches.CHOICES["neighbours"])
    arguments = parser.parse_args(values)
    if arguments.random == (arguments.run is not None):
        parser.error("name a run, or --random without one")
    if arguments.random:
        torch.manual_seed(arguments.seed)
        export_units(network.Cascade(arguments.levels, arguments.k, arguments.neighbours), arguments.out)
    else:
        print(export_model(arguments.run, arguments.out, arguments.name))


if __name__ == "__main__":
    run_command(main)
