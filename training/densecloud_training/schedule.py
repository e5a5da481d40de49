"""What learns when: stages, freezing, and the learning rate within a stage."""

import math
from typing import List

from .config import Config, Stage
from .network import Cascade


def trained_units(stage: Stage) -> range:
    """0-based units that learn in a stage: the newest alone, or all so far."""
    return range(0 if stage.together else stage.levels - 1, stage.levels)


def prepare_units(cascade: Cascade, stage: Stage, warm_start: bool, first_round: bool) -> List:
    """Freezes and thaws units for a stage and returns the parameters that learn.

    With `warm_start`, a unit that enters the schedule copies the weights of the unit before it: all units have the same
    parameters, and doubling a cloud is nearly the same task at every level.
    """
    units, learning = list(cascade.units), trained_units(stage)
    if warm_start and first_round and not stage.together and stage.levels > 1:
        units[stage.levels - 1].load_state_dict(units[stage.levels - 2].state_dict())
    for unit in units:
        unit.requires_grad_(False)
    for number in learning:
        units[number].requires_grad_(True)
    # Once each, though levels may share them.
    return list(dict.fromkeys(parameter for number in learning for parameter in units[number].parameters()))


def learning_rate(config: Config, stage: Stage, progress: float, step: int) -> float:
    """Cosine fall to `decay_to` of the stage's rate over its progress (0..1), after a linear rise of `warmup` steps."""
    fall = config.decay_to + (1 - config.decay_to) * 0.5 * (1 + math.cos(math.pi * min(1.0, progress)))
    rise = min(1.0, (step + 1) / config.warmup) if config.warmup else 1.0
    return stage.learning_rate * fall * rise
