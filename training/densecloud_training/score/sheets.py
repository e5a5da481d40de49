"""Where a surface has another sheet of itself nearby: thin walls, sharp blades, and sheets that nearly touch.

A point's other sheet is where the line through it along its normal, to either side, meets the mesh again, if the mesh
faces that line there: walls beside an edge of more than 60 degrees do not.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Iterator, Tuple

import numpy as np
from scipy.spatial import cKDTree

# The least cosine between the normals of two sheets, either way round.
FACING = 0.5
# Sheets nearer than this share of the reach are one.
SAME = 1e-3
# A point lies on a triangle if it is no further off than this share of the mesh's extent.
ON = 1e-5
# How far a triangle's own coordinates may be outside it, by rounding.
ROUNDING = 1e-6
# Triangles that are paired with points at once.
BLOCK = 2000
# How PLY may say that a face has up to 255 corners of 32 bits.
INDICES = [["uchar", "int"], ["uchar", "uint"]]


@dataclass(frozen=True)
class Triangles:
    """Triangles of a mesh, [f,3] each: a corner, the normal, and what a place's offset from the corner is multiplied
    with to get its coordinates along both edges; and [f,3] and [f] of the spheres about them."""

    corner: np.ndarray
    normal: np.ndarray
    along: Tuple[np.ndarray, np.ndarray]
    centre: np.ndarray
    radius: np.ndarray

    @classmethod
    def of(cls, corners: np.ndarray) -> "Triangles":
        """From their corners [f,3,3]; those without an area are left out."""
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        corners, across = corners[across.any(axis=1)], across[across.any(axis=1)]
        square = np.einsum("ij,ij->i", across, across)[:, None]
        one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        along = (np.cross(other, across) / square, np.cross(across, one) / square)
        centre = corners.mean(axis=1)
        radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
        return cls(corners[:, 0], across / np.sqrt(square), along, centre, radius)

    def outside(self, faces: np.ndarray, places: np.ndarray) -> np.ndarray:
        """How far places on the planes of some triangles lie outside them, in their own coordinates; 0 inside."""
        offset = places - self.corner[faces]
        one, other = (np.einsum("ij,ij->i", offset, edge[faces]) for edge in self.along)
        return np.maximum(0, -np.minimum(np.minimum(one, other), 1 - one - other))

    def near(self, tree: cKDTree, reach: float) -> Iterator[Tuple[np.ndarray, np.ndarray]]:
        """Indices of points and triangles that may lie within `reach` of each other, in blocks."""
        for start in range(0, len(self.centre), BLOCK):
            block = slice(start, start + BLOCK)
            found = tree.query_ball_point(self.centre[block], self.radius[block] + reach)
            faces = np.repeat(np.arange(start, start + len(found)), [len(points) for points in found])
            yield np.concatenate([np.asarray(points, dtype=np.int64) for points in found]), faces


def normals(triangles: Triangles, points: np.ndarray) -> np.ndarray:
    """[n,3]: those of the triangles that points [n,3] of a mesh lie on. Fails with a ValueError if one lies on none."""
    tree = cKDTree(points)
    reach = ON * float(np.ptp(points, axis=0).max())
    least, own = np.full(len(points), np.inf), np.full(len(points), -1)
    for point, face in triangles.near(tree, reach):
        offset = points[point] - triangles.corner[face]
        height = np.abs(np.einsum("ij,ij->i", offset, triangles.normal[face]))
        off = height + triangles.outside(face, points[point]) * triangles.radius[face]
        order = np.lexsort((off, point))
        first = order[np.r_[True, np.diff(point[order]) != 0]] if len(order) else order
        better = first[off[first] < least[point[first]]]
        least[point[better]], own[point[better]] = off[better], face[better]
    if (least > reach).any():
        raise ValueError(f"{(least > reach).sum()} of {len(points)} points do not lie on the mesh")
    return triangles.normal[own]


def to_other_sheet(triangles: Triangles, points: np.ndarray, reach: float) -> np.ndarray:
    """[n]: from points of the mesh to its other sheets; infinite where there is none within `reach`.

    Time goes with the pairs of triangles and points nearer than that: seconds for 70,000 and 8,000."""
    normal = normals(triangles, points)
    nearest = np.full(len(points), np.inf)
    for point, face in triangles.near(cKDTree(points), reach):
        facing = np.einsum("ij,ij->i", normal[point], triangles.normal[face])
        opposed = np.abs(facing) > FACING
        point, face, facing = point[opposed], face[opposed], facing[opposed]
        offset = triangles.corner[face] - points[point]
        ahead = np.einsum("ij,ij->i", offset, triangles.normal[face]) / facing
        met = triangles.outside(face, points[point] + ahead[:, None] * normal[point]) <= ROUNDING
        met &= (np.abs(ahead) > SAME * reach) & (np.abs(ahead) <= reach)
        np.minimum.at(nearest, point[met], np.abs(ahead[met]))
    return nearest


def read_mesh(path: Path) -> np.ndarray:
    """[f,3,3] f64, the corners of a binary little-endian PLY's triangles; its vertices are three floats, its faces
    lists of 32-bit indices. Fails with a ValueError on any other file."""
    head, found, body = path.read_bytes().partition(b"end_header\n")
    lines = [line.split() for line in head.decode("ascii", "replace").splitlines()]
    counts = {words[1]: int(words[2]) for words in lines if words[:1] == ["element"]}
    properties = [words[1:] for words in lines if words[:1] == ["property"]]
    floats, lists = [["float", axis] for axis in "xyz"], [kind for kind in properties if kind[0] == "list"]
    plain = ["format", "binary_little_endian", "1.0"] in lines and properties == floats + lists and len(lists) == 1
    if not found or not plain or list(counts) != ["vertex", "face"] or lists[0][1:3] not in INDICES:
        raise ValueError(f"{path}: expected a binary little-endian PLY of x, y, z and faces")
    record = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
    end = 12 * counts["vertex"]
    if len(body) != end + record.itemsize * counts["face"]:
        raise ValueError(f"{path}: faces that are not triangles, or a file that was cut")
    faces = np.frombuffer(body, record, offset=end)
    if (faces["count"] != 3).any():
        raise ValueError(f"{path}: faces that are not triangles")
    return np.frombuffer(body[:end], "<f4").reshape(-1, 3).astype(np.float64)[faces["corners"]]
