"""The control that knows how a scan was made: missing lines, interpolated along the range image.

A range image has a row for each scan line and a column for each direction across these. A sensor's columns may be
shifted from line to line (its lasers do not all look the same way): they are told by the points' own directions, about
the z axis through the sensor.
"""

from typing import Dict, Iterator, Optional, Tuple

import numpy as np

# Neighbours whose ranges differ by a larger share of the lesser one lie on different surfaces: the usual limit.
JUMP = 0.1

# A row and a column.
Cell = Tuple[int, int]
# An inverse range, which is linear in the direction on a plane, and the unit direction.
Beam = Tuple[float, np.ndarray]


def range_image(points: np.ndarray, line: np.ndarray, place: np.ndarray, sensor: np.ndarray) -> np.ndarray:
    """The points [n,3] of every second line and place, those between the places of a line, and the lines between.

    Nothing is put between neighbours whose ranges differ by more than `JUMP`, nor where one is missing: about 4 points
    for each, and fewer at edges.
    """
    rays = points - sensor
    ranges = np.linalg.norm(rays, axis=1)
    beams = zip(1 / ranges, rays / ranges[:, None])
    places = in_columns(rays, line, place)
    image: Dict[Cell, Beam] = dict(zip(zip(line.tolist(), places.tolist()), beams))
    image = {**dict(between(image, (0, 1))), **image}
    image = {**dict(between(image, (1, 0))), **image}
    return np.concatenate([points, sensor + made_of(image, len(points))])


def made_of(image: Dict[Cell, Beam], known: int) -> np.ndarray:
    """The points [n,3] of an image, but for the `known` ones, which are its last."""
    new = list(image.values())[: len(image) - known]
    return np.array([direction / inverse for inverse, direction in new]).reshape(-1, 3)


def between(image: Dict[Cell, Beam], step: Cell) -> Iterator[Tuple[Cell, Beam]]:
    """The empty cells between each cell and the one two steps on, where both lie on one surface."""
    for (line, place), beam in image.items():
        middle = (line + step[0], place + step[1])
        other = image.get((middle[0] + step[0], middle[1] + step[1]))
        if middle in image or other is None:
            continue
        found = mean(beam, other)
        if found is not None:
            yield middle, found


def mean(one: Beam, other: Beam) -> Optional[Beam]:
    """Midway between two beams; none where the range jumps."""
    near, far = max(one[0], other[0]), min(one[0], other[0])
    if near > (1 + JUMP) * far:
        return None
    direction = one[1] + other[1]
    length = float(np.linalg.norm(direction))
    return (one[0] + other[0]) / length, direction / length


def in_columns(rays: np.ndarray, line: np.ndarray, place: np.ndarray) -> np.ndarray:
    """The places, shifted line by line by whole numbers, so that equal ones lie in one direction about the z axis."""
    azimuth = np.exp(1j * np.arctan2(rays[:, 1], rays[:, 0]))
    order = np.lexsort((place, line))
    steps, turns = np.diff(place[order]), azimuth[order][1:] / azimuth[order][:-1]
    follow = (np.diff(line[order]) == 0) & (steps > 0) & (steps <= 2)
    if not follow.any():
        return place
    step = float(np.median(np.angle(turns[follow]) / steps[follow]))
    start = azimuth * np.exp(-1j * step * place)
    shifted, first = place.copy(), None
    for number in np.unique(line):
        its = line == number
        whole = start[its].sum()
        first = whole if first is None else first
        shifted[its] += int(np.round(np.angle(whole / first) / step))
    return shifted
