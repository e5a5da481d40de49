"""Whether `confidence` keeps its word: of the points said to be 0.9, nine in ten lie within a spacing of the surface.

Two kinds of truth. Held-out shapes: a dense random sample of the mesh. Real scans, thinned as in `real`: the whole
scan, which is a sample itself and ends at its own spacing and noise. Points that lie in no company there (see
`confirmed`) testify for nobody, themselves included; the others do, and so do the middles between each and its nearest
ones, or a perfect point between four of the scan's would count as false. What a tenth of the scan's own points would
score against the rest, if they were held out, stands in the table: no result can be expected to do better.

Constants are fitted on one half of the shapes and of the scans; what is reported is the other half.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Iterator, List, Optional

import numpy as np
from scipy.spatial import cKDTree

from ..prepare import read_points
from . import evidence, real
from .evidence import Sites
from .inputs import Inputs
from .program import Program
from .table import markdown, plain

POINTS = 2048
# Of the sample of a surface that stands for it.
DENSE = 200_000
DENSE_SEED = 9
SHAPES = "shapes"
SCANS = "scans"
# Points of a result that are looked at, and points of a truth that are looked for.
MOST = 8_000
BINS = 10
LEAST = (0.0, 0.5, 0.8, 0.9)
# A point whose nearest other is further than this many times what is usual around it is in no company.
LONELY = 3.0
# A scan counts this many times as much as a shape in the fit: what is said of scans has to hold.
SCANS_COUNT = 2.0

HEADER = ["kind", "said", "share of the points, %", "said on average", "within a spacing"]
LEAST_HEADER = ["kind", "least", "points left, %", "false 1, %", "false 2, %", "miss 1, %", "miss 2, %"]
CASE_HEADER = ["input", "ratio", "said on average", "within a spacing", "the scan's own points"]
NOTE = """Said: the program's `confidence`. Within: share of the points no further from the surface than one spacing \
of the result there. Every case (a shape or a scan, an input, a ratio) counts alike. Least: with `--min-confidence` at \
that. False: share of the result further from the surface than 1 or 2 of its spacings; miss: share of the surface \
further from the result. The scan's own points: the share of a tenth of them that lies within a spacing of the surface \
of the others.
"""


@dataclass(frozen=True)
class Case:
    """Points of one result: what is said of each, whether it is so, and what says it."""

    kind: str
    name: str
    input: str
    ratio: int
    # To the surface, in spacings of the result.
    distances: np.ndarray
    said: np.ndarray
    features: np.ndarray
    # Of points of the surface to the result's with at least each of LEAST, in its spacings.
    missed: List[np.ndarray]
    # What the truth's own points score.
    ceiling: Optional[float] = None

    @property
    def within(self) -> np.ndarray:
        return self.distances <= 1


@dataclass(frozen=True)
class Truth:
    """A surface as its points tell it."""

    tree: cKDTree
    # Points that are looked for.
    points: np.ndarray
    ceiling: Optional[np.ndarray] = None
    held: Optional[np.ndarray] = None


def confirmed(points: np.ndarray) -> np.ndarray:
    """Whether each point lies in company: its nearest other is no further than LONELY times what is usual around it."""
    distances, near = cKDTree(points).query(points, real.AROUND + 1)
    return distances[:, 1] <= LONELY * np.median(distances[near[:, 1:], 1], axis=1)


def with_middles(points: np.ndarray) -> np.ndarray:
    """Points, and the middles between each and its nearest ones."""
    near = cKDTree(points).query(points, real.JOINED + 1)[1][:, 1:]
    return np.concatenate([points, *((points + points[theirs]) / 2 for theirs in near.T)])


def some(count: int, most: int = MOST, seed: int = 1) -> np.ndarray:
    """Indices of some of `count`."""
    return np.random.default_rng(seed).permutation(count)[:most]


def of_scan(points: np.ndarray) -> Truth:
    """A scan's points in company and the middles between them; and how far a tenth is from those of the others."""
    good = confirmed(points)
    held = np.random.default_rng(0).random(len(points)) < 0.1
    others = cKDTree(with_middles(points[good & ~held]))
    wanted = points[good][some(int(good.sum()))]
    return Truth(cKDTree(with_middles(points[good])), wanted, others.query(points[held])[0], points[held])


def of_mesh(sample: np.ndarray) -> Truth:
    """A sample dense enough to be the surface."""
    return Truth(cKDTree(sample), sample[some(len(sample))])


def judged(kind: str, name: str, given: str, ratio: int, source: np.ndarray, file: Path, truth: Truth) -> Case:
    """Compares what the program says of its points with the truth."""
    table = np.load(file)
    made, says = real.points_of(table), said_of(table)
    sites = Sites.of(source, made)
    chosen = some(len(made))
    distances = truth.tree.query(made[chosen])[0] / sites.result_spacing(made[chosen])
    spacing = sites.result_spacing(truth.points)
    left = [made[says >= least] for least in LEAST]
    nothing = np.full(len(truth.points), np.inf)
    missed = [cKDTree(some_left).query(truth.points)[0] / spacing if len(some_left) else nothing for some_left in left]
    ceiling = None
    if truth.ceiling is not None and truth.held is not None:
        ceiling = float((truth.ceiling <= sites.result_spacing(truth.held)).mean())
    features = sites.features(made[chosen])
    return Case(kind, name, given, ratio, distances, says[chosen], features, missed, ceiling)


def said_of(table: np.ndarray) -> np.ndarray:
    """The confidence of each point: a field, or, of what came as plain columns, the last."""
    return (table[:, -1] if table.dtype.names is None else table["confidence"]).astype(np.float64)


def made(program: Program, source: Path, ratio: int, place: Path) -> Path:
    """What the program makes of a file, with what it says of it; kept, and made again by a newer program."""
    place.parent.mkdir(parents=True, exist_ok=True)
    newest = max(source.stat().st_mtime_ns, Path(program.path).stat().st_mtime_ns)
    if not (place.exists() and place.stat().st_mtime_ns >= newest):
        program.upsample(source, place, "--ratio", ratio, "--confidence")
    return place


def shapes(inputs: Inputs) -> Iterator[Case]:
    """All inputs and ratios of the held-out shapes."""
    kinds = {
        "even": inputs.sampled(POINTS),
        "random": inputs.sampled(POINTS, "uniform"),
        "1 % noise": inputs.sampled(POINTS, noise=0.01),
        "1 % outliers": inputs.with_outliers(POINTS, 0.01),
        "5 % outliers": inputs.with_outliers(POINTS, 0.05),
    }
    surfaces = inputs.sampled(DENSE, "uniform", seed=DENSE_SEED)
    for shape in inputs.shapes:
        truth = of_mesh(read_points(surfaces / f"{shape}.ply"))
        for kind, folder in kinds.items():
            source = next(file for file in sorted(folder.iterdir()) if file.stem == shape)
            points = np.loadtxt(source) if source.suffix == ".xyz" else read_points(source)
            for ratio in (4, 16):
                result = made(inputs.program, source, ratio, inputs.out / "made" / f"{shape}-{folder.name}-{ratio}.npy")
                yield judged(SHAPES, shape, kind, ratio, points, result, truth)


def scans(program: Program, folders: List[Path], out: Path) -> Iterator[Case]:
    """All thinnings of the scans of `real` that are there."""
    for scan in real.SCANS:
        found = [folder / scan.file for folder in folders if (folder / scan.file).exists()]
        if not found:
            continue
        name = Path(scan.file).stem
        table = real.read(program, found[0], out / "real")
        whole = np.stack([table[axis] for axis in "xyz"], 1)
        chosen = real.cropped(whole)
        points = whole[chosen]
        truth = of_scan(points)
        for thinning, thin in real.thinnings(scan, table, chosen).items():
            source = points[thin(points)]
            given = out / "made" / f"{name}-{thinning}.npy"
            given.parent.mkdir(parents=True, exist_ok=True)
            if not (given.exists() and np.array_equal(np.load(given), source)):
                np.save(given, source)
            result = made(program, given, real.RATIO, given.with_name(f"{name}-{thinning}-dense.npy"))
            yield judged(SCANS, name, thinning, real.RATIO, source, result, truth)


def halves(cases: List[Case]) -> "tuple[List[Case], List[Case]]":
    """Every second shape and every second scan by name, and the others."""
    first = set()
    for kind in (SHAPES, SCANS):
        first |= set(sorted({case.name for case in cases if case.kind == kind})[::2])
    return [case for case in cases if case.name in first], [case for case in cases if case.name not in first]


def weights(cases: List[Case]) -> np.ndarray:
    """Of each point of the cases: each case counts alike within its kind."""
    kinds = [case.kind for case in cases]
    counts = {SHAPES: 1.0, SCANS: SCANS_COUNT}
    each = [counts[case.kind] / kinds.count(case.kind) / len(case.said) for case in cases]
    return np.concatenate([np.full(len(case.said), weight) for case, weight in zip(cases, each)])


def fitted(cases: List[Case]) -> np.ndarray:
    """The model's constants for some cases."""
    features = np.concatenate([case.features for case in cases])
    within = np.concatenate([case.within for case in cases]).astype(np.float64)
    return evidence.fit(features, within, weights(cases))


def calibration(said: np.ndarray, within: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """[10,3]: of each tenth of what can be said, the share of the points, what is said on average, and the share that
    lies within a spacing; NaN where nothing is."""
    bins = np.clip((said * BINS).astype(int), 0, BINS - 1)
    total = np.bincount(bins, weight, BINS)
    with np.errstate(invalid="ignore"):
        means = [np.bincount(bins, weight * values, BINS) / total for values in (said, within.astype(np.float64))]
    return np.stack([total / weight.sum(), *means], 1)


def of_kind(cases: List[Case], kind: str) -> "tuple[np.ndarray, np.ndarray, np.ndarray]":
    """Said, within and weight of all points of a kind."""
    cases = [case for case in cases if case.kind == kind]
    said = np.concatenate([case.said for case in cases])
    return said, np.concatenate([case.within for case in cases]), weights(cases)


def kinds_of(cases: List[Case]) -> List[str]:
    """The kinds that there are."""
    return [kind for kind in (SHAPES, SCANS) if any(case.kind == kind for case in cases)]


def bins_table(cases: List[Case]) -> str:
    """Said against observed, in ten bins, and what is said to be 0.9 or more."""
    rows = []
    for kind in kinds_of(cases):
        said, within, weight = of_kind(cases, kind)
        for i, (share, mean, observed) in enumerate(calibration(said, within, weight)):
            rows.append([kind, f"{i / BINS:.1f} to {(i + 1) / BINS:.1f}", plain(100 * share), plain(mean, 3),
                         plain(observed, 3)])  # fmt: skip
        for text, chosen in (("0.85 to 0.95", (said >= 0.85) & (said < 0.95)), ("0.9 and more", said >= 0.9)):
            share = weight[chosen].sum()
            means = [np.sum((weight * values)[chosen]) / share for values in (said, within)]
            rows.append([kind, text, plain(100 * share / weight.sum()), *(plain(mean, 3) for mean in means)])
    return markdown(HEADER, rows)


def least_table(cases: List[Case]) -> str:
    """What `--min-confidence` leaves of points, of false surface and of coverage: means over the cases."""
    rows = []
    for kind in kinds_of(cases):
        chosen = [case for case in cases if case.kind == kind]
        for i, least in enumerate(LEAST):
            kept = [case.distances[case.said >= least] for case in chosen]
            left = np.mean([len(k) / len(case.said) for k, case in zip(kept, chosen)])
            false = [np.mean([(k > limit).mean() for k in kept if len(k)]) for limit in (1, 2)]
            miss = [np.mean([(case.missed[i] > limit).mean() for case in chosen]) for limit in (1, 2)]
            rows.append([kind, plain(least, 1), *(plain(100 * float(share)) for share in (left, *false, *miss))])
    return markdown(LEAST_HEADER, rows)


def cases_table(cases: List[Case]) -> str:
    """Each input: shapes together, scans each."""
    rows = []
    keys = dict.fromkeys((c.kind, c.name if c.kind == SCANS else "", c.input, c.ratio) for c in cases)
    for kind, name, given, ratio in keys:
        chosen = [
            c for c in cases if (c.kind, c.input, c.ratio) == (kind, given, ratio) and (not name or c.name == name)
        ]
        means = [np.mean([values(c).mean() for c in chosen]) for values in (lambda c: c.said, lambda c: c.within)]
        ceiling = [c.ceiling for c in chosen if c.ceiling is not None]
        cells = [plain(float(mean), 3) for mean in means]
        best = plain(float(np.mean(ceiling)), 3) if ceiling else ""
        rows.append([f"{name} {given}".strip(), str(ratio), *cells, best])
    return markdown(CASE_HEADER, rows)


def text(cases: List[Case]) -> str:
    """All tables, of the half that nothing was fitted on."""
    tested = halves(cases)[1]
    return "\n".join([NOTE, bins_table(tested), least_table(tested), cases_table(tested)])


def fit_text(cases: List[Case]) -> str:
    """The constants for the first half, how near the program says the same, and the tables that they would give."""
    first, second = halves(cases)
    constants = fitted(first)
    again = [
        Case(c.kind, c.name, c.input, c.ratio, c.distances, evidence.said(constants, c.features), c.features, c.missed)
        for c in second
    ]
    off = np.concatenate([np.abs(a.said - c.said) for a, c in zip(again, second)])
    lines = [f"constant {constants[0]:.4f}"]
    lines += [f"{name} {weight:.4f}" for name, weight in zip(evidence.NAMES, constants[1:])]
    lines.append(f"The program says it to {off.mean():.4f} on average, {np.quantile(off, 0.99):.4f} for 99 in 100.\n")
    return "\n".join([*lines, bins_table(again)])


def draw(cases: List[Case], out: Path) -> None:
    """Said against observed."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    tested = halves(cases)[1]
    figure, panel = pyplot.subplots(figsize=(5, 5))
    panel.plot([0, 1], [0, 1], color="0.6", linestyle="--", label="as said")
    for kind, marker in zip(kinds_of(tested), "os"):
        _, said, within = calibration(*of_kind(tested, kind)).T
        panel.plot(said, within, marker=marker, label=kind)
    panel.set(xlabel="said: confidence", ylabel="share within one spacing of the surface", xlim=(0, 1), ylim=(0, 1))
    panel.grid(alpha=0.25)
    panel.legend()
    figure.tight_layout()
    figure.savefig(out, dpi=90)
