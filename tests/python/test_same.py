"""The same bytes as the program's."""

import hashlib
import json

import densecloud
import numpy as np
import pytest

from conftest import sphere

OPTIONS = [
    {"ratio": 4},
    {"ratio": 2.5, "seed": 7, "keep_input": True, "source_fields": True, "confidence": True, "overlap": 2.5},
    {"spacing": 0.7, "normals": "estimate", "quality": "best", "spread": "area", "max_distance": float("inf")},
    {
        "points": 1000,
        "no_polish": True,
        "inner": 0.6,
        "min_confidence": 0.2,
        "sensor": (1, 2, 3.5),
        "normals": "estimate",
    },
]


def flags(options):
    given = [(f"--{name.replace('_', '-')}", value) for name, value in options.items()]
    text = {name: ",".join(map(str, value)) if isinstance(value, tuple) else str(value) for name, value in given}
    return [name if value is True else f"{name}={text[name]}" for name, value in given]


def clouds(folder):
    """Files of one cloud in formats that hold attributes or not."""
    points, n = sphere(500), 500
    colors = (np.arange(3 * n).reshape(n, 3) % 256).astype("u1")
    cloud = densecloud.Cloud(points, colors=colors, attributes={"intensity": np.arange(n, dtype="u2")})
    names = ["a.ply", "a.las", "a.laz", "a.copc.laz", "a.pcd", "a.npy", "a.xyz", "a.csv", "a.e57"]
    for name in names:
        cloud.write(folder / name)
    return [folder / name for name in names]


@pytest.mark.parametrize("options", OPTIONS, ids=range(len(OPTIONS)))
@pytest.mark.filterwarnings("ignore::densecloud.DensecloudWarning")
def test_files_become_the_same_files(tmp_path, densecloud_program, options):
    for path in clouds(tmp_path):
        here, there = tmp_path / f"here-{path.name}", tmp_path / f"there-{path.name}"
        densecloud.upsample(path, **options).write(here)
        densecloud_program("upsample", path, there, "--quiet", *flags(options))
        digest = [hashlib.sha256(made.read_bytes()).hexdigest() for made in (here, there)]
        assert digest[0] == digest[1], path.name
        beside = [made.with_name(made.name + ".provenance.txt") for made in (here, there)]
        assert beside[0].exists() == beside[1].exists()
        assert not beside[0].exists() or beside[0].read_bytes() == beside[1].read_bytes()


@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_arrays_become_the_points_that_their_file_becomes(tmp_path, densecloud_program, kind):
    points = (sphere(500) - sphere(500)[0]).astype(kind)
    densecloud.write(tmp_path / "in.ply", points)
    densecloud_program("upsample", tmp_path / "in.ply", tmp_path / "there.ply", "--seed", 5)
    here = densecloud.upsample(points, seed=5)
    there = densecloud.read(tmp_path / "there.ply")
    assert np.array_equal(here.points.astype(kind), there.points)
    here.write(tmp_path / "here.ply")
    differing = {"input_sha256"}
    told = [dict(pair.split("=", 1) for pair in line.split()[1:]) for line in (here.provenance, there.comments[-1])]
    assert {name: value for name, value in told[1].items() if name not in differing} == told[0]
    body = [(tmp_path / name).read_bytes().split(b"end_header\n")[1] for name in ("here.ply", "there.ply")]
    assert body[0] == body[1]


def test_threads_and_upsamplers_change_nothing(tmp_path):
    points = sphere(3000)
    whole = densecloud.upsample(points)
    for threads in (1, 3):
        upsampler = densecloud.Upsampler(threads=threads)
        assert upsampler.threads == threads
        assert np.array_equal(upsampler.upsample(points).points, whole.points)


def test_measures_are_the_programs(tmp_path, densecloud_program):
    paths = clouds(tmp_path)
    for path in paths:
        assert densecloud.inspect(path) == json.loads(densecloud_program("inspect", path, "--json"))
    dense = tmp_path / "dense.npy"
    densecloud.upsample(paths[0], confidence=True).write(dense)
    told = densecloud.inspect(dense, source=paths[0], ratio=2, sample=100)
    there = densecloud_program("inspect", dense, "--source", paths[0], "--ratio", 2, "--sample", 100, "--json")
    assert told == json.loads(there) and told["strays"] is not None and len(told["provenance"]) == 1
    densecloud_program("sample", "shape:knot", tmp_path / "reference.ply", "--points", 2000)
    densecloud_program("sample", "shape:knot", tmp_path / "sparse.ply", "--points", 500, "--seed", 2)
    there = densecloud_program(
        "evaluate", "--pred", tmp_path / "sparse.ply", "--reference", tmp_path / "reference.ply", "--json", "-"
    )
    scores = densecloud.evaluate(tmp_path / "sparse.ply", densecloud.read(tmp_path / "reference.ply"))
    row = json.loads(there)["rows"][0]
    assert scores == {block: row[block] for block in ("published", "corrected")}


def test_what_was_cut_is_no_longer_the_file(tmp_path):
    path = clouds(tmp_path)[0]
    cloud = densecloud.read(path)
    assert "input_sha256" in densecloud.upsample(cloud).provenance
    assert "input_sha256" not in densecloud.upsample(cloud[:300]).provenance
    dense = densecloud.upsample(cloud)
    dense.points[0] += 0.01
    assert "input_sha256" not in densecloud.upsample(dense).provenance, "no file has a result"
    with pytest.raises(ValueError, match="read-only"):
        cloud.points[0] = 0


def test_reading_options_are_in_the_provenance(tmp_path, densecloud_program):
    path = tmp_path / "rows.txt"
    path.write_text("".join(f"{i};{x:.3f};{y:.3f};{z:.3f}\n" for i, (x, y, z) in enumerate(sphere(400) - 1e5)))
    options = {"axes": (2, 3, 4), "separator": "semicolon", "bounds": (365_113, 5_104_977, 365_130, 5_104_998)}
    densecloud_program("upsample", path, tmp_path / "there.ply", *flags(options))
    here = densecloud.upsample(path, **options)
    there = densecloud.read(tmp_path / "there.ply")
    assert here.provenance == there.comments[-1] and "bounds=365113" in here.provenance
    assert np.array_equal(here.points, there.points)


def test_files_that_cannot_be_are_told_apart(tmp_path):
    with pytest.raises(FileNotFoundError) as caught:
        densecloud.read(tmp_path / "none.ply")
    assert caught.value.filename == str(tmp_path / "none.ply")
    broken = tmp_path / "broken.xyz"
    broken.write_text("0 0 0\n1 0 x\n")
    with pytest.raises(densecloud.InvalidInputError, match=r"broken\.xyz: line 2"):
        densecloud.read(broken)
    for path in [tmp_path / "no" / "a.ply", tmp_path]:
        with pytest.raises((OSError, ValueError)):
            densecloud.write(path, [[0, 0, 0], [1, 1, 1]])
    with pytest.raises(densecloud.InvalidInputError, match="nothing is written as `.stl`"):
        densecloud.write(tmp_path / "a.stl", [[0, 0, 0]])
    assert list(tmp_path.glob("*.part")) == []
    with broken.open("rb") as file, pytest.raises(densecloud.InvalidInputError, match="^line 2"):
        densecloud.read(file)


def scan(path):
    """A scan that is worked on in tiles."""
    points = np.random.default_rng(1).random((6000, 3)) * [40, 20, 0.01]
    densecloud.write(path, densecloud.Cloud(points, attributes={"intensity": np.arange(6000, dtype="u2")}))


@pytest.mark.parametrize(
    "names", [("a.ply", "b.ply"), ("a.las", "b.laz"), ("a.xyz", "b.csv"), ("a.ply", "b.npy")], ids=str
)
@pytest.mark.parametrize("tile_points", [None, 1500])
def test_files_of_any_size_become_the_same(tmp_path, densecloud_program, names, tile_points):
    source, there = tmp_path / names[0], tmp_path / f"there-{names[1]}"
    scan(source)
    options = {"ratio": 2} if tile_points is None else {"ratio": 2, "tile_points": tile_points}
    densecloud_program("upsample", source, there, "--quiet", *flags(options))
    heard = []
    here = tmp_path / names[1]
    told = densecloud.upsample_file(source, here, **options, progress=lambda *now: heard.append(now))
    assert here.read_bytes() == there.read_bytes()
    assert (told.points_in, told.points_out, heard[-1]) == (6000, 12_000, (1.0, "done"))
    assert heard == sorted(heard, key=lambda now: now[0])
    beside = [path.with_name(path.name + ".provenance.txt") for path in (here, there)]
    assert beside[0].exists() == beside[1].exists() == here.name.endswith((".csv", ".npy"))


def test_a_stopped_work_in_tiles_goes_on(tmp_path):
    scan(tmp_path / "a.ply")
    options = {"ratio": 2, "tile_points": 1500, "temp_dir": tmp_path, "resume": True}

    def stop(fraction, stage):
        if fraction > 0.3:
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        densecloud.upsample_file(tmp_path / "a.ply", tmp_path / "b.ply", **options, progress=stop)
    assert not (tmp_path / "b.ply").exists()
    with pytest.raises(densecloud.DensecloudError, match="begun with another"):
        densecloud.upsample_file(tmp_path / "a.ply", tmp_path / "b.ply", **options, seed=9)
    densecloud.upsample_file(tmp_path / "a.ply", tmp_path / "b.ply", **options)
    densecloud.upsample_file(tmp_path / "a.ply", tmp_path / "whole.ply", ratio=2, tile_points=1500)
    assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.ply", "b.ply", "whole.ply"]


def test_steps_of_tiles_make_the_same(tmp_path):
    scan(tmp_path / "a.ply")
    options = {"ratio": 2, "tile_points": 1500}
    densecloud.upsample_file(tmp_path / "a.ply", tmp_path / "whole.laz", **options)
    tiling = densecloud.tiles.plan(tmp_path / "a.ply", tmp_path / "work", output="b.laz", **options)
    assert len(tiling) > 2 and sum(tiling.points(tile)[0] for tile in range(len(tiling))) == 6000
    with pytest.raises(densecloud.DensecloudError, match="tiles are not done: 0, 1"):
        tiling.join(tmp_path / "b.laz")
    upsampler = densecloud.Upsampler(threads=1)
    for tile in reversed(densecloud.tiles.load(tmp_path / "work").not_done()):
        assert tiling.run(tile, upsampler=upsampler) == tiling.points(tile)[2]
    assert tiling.not_done() == []
    with pytest.raises(ValueError, match="planned for LA"):
        tiling.join(tmp_path / "b.ply")
    with pytest.raises(ValueError, match="there is no tile 99"):
        tiling.run(99)
    with pytest.raises(ValueError, match="not empty"):
        densecloud.tiles.plan(tmp_path / "a.ply", tmp_path / "work", **options)
    told = tiling.join(tmp_path / "b.laz")
    assert (tmp_path / "b.laz").read_bytes() == (tmp_path / "whole.laz").read_bytes() and told.points_out == 12_000
    tiling.remove()
    assert not (tmp_path / "work").exists()
