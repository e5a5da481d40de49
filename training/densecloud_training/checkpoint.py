"""Everything a run needs to go on as if it had never stopped, in one small file."""

import os
import pickle
import random
from pathlib import Path
from typing import Any, Dict, Tuple

import torch

from .config import Switches
from .errors import InputError
from .network import Cascade
from .variants import build_cascade

VERSION = 1
FILE = "checkpoint.pt"


def save(path: Path, state: Dict[str, Any]) -> None:
    """Writes beside the file and renames, so that a kill leaves a whole checkpoint, old or new."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".tmp")
    torch.save({**state, "version": VERSION}, temporary)
    os.replace(temporary, path)


def load(path: Path) -> Dict[str, Any]:
    """Reads a checkpoint into main memory; what takes it over moves it to its own device.

    It holds tensors and plain values only, and PyTorch 2 refuses anything else in the file. PyTorch 1 cannot read
    numbers in that way: with it, load only files that you trust.
    """
    with open(path, "rb") as file:
        try:
            state = torch.load(file, map_location="cpu", weights_only=int(torch.__version__.split(".")[0]) >= 2)
        except (RuntimeError, pickle.UnpicklingError, EOFError) as error:
            raise InputError(f"{path}: not a checkpoint, or one cut short; `train` writes them") from error
    version = state.get("version") if isinstance(state, dict) else None
    if version != VERSION:
        raise InputError(f"{path}: checkpoint version {version}, this program reads {VERSION}")
    return state


def load_cascade(path: Path) -> Tuple[Cascade, Dict[str, Any], int]:
    """The cascade of a checkpoint, or of a folder that holds one (mean weights), the checkpoint, and how many units are
    trained.

    Units that the schedule has not reached are copies of the last one that it has: what a warm start would begin with.
    """
    state = load(path / FILE if path.is_dir() else path)
    config, counters = state["config"], state["counters"]
    cascade = build_cascade(config["levels"], config["k"], Switches(**config.get("unit", {})))
    cascade.load_state_dict(state.get("averaged", state["cascade"]))
    trained = config["levels"]
    if counters["round"] == 0 and counters["stage_index"] < len(config["stages"]):
        trained = config["stages"][counters["stage_index"]]["levels"]
    for unit in list(cascade.units)[trained:]:
        unit.load_state_dict(cascade.units[trained - 1].state_dict())
    return cascade.eval().requires_grad_(False), state, trained


def random_state(host: random.Random, device: torch.device) -> Dict[str, Any]:
    """Of Python's generator, which decides shapes, and PyTorch's, which decide the rest; nothing draws from numpy's."""
    state = {"host": host.getstate(), "torch": torch.get_rng_state()}
    if device.type == "cuda":
        state["cuda"] = torch.cuda.get_rng_state(device)
    return state


def restore_random_state(state: Dict[str, Any], host: random.Random, device: torch.device) -> None:
    """A run that moves to another kind of device goes on with that device's own generator."""
    version, internal, gauss = state["host"]
    host.setstate((version, tuple(internal), gauss))
    torch.set_rng_state(state["torch"].cpu())
    if device.type == "cuda" and "cuda" in state:
        torch.cuda.set_rng_state(state["cuda"].cpu(), device)
