"""PLY against plyfile."""

import numpy as np
import plyfile
import pytest

from conftest import assert_on_sphere


@pytest.mark.parametrize("text, order", [(True, "="), (False, "<"), (False, ">")])
def test_what_plyfile_writes_is_read_and_what_is_written_plyfile_reads(tmp_path, sphere, upsample, text, order):
    points, normals = sphere
    fields = [(n, "f8") for n in "xyz"] + [(n, "f4") for n in ("nx", "ny", "nz")]
    fields += [("red", "u1"), ("label", "i4"), ("time", "f8")]
    rows = np.zeros(len(points), dtype=fields)
    for axis, name in enumerate("xyz"):
        rows[name], rows["n" + name] = points[:, axis], normals[:, axis]
    rows["red"] = 127 + 120 * normals[:, 2]
    rows["label"] = np.where(normals[:, 0] > 0, 70_000, -5)
    rows["time"] = 3.5e8 + np.arange(len(points))
    source, result = tmp_path / "source.ply", tmp_path / "result.ply"
    element = plyfile.PlyElement.describe(rows, "vertex")
    plyfile.PlyData([element], text=text, byte_order=order, comments=["from plyfile"]).write(source)

    upsample(source, result, "--ratio", 4)

    dense = plyfile.PlyData.read(result)
    assert (dense.text, dense.byte_order) == (text, order)
    vertices = dense["vertex"]
    assert vertices.count == 4 * len(points)
    assert [(p.name, p.val_dtype) for p in vertices.properties] == fields
    xyz = np.stack([vertices[n] for n in "xyz"], axis=1)
    assert_on_sphere(xyz)
    directions = (xyz - np.array([465_123.25, 5_204_987.5, 812.125])) / 10
    made = np.stack([vertices[n] for n in ("nx", "ny", "nz")], axis=1)
    assert np.abs(made - directions).max() < 0.1
    assert np.abs(vertices["red"] - (127 + 120 * directions[:, 2])).max() < 8
    assert set(vertices["label"]) == {70_000, -5}
    assert set(vertices["time"]) <= set(rows["time"])
