"""COLMAP's binary models: points in and out, cameras, images."""

import struct
from pathlib import Path
from typing import List, NamedTuple, Optional

import numpy as np
from scipy.spatial.transform import Rotation

from .gaussians import Seeds
from .view import Photograph, View

# COLMAP's number of a camera with two focal lengths and no distortion.
PINHOLE = 1
POINT = struct.Struct("<Q3d3BdQ")


class Found(NamedTuple):
    """What structure from motion knows of points: `seeds`, `errors` [n] in pixels, `seen` [views,n] whether a view sees
    a point."""

    seeds: Seeds
    errors: np.ndarray
    seen: np.ndarray


def write_points(
    file: Path, seeds: Seeds, errors: Optional[np.ndarray] = None, seen: Optional[np.ndarray] = None
) -> Path:
    """A points3D.bin; keys count from 1. Without `seen` all tracks are empty, without `errors` these are -1."""
    file.parent.mkdir(parents=True, exist_ok=True)
    places = None if seen is None else np.cumsum(seen, axis=1) - 1
    records = [struct.pack("<Q", len(seeds.points))]
    for i, (point, colour) in enumerate(zip(seeds.points, np.round(255 * seeds.colours).astype(int))):
        views = [] if seen is None else np.flatnonzero(seen[:, i])
        error = -1.0 if errors is None else errors[i]
        track = [n for view in views for n in (view + 1, places[view, i])]  # type: ignore
        records += [POINT.pack(i + 1, *point, *colour, error, len(views)), struct.pack(f"<{len(track)}i", *track)]
    file.write_bytes(b"".join(records))
    return file


def read_points(file: Path) -> Seeds:
    """The points and colours of a points3D.bin. Fails with a ValueError on a file that was cut."""
    content = file.read_bytes()
    points, colours, at = [], [], 8
    try:
        for _ in range(struct.unpack_from("<Q", content)[0]):
            values = POINT.unpack_from(content, at)
            points.append(values[1:4])
            colours.append(values[4:7])
            at += POINT.size + 8 * values[8]
    except struct.error as error:
        raise ValueError(f"{file}: it ends within a point") from error
    if at != len(content):
        raise ValueError(f"{file}: {len(content)} bytes where its points take {at}")
    return Seeds(np.array(points).reshape(-1, 3), np.array(colours).reshape(-1, 3) / 255)


def image_name(number: int) -> str:
    return f"{number:03}.png"


def write_images(file: Path, views: List[View], found: Found) -> None:
    """An images.bin; image k + 1 is views[k], and refers to the points that it sees."""
    records = [struct.pack("<Q", len(views))]
    for k, view in enumerate(views):
        x, y, z, w = Rotation.from_matrix(view.rotation).as_quat()
        records.append(struct.pack("<I7dI", k + 1, w, x, y, z, *view.shift, 1) + image_name(k).encode() + b"\0")
        keys = np.flatnonzero(found.seen[k])
        at = view.project(found.seeds.points[keys])[0]
        records.append(struct.pack("<Q", len(keys)))
        records += [struct.pack("<2dQ", *place, key + 1) for place, key in zip(at, keys)]
    file.write_bytes(b"".join(records))


def write_model(folder: Path, photographs: List[Photograph], found: Found) -> Path:
    """A folder as trainers of Gaussian splatting take it: `images/` and `sparse/0/`. Gives the file of the points."""
    from matplotlib import image

    (folder / "images").mkdir(parents=True, exist_ok=True)
    for k, photograph in enumerate(photographs):
        image.imsave(folder / "images" / image_name(k), np.round(255 * photograph.image).astype(np.uint8))
    model = folder / "sparse" / "0"
    points = write_points(model / "points3D.bin", *found)
    write_images(model / "images.bin", [photograph.view for photograph in photographs], found)
    view = photographs[0].view
    middle = view.size / 2
    camera = struct.pack("<QIi2Q4d", 1, 1, PINHOLE, view.size, view.size, view.focal, view.focal, middle, middle)
    (model / "cameras.bin").write_bytes(camera)
    return points
