"""Fine-tunes a model on one's own scans: `python -m densecloud_training.adapt SCAN... --out MODEL`.

Each scan is thinned by its own pattern, and the units learn to give back what was taken away. A quarter of every scan
is held out; there the program itself decides: adapted weights that are no better are not kept, and MODEL gets those
that were there before. Either way `densecloud upsample --model MODEL` runs, and MODEL/model.toml says which they are.
"""

import argparse
import random
import shutil
import signal
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

import torch

from . import checkpoint as checkpoints
from . import clouds as cloud_sets
from . import config as configs
from .card import text
from .config import Config, Stage
from .errors import InputError, run_command
from .export import export_model
from .network import Cascade
from .own_scan import OwnScan, divide, load
from .patches import PatchSource, Source
from .prepare import find_program
from .scan_patches import Mixed, ScanPatches
from .score.program import Program
from .train import Material, Trainer, run
from .verdict import Verdict, measure

SHIPPED = Path(__file__).resolve().parents[2] / "models" / "default"
CPU = torch.device("cpu")
LEARNING_RATE = 3e-4
# How often 2x, 4x, 8x and 16x are trained: 4x is what most ask for.
RATIO_DRAW = [2.0, 2.0, 1.0, 1.0]
# Of the batches, where there are clouds of meshes.
MESH_SHARE = 0.5
# The second measurement takes as long as the first; some time is spared for the export.
SPARE = 1.3
# Of the whole time, however long measuring takes.
LEAST_TRAINING = 0.25

# A checkpoint: the cascade with its mean weights, all of its state, and how many units are trained.
Base = Tuple[Cascade, Dict[str, Any], int]


def trainer_from(base: Base, scans: Sequence[OwnScan], seconds: float, arguments: argparse.Namespace) -> Trainer:
    """A run that goes on from the mean weights of `base`, for one stage more."""
    cascade, state, _ = base
    config = configs.from_dict(state["config"])
    own = ScanPatches(scans, config.patch, config.data.reference_margin)
    source = own if arguments.data is None else with_meshes(own, config, arguments.data)
    config = settings(config, own.levels, arguments)
    trainer = Trainer(config, material(state["data"], scans), seconds, source)
    for weights in (trainer.cascade, trainer.averaged):
        weights.load_state_dict(cascade.state_dict())
    for name in ("round", "step", "seconds", "patches", "history"):
        setattr(trainer, name, state["counters"][name])
    trainer.extend()
    return trainer


def settings(config: Config, levels: int, arguments: argparse.Namespace) -> Config:
    """The config with one stage of fine-tuning as its next extension: of as many levels as the scans have points for,
    or of the unit of 4x alone."""
    last = arguments.units == "last"
    levels = min(levels, config.levels, 2 if last else config.levels)
    stage = Stage(levels, together=not last, share=1.0, iterations=10_000, learning_rate=arguments.learning_rate)
    return replace(config, extension=[stage], ratio_draw=RATIO_DRAW[: config.levels])


def with_meshes(own: ScanPatches, config: Config, data: Path) -> Source:
    """The scans' patches mixed with those of prepared meshes."""
    host = random.Random(config.seed)
    meshes = PatchSource(cloud_sets.load(data, CPU, held_out=False), config.data, config.patch, host)
    return Mixed(own, meshes, MESH_SHARE, host)


def material(known: List[Dict[str, str]], scans: Sequence[OwnScan]) -> Material:
    """What the model card credits: what the weights had been trained on, and the scans."""
    credit = {"source": "fine-tuned on, by adapt", "licence": "that of the scan"}
    names = [*(entry["name"] for entry in known), *(scan.name for scan in scans)]
    rest = [{key: value for key, value in entry.items() if key != "name"} for entry in known]
    return Material(names, [*rest, *(credit for _ in scans)], CPU)


def train(trainer: Trainer, folder: Path, name: str) -> Path:
    """Trains until the time is up, or until Ctrl-C; returns the model folder of what was learned."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    run(trainer, folder / "run", None, argparse.Namespace(stop_after=None, log_every=30.0, save_every=1e9))
    for number, handler in handlers.items():
        signal.signal(number, handler)
    return export_model(folder / "run", folder / "model", name).parent


def finish(verdict: Verdict, adapted: Path, before: Path, scans: Sequence[OwnScan], out: Path) -> None:
    """Puts the better model to `out`, whole or not at all."""
    chosen = adapted
    if not verdict.better:
        chosen = adapted.with_name("before")
        shutil.copytree(before, chosen)
    with open(chosen / "model.toml", "a") as card:
        card.write("\n".join(["", *card_lines(verdict, scans), ""]))
    chosen.rename(out)


def card_lines(verdict: Verdict, scans: Sequence[OwnScan]) -> List[str]:
    """One adaptation in the model card; there may have been others before."""
    before, after = verdict.means("CDH")
    return [
        "# Parts of scans that were not trained on, thinned to a quarter and upsampled back by the program.",
        "[[adaptations]]",
        f"scans = [{', '.join(text(scan.name) for scan in scans)}]",
        f"kept = {str(verdict.better).lower()}",
        f"cdh = {{ before = {before:.4f}, adapted = {after:.4f} }}",
        f"gain = {{ mean = {verdict.gains.mean():.4f}, standard_error = {verdict.error:.4f} }}",
    ]


def training_time(total: float, spent: float, measuring: float) -> float:
    """Seconds that are left to train, when another measurement must follow."""
    return max(total - spent - SPARE * measuring, LEAST_TRAINING * total)


def adapt(arguments: argparse.Namespace, program: Program, folder: Path) -> Verdict:
    """All of it; `folder` takes what is made on the way."""
    start = time.monotonic()
    base = checkpoints.load_cascade(arguments.start_from)
    scans = [load(program, file, folder / f"scan{number}") for number, file in enumerate(arguments.scans)]
    learned, held_out = zip(*(divide(scan) for scan in scans))
    read = time.monotonic()
    before = measure(program, arguments.start_from, held_out, folder)
    now = time.monotonic()
    seconds = training_time(60 * arguments.minutes, now - start, now - read)
    name = f"adapted to {', '.join(scan.name for scan in scans)}"
    made = train(trainer_from(base, learned, seconds, arguments), folder, name)
    verdict = Verdict(before, measure(program, made, held_out, folder))
    finish(verdict, made, arguments.start_from, scans, arguments.out)
    return verdict


def parse(values: Optional[List[str]] = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scans", type=Path, nargs="+", metavar="SCAN", help="in any format that the program reads")
    parser.add_argument("--out", type=Path, required=True, help="the model folder to write; must not be there")
    parser.add_argument("--minutes", type=float, default=20.0, help="for all of it [default: 20]")
    parser.add_argument("--threads", type=int, help="[default: all]")
    parser.add_argument("--start-from", type=Path, default=SHIPPED, help="model folder [default: the shipped one]")
    parser.add_argument("--data", type=Path, help="clouds that `prepare` wrote: half of the batches come from these")
    parser.add_argument("--learning-rate", type=float, default=LEARNING_RATE)
    parser.add_argument("--units", choices=["all", "last"], default="all", help="last: only that of 4x learns")
    parser.add_argument("--program", default="", help="the densecloud program [default: target/release, or the path]")
    return parser.parse_args(values)


def check(arguments: argparse.Namespace) -> None:
    """Refuses what would fail only after minutes."""
    if arguments.out.exists():
        raise InputError(f"--out {arguments.out} is there already: name a folder that is not")
    if not arguments.minutes > 0:
        raise InputError(f"--minutes {arguments.minutes:g}: must be above 0")
    for file in (*arguments.scans, arguments.start_from / checkpoints.FILE):
        file.stat()


def main(values: Optional[List[str]] = None) -> None:
    arguments = parse(values)
    check(arguments)
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    program = Program(find_program(arguments.program), None, arguments.threads)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".adapt-", dir=arguments.out.parent) as folder:
        print(f"\n{adapt(arguments, program, Path(folder))}: {arguments.out}")


if __name__ == "__main__":
    run_command(main)
