"""PLY against plyfile."""

import numpy as np
import open3d
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


def test_comments_and_other_elements_come_back_and_faces_do_not(tmp_path, sphere, upsample):
    points, _ = sphere
    rows = np.zeros(len(points), dtype=[(n, "f8") for n in "xyz"])
    for axis, name in enumerate("xyz"):
        rows[name] = points[:, axis]
    cameras = np.array([(35.0, 7), (50.5, -7)], dtype=[("focal", "f4"), ("id", "i4")])
    # By itself: plyfile writes numbers beside a list in the machine's order, whatever it was asked for.
    tracks = np.zeros(2, dtype=[("times", "O")])
    tracks["times"] = [np.array([1.5, 2.5, 3.5]), np.array([], dtype="f8")]
    faces = np.zeros(1, dtype=[("vertex_indices", "O")])
    faces["vertex_indices"] = [np.array([0, 1, 2], dtype="i4")]
    elements = [
        plyfile.PlyElement.describe(cameras, "camera"),
        plyfile.PlyElement.describe(tracks, "track", val_types={"times": "f8"}, len_types={"times": "u2"}),
        plyfile.PlyElement.describe(rows, "vertex"),
        plyfile.PlyElement.describe(faces, "face"),
    ]
    for text, order in [(True, "="), (False, "<"), (False, ">")]:
        source, result = tmp_path / "source.ply", tmp_path / "result.ply"
        comments = ["by plyfile", "crs: EPSG:32632"]
        plyfile.PlyData(elements, text=text, byte_order=order, comments=comments, obj_info=["a scanner"]).write(source)

        said = upsample(source, result, "--ratio", 2)

        assert "not carried over: face" in said
        dense = plyfile.PlyData.read(result)
        assert [element.name for element in dense.elements] == ["vertex", "camera", "track"]
        assert {"by plyfile", "crs: EPSG:32632", "a scanner"} <= set(dense.comments)
        camera = dense["camera"]
        assert [str(p) for p in camera.properties] == [str(p) for p in elements[0].properties]
        assert list(camera["focal"]) == [35.0, 50.5]
        assert list(camera["id"]) == [7, -7]
        assert str(dense["track"].properties[0]) == str(elements[1].properties[0])
        assert [list(times) for times in dense["track"]["times"]] == [[1.5, 2.5, 3.5], []]


def test_what_open3d_writes_is_read_and_what_is_written_open3d_reads(tmp_path, sphere, upsample):
    points, normals = sphere
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud.normals = open3d.utility.Vector3dVector(normals)
    cloud.colors = open3d.utility.Vector3dVector(0.5 + normals / 2)
    source, result = tmp_path / "source.ply", tmp_path / "result.ply"
    assert open3d.io.write_point_cloud(str(source), cloud)

    upsample(source, result, "--ratio", 4)

    dense = open3d.io.read_point_cloud(str(result))
    xyz = np.asarray(dense.points)
    assert len(xyz) == 4 * len(points)
    assert_on_sphere(xyz)
    directions = (xyz - np.array([465_123.25, 5_204_987.5, 812.125])) / 10
    assert np.abs(np.asarray(dense.normals) - directions).max() < 0.1
    assert np.abs(np.asarray(dense.colors) - (0.5 + directions / 2)).max() < 0.04


def test_gaussian_splats_come_back_whole(tmp_path, upsample, sphere):
    names = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(45))]
    names += ["opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    random = np.random.default_rng(3)
    splats = np.zeros(len(sphere[0]), [(name, "f4") for name in names])
    for axis, name in enumerate("xyz"):
        splats[name] = sphere[0][:, axis] - sphere[0][0, axis]
    for name in names[6:]:
        splats[name] = random.normal(size=len(splats))
    splats["rot_0"] = 3 * np.sign(splats["rot_0"])
    plyfile.PlyData([plyfile.PlyElement.describe(splats, "vertex")]).write(tmp_path / "splats.ply")
    upsample(tmp_path / "splats.ply", tmp_path / "dense.ply", "--ratio", 2)
    dense = plyfile.PlyData.read(tmp_path / "dense.ply")["vertex"]
    assert [(p.name, p.val_dtype) for p in dense.properties] == [(name, "f4") for name in names]
    assert len(dense) == 3000
    for name in names:
        assert np.isfinite(dense[name]).all()
    assert all((dense[name] == 0).all() for name in ("nx", "ny", "nz"))
    lengths = np.linalg.norm([dense[f"rot_{i}"] for i in range(4)], axis=0)
    # Of one length, or as long as those about it.
    assert (lengths > 0.9).all()
