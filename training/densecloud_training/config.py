"""Settings of a run, read from a TOML file; every field is documented in configs/default.toml."""

from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Dict, List

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib

from .errors import InputError

CONFIGS = Path(__file__).with_name("configs")


@dataclass
class Stage:
    """One stage of the schedule: `levels` units take part; the last alone learns, or all together."""

    levels: int
    together: bool
    share: float
    iterations: int
    learning_rate: float

    @property
    def name(self) -> str:
        return f"{'together' if self.together else 'alone'}-{2**self.levels}x"


@dataclass
class Data:
    windows: List[float] = field(default_factory=lambda: [1.0, 1.0, 1.0, 1.0])
    kinds: Dict[str, float] = field(default_factory=lambda: {"poisson": 1.0})
    noise_share: float = 1.0
    noise_most: float = 0.01
    noise_power: float = 0.0
    scale: List[float] = field(default_factory=lambda: [0.8, 1.2])
    reference_margin: float = 1.0
    reference_extra: int = 0
    seed_pull: float = 1.0
    coverage: float = 1e9
    level_noise: float = 0.0
    seed_jitter: float = 0.0
    holes_share: float = 0.0
    holes_most: float = 0.2
    cut_share: float = 0.0
    thin_share: float = 0.0
    quantised_share: float = 0.0
    quantised_most: float = 0.1
    outlier_share: float = 0.0
    outlier_most: float = 0.03


@dataclass
class Loss:
    factor: float = 50.0
    ratio_weights: List[float] = field(default_factory=lambda: [4.0, 3.0, 2.0, 1.0])
    outlier_threshold: float = 2.0
    outliers_from: List[float] = field(default_factory=lambda: [2.0, 0.6, 0.6, 0.6])
    borders: bool = False
    balance: float = 0.0
    surface: float = 1.0
    uniformity: float = 0.0


@dataclass
class Switches:
    """What a unit does; the defaults are the plain unit, the only one that the ONNX files hold (see `variants`)."""

    neighbours: str = "features"
    code: str = "fixed"
    start: str = "copies"
    skip: bool = True
    shared: bool = False

    CHOICES = {
        "neighbours": ("features", "space", "space-shared"),
        "code": ("fixed", "learned"),
        "start": ("copies", "midpoints"),
    }

    def __post_init__(self):
        for name, choices in self.CHOICES.items():
            if getattr(self, name) not in choices:
                raise InputError(f"unit.{name} = {getattr(self, name)!r}: must be one of {', '.join(choices)}")


@dataclass
class Config:
    seed: int = 0
    levels: int = 4
    k: int = 32
    patch: int = 312
    batch_cpu: int = 8
    batch_cuda: int = 28
    warm_start: bool = False
    decay_to: float = 1.0
    warmup: int = 0
    clip_value: float = 1.0
    average: float = 0.0
    ratio_draw: List[float] = field(default_factory=lambda: [1.0, 2.0, 3.0, 4.0])
    data: Data = field(default_factory=Data)
    loss: Loss = field(default_factory=Loss)
    unit: Switches = field(default_factory=Switches)
    stages: List[Stage] = field(default_factory=list)
    extension: List[Stage] = field(default_factory=list)

    def as_dict(self) -> dict:
        return asdict(self)


def load(path: Path) -> Config:
    """Reads a config by path, or by name from the package's `configs/`."""
    try:
        return from_dict(read(path))
    except (tomllib.TOMLDecodeError, TypeError) as error:
        raise InputError(f"{path}: not a config: {error}") from error


def read(path: Path) -> dict:
    """The values of a config; what it leaves out comes from the one that its `base` names."""
    with open(found(path), "rb") as file:
        values = tomllib.load(file)
    if "base" not in values:
        return values
    base = read(Path(values.pop("base")))
    return {**base, **{name: filled(base.get(name), value) for name, value in values.items()}}


def found(path: Path) -> Path:
    """A config's file, given itself or as a name of the package's own."""
    if path.exists():
        return path
    own = sorted(file.stem for file in CONFIGS.glob("*.toml"))
    if str(path) not in own:
        raise InputError(f"--config {path} is no file, nor one of the package's own: {', '.join(own)}")
    return CONFIGS / f"{path}.toml"


def filled(base: object, value: object) -> object:
    """A table with what it leaves out of `base`; anything else as it is, inner tables too."""
    return {**base, **value} if isinstance(base, dict) and isinstance(value, dict) else value


def from_dict(values: dict) -> Config:
    values = dict(values)
    known = {item.name for item in fields(Config)}
    unknown = set(values) - known
    if unknown:
        raise InputError(f"unknown settings: {', '.join(sorted(unknown))}; known: {', '.join(sorted(known))}")
    values["data"] = Data(**values.get("data", {}))
    values["loss"] = Loss(**values.get("loss", {}))
    values["unit"] = Switches(**values.get("unit", {}))
    for schedule in ("stages", "extension"):
        values[schedule] = [Stage(**stage) for stage in values.get(schedule, [])]
    return Config(**values)
