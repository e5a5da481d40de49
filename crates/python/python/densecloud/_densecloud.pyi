from collections.abc import Callable
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "__version__",
    "Origin",
    "Report",
    "Tiling",
    "Upsampler",
    "evaluate",
    "inspect",
    "load",
    "parameters",
    "places",
    "plan",
    "program",
    "read",
    "read_bytes",
    "upsample_file",
    "write",
]

__version__: str

_Columns = list[tuple[str, NDArray[Any]]]
_Pairs = list[tuple[str, str]]

@final
class Origin:
    def __new__(cls, single: bool) -> Origin: ...
    def changed(self) -> Origin: ...
    def noted(self, notes: list[str]) -> Origin: ...
    @property
    def format(self) -> str: ...
    @property
    def crs(self) -> str | None: ...
    @property
    def comments(self) -> list[str]: ...
    @property
    def sensor(self) -> tuple[float, float, float] | None: ...
    @property
    def sha256(self) -> str | None: ...
    @property
    def warnings(self) -> list[str]: ...

@final
class Report:
    @property
    def points_in(self) -> int: ...
    @property
    def points_out(self) -> int: ...
    @property
    def provenance(self) -> str: ...
    @property
    def warnings(self) -> list[str]: ...

@final
class Upsampler:
    def __new__(cls, library: Path, model: str | None, threads: int) -> Upsampler: ...
    @property
    def model(self) -> tuple[str, str]: ...
    @property
    def threads(self) -> int: ...
    def upsample(
        self,
        points: NDArray[np.float64],
        columns: _Columns,
        origin: Origin,
        pairs: _Pairs,
        hear: Callable[[float, str], object] | None = None,
    ) -> tuple[NDArray[np.float64], _Columns, Origin, Report]: ...

@final
class Tiling:
    def __len__(self) -> int: ...
    @property
    def folder(self) -> Path: ...
    @property
    def report(self) -> Report: ...
    def points(self, tile: int) -> list[int]: ...
    def not_done(self) -> list[int]: ...
    def run(self, upsampler: Upsampler, tile: int, hear: Callable[[float, str], object] | None = None) -> int: ...
    def join(self, output: str) -> Report: ...
    def remove(self) -> None: ...

def upsample_file(
    upsampler: Upsampler,
    input: str,
    output: str,
    pairs: _Pairs,
    temp: str | None,
    resume: bool,
    hear: Callable[[float, str], object] | None,
) -> Report: ...
def plan(upsampler: Upsampler, input: str, folder: str, output: str | None, pairs: _Pairs) -> Tiling: ...
def load(folder: str) -> Tiling: ...
def read(path: str, pairs: _Pairs) -> tuple[NDArray[np.float64], _Columns, Origin]: ...
def read_bytes(bytes: bytes, pairs: _Pairs) -> tuple[NDArray[np.float64], _Columns, Origin]: ...
def places(names: list[str], roles: list[str]) -> list[int | None]: ...
def write(
    path: str, points: NDArray[np.float64], columns: _Columns, origin: Origin, provenance: str | None = None
) -> list[str]: ...
def inspect(
    points: NDArray[np.float64],
    columns: _Columns,
    origin: Origin,
    path: str | None,
    sample: int,
    ratio: float,
    source: NDArray[np.float64] | None,
) -> str: ...
def evaluate(
    points: NDArray[np.float64], reference: NDArray[np.float64], mesh: str | None, tolerance: float
) -> str: ...
def parameters() -> list[tuple[str, str | None, str]]: ...
def program(arguments: list[str], library: Path | None, missing: str) -> int: ...
