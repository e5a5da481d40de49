"""Readers of scan files: PCD, LAS, PLY in text, and columns of text."""

import struct
from pathlib import Path
from typing import Dict, List, Sequence

import numpy as np


def read_scan(path: Path) -> np.ndarray:
    """[n,3] f64, finite points only: a depth camera writes NaN where it saw nothing. By the extension: .pcd, .las,
    .ply, else text whose first three columns are coordinates. Fails with a ValueError on anything else."""
    readers = {".pcd": read_pcd, ".las": read_las, ".ply": read_text_ply}
    points = readers.get(path.suffix.lower(), read_columns)(path)
    return points[np.isfinite(points).all(axis=1)]


def read_columns(path: Path) -> np.ndarray:
    """The first three columns; lines before the first of at least three numbers are skipped."""
    lines = path.read_text().splitlines()
    start = next((i for i, line in enumerate(lines) if len(line.split()) >= 3), len(lines))
    return np.loadtxt(lines[start:], usecols=(0, 1, 2), ndmin=2)


def read_text_ply(path: Path) -> np.ndarray:
    """A PLY file in text whose vertices come first, and begin with x, y, z."""
    header, found, body = path.read_bytes().partition(b"end_header")
    lines = [line.split() for line in header.decode("ascii").splitlines()]
    if not found or ["format", "ascii", "1.0"] not in lines:
        raise ValueError(f"{path}: not a PLY file in text")
    counts = [int(words[2]) for words in lines if words[:2] == ["element", "vertex"]]
    names = [words[-1] for words in lines if words[:1] == ["property"]]
    if len(counts) != 1 or names[:3] != ["x", "y", "z"]:
        raise ValueError(f"{path}: no vertices that begin with x, y, z")
    return np.loadtxt(body.decode("ascii").strip().splitlines()[: counts[0]], usecols=(0, 1, 2), ndmin=2)


def read_pcd(path: Path) -> np.ndarray:
    """x, y, z of a PCD file: ascii, binary or compressed."""
    content = path.read_bytes()
    header: Dict[str, List[str]] = {}
    start = 0
    while "DATA" not in header:
        end = content.find(b"\n", start)
        if end < 0:
            raise ValueError(f"{path}: the PCD header does not end")
        words = content[start:end].decode("ascii").split()
        if words and not words[0].startswith("#"):
            header[words[0].upper()] = words[1:]
        start = end + 1
    return decode_pcd(header, content[start:])


def decode_pcd(header: Dict[str, List[str]], body: bytes) -> np.ndarray:
    """x, y, z of what comes after a PCD header."""
    fields, points = header["FIELDS"], int(header["POINTS"][0])
    counts = [int(c) for c in header.get("COUNT", ["1"] * len(fields))]
    kinds = [f"<{'f' if t == 'F' else t.lower()}{size}" for t, size in zip(header["TYPE"], header["SIZE"])]
    if header["DATA"][0] == "ascii":
        starts = dict(zip(fields, np.cumsum([0, *counts])))
        columns = [int(starts[axis]) for axis in "xyz"]
        return np.loadtxt(body.decode("ascii").splitlines(), usecols=columns, ndmin=2)
    if header["DATA"][0] == "binary":
        # Fields may share a name (padding is called "_"), and structured arrays forbid that.
        layout = np.dtype([(f"{i}", k, c) for i, (k, c) in enumerate(zip(kinds, counts))])
        records = np.frombuffer(body, dtype=layout, count=points)
        return np.stack([records[f"{fields.index(axis)}"].reshape(points) for axis in "xyz"], 1).astype(float)
    if header["DATA"][0] == "binary_compressed":
        packed, size = struct.unpack_from("<II", body)
        plain = decompress(body[8 : 8 + packed], size)
        # One field after the other, each for all points.
        lengths = [np.dtype(k).itemsize * c * points for k, c in zip(kinds, counts)]
        starts = dict(zip(fields, np.cumsum([0, *lengths])))
        columns = [np.frombuffer(plain, kinds[fields.index(a)], points, int(starts[a])) for a in "xyz"]
        return np.stack(columns, 1).astype(float)
    raise ValueError(f"PCD data of the unknown kind {header['DATA'][0]}")


def decompress(packed: bytes, size: int) -> bytes:
    """LZF: runs of literal bytes, and copies of what was written before."""
    out = bytearray()
    i = 0
    while i < len(packed):
        control = packed[i]
        i += 1
        if control < 32:
            out += packed[i : i + control + 1]
            i += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += packed[i]
            i += 1
        begin = len(out) - ((control & 31) << 8) - packed[i] - 1
        i += 1
        if begin < 0:
            raise ValueError("damaged LZF data: a copy from before the start")
        for k in range(begin, begin + length + 2):
            # Byte by byte, since a copy may overlap what it writes.
            out.append(out[k])
    if len(out) != size:
        raise ValueError(f"damaged LZF data: {len(out)} bytes in place of {size}")
    return bytes(out)


def read_las(path: Path) -> np.ndarray:
    """x, y, z of an uncompressed LAS file, any version."""
    content = path.read_bytes()
    if content[:4] != b"LASF":
        raise ValueError(f"{path}: not a LAS file")
    start, _, kind, length, points = struct.unpack_from("<IIBHI", content, 96)
    if kind & 0x80:
        raise ValueError(f"{path}: compressed; unpack it to LAS first")
    if content[25] >= 4 and points == 0:
        (points,) = struct.unpack_from("<Q", content, 247)
    scale, offset = np.frombuffer(content, "<f8", 3, 131), np.frombuffer(content, "<f8", 3, 155)
    records = np.frombuffer(content, np.uint8, points * length, start).reshape(points, length)
    return np.ascontiguousarray(records[:, :12]).view("<i4") * scale + offset


def crop(points: np.ndarray, low: Sequence[float], high: Sequence[float]) -> np.ndarray:
    """The points of a box, its corners as shares of the cloud's own box."""
    corner, size = points.min(0), np.ptp(points, axis=0)
    inside = (points >= corner + np.asarray(low) * size) & (points <= corner + np.asarray(high) * size)
    return points[inside.all(axis=1)]
