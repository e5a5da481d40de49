"""The cascade's own rules (overlap, what is merged, strays, polish), each changed alone: scores and time."""

import statistics
import time
from dataclasses import dataclass, replace
from typing import Dict, List, Sequence, Tuple

from .inputs import Inputs
from .program import Program
from .report import Scores, mean
from .table import markdown, plain, published, thousandths

POINTS, RATIO = 2048, 4
# The published distances vary with where farthest point sampling starts: means over these.
SEEDS = (1, 2)
METHODS = ("poisson", "uniform")
# For the time: a cloud large enough for the start of the program not to count.
TIMED_POINTS, TIMED_RUNS = 20_000, 3


@dataclass(frozen=True)
class Rule:
    """What changed, and the options of `evaluate` and `upsample` that do it."""

    says: str
    options: Tuple[str, ...] = ()


RULES = (
    Rule("the defaults"),
    *(Rule(f"overlap {x}", ("--overlap", x)) for x in ("1.5", "3", "5")),
    *(Rule(f"inner {x}", ("--inner", x)) for x in ("0", "0.15", "0.5", "1")),
    Rule("strays kept", ("--max-displacement", "inf", "--max-distance", "inf")),
    Rule("strays by displacement alone", ("--max-distance", "inf")),
    Rule("strays by distance alone", ("--max-displacement", "inf")),
    Rule("no polish", ("--no-polish",)),
)
HEADER = ["rule", "CD / HD / P2F, even", "chamfer", "CV", "CD / HD / P2F, random", "chamfer", "CV", "time"]


@dataclass(frozen=True)
class Row:
    """Mean scores by kind of input, and the median time of `upsample` in seconds."""

    scores: Dict[str, Scores]
    seconds: float


def text(rows: Dict[Rule, Row]) -> str:
    """The table, in Markdown; time as a share of the first row's."""
    base = next(iter(rows.values())).seconds
    lines = []
    for rule, row in rows.items():
        cells = [rule.says]
        for method in METHODS:
            s = row.scores[method]
            cells += [published(s["cd"], s["hd"], s["p2f"]), thousandths(s["chamfer"]), plain(s["spacing_variation"])]
        lines.append([*cells, plain(row.seconds / base)])
    return markdown(HEADER, lines)


def evaluate(inputs: Inputs, rules: Sequence[Rule] = RULES) -> Dict[Rule, Row]:
    """Scores every rule on the held-out shapes, then times all of them in turns."""
    reference = inputs.references(POINTS * RATIO)
    scores: Dict[Rule, Dict[str, Scores]] = {}
    for rule in rules:
        scores[rule] = {}
        for method in METHODS:
            given, found = inputs.sampled(POINTS, method), []
            for seed in SEEDS:
                program = changed(inputs.program, rule, "--seed", str(seed))
                report = program.evaluate(
                    inputs.out / "results", given, reference, inputs.meshes, inputs.shapes, float(RATIO), controls=False
                )
                found.append(report.means()["prediction"])
            scores[rule][method] = mean(found)
    seconds = timed(inputs, rules)
    return {rule: Row(scores[rule], seconds[rule]) for rule in rules}


def timed(inputs: Inputs, rules: Sequence[Rule]) -> Dict[Rule, float]:
    """Rules take turns, so that a busy machine treats them alike."""
    only = replace(inputs, shapes=inputs.shapes[:1])
    cloud = only.sampled(TIMED_POINTS) / f"{only.shapes[0]}.ply"
    times: Dict[Rule, List[float]] = {rule: [] for rule in rules}
    for _ in range(TIMED_RUNS):
        for rule in rules:
            start = time.perf_counter()
            program = changed(inputs.program, rule)
            program.upsample(cloud, inputs.out / "timed.ply", "--ratio", RATIO)
            times[rule].append(time.perf_counter() - start)
    return {rule: statistics.median(found) for rule, found in times.items()}


def changed(program: Program, rule: Rule, *more: str) -> Program:
    """The program with a rule's options."""
    return replace(program, options=[*program.options, *rule.options, *more])
