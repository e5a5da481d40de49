"""PCD against Open3D and pypcd4."""

import numpy as np
import open3d
import pypcd4
import pytest

from conftest import assert_on_sphere

CENTRE = np.array([465_123.25, 5_204_987.5, 812.125])
ENCODINGS = [pypcd4.Encoding.ASCII, pypcd4.Encoding.BINARY, pypcd4.Encoding.BINARY_COMPRESSED]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_what_pypcd4_writes_is_read_and_what_is_written_pypcd4_reads(tmp_path, sphere, upsample, encoding):
    points, normals = sphere
    rgb = pypcd4.PointCloud.encode_rgb((127 + 120 * normals).astype(np.uint8))
    fields = {
        "x": (points[:, 0], np.float64),
        "y": (points[:, 1], np.float64),
        "z": (points[:, 2], np.float64),
        # In text, pypcd4 rounds the float that the bits are to zero.
        "rgb": (rgb.view(np.uint32), np.uint32) if encoding == pypcd4.Encoding.ASCII else (rgb, np.float32),
        "normal_x": (normals[:, 0], np.float32),
        "normal_y": (normals[:, 1], np.float32),
        "normal_z": (normals[:, 2], np.float32),
        "label": (np.where(normals[:, 0] > 0, 70_000, 5), np.uint32),
        "ring": (np.arange(len(points)) % 16, np.uint16),
    }
    columns = [column.astype(kind) for column, kind in fields.values()]
    cloud = pypcd4.PointCloud.from_points(columns, list(fields), [kind for _, kind in fields.values()])
    cloud.metadata.viewpoint = (1.5, 2.0, 3.0, 0.5, 0.5, 0.5, 0.5)
    source, result = tmp_path / "source.pcd", tmp_path / "result.pcd"
    cloud.save(source, encoding)

    assert "warning" not in upsample(source, result, "--ratio", 4)

    dense = pypcd4.PointCloud.from_path(result)
    assert dense.fields == tuple(fields)
    data = dense.pc_data
    expected = {name: np.dtype(kind) for name, (_, kind) in fields.items()}
    assert {name: data.dtype[name] for name in data.dtype.names} == expected
    assert dense.metadata.data == encoding
    assert tuple(dense.metadata.viewpoint) == (1.5, 2.0, 3.0, 0.5, 0.5, 0.5, 0.5)
    xyz = np.stack([data[n] for n in "xyz"], axis=1)
    assert len(xyz) == 4 * len(points)
    assert_on_sphere(xyz)
    directions = (xyz - CENTRE) / 10
    assert np.abs(np.stack([data["normal_" + n] for n in "xyz"], axis=1) - directions).max() < 0.1
    bits = data["rgb"] if encoding == pypcd4.Encoding.ASCII else data["rgb"].view(np.uint32)
    for shift, axis in ((16, 0), (8, 1), (0, 2)):
        assert np.abs((bits >> shift & 255).astype(float) - (127 + 120 * directions[:, axis])).max() < 10
    assert set(data["label"]) == {70_000, 5}
    assert set(data["ring"]) <= set(range(16))


@pytest.mark.parametrize("text, compressed", [(True, False), (False, False), (False, True)])
def test_what_open3d_writes_is_read_and_what_is_written_open3d_reads(tmp_path, sphere, upsample, text, compressed):
    points, normals = sphere
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points - CENTRE))
    cloud.normals = open3d.utility.Vector3dVector(normals)
    cloud.colors = open3d.utility.Vector3dVector((normals + 1) / 2)
    source, result = tmp_path / "source.pcd", tmp_path / "result.pcd"
    open3d.io.write_point_cloud(str(source), cloud, write_ascii=text, compressed=compressed)

    upsample(source, result, "--ratio", 4)

    dense = open3d.io.read_point_cloud(str(result))
    xyz = np.asarray(dense.points)
    assert len(xyz) == 4 * len(points)
    assert_on_sphere(xyz + CENTRE)
    assert np.abs(np.asarray(dense.normals) - xyz / 10).max() < 0.1
    assert np.abs(np.asarray(dense.colors) - (xyz / 10 + 1) / 2).max() < 0.05


def test_ply_becomes_pcd_that_open3d_reads(tmp_path, sphere, upsample):
    points, normals = sphere
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points - CENTRE))
    cloud.normals = open3d.utility.Vector3dVector(normals)
    cloud.colors = open3d.utility.Vector3dVector((normals + 1) / 2)
    source, result = tmp_path / "source.ply", tmp_path / "result.pcd"
    open3d.io.write_point_cloud(str(source), cloud)
    # What is long in the header must not hinder a reader of lines.
    told = source.read_bytes().replace(b"element vertex", b"comment " + b"x" * 3000 + b"\nelement vertex", 1)
    source.write_bytes(told)
    upsample(source, result, "--ratio", 4)
    dense = open3d.io.read_point_cloud(str(result))
    xyz = np.asarray(dense.points)
    assert_on_sphere(xyz + CENTRE)
    assert np.abs(np.asarray(dense.normals) - xyz / 10).max() < 0.1
    assert np.abs(np.asarray(dense.colors) - (xyz / 10 + 1) / 2).max() < 0.05


def test_coordinates_far_from_the_origin_stay_exact(tmp_path, sphere, upsample):
    points, _ = sphere
    source, result = tmp_path / "source.xyz", tmp_path / "result.pcd"
    np.savetxt(source, points, fmt="%.6f")
    upsample(source, result, "--ratio", 4)
    # The older reader of Open3D takes 64-bit coordinates for zeros.
    assert_on_sphere(open3d.t.io.read_point_cloud(str(result)).point.positions.numpy())
