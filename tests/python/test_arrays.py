"""What is taken as a cloud, and what comes out."""

import warnings

import densecloud
import numpy as np
import pytest
from densecloud import Cloud, InvalidInputError, upsample

from conftest import sphere


def test_arrays_of_any_numbers_and_whatever_has_one():
    points = np.round(sphere(200))

    class Wrapped:
        def __array__(self, dtype=None, copy=None):
            return points

    whole = upsample(points, ratio=2, seed=3)
    assert whole.points.shape == (400, 3) and whole.points.dtype == np.float64
    for same in [
        points.tolist(),
        Wrapped(),
        np.asfortranarray(points),
        np.repeat(points, 2, axis=0)[::2],
        Cloud(points),
    ]:
        assert np.array_equal(upsample(same, 2, seed=3).points, whole.points)
    near = points - points[0]
    for kind in ["f4", "f2", "i2", "i8", ">f8", ">f4"]:
        assert np.array_equal(upsample(near.astype(kind), 2).points, upsample(near, 2).points), kind


def test_structured_arrays_and_tables_are_what_a_file_of_them_is():
    rows = np.zeros(300, dtype=[("label", "u1"), ("X", "f8"), ("Y", "f8"), ("Z", "f8"), ("Intensity", "u2")])
    for axis, name in enumerate("XYZ"):
        rows[name] = sphere(300)[:, axis]
    rows["label"], rows["Intensity"] = 7, np.arange(300)
    dense = upsample(rows, ratio=3)
    assert len(dense) == 900 and list(dense.attributes) == ["label", "Intensity"]
    assert (dense.attributes["label"] == 7).all() and dense.attributes["Intensity"].dtype == np.uint16
    table = np.column_stack([sphere(300), np.arange(300.0)])
    assert len(upsample(table, ratio=2).attributes) == 1


def test_colors_and_attributes_are_carried_over_in_their_types():
    points, n = sphere(300), 300
    for colors in [np.full((n, 3), [9, 8, 7], "u1"), np.full((n, 3), [900, 800, 7], "u2"), np.full((n, 3), 0.25)]:
        dense = upsample(points, colors=colors)
        assert dense.colors.dtype == colors.dtype and (dense.colors == colors[0]).all()
    kinds = ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"]
    given = {f"a_{kind}": np.full(n, 5, kind) for kind in kinds}
    dense = upsample(points, attributes={**given, "switch": np.ones(n, bool), "half": np.ones(n, "f2")})
    assert {name: column.dtype.str[1:] for name, column in dense.attributes.items()} == {
        **{f"a_{kind}": kind for kind in kinds},
        "switch": "u1",
        "half": "f4",
    }
    assert all((dense.attributes[name] == 5).all() for name in given)
    alpha = upsample(points, colors=np.full((n, 4), 200, "u1"))
    assert (alpha.attributes["alpha"] == 200).all() and alpha.colors.shape == (1200, 3)
    normals = (points - points.mean(axis=0)) / 10
    turned = upsample(Cloud(points, normals=normals)).normals
    assert np.allclose(np.linalg.norm(turned, axis=1), 1, atol=1e-3)


def test_the_result_tells_what_was_asked_for():
    points = sphere(300)
    plain = upsample(points)
    assert (plain.confidence, plain.source_index, plain.is_generated, plain.colors) == (None, None, None, None)
    assert plain.points_in == 300 and plain.provenance.startswith("densecloud: version=")
    full = upsample(
        points, confidence=True, source_fields=True, keep_input=True, attributes={"confidence": np.ones(300)}
    )
    assert full.confidence.dtype == np.float32 and 0 <= full.confidence.min() <= full.confidence.max() <= 1
    assert np.array_equal(full.points[:300], points) and (full.source_index[:300] == np.arange(300)).all()
    assert not full.is_generated[:300].any() and full.is_generated[300:].all()
    assert (full.attributes["confidence"] == 1).all(), "the input's own"


def test_goals_and_options():
    points = sphere(400)
    assert len(upsample(points)) == 1600
    assert len(upsample(points, 2.5)) == 1000
    assert len(upsample(points, points=777)) == 777
    assert 400 <= len(upsample(points, spacing=0.6)) <= 25_600
    rules = upsample(points, attributes={"a": np.arange(400), "b": np.ones(400)}, rules={"a": "nearest", "b": "drop"})
    assert list(rules.attributes) == ["a"] and "attributes=a:nearest,b:drop" in rules.provenance
    made = upsample(
        points, normals="estimate", sensor=points.mean(axis=0), max_displacement=np.inf, seed=np.uint64(2**63)
    )
    assert "sensor=" in made.provenance and f"seed={2**63}" in made.provenance
    assert made.normals is not None and made.normals.shape == (1600, 3)


@pytest.mark.parametrize(
    "give, says",
    [
        (lambda: upsample(np.zeros((9, 2))), "an array of N x 3, and this one is of 9 x 2"),
        (lambda: upsample(np.zeros(9)), "N x 3"),
        (lambda: upsample(np.zeros((9, 3), complex)), "complex128"),
        (lambda: upsample([["a", "b", "c"]]), "points are numbers"),
        (lambda: upsample(np.zeros((0, 3))), "no finite points"),
        (lambda: upsample(np.full((50, 3), np.nan)), "no finite points"),
        (lambda: upsample(np.ones((50, 3))), "all points are the same"),
        (lambda: upsample(sphere(5)), "5 distinct finite points; the model needs at least 17"),
        (lambda: upsample(sphere(50), ratio=0.5), 'ratio: "0.5" is not a number from 1 to 64'),
        (lambda: upsample(sphere(50), ratio=2, points=100), "give one of ratio, points, spacing and density"),
        (lambda: upsample(sphere(50), points=100_000), "is a ratio outside 1 to 64"),
        (lambda: upsample(sphere(50), quality="good"), "quality"),
        (lambda: upsample(sphere(50), bounds=(0, 0, 1, 1)), "bounds: how a file is read"),
        (lambda: upsample(sphere(50), colors=np.zeros((50, 2))), "colors are an array of N x 3"),
        (lambda: upsample(sphere(50), colors=np.zeros((49, 3))), "'red' has values of 49, and there are 50 points"),
        (lambda: upsample(sphere(50), attributes={"a": np.zeros((50, 2))}), "values of 50 x 2"),
        (lambda: upsample(sphere(50), attributes={"a": ["x"] * 50}), "numbers of up to 64 bits"),
        (lambda: upsample(sphere(50), rules={"a": "mean"}), "rules: no attribute"),
        (lambda: upsample(sphere(50), colors=np.zeros((50, 3)), attributes={"red": np.zeros(50)}), "'red' already"),
        (lambda: upsample(Cloud(sphere(50)), colors=np.zeros((50, 3))), "this cloud has its own"),
        (lambda: upsample(np.zeros((50, 3), dtype=[("a", "f4")])), ""),
        (lambda: densecloud.Upsampler(threads=0), "threads: 0"),
    ],
)
def test_what_cannot_be_is_refused_in_the_programs_words(give, says):
    with pytest.raises(ValueError) as caught:
        give()
    assert isinstance(caught.value, InvalidInputError) and says in str(caught.value)


def test_names_that_are_none_are_refused_as_python_does():
    with pytest.raises(TypeError, match="unknown option 'ration'; there are ratio, axes, bounds"):
        upsample(sphere(50), ration=4)
    with pytest.raises(TypeError, match="`rules`"):
        upsample(sphere(50), attributes="a:mean")


def test_what_a_person_should_know_is_a_warning():
    points = np.concatenate([sphere(300), sphere(300)[:20], [[np.nan, 0, 0]]])
    with pytest.warns(densecloud.DensecloudWarning, match="coincide with another") as told:
        dense = upsample(points)
    assert [str(one.message) for one in told] == dense.warnings
    assert told[0].filename == __file__, "it names the caller"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert upsample(sphere(300)).warnings == []


def test_clouds_are_cut_and_kept():
    cloud = Cloud(sphere(100), attributes={"height": sphere(100)[:, 2]})
    assert np.asarray(cloud) is cloud.points and np.asarray(cloud, np.float32).dtype == np.float32
    upper = cloud[cloud.attributes["height"] > 812]
    assert 0 < len(upper) < 100 and (upper.points[:, 2] > 812).all()
    assert len(cloud[10:20]) == 10 and len(cloud[[1, 2]]) == 2 and len(cloud[3]) == 1
    with pytest.raises(TypeError):
        cloud.attributes["new"] = np.zeros(100)


def test_too_much_for_memory_is_a_memory_error():
    # As many points as take 64 bytes each are 4 GB of a result, and 100 of it.
    points = np.zeros((4_000_000, 3), np.float32)
    points[:] = np.random.default_rng(0).random((4_000_000, 3))
    with pytest.raises(MemoryError, match="points out would take about .* GB of memory"):
        upsample(points, ratio=64, quality="best", overlap=100)
