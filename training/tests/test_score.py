"""The scores' pure parts: no program, no meshes."""

import math
import struct

import numpy as np
import pytest

from densecloud_training.clouds import validation_names
from densecloud_training.score import __main__ as command
from densecloud_training.score import (
    cleaning,
    confidence,
    evidence,
    inputs,
    noisy,
    peers,
    pictures,
    plane,
    range_image,
    real,
    report,
    rules,
    scans,
    stress,
    surfaces,
    table,
    validation,
    worst,
)
from densecloud_training.score.program import Program, ProgramError


def row(shape: str, method: str, cd: float, surface: float, variation) -> dict:
    return {
        "shape": shape,
        "method": method,
        "published": {"chamfer": cd, "hausdorff": 0.002, "point_to_face": 0.003},
        "corrected": {
            "chamfer": cd / 2,
            "hausdorff": 0.03,
            "hausdorff_95": 0.02,
            "to_surface": surface,
            "from_surface": 0.01,
            "f_score": 0.5,
            "spacing_variation": variation,
        },
    }


def evaluation(prediction: tuple, midpoints: tuple = (0.0005, 0.004, 0.1)) -> report.Report:
    """Two shapes; the first has the scores given (CD, distance to the surface, spacing), the second beats all."""
    rows = []
    for shape, ours in (("cow", prediction), ("cup", (0.0003, 0.001, 0.05))):
        rows.append(row(shape, "prediction", *ours))
        rows.append(row(shape, "floor", 0.0002, 0.0, 0.04))
        rows.append(row(shape, "repeat", 0.001, 0.0, None))
        rows.append(row(shape, "midpoints", *midpoints))
    # Repeated input is far from the surface's points, as it is in truth.
    for made in rows[2::4]:
        made["corrected"]["from_surface"] = 0.02
    return report.parse({"rows": rows})


def test_a_report_is_read_and_averaged():
    found = evaluation((0.0005, 0.003, 0.25))
    means = found.means()
    assert list(means) == ["prediction", "floor", "repeat", "midpoints"]
    assert means["prediction"]["cd"] == pytest.approx(0.0004)
    assert means["prediction"]["two_sided"] == pytest.approx((0.013 + 0.011) / 4)
    assert means["repeat"]["spacing_variation"] == math.inf


@pytest.mark.parametrize("content", [{}, {"rows": []}, {"rows": [{"shape": "cow"}]}, {"rows": None}])
def test_what_is_no_report_is_refused(content):
    with pytest.raises(ValueError, match="report"):
        report.parse(content)


def test_a_report_without_surface_distances_is_refused():
    made = row("cow", "prediction", 0.1, 0.1, 0.1)
    made["published"]["point_to_face"] = None
    with pytest.raises(ValueError, match="--mesh"):
        report.parse({"rows": [made]})


def test_tables_have_as_many_cells_as_their_header():
    assert table.markdown(["a", "b"], [["1", "2"]]) == "| a | b |\n| --- | --- |\n| 1 | 2 |\n"
    with pytest.raises(ValueError, match="3 cells"):
        table.markdown(["a", "b"], [["1", "2", "3"]])
    assert table.thousandths(0.00024) == "0.240"
    assert table.plain(math.inf) == "-"


def test_every_check_finds_its_loss():
    assert validation.losses(evaluation((0.0003, 0.001, 0.05))) == []
    found = {(lost.shape, lost.check, lost.control) for lost in validation.losses(evaluation((0.0006, 0.005, 0.2)))}
    assert found == {("cow", check, "midpoints") for check in validation.CHECKS}
    # As good is not better.
    equal = validation.losses(evaluation((0.0005, 0.004, 0.1)))
    assert [lost.check for lost in equal] == list(validation.CHECKS)
    assert equal[0].ours == pytest.approx(0.0003)  # above the floor


def test_repeated_input_wins_by_distances_but_never_by_spacing():
    # On an input so dense that midpoints and network only add error.
    found = validation.losses(evaluation((0.0012, 0.0301, 9.0), midpoints=(0.002, 0.1, 10.0)))
    assert {(lost.check, lost.control) for lost in found} == {
        ("excess CD", "repeat"),
        ("excess chamfer", "repeat"),
        ("two-sided distance", "repeat"),
    }


def test_the_validation_table_tells_where_the_network_loses():
    losing, winning = evaluation((0.0006, 0.005, 0.2)), evaluation((0.0003, 0.001, 0.05))
    must = next(s for s in validation.SETTINGS if s.must)
    other = next(s for s in validation.SETTINGS if not s.must)
    text = validation.text({must: losing, other: winning}, {must: {"cow": 0.0007, "duck": 0.0}})
    assert "| 1 of 2 | 1 of 2 | 1 of 2 | 1 of 2 | 1 of 2 |" in text
    assert "| 2 of 2 | 2 of 2 | 2 of 2 | 2 of 2 | 2 of 2 |" in text
    assert "0.20 against 0.10 (midpoints)" in text
    assert "| 0.700 |" in text
    assert "Where it is not" not in validation.text({must: winning}, {})


def test_the_input_centroid_costs_nothing_where_it_is_right_and_more_the_further_it_is_off():
    rng = np.random.default_rng(0)
    square = rng.random((3000, 3)) * [1, 1, 0]
    reference, exact = square[:2000], square[2000:]
    own = validation.published_cd(exact, reference, exact.mean(0))
    # By hand: each cloud in its own unit sphere, all pairs.
    p, q = (c - c.mean(0) for c in (exact, reference))
    p, q = (c / np.linalg.norm(c, axis=1).max() for c in (p, q))
    squares = ((p[:, None] - q) ** 2).sum(2)
    assert own == pytest.approx(squares.min(1).mean() + squares.min(0).mean(), rel=1e-9)
    off = [validation.published_cd(exact, reference, exact.mean(0) + [d, 0, 0]) for d in (0.02, 0.05)]
    assert own < off[0] < off[1]


def test_removal_is_exact_nested_and_repeatable():
    points = np.arange(300.0).reshape(100, 3)
    less, more = inputs.remove(points, 0.2, 7), inputs.remove(points, 0.5, 7)
    assert (len(less), len(more)) == (80, 50)
    assert np.array_equal(less, inputs.remove(points, 0.2, 7))
    assert np.all(np.diff(less[:, 0]) > 0)
    assert {tuple(p) for p in more} < {tuple(p) for p in less}
    assert not np.array_equal(less, inputs.remove(points, 0.2, 8))
    for share in (-0.1, 1.0):
        with pytest.raises(ValueError, match="share"):
            inputs.remove(points, share, 0)


def test_outliers_are_nested_repeatable_and_about_the_cloud():
    points = np.random.default_rng(0).uniform(1.0, 2.0, (1000, 3))
    less, more = inputs.strew(points, 0.01, 7), inputs.strew(points, 0.05, 7)
    moved, further = (np.flatnonzero((cloud != points).any(1)) for cloud in (less, more))
    assert (len(moved), len(further)) == (10, 50)
    assert set(moved) < set(further) and np.array_equal(less[moved], more[moved])
    assert np.array_equal(less, inputs.strew(points, 0.01, 7))
    all_moved = inputs.strew(points, 1.0, 7)
    assert 0.85 < all_moved.min() < 1.0 and 2.0 < all_moved.max() < 2.15
    with pytest.raises(ValueError, match="share"):
        inputs.strew(points, 1.5, 0)


def test_the_ratio_gives_the_same_count_from_whatever_is_left():
    for share in stress.REMOVED:
        left = inputs.remaining(stress.POINTS, share)
        assert len(inputs.remove(np.zeros((stress.POINTS, 3)), share, 0)) == left
        assert round(float(repr(stress.POINTS_OUT / left)) * left) == stress.POINTS_OUT


def test_stress_has_a_table_a_json_without_infinities_and_a_picture(tmp_path):
    steps = [stress.Step(sweep, s, evaluation((0.0006, 0.005, 0.2))) for sweep in stress.AXES for s in (0.0, 0.1)]
    assert stress.text(steps).count("\n| 10 |") == len(stress.AXES)
    entry = stress.as_json(steps)[0]
    assert entry["means"]["repeat"]["spacing_variation"] is None
    assert entry["shapes"]["cow"]["prediction"]["cd"] == 0.0006
    stress.draw(steps, tmp_path / "stress.png")
    assert (tmp_path / "stress.png").read_bytes().startswith(b"\x89PNG")


def test_peers_have_all_columns_and_goals_are_checked():
    width = len(peers.COLUMNS)
    assert all(len(triples) == width for triples in {**peers.PEERS, **peers.GOALS}.values())
    reports = {column: evaluation((0.0003, 0.001, 0.05)) for column in peers.COLUMNS}
    text = peers.text(reports)
    assert "| **densecloud** | 0.300 / 2.00 / 3.00 |" in text
    assert "| **densecloud** | 0.1500 / 20.00 |" in text.split("Corrected")[1]
    missed = peers.missed(reports, "must")
    assert "4x, even: CD 0.300, must 0.24" in missed
    assert not any(line.startswith("4x, random: CD") for line in missed)


def test_pcd_bodies_of_all_kinds_are_read():
    header = {
        "FIELDS": ["rgb", "x", "y", "z"],
        "SIZE": ["4"] * 4,
        "TYPE": ["U", "F", "F", "F"],
        "COUNT": ["1"] * 4,
        "POINTS": ["2"],
    }
    expected = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    text = b"9 1 2 3\n9 4 5 6\n"
    assert scans.decode_pcd({**header, "DATA": ["ascii"]}, text).tolist() == expected
    packed = struct.pack("<IfffIfff", 9, 1, 2, 3, 9, 4, 5, 6)
    assert scans.decode_pcd({**header, "DATA": ["binary"]}, packed).tolist() == expected
    columns = struct.pack("<IIffffff", 9, 9, 1, 4, 2, 5, 3, 6)
    body = struct.pack("<II", 33, 32) + bytes([31]) + columns
    assert scans.decode_pcd({**header, "DATA": ["binary_compressed"]}, body).tolist() == expected


def test_lzf_copies_may_overlap_and_damage_is_found():
    # "ab" literally, then 9 bytes from 2 back (length 7 + 0 + 2).
    assert scans.decompress(bytes([1, 97, 98, 7 << 5, 0, 1]), 11) == b"abababababa"
    with pytest.raises(ValueError, match="in place of"):
        scans.decompress(bytes([1, 97, 98]), 3)
    with pytest.raises(ValueError, match="before the start"):
        scans.decompress(bytes([1, 97, 98, 1 << 5, 9]), 5)


def test_las_text_and_ply_are_read(tmp_path):
    las = bytearray(227)
    las[:4] = b"LASF"
    las[24:26] = bytes([1, 2])
    struct.pack_into("<IIBHI", las, 96, 227, 0, 0, 20, 1)
    struct.pack_into("<6d", las, 131, 0.01, 0.01, 0.1, 100.0, 200.0, 0.0)
    (tmp_path / "a.las").write_bytes(bytes(las) + struct.pack("<iii", 100, -100, 5) + bytes(8))
    assert scans.read_scan(tmp_path / "a.las") == pytest.approx(np.array([[101.0, 199.0, 0.5]]))
    (tmp_path / "a.xyz").write_text("2\n1 2 3 9\nnan 0 0 9\n")
    assert scans.read_scan(tmp_path / "a.xyz").tolist() == [[1.0, 2.0, 3.0]]
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    (tmp_path / "a.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n4 5 6\n")
    assert scans.read_scan(tmp_path / "a.ply").tolist() == [[4.0, 5.0, 6.0]]
    (tmp_path / "b.las").write_bytes(b"PK")
    with pytest.raises(ValueError, match="not a LAS"):
        scans.read_scan(tmp_path / "b.las")


def test_a_crop_is_in_shares_of_the_box():
    points = np.array([[0.0, 0, 0], [5, 5, 5], [10, 10, 10]])
    assert scans.crop(points, (0, 0, 0), (0.5, 0.5, 0.5)).tolist() == [[0, 0, 0], [5, 5, 5]]


def plane_with_noise(count: int, noise: float) -> np.ndarray:
    random = np.random.default_rng(0)
    points = random.uniform(0, 1, (count, 3)) + 1000
    points[:, 2] = random.normal(0, noise, count)
    return points


def test_neighbours_are_those_of_the_definition():
    points = np.random.default_rng(1).normal(size=(300, 3))
    distances, found = cleaning.nearest(points, 5)
    every = np.linalg.norm(points[:, None] - points, axis=2)
    np.fill_diagonal(every, np.inf)
    assert np.array_equal(found, np.argsort(every, axis=1)[:, :5])
    assert distances == pytest.approx(np.sort(every, axis=1)[:, :5], abs=1e-5)


def test_cleaning_removes_strays_and_noise_across_the_surface():
    points = plane_with_noise(1000, 0.01)
    stray = np.array([[1000.5, 1000.5, 3.0]])
    kept = cleaning.without_strays(np.concatenate([points, stray]))
    assert len(kept) > 900 and kept[:, 2].max() < 1
    smooth = cleaning.onto_planes(points)
    assert smooth[:, 2].std() < 0.4 * points[:, 2].std()
    assert cleaning.roughness(points) == pytest.approx(0.01, rel=0.15)
    assert cleaning.roughness(smooth) < 0.4 * cleaning.roughness(points)


def test_a_noisy_cloud_is_cleaned_in_each_way(tmp_path):
    """A stand-in for the program, which copies its input."""
    script = tmp_path / "program"
    script.write_text('#!/bin/sh\nset -e\n[ "$1" = clean ]\ncp "$2" "$3"\necho "$@" >> "$0.log"\n')
    script.chmod(0o755)
    cloud = tmp_path / "cloud.xyz"
    inputs.write_points(cloud, plane_with_noise(200, 0.01))
    files = noisy.cleaned(Program(str(script)), cloud, tmp_path)
    assert set(files) == {*noisy.WAYS, noisy.LIBRARY} >= set(noisy.WAYS_DRAWN)
    assert len({*files.values()}) == len(files)
    calls = (tmp_path / "program.log").read_text().splitlines()
    assert len(calls) == len(noisy.WAYS) - 1 and calls[1].endswith("--quiet --smooth")


def test_the_better_of_two_surfaces_is_told():
    def result(cloud, to, back):
        return surfaces.Result(0.01, cloud, "a", dict(to_surface=to, from_surface=back, hausdorff_95=0.5))

    table = surfaces.text([result("sparse", 0.002, 0.004), result("upsampled 8x", 0.001, 0.005)])
    assert "| 1 % | a | sparse | 2.00 | **4.00** | **500.00** |" in table
    assert "| 1 % | a | upsampled 8x | **1.00** | 5.00 | **500.00** |" in table


def test_strays_are_added_in_the_box():
    points = plane_with_noise(1000, 0.01)
    more = noisy.with_strays(points, 0.01, 0)
    assert len(more) == 1010
    assert np.array_equal(more[:1000], points)
    assert (more.min(0) >= points.min(0)).all() and (more.max(0) <= points.max(0)).all()


def test_views_are_chosen_by_name():
    assert [v.scan for v in pictures.views(["pcl_milk", "cgal_oni"])] == ["pcl_milk", "cgal_oni"]
    assert len(pictures.views([])) == 6
    with pytest.raises(SystemExit, match="no view"):
        pictures.views(["nothing"])


def test_the_program_is_told_once_and_its_failures_are_shown(tmp_path):
    """A stand-in for the program: it notes its calls, and knows one command."""
    script = tmp_path / "program"
    known = '[ "$1" = sample ] || { echo "no $1" >&2; exit 1; }'
    script.write_text(f'#!/bin/sh\n{known}\necho "$@" >> "$0.log"\necho 1 > "$3"\n')
    script.chmod(0o755)
    mesh = tmp_path / "cow.ply"
    mesh.write_text("a mesh")
    program = Program(str(script))
    for _ in range(2):
        assert program.sample(mesh, tmp_path / "out/cow.ply", 10, 3, "--noise", 0.01).read_text() == "1\n"
    calls = (tmp_path / "program.log").read_text().splitlines()
    assert len(calls) == 1 and calls[0].endswith("--points 10 --seed 3 --noise 0.01")
    with pytest.raises(ProgramError, match="no render"):
        program.run("render")


def test_the_command_line_knows_the_held_out_shapes(tmp_path):
    names = validation_names()
    common = ["--meshes", "meshes", "--out", str(tmp_path)]
    program = Program("densecloud")
    every = command.held_out(command.parser().parse_args(["validation", *common]), program)
    assert every.shapes == names
    some = command.parser().parse_args(["stress", *common, "--shapes", f"{names[3]},{names[1]}"])
    assert command.held_out(some, program).shapes == [names[1], names[3]]
    with pytest.raises(SystemExit, match="not held out: cow"):
        command.held_out(command.parser().parse_args(["stress", *common, "--shapes", "cow"]), program)


def test_rules_are_scored_and_timed_one_by_one():
    def row(factor: float) -> rules.Row:
        return rules.Row(
            {method: dict.fromkeys(report.METRICS, 0.001 * factor) for method in rules.METHODS}, 2 * factor
        )

    table = rules.text({rules.RULES[0]: row(1), rules.RULES[1]: row(1.5)}).splitlines()
    assert (
        table[2] == "| the defaults | 1.000 / 1.00 / 1.00 | 1.000 | 0.00 | 1.000 / 1.00 / 1.00 | 1.000 | 0.00 | 1.00 |"
    )
    assert table[3].startswith("| overlap 1.5 | 1.500 / 1.50 / 1.50 |") and table[3].endswith("| 1.50 |")
    program = rules.changed(Program("p", options=["--x"]), rules.RULES[1], "--seed", "1")
    assert program.options == ["--x", "--overlap", "1.5", "--seed", "1"]


def test_predictions_alone_are_averaged_over_seeds():
    first, second = evaluation((0.0002, 0.001, 0.08)), evaluation((0.0004, 0.003, 0.10))
    mixed = report.average(first, [second])
    assert mixed.rows["cow"]["prediction"]["cd"] == pytest.approx(0.0003)
    assert mixed.rows["cow"]["prediction"]["spacing_variation"] == pytest.approx(0.09)
    assert mixed.rows["cow"]["midpoints"] == first.rows["cow"]["midpoints"]
    assert mixed.rows["cup"] == first.rows["cup"]


def grid(side: int) -> np.ndarray:
    """Points of a plane, a unit apart."""
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    return np.stack([x.ravel(), y.ravel(), np.zeros(side * side)], 1).astype(float)


def test_a_scan_that_comes_back_scores_nothing_and_the_input_alone_misses():
    points = grid(40)
    truth = real.Truth.of(points)
    assert truth.spacing == 1
    kept = real.by_lines(points[:, 1], points[:, 0])(points)
    assert len(kept) == 400
    whole = real.score(truth, kept, points)
    assert whole["CDH"] == 0 and whole["miss 1"] == 0 and whole["thinned"] == 0
    alone = real.score(truth, kept, points[kept])
    # Of what was taken away two in three lie beside a kept point, the others across: (2 + sqrt 2) / 3, borders aside.
    assert abs(alone["CDH"] - (2 + math.sqrt(2)) / 3) < 0.02
    moved = real.score(truth, kept, points + [0, 0, 3])
    assert moved["false 2"] == 100 and moved["CDH"] == 6


def test_a_result_that_leaves_a_place_out_is_thinner_there():
    points = grid(40)
    kept = real.by_lines(points[:, 1], points[:, 0])(points)
    half = points[points[:, 0] < 20]
    thinned = real.score(real.Truth.of(points), kept, half)["thinned"]
    assert 40 < thinned < 60


def test_thinnings_take_a_quarter_and_go_by_range():
    points = grid(40)
    for thin in (real.at_random, real.evenly, real.by_range([0, 0, 0])):
        kept = thin(points)
        assert len(np.unique(kept)) == 400
    near = np.linalg.norm(points, axis=1) < 20
    assert near[real.by_range([0, 0, 0])(points)].mean() > 1.3 * near[real.at_random(points)].mean()
    apart = real.cKDTree(points[real.evenly(points)]).query(points[real.evenly(points)], 2)[0][:, 1]
    assert apart.min() >= math.sqrt(2)


def test_midpoints_come_with_the_points_and_once():
    points = grid(12)
    middles = real.midpoints(points)
    assert len(middles) == 4 * len(points) and (middles[: len(points)] == points).all()
    assert len(np.unique(middles, axis=0)) > 3 * len(points)


def range_scan(ranges, shift: int = 0) -> tuple:
    """Points, lines and places of a spinning sensor at (1, 2, 3), 40 lines of 90 places; every second line of the kept
    ones is shifted by so many places. `ranges` gives the range in a direction."""
    line, place = (part.ravel() for part in np.meshgrid(np.arange(40), np.arange(90), indexing="ij"))
    azimuth = np.radians(place + shift * (line // 2 % 2))
    height = np.radians(line - 60)
    rays = np.stack([np.cos(azimuth) * np.cos(height), np.sin(azimuth) * np.cos(height), np.sin(height)], 1)
    return rays * ranges(rays)[:, None] + [1, 2, 3], line, place


@pytest.mark.parametrize("shift", [0, 4])
def test_the_range_image_of_a_floor_gets_its_missing_lines_back(shift):
    points, line, place = range_scan(lambda rays: -2 / rays[:, 2], shift)
    kept = real.by_lines(line, place)(points)
    found = range_image.range_image(points[kept], line[kept], place[kept], np.array([1.0, 2.0, 3.0]))
    assert 3.6 * len(kept) < len(found) <= 4 * len(kept)
    assert (found[: len(kept)] == points[kept]).all()
    assert np.abs(found[:, 2] - 1).max() < 1e-9
    assert len(np.unique(found.round(9), axis=0)) == len(found)
    # Lines of the same shift are those that were taken away, but for the bow of a line between its places.
    if shift == 0:
        assert np.median(real.cKDTree(points).query(found)[0]) < 1e-3


def test_nothing_is_put_where_the_range_jumps():
    points, line, place = range_scan(lambda rays: np.where(rays[:, 0] > 0.3, 5.0, 6.0))
    kept = real.by_lines(line, place)(points)
    sensor = np.array([1.0, 2.0, 3.0])
    found = range_image.range_image(points[kept], line[kept], place[kept], sensor)
    ranges = np.linalg.norm(found - sensor, axis=1)
    assert (np.minimum(np.abs(ranges - 5), np.abs(ranges - 6)) < 0.01).all()
    assert len(found) > 3 * len(kept)


def test_roughness_tells_a_plane_from_a_volume():
    assert real.roughness(real.Truth.of(grid(40))) == (0, 0)
    volume = np.random.default_rng(1).random((4000, 3))
    assert real.roughness(real.Truth.of(volume))[1] > 0.9


def test_a_perfect_result_loses_to_doing_nothing_where_a_scan_is_random_and_noisy():
    clean, noisy, even = (plane.scores(*scan, points=2_500) for scan in ((False, 0.0), (False, 0.6), (True, 0.0)))
    assert clean["perfect"]["CDH"] < clean["repeated"]["CDH"] < clean["midpoints"]["CDH"]
    assert noisy["perfect"]["CDH"] > noisy["repeated"]["CDH"] and noisy["perfect"]["miss L"] < 0.2
    assert even["perfect"]["CDH"] < even["midpoints"]["CDH"] < even["repeated"]["CDH"]


def test_the_worst_scans_are_those_that_lose_most_to_doing_nothing():
    scores = dict.fromkeys(real.HEADER[3:], 1.0)
    rows = [
        real.Row(scan, "random", method, {**scores, "CDH": cdh})
        for scan, ours, theirs in (("a", 1.0, 2.0), ("b", 3.0, 2.0), ("c", 2.5, 2.4))
        for method, cdh in (("repeated", theirs), ("densecloud", ours))
    ]
    assert worst.cases(rows) == [("b", "random"), ("c", "random"), ("a", "random")]
    # Twenty points stand where the scan has none.
    off = np.random.default_rng(1).random((20, 3)) * 0.01 + [1.0, 1.0, 0.2]
    ball = worst.around(grid(60), np.concatenate([grid(30), off]))
    assert ball.contains(off).all() and ball.contains(grid(60)).any()


def test_the_table_of_real_scans_counts_where_the_program_is_ahead():
    scores = dict.fromkeys(real.HEADER[3:], 1.0)
    rows = [
        real.Row("a", "random", method, {**scores, "CDH": cdh, "thinned": 0.5})
        for method, cdh in (("repeated", 2.0), ("midpoints", 0.9), ("densecloud", 1.0), ("resampled", 0.5))
    ]
    text = real.text(rows, [["a", "1,600", "1", "0.10", "0.0"]])
    assert "| repeated | 1 of 1 | 1.00 | 2.00 |" in text and "| midpoints | 0 of 1 | 1.00 | 0.90 |" in text
    assert "Thinned at most: 0.50 %" in text and "| range image | 0 of" not in text
    rows += [
        real.Row("a", "lines", method, {**scores, "CDH": cdh})
        for method, cdh in (("range image", 1.5), ("densecloud", 2.0))
    ]
    assert "| range image | 0 of 1 | 2.00 | 1.50 |" in real.text(rows, [])


def case(kind: str, name: str, said: np.ndarray, within: np.ndarray, features: np.ndarray) -> confidence.Case:
    missed = [np.array([0.5, 1.5, 2.5])] * len(confidence.LEAST)
    return confidence.Case(kind, name, "even", 4, np.where(within, 0.5, 1.5), said, features, missed)


def believable(n: int, seed: int, power: float = 1.0):
    """Points of which is said what is true, or that raised to a power."""
    random = np.random.default_rng(seed)
    chance = random.random(n)
    return chance**power, random.random(n) < chance


def test_a_confidence_that_is_true_is_on_the_diagonal_and_one_that_is_not_is_off_it():
    said, within = believable(100_000, 1)
    share, mean, observed = confidence.calibration(said, within, np.ones(len(said))).T
    assert share == pytest.approx(np.full(10, 0.1), abs=0.005)
    assert np.abs(mean - observed).max() < 0.015
    said, within = believable(100_000, 1, power=3)
    _, mean, observed = confidence.calibration(said, within, np.ones(len(said))).T
    assert (observed - mean)[:7].min() > 0.1, "said too low"


def test_a_bin_where_nothing_is_said_has_no_number_and_one_is_in_the_last():
    table = confidence.calibration(np.array([0.0, 1.0, 1.0]), np.array([False, True, False]), np.array([1, 1, 2]))
    assert table[0].tolist() == [0.25, 0, 0]
    assert table[9].tolist() == [0.75, 1, pytest.approx(1 / 3)]
    assert np.isnan(table[1:9, 1:]).all()


def test_the_fit_finds_the_model_that_made_the_points():
    random = np.random.default_rng(2)
    features = random.normal(size=(200_000, 2)) * [1, 30] + [5, 0]
    constants = np.array([-4.0, 1.0, -0.05])
    within = random.random(len(features)) < evidence.said(constants, features)
    found = evidence.fit(features, within.astype(float), np.ones(len(features)))
    assert found == pytest.approx(constants, rel=0.05)
    assert evidence.said(found, features).mean() == pytest.approx(within.mean(), abs=1e-3)


def test_what_is_far_from_the_input_or_in_no_sheet_has_other_features():
    random = np.random.default_rng(3)
    flat = np.hstack([random.random((2000, 2)), np.zeros((2000, 1))])
    result = np.hstack([random.random((8000, 2)), np.zeros((8000, 1))])
    sites = evidence.Sites.of(flat, result)
    assert sites.root == 2
    assert sites.result_spacing(flat).mean() == pytest.approx(0.0125, rel=0.1)
    near, off = sites.features(result), sites.features(result + [0, 0, 0.1])
    assert near[:, 2].max() < 1e-6 and near[:, 5] == pytest.approx(np.log(2))
    assert (off[:, 0] > near[:, 0]).all() and (off[:, 1] > near[:, 1]).all()
    # One that comes out as it went in was an outlier, and is no part of the surface.
    outlier = np.array([[0.5, 0.5, 0.4]])
    sites = evidence.Sites.of(np.concatenate([flat, outlier]), np.concatenate([result, outlier]))
    assert len(sites.points) == 2000
    assert sites.features(outlier)[0, 0] > 0.9


def test_a_scan_testifies_for_itself_but_for_points_in_no_company():
    points = np.concatenate([grid(40), [[20.0, 20.0, 15.0]]])
    assert (~confidence.confirmed(points)).nonzero()[0].tolist() == [1600]
    truth = confidence.of_scan(points)
    assert truth.tree.query([20.0, 20.0, 15.0])[0] == 15
    # Between four points of a grid is its surface, too.
    assert truth.tree.query([20.5, 20.5, 0.0])[0] < 0.01
    assert np.median(truth.ceiling) < 1


def test_halves_share_no_shape_and_every_case_counts_alike():
    names = [(confidence.SHAPES, n) for n in "abcd"] + [(confidence.SCANS, n) for n in "efg"]
    cases = []
    for i, (kind, name) in enumerate(names):
        said, within = believable(1000 * (i + 1), i)
        features = np.log(said / (1 - said))[:, None]
        cases.append(case(kind, name, said, within, features))
    first, second = confidence.halves(cases)
    assert ([c.name for c in first], [c.name for c in second]) == (["a", "c", "e", "g"], ["b", "d", "f"])
    weight = confidence.weights(cases)
    assert weight[:1000].sum() == pytest.approx(weight[1000:3000].sum()) == pytest.approx(1 / 4)
    assert confidence.fitted(cases) == pytest.approx([0, 1], abs=0.06)
    told = confidence.text(cases)
    assert "| scans | 0.9 and more | " in told and "| f even | 4 | " in told
    left = next(line for line in told.splitlines() if line.startswith("| scans | 0.5 |"))
    kept = cases[5].said >= 0.5
    false = 100 * (~cases[5].within[kept]).mean()
    assert left == f"| scans | 0.5 | {100 * kept.mean():.2f} | {false:.2f} | 0.00 | 66.67 | 33.33 |"


def test_a_confidence_is_a_field_or_the_last_column():
    columns = np.array([[1.0, 2.0, 3.0, 0.5], [4.0, 5.0, 6.0, 0.25]])
    fields = np.zeros(2, [("x", "<f4"), ("confidence", "<f4")])
    fields["confidence"] = columns[:, 3]
    assert confidence.said_of(columns).tolist() == confidence.said_of(fields).tolist() == [0.5, 0.25]
