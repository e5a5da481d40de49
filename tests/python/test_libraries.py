"""Clouds of Open3D, PyVista, trimesh and laspy, in and out."""

import subprocess
import sys
import warnings

import densecloud
import numpy as np
import pytest

from conftest import library, sphere


@pytest.fixture(autouse=True)
def nothing_is_lost():
    with warnings.catch_warnings():
        warnings.simplefilter("error", densecloud.DensecloudWarning)
        yield


POINTS = sphere(300)
NORMALS = (POINTS - POINTS.mean(axis=0)) / 10
COLORS = np.full((300, 3), [250, 120, 7], np.uint8)


def expected(**given):
    return densecloud.upsample(densecloud.Cloud(POINTS, **given), ratio=2, seed=3)


def test_open3d(tmp_path):
    o3d = library("open3d")
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(POINTS))
    cloud.colors = o3d.utility.Vector3dVector(COLORS / 255)
    cloud.normals = o3d.utility.Vector3dVector(NORMALS)
    dense = densecloud.upsample(cloud, ratio=2, seed=3)
    same = expected(colors=COLORS / 255, normals=np.asarray(cloud.normals))
    made = dense.to_open3d()
    assert np.array_equal(np.asarray(made.points), same.points) and np.array_equal(made.colors, same.colors)
    assert np.array_equal(np.asarray(made.normals), same.normals)
    densecloud.write(tmp_path / "a.ply", densecloud.Cloud(POINTS, colors=COLORS))
    bytes_ = densecloud.read(tmp_path / "a.ply").to_open3d()
    assert np.array_equal(np.asarray(bytes_.colors), COLORS / 255)


def test_open3d_tells_what_it_has_no_place_for():
    o3d = library("open3d")
    cloud = densecloud.Cloud(POINTS, colors=np.full((300, 4), 9, "u1"), attributes={"intensity": np.ones(300)})
    with pytest.warns(densecloud.DensecloudWarning, match="has no place for opacity, intensity") as told:
        cloud.to_open3d()
    assert told[0].filename == __file__, "it names the caller"
    given = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(POINTS))
    given.covariances = o3d.utility.Matrix3dVector(np.zeros((300, 3, 3)))
    with pytest.warns(densecloud.DensecloudWarning, match="not carried over: covariances") as told:
        dense = densecloud.upsample(given, ratio=2)
    assert told[0].filename == __file__ and len(told) == 1 and dense.warnings == [str(told[0].message)]


def test_open3d_of_tensors():
    o3d = library("open3d")
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(POINTS))
    cloud.point.colors = o3d.core.Tensor(COLORS)
    cloud.point["label"] = o3d.core.Tensor(np.full((300, 1), 7, np.uint16))
    cloud.point["velocity"] = o3d.core.Tensor(np.full((300, 3), [1, 2, 3], np.float32))
    made = densecloud.upsample(cloud, ratio=2, seed=3).to_open3d(tensors=True)
    same = expected(colors=COLORS)
    assert np.array_equal(made.point.positions.numpy(), same.points)
    assert np.array_equal(made.point.colors.numpy(), same.colors) and made.point.colors.dtype == o3d.core.uint8
    assert made.point["label"].shape == [600, 1] and (made.point["label"].numpy() == 7).all()
    assert made.point["label"].dtype == o3d.core.uint16
    assert np.array_equal(made.point["velocity"].numpy(), np.full((600, 3), [1, 2, 3], np.float32))
    again = densecloud.Cloud(made)
    assert np.array_equal(again.points, same.points) and list(again.attributes)[-1] == "velocity:2"


def test_pyvista():
    pv = library("pyvista")
    cloud = pv.PolyData(POINTS)
    cloud["RGB"], cloud["Normals"], cloud["heat"] = COLORS, NORMALS, np.full(300, 5, np.int32)
    cloud["velocity"] = np.full((300, 3), [1.0, 2.0, 3.0])
    dense = densecloud.upsample(cloud, ratio=2, seed=3)
    same = expected(colors=COLORS, normals=NORMALS)
    made = dense.to_pyvista()
    assert isinstance(made, pv.PolyData) and made.points.dtype == np.float64 and made.n_verts == 600
    assert np.array_equal(made.points, same.points) and np.array_equal(made["RGB"], same.colors)
    assert np.array_equal(made["Normals"], same.normals) and made["heat"].dtype == np.int32
    assert np.array_equal(made["velocity"], np.full((600, 3), [1.0, 2.0, 3.0]))
    assert np.array_equal(densecloud.upsample(pv.PointSet(POINTS), ratio=2, seed=3).points, same.points)
    assert np.array_equal(densecloud.upsample(cloud.points, ratio=2, seed=3).points, same.points), "their array"
    deep = densecloud.Cloud(POINTS, colors=np.full((300, 4), 65_535, "u2")).to_pyvista()
    assert deep["RGBA"].dtype == np.float32 and (deep["RGBA"] == 1).all(), "a viewer takes bytes or shares"


def test_pyvista_tells_what_is_not_carried_over():
    pv = library("pyvista")
    cloud = pv.PolyData(POINTS)
    cloud.point_data["name"], cloud.field_data["who"] = ["a"] * 300, ["us"]
    cloud.cell_data["of vertex"] = np.ones(300)
    with pytest.warns(densecloud.DensecloudWarning, match="carried over: name, cell data of vertex, field data who"):
        densecloud.Cloud(cloud)


def test_trimesh():
    trimesh = library("trimesh")
    cloud = trimesh.PointCloud(POINTS, colors=COLORS, metadata={"intensity": np.full(300, 9, np.uint16)})
    cloud.metadata["normals"] = NORMALS
    made = densecloud.upsample(cloud, ratio=2, seed=3).to_trimesh()
    same = expected(colors=np.column_stack([COLORS, np.full(300, 255, "u1")]), normals=NORMALS)
    assert np.array_equal(made.vertices, same.points) and np.array_equal(made.colors[:, :3], same.colors)
    assert (made.colors[:, 3] == 255).all() and np.array_equal(made.metadata["normals"], same.normals)
    assert (made.metadata["intensity"] == 9).all() and made.metadata["intensity"].dtype == np.uint16
    assert len(densecloud.upsample(trimesh.PointCloud(POINTS), ratio=2).attributes) == 0, "no colors of their own"
    assert densecloud.upsample(cloud.vertices, ratio=2, seed=3).points.shape == (600, 3), "their array"


def test_trimesh_tells_what_is_not_carried_over():
    trimesh = library("trimesh")
    with pytest.warns(densecloud.DensecloudWarning, match="not carried over: metadata who"):
        densecloud.Cloud(trimesh.PointCloud(POINTS, metadata={"who": "us"}))
    with pytest.warns(densecloud.DensecloudWarning, match="no place for more than 8 bits of colors"):
        densecloud.Cloud(POINTS, colors=np.full((300, 3), 12_345, "u2")).to_trimesh()
    whole = densecloud.Cloud(POINTS, colors=np.full((300, 3), 0x8080, "u2")).to_trimesh()
    assert (whole.colors[:, :3] == 0x80).all()


def las_of(laspy):
    """A cloud of a zone of UTM, in quarters of a millimetre, with an extra dimension."""
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales, header.offsets = [0.00025] * 3, [465_000.0, 5_204_000.0, 800.0]
    header.add_extra_dim(laspy.ExtraBytesParams("height", "f8"))
    las = laspy.LasData(header)
    las.xyz, las.classification, las.gps_time = POINTS, np.full(300, 6), np.full(300, 1.25e8 + 0.125)
    las.height, las.intensity = np.full(300, 0.1), np.arange(300)
    las.red, las.green, las.blue = COLORS.T.astype("u2") * 257
    las.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr('PROJCS["WGS 84 / UTM zone 32N"]'))
    return las


def test_laspy_is_what_its_file_is(tmp_path):
    laspy = library("laspy")
    las = las_of(laspy)
    las.write(tmp_path / "in.las")
    made = densecloud.upsample(las, ratio=2, seed=3, keep_input=True).to_laspy()
    there = densecloud.upsample(tmp_path / "in.las", ratio=2, seed=3, keep_input=True)
    assert np.array_equal(made.xyz, there.points) or np.abs(made.xyz - there.points).max() <= 0.000126
    assert list(made.header.scales) == [0.00025] * 3 and list(made.header.offsets) == list(las.header.offsets)
    assert made.header.point_format.id == 7 and (made.X[:300] == las.X).all() and (made.Z[:300] == las.Z).all()
    assert (made.classification == 6).all() and (made.height == 0.1).all() and (made.gps_time == las.gps_time[0]).all()
    assert made.red[0] == 250 * 257 and (made.intensity[:300] == las.intensity).all()
    assert any("UTM zone 32N" in vlr.string for vlr in made.vlrs.get("WktCoordinateSystemVlr"))
    there.write(tmp_path / "out.las")
    assert laspy.read(tmp_path / "out.las").points.array.tobytes() == made.points.array.tobytes()


def test_laspy_that_cannot_be_written_is_refused_and_what_was_cannot_be_changed():
    las = las_of(library("laspy"))
    cloud = densecloud.Cloud(las)
    with pytest.raises(ValueError, match="read-only"):
        cloud.points[0] = 0
    # As it is read of a file of that version.
    las.header._version = type(las.header.version)(1, 0)
    with pytest.raises(densecloud.InvalidInputError, match="FileVersionNotSupported: 1.0.; `densecloud.read` reads"):
        densecloud.Cloud(las)


def test_laspy_of_a_copc_is_what_its_file_is(tmp_path):
    laspy = library("laspy")
    densecloud.Cloud(las_of(laspy)).write(tmp_path / "a.copc.laz")
    las = laspy.read(tmp_path / "a.copc.laz")
    cloud, there = densecloud.Cloud(las), densecloud.read(tmp_path / "a.copc.laz")
    assert np.array_equal(cloud.points, there.points) and cloud.crs == there.crs
    assert list(cloud.attributes) == list(there.attributes)
    assert any(record.user_id == "copc" for record in las.vlrs), "it is as it was"


def test_laspy_of_arrays_has_a_scale_that_is_fine_enough():
    laspy = library("laspy")
    made = densecloud.Cloud(POINTS, colors=COLORS, attributes={"heat": np.arange(300, dtype="f4")}).to_laspy()
    assert np.abs(made.xyz - POINTS).max() <= 0.0005 and isinstance(made, laspy.LasData)
    assert (made["heat"] == np.arange(300)).all() and made.red.max() > 0


#: Of each library, what is no cloud, and the words that say so.
SURFACES = [
    ("open3d", lambda o3d: o3d.geometry.TriangleMesh.create_box(), "sample_points_uniformly"),
    ("open3d", lambda o3d: o3d.t.geometry.TriangleMesh.create_box(), "sample_points_uniformly"),
    ("open3d", lambda o3d: o3d.geometry.LineSet(), "a LineSet is not a cloud"),
    ("open3d", lambda o3d: o3d.t.geometry.PointCloud(), "no positions"),
    ("pyvista", lambda pv: pv.Sphere(), r"pyvista.PolyData\(mesh.points\)"),
    ("pyvista", lambda pv: pv.Line(), "a PolyData with cells"),
    ("pyvista", lambda pv: pv.ImageData(dimensions=(9, 9, 9)), "an? ImageData with cells"),
    ("trimesh", lambda trimesh: trimesh.creation.box(), r"mesh.sample\(10_000\)"),
    ("trimesh", lambda trimesh: trimesh.Scene(), "geometry"),
    ("laspy", lambda laspy: las_of(laspy).points, "give the LasData"),
]


@pytest.mark.parametrize("name, make, says", SURFACES, ids=str)
def test_what_is_no_cloud_is_refused_with_what_to_do(name, make, says):
    with pytest.raises(densecloud.InvalidInputError, match=says):
        densecloud.upsample(make(library(name)))


@pytest.mark.parametrize("name", ["open3d", "pyvista", "trimesh"])
def test_what_is_given_is_a_copy_of_what_cannot_be_changed(name, tmp_path):
    library(name)
    densecloud.write(tmp_path / "a.ply", densecloud.Cloud(POINTS, attributes={"intensity": np.arange(300, dtype="u2")}))
    cloud = densecloud.read(tmp_path / "a.ply")
    made = cloud.to_open3d(tensors=True) if name == "open3d" else getattr(cloud, f"to_{name}")()
    if name == "open3d":
        made.point.positions[:] = 0
        made.point["intensity"][:] = 0
    elif name == "trimesh":
        made.vertices[:] = 0
        made.metadata["intensity"][:] = 0
    else:
        made.points[:] = 0
        made["intensity"][:] = 0
    assert np.array_equal(cloud.points, POINTS) and cloud.attributes["intensity"][1] == 1


def test_all_functions_take_them(tmp_path):
    pv = library("pyvista")
    cloud = pv.PolyData(POINTS)
    densecloud.write(tmp_path / "a.ply", cloud)
    assert densecloud.inspect(cloud)["points"] == 300
    assert densecloud.evaluate(cloud, tmp_path / "a.ply")["published"]["chamfer"] == 0
    dense = densecloud.upsample(cloud, colors=COLORS, attributes={"a": np.ones(300)})
    assert list(dense.attributes) == ["red", "green", "blue", "a"]


def test_no_library_is_loaded_before_it_is_needed():
    code = """
import sys, densecloud
densecloud.upsample([[x, y, 0] for x in range(9) for y in range(9)])
print(sorted({"open3d", "pyvista", "trimesh", "laspy", "distributed", "dask"} & set(sys.modules)))
"""
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "[]\n"


@pytest.mark.parametrize("name", ["open3d", "pyvista", "trimesh", "laspy"])
def test_one_that_is_missing_is_told_with_how_to_install_it(name, monkeypatch):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ImportError, match=rf"{name} is missing: pip install 'densecloud\[{name}\]'"):
        getattr(densecloud.Cloud(POINTS), f"to_{name}")()
