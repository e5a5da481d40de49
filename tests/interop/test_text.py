"""Columns of text against NumPy and pandas."""

import csv

import numpy as np
import pandas
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


def dialects(points, normals):
    """A table as pandas writes it, in several ways, and how pandas reads each."""
    table = pandas.DataFrame(points, columns=["Easting", "Northing", "Height (m)"])
    table.insert(0, "PointID", range(len(table)))
    for i, name in enumerate(["Normal, x", 'Normal "y"', "Normal z"]):
        table[name] = normals[:, i]
    yield "comma", {}, table
    yield "german", {"sep": ";", "decimal": ","}, table
    yield "tab", {"sep": "\t"}, table
    yield "bar", {"sep": "|"}, table


@pytest.mark.parametrize("way", range(4))
def test_tables_of_pandas_come_back_as_they_were(tmp_path, sphere, upsample, way):
    points, normals = sphere
    name, options, table = list(dialects(points, normals))[way]
    source, result = tmp_path / f"{name}.txt", tmp_path / "result.txt"
    table.to_csv(source, index=False, **options)

    warned = upsample(source, result, "--keep-input", "--ratio", 2)

    assert "names are others" not in warned
    dense = pandas.read_csv(result, **options)
    columns = ["Easting", "Northing", "Height (m)"]
    assert list(dense.columns) == columns + [c for c in table.columns if c not in columns]
    assert np.array_equal(dense[columns].values[: len(points)], points)
    assert np.array_equal(dense["PointID"].values[: len(points)], np.arange(len(points)))
    assert np.array_equal(dense["Normal, x"].values[: len(points)], normals[:, 0])
    assert_on_sphere(dense[columns].values)


@pytest.mark.parametrize("options", [{"quoting": csv.QUOTE_ALL}, {"encoding": "utf-16"}, {"compression": "gzip"}])
def test_pandas_writes_in_other_ways(tmp_path, sphere, upsample, options):
    points, _ = sphere
    source, result = tmp_path / "source.csv", tmp_path / "result.csv"
    pandas.DataFrame(points, columns=["x", "y", "z"]).to_csv(source, **options)
    upsample(source, result, "--keep-input", "--ratio", 2)
    dense = pandas.read_csv(result)
    assert list(dense.columns) == ["x", "y", "z", "index"]
    assert np.array_equal(dense[["x", "y", "z"]].values[: len(points)], points)


def test_separators_of_thousands_are_refused(tmp_path, sphere, upsample):
    points, _ = sphere
    source = tmp_path / "source.csv"
    pandas.DataFrame(points, columns=["x", "y", "z"]).to_csv(source, index=False, float_format="{:,.3f}".format)
    assert "thousands" in upsample(source, tmp_path / "result.csv", fails=True)


def test_names_from_elsewhere_are_read_by_others(tmp_path, sphere, upsample):
    points, _ = sphere
    names = ["a,b", 'say "h"', "X", "GPS Time"]
    kinds = [("x", "f8"), ("y", "f8"), ("z", "f8"), *((name, "u1") for name in names)]
    cloud = np.zeros(len(points), dtype=kinds)
    cloud["x"], cloud["y"], cloud["z"] = points.T
    for i, name in enumerate(names):
        cloud[name] = i + 1
    np.save(tmp_path / "source.npy", cloud)

    warned = upsample(tmp_path / "source.npy", tmp_path / "result.csv")
    assert '"X" as "X_2"' in warned
    dense = pandas.read_csv(tmp_path / "result.csv")
    assert list(dense.columns) == ["x", "y", "z", "a,b", 'say "h"', "X_2", "GPS Time"]

    warned = upsample(tmp_path / "source.npy", tmp_path / "result.xyz")
    assert '"GPS Time" as "GPS_Time"' in warned
    dense = np.genfromtxt(tmp_path / "result.xyz", names=True, deletechars="")
    assert dense.dtype.names == ("x", "y", "z", "a_b", "say__h_", "X_2", "GPS_Time")
    assert (dense["GPS_Time"] == 4).all()
