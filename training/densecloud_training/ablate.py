"""Trains variants for the same short budget and tables their held-out scores.

`python -m densecloud_training.ablate --data CLOUDS --out FOLDER --minutes M [--only NAME,...]` writes
`FOLDER/table.md` and `FOLDER/table.json` after each variant, and skips the variants that are there already.

Group "paper" is the method's own ablations on two units (4x); group "unit" is other forms of one unit (2x). Every
variant starts from the same seed and sees the same batches as long as its schedule draws the same ratios. The budget is
of the processor's time on one thread, so that what else runs on the machine changes little.
"""

import argparse
import json
import random
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence

import torch

from . import checkpoint as checkpoints
from . import clouds as cloud_sets
from . import config as configs
from .config import Config, Data
from .edge import gather_rows, nearest_others
from .errors import run_command
from .levels import Result, Step
from .loss import masked_mean, nearest_distances
from .network import normalise
from .patches import PatchSource
from .train import Trainer, device_named
from .validation import Validation, midpoint, repeat

TABLE = "table.json"
AVERAGE = 0.99  # a few thousand steps have no use for a mean over the last thousand
UNIFORMITY = 1.0
SURFACE = 2.0
INTERIOR = 0.7  # of a patch's radius: nearer to the border, points lack neighbours
DENSEST = 16  # more doublings than any ladder has
TIMED, TIMED_BATCH = 40, 8


class Variant(NamedTuple):
    """`change` edits the group's base config in place."""

    group: str
    says: str
    change: Callable[[Config], None]


def switch(**values: Any) -> Callable[[Config], None]:
    return lambda config: setattr(config, "unit", replace(config.unit, **values))


def other_seed(config: Config) -> None:
    config.seed += 1


def one_unit(config: Config) -> None:
    """Two stages: 2x, then all levels; a stage for the newest unit alone has no meaning."""
    config.unit = replace(config.unit, shared=True)
    first, alone, joint = config.stages
    config.stages = [first, replace(joint, share=alone.share + joint.share)]


def apart(config: Config) -> None:
    """The joint stage's time goes to the second unit alone."""
    first, alone, joint = config.stages
    config.stages = [first, replace(alone, share=alone.share + joint.share)]


def at_once(config: Config) -> None:
    """At the rate of the first stage, which starts from the same random weights."""
    config.stages = [replace(config.stages[-1], share=1.0, learning_rate=config.stages[0].learning_rate)]


def neighbours(k: int, by: str) -> Callable[[Config], None]:
    def change(config: Config) -> None:
        config.k = k
        config.unit = replace(config.unit, neighbours=by)

    return change


def uniformity(config: Config) -> None:
    config.loss.uniformity = UNIFORMITY


def surface(config: Config) -> None:
    config.loss.surface = SURFACE


def outliers(config: Config) -> None:
    config.loss.outliers_from = [0.0] * len(config.loss.outliers_from)


def unbalanced(config: Config) -> None:
    config.loss.balance = 0.0


VARIANTS: Dict[str, Variant] = {
    "full": Variant("paper", "the progressive schedule", lambda config: None),
    "full-2": Variant("paper", "`full` from another seed", other_seed),
    "one-unit": Variant("paper", "one unit's weights at both levels, with the skip", one_unit),
    "apart": Variant("paper", "unit 1, then unit 2 on frozen unit 1", apart),
    "at-once": Variant("paper", "both units together from the start", at_once),
    "no-skip": Variant("paper", "nothing taken from the level before", switch(skip=False)),
    "baseline": Variant("unit", "the plain unit", lambda config: None),
    "baseline-2": Variant("unit", "`baseline` from another seed", other_seed),
    "shared-16": Variant("unit", "16 neighbours by coordinates in all blocks", neighbours(16, "space-shared")),
    "k16": Variant("unit", "16 neighbours instead of 32", neighbours(16, "features")),
    "space": Variant("unit", "first block's neighbours by coordinates", neighbours(32, "space")),
    "space-shared": Variant("unit", "all blocks' neighbours by coordinates", neighbours(32, "space-shared")),
    "learned-code": Variant("unit", "the two codes learn", switch(code="learned")),
    "midpoint": Variant("unit", "second copy starts halfway to a neighbour", switch(start="midpoints")),
    "uniformity": Variant("unit", f"crowding term in the loss, weight {UNIFORMITY:g}", uniformity),
    "outliers": Variant("unit", "the authors' outlier rule, from the first step", outliers),
    "unbalanced": Variant("unit", "all patches weigh alike, however hard", unbalanced),
    "surface": Variant("unit", f"prediction to reference weighted {SURFACE:g}", surface),
}
LEVELS = {"paper": 2, "unit": 1}


def config_of(base: Config, name: str) -> Config:
    """The base config cut to the group's levels, with the variant's change."""
    config, paper = configs.from_dict(base.as_dict()), Config()
    variant = VARIANTS[name]
    config.levels = LEVELS[variant.group]
    config.stages = [stage for stage in config.stages if stage.levels <= config.levels]
    config.average = AVERAGE
    # The paper's unit, which the variants depart from.
    config.k, config.unit = paper.k, replace(config.unit, neighbours=paper.unit.neighbours)
    variant.change(config)
    return config


def train(config: Config, clouds: cloud_sets.Clouds, seconds: float) -> Trainer:
    """Runs the config's whole schedule in `seconds`."""
    clock = clock_of(clouds.device)
    trainer = Trainer(config, clouds, seconds)
    # Cascades of fewer parameters have drawn fewer numbers: from here on all draw the same batches.
    torch.manual_seed(config.seed)
    last = clock()
    while not trainer.finished:
        trainer.train_step()
        now = clock()
        trainer.stage_seconds += now - last
        trainer.seconds += now - last
        last = now
        if trainer.progress() >= 1:
            trainer.leave_stage()
    return trainer


def clock_of(device: torch.device) -> Callable[[], float]:
    """Seconds of this process on the CPU; of the wall elsewhere."""
    return time.process_time if device.type == "cpu" else time.monotonic


class Scorer:
    """Held-out patches of one group: against references as dense as the prediction, and against the densest clouds."""

    def __init__(self, clouds: cloud_sets.Clouds, config: Config, patches: int):
        self.matched = Validation(clouds, config, patches)
        self.densest = Validation(clouds, config, patches, extra=DENSEST)
        self.levels = config.levels

    def scores(self, steps: Sequence[Step]) -> Dict[str, Dict[str, float]]:
        """{"even 2x": {"cd", "hd", "p2f", "cv"}}: see `Validation.scores`; p2f and cv as in the functions below."""
        table = self.matched.scores(steps)
        for name, result in self.densest.results(steps):
            table[name].update(p2f=1e3 * to_surface(result), cv=variation(result))
        return table

    def controls(self) -> Dict[str, Dict[str, Dict[str, float]]]:
        """Of rules that learn nothing."""
        return {rule.__name__: self.scores([rule] * self.levels) for rule in (midpoint, repeat)}


def to_surface(result: Result) -> float:
    """Mean distance of the predictions to the densest cloud of the shape, in patch radii: it stands in for the distance
    to the surface, and has a floor of about half that cloud's spacing."""
    distances = nearest_distances(result.prediction, result.reference).to_reference.sqrt()
    return masked_mean(distances, result.prediction_inside, None).mean().item()


def variation(result: Result) -> float:
    """Coefficient of variation of the distance to the nearest other prediction in a patch's interior, by patch."""
    prediction = result.prediction
    partners = gather_rows(prediction, nearest_others(prediction, 1)).squeeze(2)
    distances = (prediction - partners).norm(dim=-1)
    interior = result.prediction_inside & (prediction.norm(dim=-1) < INTERIOR)
    mean = masked_mean(distances, interior, None)
    spread = masked_mean((distances - mean.unsqueeze(1)).square(), interior, None).sqrt()
    return (spread / mean.clamp_min(1e-12)).mean().item()


@torch.no_grad()
def milliseconds(units: Dict[str, torch.nn.Module], clouds: cloud_sets.Clouds, patch: int) -> Dict[str, float]:
    """Each unit's forward pass on one patch of a batch: the least of several tries. They take turns, so that a machine
    that is busy for a while is so for all of them."""
    points = normalise(PatchSource(clouds, Data(), patch, random.Random(0)).draw(1, TIMED_BATCH).points)[0]
    clock = clock_of(clouds.device)
    least = dict.fromkeys(units, float("inf"))
    for _ in range(TIMED):
        for name, unit in units.items():
            start = clock()
            float(unit(points).dense[0, 0, 0])  # on a GPU, waits for the result
            least[name] = min(least[name], 1e3 * (clock() - start) / len(points))
    return least


def row_of(name: str, trainer: Trainer, scorer: Scorer) -> Dict[str, Any]:
    """What the table keeps of a variant, at the mean of its weights."""
    units = list(trainer.averaged.units)
    return {
        "group": VARIANTS[name].group,
        "says": VARIANTS[name].says,
        "scores": scorer.scores(units),
        "parameters": sum(parameter.numel() for parameter in trainer.averaged.parameters()),
        "steps": trainer.step,
        "seconds": trainer.seconds,
        "stages": trainer.history,
        "seed": trainer.config.seed,
    }


def save(table: Dict[str, Any], folder: Path) -> None:
    """Both forms; the one that is read again is replaced as a whole."""
    temporary = folder / "table.tmp"
    temporary.write_text(json.dumps(table, indent=1))
    temporary.replace(folder / TABLE)
    (folder / "table.md").write_text(markdown(table))


def markdown(table: Dict[str, Any]) -> str:
    """Two tables; a cell has the even, the random and the noisy input."""
    lines = []
    for group, levels in LEVELS.items():
        rows = {name: table["rows"][name] for name in VARIANTS if name in table["rows"]}
        rows = {name: row for name, row in rows.items() if row["group"] == group}
        if not rows:
            continue
        ratios = [f"{2**level}x" for level in range(1, levels + 1)]
        heads = [f"{score} {ratio}" for ratio in ratios for score in ("CD", "HD", "P2F", "CV")]
        heads = ["variant", "", *heads, "parameters", "ms", "steps"]
        lines += [f"## {group}", "", "| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
        for name, row in rows.items():
            end = [f"{row['parameters']:,}", f"{row.get('milliseconds', 0):.2f}", f"{row['steps']:,}"]
            lines.append(line([name, row["says"], *cells(row["scores"], ratios), *end]))
        for name, scores in table["controls"].get(group, {}).items():
            lines.append(line([f"rule: {name}", "learns nothing", *cells(scores, ratios), "0", "", ""]))
        lines.append("")
    return "\n".join(lines)


def line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def cells(scores: Dict[str, Dict[str, float]], ratios: List[str]) -> List[str]:
    found = []
    for ratio in ratios:
        for score, digits in (("cd", 2), ("hd", 1), ("p2f", 1), ("cv", 2)):
            values = (scores[f"{case} {ratio}"][score] for case in ("even", "random", "noisy"))
            found.append(" / ".join(f"{value:.{digits}f}" for value in values))
    return found


def parse(values: Optional[List[str]]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="the file that `prepare` wrote")
    parser.add_argument("--out", type=Path, required=True, help="folder of the tables and checkpoints")
    parser.add_argument("--minutes", type=float, required=True, help="training time of each variant")
    parser.add_argument("--only", help=f"variants, with commas between; of {', '.join(VARIANTS)}")
    parser.add_argument("--config", type=Path, default=Path("default"), help="what the variants depart from")
    parser.add_argument("--patches", type=int, default=64, help="held-out patches of each kind of input and ratio")
    parser.add_argument("--device", default="cpu", choices=["auto", "cpu", "cuda"])
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args(values)
    arguments.only = arguments.only.split(",") if arguments.only else list(VARIANTS)
    unknown = [name for name in arguments.only if name not in VARIANTS]
    if unknown:
        parser.error(f"no variant {', '.join(unknown)}; there are {', '.join(VARIANTS)}")
    return arguments


def main(values: Optional[List[str]] = None) -> None:
    arguments = parse(values)
    torch.set_num_threads(arguments.threads)
    device, base = device_named(arguments.device), configs.load(arguments.config)
    settings = {"minutes": arguments.minutes, "patches": arguments.patches, "config": base.as_dict()}
    file = arguments.out / TABLE
    table = {**settings, "rows": {}, "controls": {}}
    if file.exists():
        table = json.loads(file.read_text())
        if any(table[name] != value for name, value in settings.items()):
            raise SystemExit(f"{file} was made with another --minutes, --patches or --config; use another --out")
    training = cloud_sets.load(arguments.data, device, held_out=False)
    held_out = cloud_sets.load(arguments.data, device, held_out=True)
    scorers: Dict[str, Scorer] = {}
    for name in arguments.only:
        if name in table["rows"]:
            print(f"{name}: done before", flush=True)
            continue
        group, config = VARIANTS[name].group, config_of(base, name)
        if group not in scorers:
            scorers[group] = Scorer(held_out, config, arguments.patches)
            table["controls"][group] = scorers[group].controls()
        trainer = train(config, training, 60 * arguments.minutes)
        checkpoints.save(arguments.out / name / checkpoints.FILE, trainer.state())
        table["rows"][name] = row_of(name, trainer, scorers[group])
        save(table, arguments.out)
        print(f"{name}: {trainer.step} steps, {json.dumps(table['rows'][name]['scores'])}", flush=True)
    cascades = {name: checkpoints.load_cascade(arguments.out / name)[0].to(device) for name in table["rows"]}
    units = {name: cascade.units[0] for name, cascade in cascades.items()}
    for name, value in milliseconds(units, held_out, base.patch).items():
        table["rows"][name]["milliseconds"] = value
    save(table, arguments.out)


if __name__ == "__main__":
    run_command(main)
