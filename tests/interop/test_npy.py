"""NumPy arrays against NumPy."""

import numpy as np
import pytest

from conftest import assert_on_sphere


@pytest.mark.parametrize("kind", ["<f8", ">f8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_a_table_comes_back_as_a_table(tmp_path, sphere, upsample, kind, order):
    points, normals = sphere
    colours = np.round(127 + 120 * normals)
    source, result = tmp_path / "source.npy", tmp_path / "result.npy"
    np.save(source, np.asarray(np.hstack([points, colours, normals]), dtype=kind, order=order))

    upsample(source, result, "--ratio", 4)

    dense = np.load(result)
    assert dense.dtype == np.dtype("f8")
    assert dense.shape == (4 * len(points), 9)
    assert_on_sphere(dense[:, :3])
    directions = (dense[:, :3] - np.array([465_123.25, 5_204_987.5, 812.125])) / 10
    assert np.abs(dense[:, 6:] - directions).max() < 0.1
    assert np.abs(np.linalg.norm(dense[:, 6:], axis=1) - 1).max() < 1e-6, "read as normals"
    assert np.abs(dense[:, 3:6] - (127 + 120 * directions)).max() < 8


@pytest.mark.parametrize("kind", ["f2", "f4", "i2", "i8"])
def test_every_type_of_number_is_read(tmp_path, sphere, upsample, kind):
    _, normals = sphere
    source, result = tmp_path / "source.npy", tmp_path / "result.npy"
    np.save(source, (normals * 1000).astype(kind))
    upsample(source, result, "--points", 2000)
    dense = np.load(result)
    assert dense.dtype == np.dtype("f8" if kind == "i8" else "f4")
    assert dense.shape == (2000, 3)
    assert np.abs(np.linalg.norm(dense, axis=1) - 1000).max() < 20


@pytest.mark.parametrize("aligned", [False, True])
def test_a_structure_keeps_its_fields(tmp_path, sphere, upsample, aligned):
    points, normals = sphere
    kind = [("label", "i2"), ("x", "f8"), ("y", "f8"), ("z", "f8"), ("größe", "f4"), ("name", "U3"), ("pair", "f4", 2)]
    rows = np.zeros(len(points), dtype=np.dtype(kind, align=aligned))
    for axis, name in enumerate("xyz"):
        rows[name] = points[:, axis]
    rows["label"] = np.where(normals[:, 0] > 0, 7, -5)
    rows["größe"] = normals[:, 2]
    source, result = tmp_path / "source.npy", tmp_path / "result.npy"
    np.save(source, rows)

    said = upsample(source, result, "--ratio", 2)

    assert "not read: name, pair" in said
    dense = np.load(result)
    assert dense.dtype == np.dtype([("x", "f8"), ("y", "f8"), ("z", "f8"), ("label", "i2"), ("größe", "f4")])
    xyz = np.stack([dense[n] for n in "xyz"], axis=1)
    assert_on_sphere(xyz)
    assert set(dense["label"]) == {7, -5}
    assert np.abs(dense["größe"] - (xyz[:, 2] - 812.125) / 10).max() < 0.1


def test_what_numpy_packs_is_refused_with_a_hint(tmp_path, sphere, upsample):
    points, _ = sphere
    np.savez(tmp_path / "source.npz", points=points)
    assert ".npz" in upsample(tmp_path / "source.npz", tmp_path / "result.npy", fails=True)
    np.save(tmp_path / "objects.npy", np.array([[1, 2, None]], dtype=object))
    assert "objects" in upsample(tmp_path / "objects.npy", tmp_path / "result.npy", fails=True)
