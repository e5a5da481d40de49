"""Meshes that trimesh writes, read as clouds."""

import numpy as np
import plyfile
import pytest
import trimesh


@pytest.mark.parametrize("suffix", ["off", "obj"])
def test_the_vertices_of_a_mesh_are_points(tmp_path, upsample, suffix):
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=3.0)
    if suffix == "obj":
        mesh.visual.vertex_colors = (127 + 40 * mesh.vertices).astype("u1")
    source, result = tmp_path / f"source.{suffix}", tmp_path / "result"
    mesh.export(source)

    said = upsample(source, result, "--ratio", 2)

    assert "not read: face" in said
    vertices = plyfile.PlyData.read(result)["vertex"]
    points = np.stack([vertices[n] for n in "xyz"], axis=1)
    assert len(points) == 2 * len(mesh.vertices)
    assert np.abs(np.linalg.norm(points, axis=1) - 3).max() < 0.05
    if suffix == "obj":
        red = np.asarray(vertices["red"], dtype=float)
        scale = 1.0 if red.max() > 1.5 else 255.0
        assert np.abs(red * scale - (127 + 40 * points[:, 0])).max() < 8


def test_a_mesh_is_not_an_output(tmp_path, upsample):
    source = tmp_path / "source.off"
    trimesh.creation.icosphere().export(source)
    for name in ["a.off", "a.obj"]:
        assert "cannot be written" in upsample(source, tmp_path / name, fails=True)
