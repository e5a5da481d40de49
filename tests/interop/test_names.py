"""Names that no format was made for, and names that mean what a format has a place for, as other programs find them."""

import csv

import laspy
import numpy as np
import open3d
import plyfile
import pycolmap
import pye57
import pypcd4
import pytest
from pye57 import libe57

HOSTILE = [
    "a b",
    "a\tb",
    "a_b",
    '"quoted"',
    "it's",
    "größe",
    "高さ",
    "😀",
    " ",
    "Y",
    "twice",
    "twice_",
    "a,b",
    "a;b",
    "a#b",
    "#",
    "// c",
    "9 lives",
    "9",
    "property",
    "end_header",
    "element vertex 7",
    "comment",
    "DATA",
    "DATA ascii",
    "FIELDS",
    "_",
    "__",
    "rgb",
    "line\nbreak",
    "bell\a",
    "\\",
    "a:b",
    "<tag>",
    "&amp;",
    "]]>",
    "xml",
    "intensity ",
    "X",
    "z [m]",
    "raw_classification",
    "GpsTime_",
    "n" * 300,
    "n" * 301,
    "ü" * 40,
    "ü" * 41,
]


def columns_of(path):
    """All columns of a file beside the position, by name, as another program reads them."""
    axes = {"x", "y", "z"}
    match path.suffix:
        case ".ply":
            data = plyfile.PlyData.read(path)["vertex"].data
        case ".pcd":
            data = pypcd4.PointCloud.from_path(path).pc_data
        case ".npy":
            data = np.load(path)
        case ".las" | ".laz":
            las = laspy.read(path)
            return {name: np.array(las[name]) for name in las.point_format.dimension_names if name not in "XYZ"}
        case ".e57":
            with pye57.E57(str(path)) as file:
                header = file.get_header(0)
                names = [name for name in header.point_fields if not name.startswith("cartesian")]
                arrays = {name: np.empty(header.point_count) for name in names}
                buffers = libe57.VectorSourceDestBuffer()
                for name, array in arrays.items():
                    count = header.point_count
                    buffers.append(libe57.SourceDestBuffer(file.image_file, name, array, count, True, True))
                header.points.reader(buffers).read()
                return arrays
        case ".csv":
            with path.open(newline="", encoding="utf-8") as file:
                names, *rows = csv.reader(file)
            table = np.array(rows, dtype=float)
            assert len(set(names)) == len(names)
            return {name: table[:, i] for i, name in enumerate(names) if i >= 3}
    return {name: data[name] for name in data.dtype.names if name not in axes}


@pytest.fixture
def hostile(tmp_path, sphere):
    """An array whose columns have all of these names, and numbers that tell which is which."""
    points, _ = sphere
    table = np.zeros(len(points), dtype=[(n, "f8") for n in "xyz"] + [(name, "i4") for name in HOSTILE])
    for axis, name in enumerate("xyz"):
        table[name] = points[:, axis]
    for i, name in enumerate(HOSTILE):
        table[name] = 100_000 * (i + 1) + np.arange(len(points))
    np.save(tmp_path / "source.npy", table)
    return tmp_path / "source.npy"


@pytest.mark.parametrize("form", ["txt", "bin"])
def test_columns_of_hostile_names_are_no_matter_to_colmap(tmp_path, sphere, hostile, upsample, form):
    """It has no names; what is lost is told."""
    points, _ = sphere
    for write in ("write_text", "write_binary"):
        getattr(pycolmap.Reconstruction(), write)(tmp_path)
    for other in {"txt", "bin"} - {form}:
        for file in tmp_path.glob(f"*.{other}"):
            file.unlink()

    said = upsample(hostile, tmp_path / f"points3D.{form}", "--ratio", 1, "--keep-input")

    read = pycolmap.Reconstruction(tmp_path).points3D
    assert np.array_equal([read[key].xyz for key in sorted(read)], points)
    lost = next(line for line in said.splitlines() if "has no place for" in line)
    for name in HOSTILE:
        if name.isprintable() and name.strip():
            assert name in lost, name


@pytest.mark.parametrize("suffix", ["ply", "pcd", "las", "laz", "e57", "npy", "csv"])
def test_columns_of_hostile_names_are_read_by_others(tmp_path, sphere, hostile, upsample, suffix):
    points, _ = sphere
    result = tmp_path / f"result.{suffix}"

    said = upsample(hostile, result, "--ratio", 1, "--keep-input")

    columns = columns_of(result)
    found = {int(column[0]) for column in columns.values()}
    missing = [name for i, name in enumerate(HOSTILE) if 100_000 * (i + 1) not in found]
    assert not missing
    for i in range(len(HOSTILE)):
        column = next(c for c in columns.values() if int(c[0]) == 100_000 * (i + 1))
        assert np.array_equal(column, 100_000 * (i + 1) + np.arange(len(points)))
    if suffix in ("ply", "pcd", "las", "laz"):
        assert "names are others" in said


LAS_NAMES = ["red", "green", "blue", "intensity", "return_number", "number_of_returns", "classification", "gps_time"]
STYLES = {
    "PDAL": "X,Y,Z,Red,Green,Blue,Intensity,ReturnNumber,NumberOfReturns,Classification,GpsTime,"
    "NormalX,NormalY,NormalZ",
    "CloudCompare": "x,y,z,R,G,B,scalar_Intensity,scalar_Return_Number,scalar_Number_Of_Returns,scalar_Classification,"
    "scalar_Gps_Time,Nx,Ny,Nz",
    "ours": "x,y,z,red,green,blue,intensity,return_number,number_of_returns,classification,gps_time,nx,ny,nz",
}


@pytest.mark.parametrize("suffix", ["ply", "pcd", "las", "laz", "e57", "csv"])
@pytest.mark.parametrize("decimals", [0, 3])
@pytest.mark.parametrize("style", STYLES)
def test_what_a_column_means_has_its_place_in_every_format(tmp_path, sphere, upsample, style, decimals, suffix):
    """By whatever name, and in whole numbers or, as PDAL writes them, with three decimals."""
    points, normals = sphere
    source, result = tmp_path / "source.csv", tmp_path / f"result.{suffix}"
    i = np.arange(len(points))
    wholes = np.stack([i % 251, i % 241, i % 239, 300 + i, 1 + i % 3, 3 + 0 * i, 2 + 4 * (i % 2)], axis=1)
    time = 3e8 + i / 8
    formats = ["%.6f"] * 3 + [f"%.{decimals}f"] * 7 + ["%.3f"] + ["%.9f"] * 3
    table = np.hstack([points, wholes, time[:, None], normals])
    np.savetxt(source, table, fmt=formats, delimiter=",", header=STYLES[style], comments="")

    said = upsample(source, result, "--ratio", 1, "--keep-input")

    assert "names are others" not in said
    columns = columns_of(result)
    if suffix == "csv":
        assert list(columns) == STYLES[style].split(",")[3:]
        assert np.allclose(np.stack(list(columns.values()), axis=1), table[:, 3:])
        return
    if suffix == "pcd":
        # Open3D's reader takes no normals of 32 bits beside coordinates of 64.
        cloud = open3d.t.io.read_point_cloud(str(result))
        assert np.array_equal(cloud.point["colors"].numpy(), wholes[:, :3])
        assert np.abs(columns["normal_z"] - normals[:, 2]).max() < 1e-6
        assert np.array_equal(columns["intensity"], wholes[:, 3])
        return
    names = {
        "ply": ["red", "green", "blue"],
        "e57": ["colorRed", "colorGreen", "colorBlue", "intensity", "returnIndex", "returnCount", None, "timeStamp"],
    }.get(suffix, LAS_NAMES)
    expected = [*wholes.T, time]
    for name, column in zip(names, expected[: len(names)], strict=True):
        if suffix in ("las", "laz") and name in ("red", "green", "blue"):
            column = 257 * column  # noqa: PLW2901
        if name == "returnIndex":
            column = column - 1  # noqa: PLW2901
        assert name is None or np.array_equal(columns[name], column), name
    if suffix == "ply":
        assert columns["red"].dtype == np.uint8
        assert np.abs(columns["nz"] - normals[:, 2]).max() < 1e-6
    if suffix in ("las", "laz"):
        assert laspy.read(result).header.point_format.id == 7
    if suffix == "e57":
        assert np.abs(columns["nor:normalZ"] - normals[:, 2]).max() < 1e-6


def test_extra_bytes_of_hostile_names_are_read_by_laspy(tmp_path, sphere, upsample):
    """As a careless program writes them: twice the same, a field's name, half a character, and no name at all."""
    points, _ = sphere
    source, result = tmp_path / "source.las", tmp_path / "result.las"
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.offsets, header.scales = points.mean(axis=0).round(), [0.001] * 3
    own = [f"column{i}" for i in range(6)]
    header.add_extra_dims([laspy.ExtraBytesParams(name, "u2") for name in own])
    las = laspy.LasData(header)
    las.xyz = points
    for i, name in enumerate(own):
        las[name][:] = 300 + i
    las.write(source)
    data = source.read_bytes()
    for name, other in zip(own, [b"range", b"range", b"intensity", b"gr\xc3", b"", b"n" * 32], strict=True):
        data = data.replace(name.encode().ljust(32, b"\0"), other.ljust(32, b"\0"))
    source.write_bytes(data)

    said = upsample(source, result, "--ratio", 1, "--keep-input")

    assert "names are others" in said
    dense = laspy.read(result)
    names = list(dense.point_format.extra_dimension_names)
    assert names == ["range", "range_", "intensity_", "gr_", "extra 5", "n" * 32]
    assert [dense[name][0] for name in names] == [300 + i for i in range(6)]
