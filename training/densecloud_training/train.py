"""Trains a cascade: `python -m densecloud_training.train --data CLOUDS --out RUN --budget MINUTES`."""

import argparse
import copy
import json
import random
import shutil
import signal
import sys
import time
from pathlib import Path
from typing import Any, Dict, List, NamedTuple, Optional, Union

import torch

from . import checkpoint as checkpoints
from . import clouds as cloud_sets
from . import config as configs
from .config import Config, Stage
from .errors import run_command
from .levels import run_levels
from .loss import chamfer, crowding
from .patches import PatchSource, Source
from .profiling import part, report
from .schedule import learning_rate, prepare_units
from .validation import Validation
from .variants import build_cascade

LOG = "log.jsonl"


class Material(NamedTuple):
    """What a run is trained on, where that is no set of clouds: for the card, and the device that trains."""

    names: List[str]
    sources: List[Dict[str, str]]
    device: torch.device


class Trainer:
    """A run: the cascade, the stage it is in, and everything that decides the next step."""

    def __init__(
        self,
        config: Config,
        training: Union[cloud_sets.Clouds, Material],
        budget_seconds: Optional[float],
        source: Optional[Source] = None,
    ):
        """`source` draws the batches; without one, they come from the clouds of `training`."""
        self.config, self.training, self.budget = config, training, budget_seconds
        self.device = training.device
        self.host = random.Random(config.seed)
        torch.manual_seed(config.seed)
        self.cascade = build_cascade(config.levels, config.k, config.unit).to(self.device)
        # What is scored and shipped: a running mean of the weights, which steps of a high rate do not shake.
        self.averaged = copy.deepcopy(self.cascade).requires_grad_(False)
        self.source = source or PatchSource(training, config.data, config.patch, self.host)
        self.batch = config.batch_cuda if self.device.type == "cuda" else config.batch_cpu
        self.round, self.stage_index, self.stage_step, self.step = 0, 0, 0, 0
        self.stage_seconds, self.seconds, self.patches = 0.0, 0.0, 0
        self.history: List[Dict[str, Any]] = []
        self.enter_stage()

    @property
    def stages(self) -> List[Stage]:
        return self.config.stages if self.round == 0 else self.config.extension

    @property
    def stage(self) -> Stage:
        return self.stages[self.stage_index]

    @property
    def finished(self) -> bool:
        return self.stage_index >= len(self.stages)

    @property
    def label(self) -> str:
        return "finished" if self.finished else f"{self.round}.{self.stage_index} {self.stage.name}"

    def enter_stage(self) -> None:
        """Freezes, warm-starts, and gives the units that learn a fresh optimiser."""
        self.stage_step, self.stage_seconds = 0, 0.0
        if not self.finished:
            # The next stage goes on from the mean, too.
            self.cascade.load_state_dict(self.averaged.state_dict())
            learning = prepare_units(self.cascade, self.stage, self.config.warm_start, self.round == 0)
            self.averaged.load_state_dict(self.cascade.state_dict())
            self.optimiser = torch.optim.Adam(learning, lr=self.stage.learning_rate)

    def leave_stage(self) -> None:
        self.history.append({"stage": self.label, "steps": self.stage_step, "seconds": round(self.stage_seconds, 1)})
        self.stage_index += 1
        self.enter_stage()

    def extend(self) -> None:
        """Starts the config's extension stages on a finished run."""
        self.round, self.stage_index = self.round + 1, 0
        self.enter_stage()

    def progress(self) -> float:
        """Share of the stage that is done: of its seconds under a budget, else of its iterations."""
        if self.budget is None:
            return self.stage_step / self.stage.iterations
        total = sum(stage.share for stage in self.stages)
        return self.stage_seconds / max(1e-9, self.budget * self.stage.share / total)

    def draw_levels(self) -> int:
        """The newest unit alone trains its own ratio; a joint stage draws one among those so far."""
        stage = self.stage
        if not stage.together:
            return stage.levels
        return self.host.choices(range(1, stage.levels + 1), self.config.ratio_draw[: stage.levels])[0]

    def train_step(self) -> tuple:
        """One step; returns the ratio and the unweighted loss as a device tensor (reading it waits for the device)."""
        settings = self.config.loss
        levels = self.draw_levels()
        progress = self.progress()
        frozen = 0 if self.stage.together else levels - 1
        with part("draw patches"):
            batch = self.source.draw(levels, self.batch)
        with part("forward"):
            result = run_levels(list(self.cascade.units)[:levels], batch, self.config.data, frozen)
        with part("loss"):
            outliers = settings.outlier_threshold if progress >= settings.outliers_from[levels - 1] else None
            inside = (result.prediction_inside, result.reference_inside) if settings.borders else (None, None)
            losses = chamfer(result.prediction, result.reference, *inside, outliers, settings.surface)
            if settings.uniformity:
                losses = losses + settings.uniformity * crowding(result.prediction, inside[0])
            loss = losses.mean()
            # Patches that nobody can fill well (gaps, backs of scans) would outweigh those that can be learned.
            weights = (loss / losses.clamp_min(1e-9)).detach() ** settings.balance
            objective = (losses * weights / weights.mean()).mean()
        with part("backward"):
            self.optimiser.zero_grad(set_to_none=True)
            (objective * settings.factor * settings.ratio_weights[levels - 1]).backward()
        with part("optimiser"):
            for group in self.optimiser.param_groups:
                group["lr"] = learning_rate(self.config, self.stage, progress, self.stage_step)
            learning = [p for group in self.optimiser.param_groups for p in group["params"] if p.grad is not None]
            torch.nn.utils.clip_grad_value_(learning, self.config.clip_value)
            self.optimiser.step()
            self.average()
        self.step += 1
        self.stage_step += 1
        self.patches += self.batch
        return levels, loss.detach()

    @torch.no_grad()
    def average(self) -> None:
        """Moves the mean towards the weights: an exponential mean, over fewer steps at the start of a stage."""
        decay = min(self.config.average, (1 + self.stage_step) / (10 + self.stage_step))
        pairs = zip(self.averaged.parameters(), self.cascade.parameters())
        means, values = zip(*((mean, value) for mean, value in pairs if value.requires_grad))
        torch._foreach_mul_(means, decay)
        torch._foreach_add_(means, values, alpha=1 - decay)

    def state(self) -> Dict[str, Any]:
        names = ("round", "stage_index", "stage_step", "step", "stage_seconds", "seconds", "patches", "history")
        return {
            "config": self.config.as_dict(),
            "cascade": self.cascade.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "random": checkpoints.random_state(self.host, self.device),
            "data": [{"name": name, **source} for name, source in zip(self.training.names, self.training.sources)],
            "counters": {name: getattr(self, name) for name in names},
        }

    def restore(self, state: Dict[str, Any]) -> None:
        counters = state["counters"]
        self.round, self.stage_index = counters["round"], counters["stage_index"]
        self.enter_stage()
        self.cascade.load_state_dict(state["cascade"])
        self.averaged.load_state_dict(state.get("averaged", state["cascade"]))
        if not self.finished:
            self.optimiser.load_state_dict(state["optimiser"])
        for name, value in counters.items():
            setattr(self, name, value)
        checkpoints.restore_random_state(state["random"], self.host, self.device)


class Log:
    """One JSON object a line; a run that resumes appends."""

    def __init__(self, path: Path):
        self.path = path

    def write(self, **entry: Any) -> None:
        with open(self.path, "a") as file:
            file.write(json.dumps(entry) + "\n")
        print(" ".join(f"{key}={value}" for key, value in entry.items()), flush=True)


class Meter:
    """Losses by ratio since the last report, summed on the device."""

    def __init__(self):
        self.sums: Dict[int, Any] = {}
        self.since, self.patches = time.monotonic(), 0

    def add(self, levels: int, loss: torch.Tensor, patches: int) -> None:
        total, count = self.sums.get(levels, (0.0, 0))
        self.sums[levels] = (total + loss, count + 1)
        self.patches += patches

    def report(self) -> Dict[str, Any]:
        losses = {f"{2**level}x": round(1e3 * float(s) / n, 4) for level, (s, n) in sorted(self.sums.items())}
        rate = self.patches / max(1e-9, time.monotonic() - self.since)
        return {"loss": losses, "patches_per_second": round(rate, 1)}


def run(trainer: Trainer, out: Path, validation: Optional[Validation], arguments: argparse.Namespace) -> None:
    """Steps until the schedule ends or a signal comes; logs, scores and saves on the clock."""
    out.mkdir(parents=True, exist_ok=True)
    stop: List[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda signum, frame: stop.append(signum))
    log, meter = Log(out / LOG), Meter()
    if validation:
        log.write(controls=rounded(validation.controls))
    last = time.monotonic()
    deadline = last + 60 * arguments.stop_after if arguments.stop_after is not None else float("inf")
    next_log, next_score, next_save = last + arguments.log_every, last, last + arguments.save_every
    while not trainer.finished and not stop:
        levels, loss = trainer.train_step()
        meter.add(levels, loss, trainer.batch)
        now = time.monotonic()
        trainer.stage_seconds += now - last
        trainer.seconds += now - last
        last = now
        at = {"step": trainer.step, "stage": trainer.label, "seconds": round(trainer.seconds, 1)}
        ends = trainer.progress() >= 1
        if now >= next_log or ends:
            rate = trainer.optimiser.param_groups[0]["lr"]
            log.write(**at, **meter.report(), progress=round(trainer.progress(), 4), learning_rate=round(rate, 8))
            meter, next_log = Meter(), now + arguments.log_every
        if validation and (now >= next_score or ends):
            scores = validation.of_cascade(trainer.averaged, trainer.stage.levels)
            log.write(**at, validation=rounded(scores))
            next_score = time.monotonic() + arguments.score_every
        if ends:
            trainer.leave_stage()
        if now >= deadline:
            stop.append(0)
        if now >= next_save or ends:
            checkpoints.save(out / checkpoints.FILE, trainer.state())
            next_save = now + arguments.save_every
    checkpoints.save(out / checkpoints.FILE, trainer.state())
    log.write(step=trainer.step, stage=trainer.label, stopped="schedule ended" if trainer.finished else "early")


def starting_point(out: Path, start_from: Optional[Path]) -> Optional[Path]:
    """The checkpoint to go on from: the run's own, else a copy of the one given, whose log then comes along."""
    own = out / checkpoints.FILE
    if own.exists() or start_from is None:
        return own if own.exists() else None
    checkpoint = start_from / checkpoints.FILE if start_from.is_dir() else start_from
    out.mkdir(parents=True, exist_ok=True)
    if (checkpoint.parent / LOG).exists():
        shutil.copyfile(checkpoint.parent / LOG, out / LOG)
    return checkpoint


def rounded(table: Dict[str, Any]) -> Dict[str, Any]:
    return {k: rounded(v) if isinstance(v, dict) else round(v, 4) for k, v in table.items()}


def device_named(name: str) -> torch.device:
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise SystemExit("no CUDA device is available; use --device cpu, or auto to take what is there")
    return torch.device(name)


def parse(values: Optional[List[str]] = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="the file that `prepare` wrote")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run; resumed if a checkpoint is there")
    parser.add_argument("--config", type=Path, default=Path("default"), help="a TOML file, or `default` or `paper`")
    parser.add_argument("--budget", type=float, help="minutes for the whole schedule; without: its iterations")
    parser.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"])
    parser.add_argument("--threads", type=int, help="CPU threads")
    parser.add_argument("--extend", action="store_true", help="run the extension stages on a finished checkpoint")
    parser.add_argument("--start-from", type=Path, help="go on from this run, model folder or checkpoint, into --out")
    parser.add_argument("--stop-after", type=float, help="minutes until this call saves and ends, whatever is left")
    parser.add_argument("--log-every", type=float, default=20.0, help="seconds")
    parser.add_argument("--score-every", type=float, default=240.0, help="seconds")
    parser.add_argument("--save-every", type=float, default=120.0, help="seconds")
    parser.add_argument("--compile", action="store_true", help="torch.compile the units (PyTorch 2 on a GPU)")
    parser.add_argument("--profile", type=int, metavar="STEPS", help="print where a step's time goes, and end")
    parser.add_argument("--no-validation", action="store_true")
    return parser.parse_args(values)


def main(values: Optional[List[str]] = None) -> None:
    arguments = parse(values)
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    device = device_named(arguments.device)
    source = starting_point(arguments.out, arguments.start_from)
    state = checkpoints.load(source) if source else None
    config = configs.load(arguments.config)
    training = cloud_sets.load(arguments.data, device, held_out=False)
    trainer = Trainer(config, training, arguments.budget * 60 if arguments.budget else None)
    if state:
        trainer.restore(state)
        if trainer.finished and arguments.extend:
            trainer.extend()
    if trainer.finished:
        sys.exit(f"the schedule of {source} has ended; --extend continues it")
    if arguments.compile:
        for unit in trainer.cascade.units:
            unit.forward = torch.compile(unit.forward)
    if arguments.profile:
        print("\n".join(report(trainer.train_step, arguments.profile, device)))
        return
    validation = None
    if not arguments.no_validation:
        validation = Validation(cloud_sets.load(arguments.data, device, held_out=True), config)
    run(trainer, arguments.out, validation, arguments)


if __name__ == "__main__":
    run_command(main)
