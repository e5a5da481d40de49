"""E57 against pye57, which is libE57Format."""

import numpy as np
import pye57
import pytest
from pye57 import libe57
from pyquaternion import Quaternion

from conftest import assert_on_sphere

CENTRE = np.array([465_123.25, 5_204_987.5, 812.125])


def write(path, scans):
    """Writes scans of (data, rotation, translation)."""
    with pye57.E57(str(path), mode="w") as file:
        for data, rotation, translation in scans:
            file.write_scan_raw(data, rotation=rotation, translation=translation)


def scan_of(points, normals, rotation, translation):
    """A scan as its sensor saw it: local coordinates, in the types that pye57 takes."""
    local = (points - translation) @ rotation.rotation_matrix
    data = {"cartesian" + axis: np.ascontiguousarray(local[:, i]) for i, axis in enumerate("XYZ")}
    data["intensity"] = (0.5 + normals[:, 2] / 4).astype("f4")
    for i, colour in enumerate(["Red", "Green", "Blue"]):
        data["color" + colour] = (127 + 120 * normals[:, i]).astype("u1")
    return data, rotation.elements, translation


def positions(data):
    return np.stack([data["cartesian" + axis] for axis in "XYZ"], axis=1)


def test_a_scan_is_read_where_it_stands_and_its_result_by_pye57(tmp_path, sphere, upsample):
    points, normals = sphere
    source, result = tmp_path / "source.e57", tmp_path / "result.e57"
    rotation, translation = Quaternion(axis=[1, 2, 3], angle=0.7), CENTRE + [3.0, -4.0, 1.5]
    write(source, [scan_of(points, normals, rotation, translation)])

    upsample(source, result, "--ratio", 4)

    with pye57.E57(str(result)) as file:
        assert file.scan_count == 1
        assert np.allclose(file.scan_position(0)[0], translation)
        limits = file.get_header(0)["intensityLimits"]
        assert 0.2 < limits["intensityMinimum"].value() < 0.3
        assert 0.7 < limits["intensityMaximum"].value() < 0.8
        assert file.get_header(0)["description"].value().startswith("pye57")
        data = file.read_scan(0, intensity=True, colors=True, ignore_missing_fields=True)
    dense = positions(data)
    assert len(dense) == 4 * len(points)
    assert_on_sphere(dense)
    directions = (dense - CENTRE) / 10
    assert np.abs(data["intensity"] - (0.5 + directions[:, 2] / 4)).max() < 0.02
    assert np.abs(data["colorRed"] - (127 + 120 * directions[:, 0])).max() < 8


def test_two_scans_stay_two_scans(tmp_path, sphere, upsample):
    points, normals = sphere
    source, result = tmp_path / "source.e57", tmp_path / "result.e57"
    east = normals[:, 0] > 0
    write(
        source,
        [
            scan_of(points[east], normals[east], Quaternion(axis=[0, 0, 1], angle=1.0), CENTRE + [20.0, 0.0, 0.0]),
            scan_of(points[~east], normals[~east], Quaternion(axis=[1, 0, 0], angle=-2.0), CENTRE - [20.0, 0.0, 0.0]),
        ],
    )

    upsample(source, result, "--ratio", 4)

    with pye57.E57(str(result)) as file:
        assert file.scan_count == 2
        scans = [positions(file.read_scan(i, ignore_missing_fields=True)) for i in range(2)]
    assert sum(map(len, scans)) == 4 * len(points)
    assert_on_sphere(np.concatenate(scans))
    assert (scans[0][:, 0] - CENTRE[0]).min() > -1.0
    assert (scans[1][:, 0] - CENTRE[0]).max() < 1.0


def test_grids_and_invalid_points_are_read(tmp_path, sphere, upsample):
    points, normals = sphere
    source, result = tmp_path / "source.e57", tmp_path / "result.e57"
    data, rotation, translation = scan_of(points, normals, Quaternion(), CENTRE)
    data["rowIndex"] = (np.arange(len(points)) // 50).astype("u2")
    data["columnIndex"] = (np.arange(len(points)) % 50).astype("u2")
    data["cartesianInvalidState"] = (np.arange(len(points)) % 10 == 0).astype("i1")
    write(source, [(data, rotation, translation)])

    said = upsample(source, result, "--points", 5000)

    assert "150 points that the file calls invalid" in said
    with pye57.E57(str(result)) as file:
        dense = file.read_scan(0, row_column=True, ignore_missing_fields=True)
    assert len(dense["cartesianX"]) == 5000
    assert dense["rowIndex"].max() == 29
    assert dense["columnIndex"].max() == 49


def test_all_attributes_are_there_for_libe57(tmp_path, sphere, upsample):
    """From text, by way of an extension of ours for what E57 has no column for."""
    points, normals = sphere
    source, result = tmp_path / "source.xyz", tmp_path / "result.e57"
    table = np.hstack([points, normals, np.arange(len(points))[:, None] % 7])
    np.savetxt(source, table, header="x y z nx ny nz my-class", comments="", fmt="%.9g %.9g %.9g %.6f %.6f %.6f %d")

    upsample(source, result, "--ratio", 2)

    with pye57.E57(str(result)) as file:
        count = file.get_header(0).point_count
        arrays = {name: np.empty(count) for name in ("nor:normalX", "nor:normalZ", "densecloud:my-2D-class")}
        buffers = libe57.VectorSourceDestBuffer()
        for name, array in arrays.items():
            buffers.append(libe57.SourceDestBuffer(file.image_file, name, array, count, True, True))
        file.get_header(0).points.reader(buffers).read()
        dense = positions(file.read_scan(0, ignore_missing_fields=True))
    directions = (dense - CENTRE) / 10
    assert np.abs(arrays["nor:normalZ"] - directions[:, 2]).max() < 0.1
    assert set(arrays["densecloud:my-2D-class"]) == set(range(7))


def test_the_same_input_gives_the_same_bytes(tmp_path, sphere, upsample):
    points, normals = sphere
    source = tmp_path / "source.e57"
    write(source, [scan_of(points, normals, Quaternion(), CENTRE)])
    results = [tmp_path / "first.e57", tmp_path / "second.e57"]
    for result in results:
        upsample(source, result, "--points", 3000)
    assert results[0].read_bytes() == results[1].read_bytes()


@pytest.mark.parametrize("suffix", ["ply", "xyz", "npy"])
def test_other_formats_take_what_it_tells(tmp_path, sphere, upsample, suffix):
    points, normals = sphere
    source, result = tmp_path / "source.e57", tmp_path / f"result.{suffix}"
    write(source, [scan_of(points, normals, Quaternion(), CENTRE)])
    upsample(source, result, "--ratio", 2)
    back = tmp_path / "back.e57"
    upsample(result, back, "--ratio", 1)
    with pye57.E57(str(back)) as file:
        data = file.read_scan(0, intensity=True, colors=True, ignore_missing_fields=True)
    assert_on_sphere(positions(data))
    assert 0.2 < data["intensity"].min() < 0.3
