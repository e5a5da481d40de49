"""LAS and LAZ against laspy."""

import struct

import laspy
import numpy as np
import pytest

from conftest import assert_on_sphere

WKT = (
    'PROJCS["WGS 84 / UTM zone 32N",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],'
    'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],'
    'PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",9],PARAMETER["scale_factor",0.9996],'
    'PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["metre",1],AUTHORITY["EPSG","32632"]]'
)


def geo_keys(*keys):
    return b"".join(struct.pack("<4H", *key) for key in [(1, 1, 0, len(keys)), *keys])


def scan(points, normals, version, point_format):
    """A scan with a value in every field of the point format, extra bytes, records and a coordinate system."""
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales, header.offsets = [0.001, 0.001, 0.0005], [465_000, 5_204_000, 100]
    header.system_identifier, header.file_source_id = "Scanner 7", 77
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.vlrs.append(laspy.VLR("someone", 42, "of theirs", b"\x00\x01payload\x00"))
    if point_format < 6:
        keys = geo_keys((1024, 0, 1, 1), (3072, 0, 1, 32632), (4096, 0, 1, 5783))
        header.vlrs.append(laspy.VLR("LASF_Projection", 34735, "keys", keys))
    else:
        header.global_encoding.wkt = True
        header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "wkt", WKT.encode() + b"\0"))
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams("range", "u2", "to the scanner", offsets=[5.0], scales=[0.01]),
            laspy.ExtraBytesParams("label", "i4"),
            laspy.ExtraBytesParams("planarity", "f4"),
        ]
    )
    las = laspy.LasData(header)
    las.xyz = points
    las.intensity = 30_000 + 20_000 * normals[:, 2]
    las.return_number = 1 + (normals[:, 0] > 0)
    las.number_of_returns[:] = 2
    las.classification = np.where(normals[:, 1] > 0, 2, 6)
    las.user_data[:] = 5
    las.point_source_id[:] = 77
    las.withheld = normals[:, 2] > 0.9
    if point_format < 6:
        las.scan_angle_rank[:] = -12
    else:
        las.scan_angle[:] = -2000
        las.scanner_channel[:] = 2
    names = set(las.point_format.dimension_names)
    if "gps_time" in names:
        las.gps_time = 2e8 + np.arange(len(points)) / 8
    if "red" in names:
        las.red, las.green, las.blue = 65_535 * (normals.T + 1) / 2
    if "nir" in names:
        las.nir[:] = 1234
    las["range"] = 10 + 3 * normals[:, 0]
    las.label = np.where(normals[:, 2] > 0, 70_000, -5)
    las.planarity = normals[:, 0]
    if version == "1.4":
        las.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR("someone", i, "after", bytes(70_000)) for i in (1, 2)])
    return las


@pytest.mark.parametrize("extensions", [("las", "las"), ("las", "laz"), ("laz", "las"), ("laz", "laz")])
@pytest.mark.parametrize(
    "version, point_format", [("1.2", 0), ("1.2", 1), ("1.2", 3), ("1.3", 2), ("1.4", 3), ("1.4", 6), ("1.4", 8)]
)
def test_las_stays_what_it_was(tmp_path, sphere, upsample, version, point_format, extensions):
    points, normals = sphere
    source, result = (tmp_path / f"{name}.{end}" for name, end in zip(("a", "b"), extensions, strict=True))
    scan(points, normals, version, point_format).write(source)
    before = laspy.read(source)

    said = upsample(source, result, "--ratio", 4)

    assert "warning" not in said
    after = laspy.read(result)
    assert len(after) == 4 * len(points)
    assert_on_sphere(after.xyz)
    for of in (
        lambda h: str(h.version),
        lambda h: h.point_format.id,
        lambda h: list(h.scales),
        lambda h: list(h.offsets),
        lambda h: h.system_identifier,
        lambda h: h.file_source_id,
        lambda h: h.global_encoding.value,
        lambda h: h.uuid,
        lambda h: h.creation_date,
        lambda h: list(h.point_format.dimension_names),
        lambda h: [d.dtype for d in h.point_format.extra_dimensions],
        lambda h: [str(d.scales) + str(d.offsets) + d.description for d in h.point_format.extra_dimensions],
    ):
        assert of(after.header) == of(before.header)
    assert after.header.generating_software.startswith("densecloud ")
    assert after.header.are_points_compressed == (extensions[1] == "laz")

    def records(vlrs):
        storage = {"laszip encoded", "LASF_Spec", "densecloud"}
        kept = [v for v in vlrs or [] if v.user_id not in storage]
        return [(v.user_id, v.record_id, v.description, v.record_data_bytes()) for v in kept]

    assert records(after.header.vlrs) == records(before.header.vlrs)
    assert records(after.header.evlrs) == records(before.header.evlrs)
    count = after.header.number_of_points_by_return
    assert sum(count[:2]) == len(after)
    assert np.array_equal(after.header.mins, after.xyz.min(axis=0))
    assert np.array_equal(after.header.maxs, after.xyz.max(axis=0))
    directions = (after.xyz - np.array([465_123.25, 5_204_987.5, 812.125])) / 10
    assert np.abs(after.intensity - (30_000 + 20_000 * directions[:, 2])).max() < 1500
    assert np.abs(after["range"] - (10 + 3 * directions[:, 0])).max() < 0.3
    assert np.abs(after.planarity - directions[:, 0]).max() < 0.1
    for name in set(before.point_format.dimension_names) - {"X", "Y", "Z", "intensity", "range", "planarity"}:
        ours, theirs = np.asarray(after[name]), np.asarray(before[name])
        if name in ("red", "green", "blue"):
            axis = ("red", "green", "blue").index(name)
            assert np.abs(ours - 65_535 * (directions[:, axis] + 1) / 2).max() < 3000
        else:
            assert set(ours.tolist()) <= set(theirs.tolist()), name


@pytest.mark.parametrize("version, point_format", [("1.2", 3), ("1.4", 6), ("1.4", 8)])
def test_copc_is_laz_by_place(tmp_path, upsample, inspect, version, point_format):
    i = np.arange(15_000)
    z = 1.0 - (2 * i + 1) / len(i)
    r, angle = np.sqrt(1 - z * z), i * 2.399963229728653
    normals = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    source, plain, copc = (tmp_path / name for name in ("source.laz", "plain.laz", "dense.copc.laz"))
    scan(np.array([465_123.25, 5_204_987.5, 812.125]) + 10 * normals, normals, version, point_format).write(source)
    for result in (plain, copc):
        assert "warning" not in upsample(source, result, "--ratio", 4)

    with laspy.CopcReader.open(copc) as reader:
        everything = reader.query()
        low, middle = (reader.header.mins, (reader.header.mins + reader.header.maxs) / 2)
        quarter = reader.query(bounds=laspy.Bounds(low[:2], middle[:2]))
        coarse = reader.query(level=0)
        assert reader.copc_info.spacing > 0
    whole, theirs = laspy.read(copc), laspy.read(plain)
    assert 0 < len(coarse) < len(whole) == len(theirs) == len(everything) == 60_000

    def rows(las, names):
        return sorted(zip(*(np.asarray(las[name]).tolist() for name in names), strict=True))

    names = [name for name in theirs.point_format.dimension_names if name in whole.point_format.dimension_names]
    lost = set(theirs.point_format.dimension_names) - set(names)
    assert lost == (set() if point_format > 5 else {"scan_angle_rank"})
    assert {"range", "label", "planarity", "X", "intensity", "withheld"} <= set(names)
    assert rows(whole, names) == rows(theirs, names) == rows(everything, names)
    xy = np.stack([theirs.x, theirs.y], axis=1)
    inside = (xy <= middle[:2]).all(axis=1)
    assert rows(quarter, names) == rows(theirs[inside], names)
    crs = {v.record_id: v.record_data_bytes() for v in theirs.header.vlrs if v.user_id == "LASF_Projection"}
    assert crs == {v.record_id: v.record_data_bytes() for v in whole.header.vlrs if v.user_id == "LASF_Projection"}

    bounds = [*low[:2], *middle[:2]]
    inside = ((xy >= low[:2]) & (xy < middle[:2])).all(axis=1)
    for path in (plain, copc):
        told = inspect(path, "--bounds", ",".join(map(repr, map(float, bounds))))
        assert (told["points"], told["format"]) == (inside.sum(), "LAZ" if path == plain else "COPC")


def test_xyz_becomes_las(tmp_path, sphere, upsample):
    points, normals = sphere
    source = tmp_path / "source.csv"
    rows = np.concatenate([points, normals, np.full((len(points), 1), 7)], axis=1)
    np.savetxt(source, rows, delimiter=",", header="x,y,z,nx,ny,nz,classification", comments="", fmt="%.9g")
    for end in ("las", "laz"):
        result = tmp_path / f"result.{end}"
        assert "warning" not in upsample(source, result, "--ratio", 4)
        las = laspy.read(result)
        assert (str(las.header.version), las.header.point_format.id) == ("1.4", 6)
        assert_on_sphere(las.xyz)
        assert las.header.scales.max() <= 1e-3
        assert set(las.classification) == {7}
        assert set(las.return_number) == {1}
        directions = (las.xyz - np.array([465_123.25, 5_204_987.5, 812.125])) / 10
        assert np.abs(np.stack([las.nx, las.ny, las.nz], axis=1) - directions).max() < 0.1


def test_las_through_pcd_and_back_keeps_its_coordinate_system(tmp_path, sphere, upsample):
    points, normals = sphere
    for point_format, expected in ((1, 3), (7, 7)):
        source, between, result = (tmp_path / name for name in ("a.las", "b.pcd", "c.laz"))
        scan(points, normals, "1.4", point_format).write(source)
        assert "someone 42" in upsample(source, between, "--ratio", 1.5)
        upsample(between, result, "--ratio", 1.5)
        las = laspy.read(result)
        assert las.header.point_format.id == (expected if point_format == 7 else 1)
        [record] = [v for v in las.header.vlrs if v.user_id == "LASF_Projection"]
        if point_format == 7:
            assert record.string == WKT
            assert las.header.global_encoding.wkt
        else:
            assert [(k.id, k.value_offset) for k in record.geo_keys] == [(1024, 1), (3072, 32632), (4096, 5783)]
            assert not las.header.global_encoding.wkt
        assert_on_sphere(las.xyz)
        assert set(las.label) == {70_000, -5}
