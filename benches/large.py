"""Random points of a wavy torus, as many as are asked for: `python benches/large.py POINTS OUT.ply [attributes]`.

Written a million at a time as binary PLY in 32 bits; with `attributes` they have normals and colours. Needs NumPy.
"""

import sys

import numpy as np

BLOCK = 1_000_000
POSITION, NORMAL, COLOUR = ("x", "y", "z"), ("nx", "ny", "nz"), ("red", "green", "blue")


def torus(points: int, kind: np.dtype, random: np.random.Generator) -> np.ndarray:
    """A block of points."""
    u, v = 2 * np.pi * random.random((2, points))
    ring = 10 + 0.3 * np.sin(9 * u) * np.cos(7 * v)
    tube = 3 + 0.2 * np.cos(11 * u + 5 * v)
    found = np.zeros(points, kind)
    found["x"], found["y"] = (
        (ring + tube * np.cos(v)) * turn(u) for turn in (np.cos, np.sin)
    )
    found["z"] = tube * np.sin(v)
    if NORMAL[0] in kind.names:
        for name, value in zip(
            NORMAL, (np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v))
        ):
            found[name] = value
        for name, value in zip(
            COLOUR, (127 + 120 * np.sin(3 * u), 127 + 120 * np.sin(5 * v), 127)
        ):
            found[name] = value
    return found


def main(points: int, path: str, attributes: bool) -> None:
    """Writes the file."""
    random = np.random.default_rng(1)
    floats = [*POSITION, *(NORMAL if attributes else ())]
    bytes_ = COLOUR if attributes else ()
    kind = np.dtype(
        [(name, "<f4") for name in floats] + [(name, "u1") for name in bytes_]
    )
    lines = [f"property float {name}" for name in floats] + [
        f"property uchar {name}" for name in bytes_
    ]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {points}",
        *lines,
        "end_header",
    ]
    with open(path, "wb") as sink:
        sink.write("".join(f"{line}\n" for line in header).encode())
        for start in range(0, points, BLOCK):
            torus(min(BLOCK, points - start), kind, random).tofile(sink)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2], len(sys.argv) > 3)
