"""What can be asked of an upsampling: the program's options, by the same names."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, TypedDict

import numpy as np

#: A table's option that is an argument of another name here, since `attributes` are arrays.
RENAMED = {"rules": "attributes"}


class Reading(TypedDict, total=False):
    """How a file is read, where its content does not tell."""

    axes: str | Sequence[str | int] | None
    """The columns of text that are x, y and z: names, or numbers from 1."""
    separator: str | None
    """What stands between columns of text: comma, semicolon, tab, space or bar."""
    decimal: str | None
    """What stands before the fractions of numbers in text: point or comma."""
    format: str | None
    """The file's format, such as `ply`, `kitti` or `text`."""
    bounds: str | Sequence[float] | None
    """Only the points in this box: min x, min y, max x, max y, or with heights min x, min y, min z, max x, ..."""


class Making(TypedDict, total=False):
    """How a cloud is made dense. Without any of `points`, `spacing`, `density` and a ratio, four times the points."""

    points: int | None
    """Points out, exactly: 1 to 64 times the points in."""
    spacing: float | None
    """Mean distance from a point to its nearest neighbour, in the cloud's units."""
    density: float | None
    """Points a square unit of surface."""
    keep_input: bool
    """Keep the input's points exactly, before the new ones."""
    source_fields: bool
    """Tell of each point the row of the input's point that is nearest, and whether it is new."""
    confidence: bool
    """Tell of each point, from 0 to 1, how likely it lies within one spacing of the surface."""
    min_confidence: float | None
    """Leave out points whose confidence is below this, but for the input's own."""
    normals: Literal["estimate"] | None
    """Make normals from the dense cloud itself, on the side of the input's, or of the sensor."""
    sensor: str | Sequence[float] | None
    """Where the sensor stood, for the side of estimated normals: x, y, z."""
    seed: int
    """Chooses among equally good results; the same seed gives the same bytes."""
    overlap: float | None
    """How many patches each point lies in, on average, from 1 to 100: more is slower."""
    inner: float | None
    """Share of each patch, around its centre, whose points are kept, from 0 to 1."""
    max_displacement: float | None
    """Leave out points moved further than this many spacings from their source; infinity keeps all."""
    max_distance: float | None
    """Leave out points further from the input than this many times what nine in ten keep to."""
    no_polish: bool
    """Keep what the network made as it is."""
    spread: Literal["neighbourhood", "area"] | None
    """`area`: the whole becomes equally dense, and dense places may lose points."""
    quality: Literal["standard", "best"] | None
    """`best`: better coverage, for about twice the work."""
    rules: str | Mapping[str, Literal["mean", "nearest", "drop"]] | None
    """How new points come by their attributes, by name (`--attributes` of the program)."""


class Options(Making, Reading, total=False):
    """All options of a cloud that may be a file."""


class FileOptions(Options, total=False):
    """All options of a work on files."""

    tile_points: int | None
    """Work on a cloud of more points than that in tiles of about as many."""


def pairs(ratio: float | None, given: Mapping[str, Any], known: Any) -> list[tuple[str, str]]:
    """Names and values as the program's table reads them.

    Raises TypeError for a name that is not one of `known`.
    """
    names = sorted(known.__optional_keys__)
    for name in given:
        if name not in names:
            raise TypeError(f"unknown option {name!r}; there are ratio, {', '.join(names)}")
    named = {"ratio": ratio, **given}
    return [(RENAMED.get(name, name), _text(value)) for name, value in named.items() if value is not None]


def split(given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The options that say how a cloud is made, and those that say how it is read."""
    of_reading = Reading.__annotations__
    making = {name: value for name, value in given.items() if name not in of_reading}
    return making, {name: value for name, value in given.items() if name in of_reading}


def _text(value: object) -> str:
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        return ",".join(f"{name}:{rule}" for name, rule in value.items())
    if isinstance(value, Iterable):
        return ",".join(map(_item, value))
    return _number(value)


def _item(value: object) -> str:
    if isinstance(value, str) and any(mark in value for mark in ',"'):
        return '"' + value.replace('"', '""') + '"'
    return _text(value)


def _number(value: Any) -> str:
    try:
        return str(operator.index(value))
    except TypeError:
        # Shortest digits that read back as the same number.
        return repr(float(value))
