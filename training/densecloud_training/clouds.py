"""The prepared set of point clouds, resident on the training device.

One file holds a ladder of independent samplings of every shape: 625, 1250, ... points, as 16-bit coordinates in the
shape's bounding box of [-1, 1]. Any two levels of the ladder are a training pair.
"""

import json
import zipfile
from pathlib import Path
from typing import Dict, Iterable, List, NamedTuple

import numpy as np
import torch

from .errors import InputError

COARSEST = 625
VALIDATION_FILE = Path(__file__).with_name("validation.txt")


def level_size(level: int) -> int:
    """Points of a cloud at `level` of the ladder."""
    return COARSEST << level


class Clouds(NamedTuple):
    """sources: {"source", "licence"} of each shape where known. levels[k]: [shapes, 625*2^k, 3] f32.
    weights [shapes]: how often a shape is drawn. spread [shapes]: a point's k nearest of n lie within spread*sqrt(k/n).
    """

    names: List[str]
    sources: List[Dict[str, str]]
    levels: List[torch.Tensor]
    weights: torch.Tensor
    spread: torch.Tensor

    @property
    def device(self) -> torch.device:
        return self.weights.device


def validation_names() -> List[str]:
    """Shapes that are never trained on; the list is a file of the package."""
    lines = VALIDATION_FILE.read_text().splitlines()
    return [line.split()[0] for line in lines if line.strip() and not line.startswith("#")]


def load(path: Path, device: torch.device, held_out: bool) -> Clouds:
    """The training shapes of a prepared file, or, with `held_out`, the validation shapes."""
    with open(path, "rb") as file:
        try:
            archive = np.load(file)
            meta = json.loads(str(archive["meta"]))
        except (ValueError, KeyError, IndexError, EOFError, zipfile.BadZipFile) as error:
            raise InputError(f"{path}: not a file of prepared clouds; `prepare` writes them") from error
        chosen = _choose(meta["names"], held_out)
        if not chosen:
            raise InputError(f"{path} has no {'validation' if held_out else 'training'} shapes")
        levels = [archive[f"level{k}"][chosen] for k in range(len(meta["levels"]))]
    tensors = [torch.from_numpy(level.astype(np.float32)).to(device) * (2 / 65535) - 1 for level in levels]
    # A mesh of few triangles teaches facets; shapes with more detail are drawn more often.
    faces = torch.tensor([meta["faces"][i] for i in chosen], dtype=torch.float32, device=device)
    weights = (faces / 10_000).clamp(0.25, 2.0).sqrt()
    names = [meta["names"][i] for i in chosen]
    sources = [meta.get("sources", [{}] * len(meta["names"]))[i] for i in chosen]
    spread = torch.stack([_spread(level) for level in tensors[2]])
    return Clouds(names, sources, tensors, weights / weights.sum(), spread)


def _choose(names: Iterable[str], held_out: bool) -> List[int]:
    validation = set(validation_names())
    return [i for i, name in enumerate(names) if (name in validation) == held_out]


def _spread(cloud: torch.Tensor) -> torch.Tensor:
    """Measured on 16 neighbourhoods of 64 points: k points lie within spread * sqrt(k/n)."""
    centres = cloud[:: max(1, len(cloud) // 16)]
    radii = torch.cdist(centres, cloud).topk(64, largest=False)[0][:, -1]
    return radii.median() * (len(cloud) / 64) ** 0.5
