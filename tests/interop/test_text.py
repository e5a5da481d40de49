"""Columns of text against NumPy."""

import numpy as np
import pytest

from conftest import assert_on_sphere


@pytest.mark.parametrize(
    "name, separator", [("cloud.xyz", " "), ("cloud.txt", "\t"), ("cloud.csv", ","), ("cloud.pts", " ")]
)
def test_what_numpy_saves_is_read_and_what_is_written_numpy_loads(tmp_path, sphere, upsample, name, separator):
    points, normals = sphere
    red = np.round(127 + 120 * normals)
    table = np.column_stack([points, red])
    source, result = tmp_path / name, tmp_path / f"dense-{name}"
    header = str(len(points)) if name.endswith(".pts") else ""
    np.savetxt(source, table, fmt=["%.3f"] * 3 + ["%d"] * 3, delimiter=separator, header=header, comments="")

    upsample(source, result, "--ratio", 4)

    dense = np.loadtxt(result, delimiter="," if separator == "," else None)
    assert dense.shape == (4 * len(points), 6)
    assert_on_sphere(dense[:, :3])
    directions = (dense[:, :3] - np.array([465_123.25, 5_204_987.5, 812.125])) / 10
    assert np.abs(dense[:, 3:] - (127 + 120 * directions)).max() < 8


def test_named_columns_come_back_under_their_names(tmp_path, sphere, upsample):
    points, normals = sphere
    source, result = tmp_path / "cloud.csv", tmp_path / "dense.csv"
    label = np.where(normals[:, 0] > 0, 7, -3)
    table = np.column_stack([label, points, normals[:, 2]])
    np.savetxt(
        source, table, fmt=["%d"] + ["%.3f"] * 3 + ["%.9g"], delimiter=",", header="label,x,y,z,height", comments=""
    )

    upsample(source, result, "--ratio", 4, "--keep-input")

    dense = np.genfromtxt(result, delimiter=",", names=True)
    assert set(dense.dtype.names) == {"x", "y", "z", "label", "height"}
    assert set(dense["label"]) == {7, -3}
    kept = np.column_stack([dense[n][: len(points)] for n in "xyz"])
    assert np.array_equal(kept, np.round(points, 3)), "the input, exactly"
