"""Columns of numbers, and the tables and colors that other libraries make of them."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _densecloud

if TYPE_CHECKING:
    from typing import TypeAlias

    from numpy.typing import ArrayLike, NDArray

    from ._cloud import Cloud

    #: Positions (N x 3), columns of N numbers by their names, and what is told of the whole.
    Parts: TypeAlias = tuple[NDArray[np.float64], list[tuple[str, NDArray[Any]]], _densecloud.Origin]

COLORS = ["red", "green", "blue"]
NORMALS = ["nx", "ny", "nz"]


class Taken:
    """What of another library's cloud is carried over, and the names of what is not."""

    def __init__(self) -> None:
        self._columns: list[tuple[str, NDArray[Any]]] = []
        self._lost: list[str] = []

    def add(self, name: str, table: ArrayLike, parts: list[str] | None = None) -> None:
        """Adds numbers of each point: N, or N x K as columns of the names `parts`, else `name:0`, `name:1`, ..."""
        array = np.asarray(table)
        if array.dtype.kind not in "fiub" or array.dtype.itemsize > 8 or array.ndim not in (1, 2):
            self.lose(name)
            return
        columns = array.reshape(len(array), -1)
        if columns.shape[1] == 1:
            parts = [name]
        elif parts is None or len(parts) < columns.shape[1]:
            parts = [f"{name}:{part}" for part in range(columns.shape[1])]
        self._columns += [(part, columns[:, place]) for place, part in zip(range(columns.shape[1]), parts)]

    def lose(self, *names: str) -> None:
        """Tells of what there is no place for."""
        self._lost += names

    def parts(self, points: ArrayLike) -> Parts:
        """All of it, with these points, N x 3."""
        array = np.asarray(points)
        origin = _densecloud.Origin(array.dtype == np.float32)
        if self._lost:
            origin = origin.noted([f"not carried over: {', '.join(self._lost)}"])
        # A copy: Open3D's vectors may move.
        return np.array(array, dtype=np.float64, order="C"), self._columns, origin


def tables(cloud: Cloud, colors: str, normals: str) -> dict[str, NDArray[Any]]:
    """Copies of a cloud's columns by name, N or N x K: of `name:0`, `name:1`, ... one table; so of colors, normals."""
    parts = cloud._named([*COLORS, "alpha"]) or cloud._named(COLORS)
    columns = _renamed(_renamed(cloud._attributes, parts, colors), cloud._named(NORMALS), normals)
    made: dict[str, NDArray[Any]] = {}
    for name in columns:
        table = re.sub(r":\d+$", "", name)
        parts = _parts(table, columns)
        if name in parts and table not in columns and len({columns[part].dtype for part in parts}) == 1:
            made[table] = np.stack([columns[part] for part in parts], axis=1)
        else:
            made[name] = columns[name].copy()
    return made


def _renamed(columns: dict[str, NDArray[Any]], parts: list[str], table: str) -> dict[str, NDArray[Any]]:
    """The same where these columns are those of a table, unless another has its name."""
    names = {part: f"{table}:{place}" for place, part in enumerate(parts)}
    taken = {table, *names.values()} & (set(columns) - set(parts))
    return columns if taken else {names.get(name, name): column for name, column in columns.items()}


def _parts(table: str, columns: Iterable[str]) -> list[str]:
    """The names of a table's columns: as many as there are without a gap, and none where there is only one."""
    parts: list[str] = []
    while f"{table}:{len(parts)}" in columns:
        parts.append(f"{table}:{len(parts)}")
    return parts if len(parts) > 1 else []


def shares(colors: NDArray[Any]) -> NDArray[np.float64]:
    """Colors from 0 to 1, of bytes, of 16 bits, or of floats."""
    numbers = np.nan_to_num(colors.astype(np.float64))
    return np.clip(numbers / _full(numbers, colors.dtype.kind == "f"), 0, 1)


def _full(numbers: NDArray[np.float64], is_float: bool) -> int:
    """What stands for all of a color; files of 16 bits often have bytes in them."""
    most = numbers.max(initial=0)
    if is_float and most <= 1:
        return 1
    return 255 if most <= 255 else 65_535


def drawable(colors: NDArray[Any]) -> NDArray[Any]:
    """Colors as viewers take them: bytes and shares as they are, others from 0 to 1."""
    is_share = colors.dtype.kind == "f" and colors.max(initial=0) <= 1
    return colors if is_share or colors.dtype == np.uint8 else shares(colors).astype(np.float32)


def library(name: str) -> Any:
    """Another library, which is loaded now.

    Raises ImportError, with how to install it.
    """
    try:
        return importlib.import_module(name)
    except ImportError as why:
        raise ImportError(f"{name} is missing: pip install 'densecloud[{name}]' ({why})", name=name) from why
