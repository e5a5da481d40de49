"""The model card: what a cascade is, what it was trained on and for how long, and how it scores."""

import hashlib
import json
from pathlib import Path
from typing import Any, Dict, List, Tuple

from . import network
from .clouds import validation_names


def write_card(
    folder: Path, name: str, units: List[Path], state: Dict[str, Any], trained: int, log: List[dict]
) -> Path:
    """Writes `model.toml` beside the unit files; the program reads the top part, people the rest."""
    config, counters = state["config"], state["counters"]
    lines = [
        "# Written by `python -m densecloud_training.export`; training/README.md says how to repeat the run.",
        f"name = {text(name)}",
        f"levels = {len(units)}",
        f"patch_size = {config['patch']}",
        f"neighbours = {config['k']}",
        f"channels = {network.CHANNELS}",
        f"parameters = {network.PARAMETERS_PER_UNIT * len(units)}",
        'method = "Patch-based Progressive 3D Point Set Upsampling (CVPR 2019)"',
    ]
    for unit in units:
        digest = hashlib.sha256(unit.read_bytes()).hexdigest()
        lines += ["", "[[units]]", f"file = {text(unit.name)}", f"sha256 = {text(digest)}"]
    lines += ["", "[training]", f"steps = {counters['step']}", f"patches = {counters['patches']}"]
    lines += [f"minutes = {counters['seconds'] / 60:.1f}", f"trained_units = {trained}"]
    if trained < len(units):
        lines.append(f"note = {text(f'the units after unit {trained} are copies of unit {trained}')}")
    for stage in stages(state):
        lines += ["", "[[training.stages]]", *(f"{key} = {json.dumps(value)}" for key, value in stage.items())]
    scores, controls = latest(log)
    if scores:
        lines += ["", "# Held-out shapes, patch by patch: two-way mean and largest squared distance, x 1e-3, radius 1,"]
        lines += ["# and the Chamfer distance of rules that learn nothing on the same patches.", "[validation]"]
        lines.append(f"shapes = {json.dumps(sorted(validation_names()))}")
    for case, score in scores.items():
        row = {**score, **{f"{rule}_cd": table[case]["cd"] for rule, table in controls.items() if case in table}}
        values = ", ".join(f"{key} = {value}" for key, value in row.items())
        lines.append(f"{text(case)} = {{ {values} }}")
    for (source, licence), shapes in grouped(state["data"]):
        lines += ["", "[[data]]", f"source = {text(source)}", f"licence = {text(licence)}"]
        lines.append(f"shapes = {json.dumps(shapes)}")
    path = folder / "model.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def text(value: str) -> str:
    """A TOML basic string; JSON's escapes are a subset of TOML's."""
    return json.dumps(value)


def stages(state: Dict[str, Any]) -> List[Dict[str, Any]]:
    """Finished stages, and the one that was cut short by this export."""
    config, counters = state["config"], state["counters"]
    rows = list(counters["history"])
    schedule = config["stages"] if counters["round"] == 0 else config["extension"]
    if counters["stage_index"] < len(schedule) and counters["stage_step"]:
        row = schedule[counters["stage_index"]]
        name = f"{'together' if row['together'] else 'alone'}-{2 ** row['levels']}x (not finished)"
        rows.append({"stage": name, "steps": counters["stage_step"], "seconds": round(counters["stage_seconds"], 1)})
    return rows


def latest(log: List[dict]) -> Tuple[Dict[str, Any], Dict[str, Any]]:
    """The last validation scores and the controls that belong to them."""
    scores = [entry["validation"] for entry in log if "validation" in entry]
    controls = [entry["controls"] for entry in log if "controls" in entry]
    return (scores[-1] if scores else {}), (controls[-1] if controls else {})


def grouped(data: List[Dict[str, str]]) -> List[Tuple[Tuple[str, str], List[str]]]:
    """Shapes by source and licence."""
    groups: Dict[Tuple[str, str], List[str]] = {}
    for shape in data:
        key = (shape.get("source", "unknown"), shape.get("licence", "unknown"))
        groups.setdefault(key, []).append(shape["name"])
    return sorted(groups.items())
