"""Where a surface has another sheet nearby, and what is missed there."""

import struct

import numpy as np
import pytest

from densecloud_training.score import sheets, thin


def slab(thickness: float) -> np.ndarray:
    """The corners of the twelve triangles of a box of 10 by 10, so thick."""
    corner = np.array([[x, y, z] for x in (0, 10) for y in (0, 10) for z in (0, thickness)], dtype=float)
    quads = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
    return np.array([corner[[q[0], q[a], q[a + 1]]] for q in quads for a in (1, 2)])


def on_slab(thickness: float, n: int) -> np.ndarray:
    """As many points on its lower, upper and one narrow side."""
    random = np.random.default_rng(1)
    flat, side = 1 + 8 * random.random((n, 2)), random.random((n, 2))
    lower, upper = (np.c_[flat, np.full(n, height)] for height in (0, thickness))
    return np.concatenate([lower, upper, np.c_[10 * side[:, 0], np.zeros(n), thickness * side[:, 1]]])


@pytest.mark.parametrize("thickness", [0.01, 0.4, 2.0])
def test_the_other_sheet_of_a_slab_is_as_far_as_it_is_thick(thickness):
    triangles, points = sheets.Triangles.of(slab(thickness)), on_slab(thickness, 200)
    found = sheets.to_other_sheet(triangles, points, 2.5)
    assert np.allclose(found[:400], thickness)
    # The narrow side is 10 from its opposite; what is beside it stands at a right angle.
    assert np.isinf(found[400:]).all()
    assert np.isinf(sheets.to_other_sheet(triangles, points, 0.9 * thickness)).all()


def test_sheets_side_by_side_are_near_and_steep_ones_are_not():
    sheet = np.array([[[0, 0, 0], [4, 0, 0], [0, 4, 0]]], dtype=float)
    points = np.array([[0.5, 0.5, 0.0], [1.0, 0.5, 0.0]])
    for turn, near in ((0, True), (50, True), (70, False)):
        angle = np.radians(turn)
        turned = np.array([[1, 0, 0], [0, np.cos(angle), np.sin(angle)], [0, -np.sin(angle), np.cos(angle)]])
        other = (sheet - [0, 0.5, 0]) @ turned + [0, 0.5, 0.3]
        found = sheets.to_other_sheet(sheets.Triangles.of(np.concatenate([sheet, other])), points, 1.0)
        assert np.allclose(found, 0.3) if near else np.isinf(found).all(), turn


def test_points_that_lie_on_no_triangle_are_refused():
    with pytest.raises(ValueError, match="1 of 2 points"):
        sheets.normals(sheets.Triangles.of(slab(1.0)), np.array([[5.0, 5.0, 1.0], [5.0, 5.0, 1.01]]))


def test_what_is_missed_where_a_shape_is_thin_is_told_from_the_rest():
    thickness, unit = 0.5, 0.2
    reference = on_slab(thickness, 200)
    off = np.where(np.arange(600) < 400, 0.03, 0.02)
    results = {method: reference + off[:, None] * [1.0, 0.0, 0.0] for method in thin.METHODS}
    parts = [thin.measured("slab", slab(thickness), reference, results, unit)]
    assert np.allclose(parts[0].apart[:400], 2.5)
    assert thin.scores(thin.pooled(parts, "densecloud", (2, 3)))[0] == pytest.approx(0.15, rel=0.05)
    assert thin.scores(thin.pooled(parts, "densecloud", (3, np.inf)))[0] == pytest.approx(0.1, rel=0.05)
    assert thin.ratios([parts[0]])[0].startswith("+5") and thin.share(parts, (0, 3)) == "66.7"
    assert "| slab | 66.7 |" in thin.text(parts) and "- / -" in thin.text(parts)


def test_a_mesh_is_read_and_what_is_no_mesh_of_triangles_is_refused(tmp_path):
    file = tmp_path / "one.ply"
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 3\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    vertices = np.arange(9, dtype="<f4").tobytes()
    file.write_bytes(head.encode() + vertices + struct.pack("<B3i", 3, 2, 0, 1))
    assert np.array_equal(sheets.read_mesh(file)[0], [[6, 7, 8], [0, 1, 2], [3, 4, 5]])
    for head_, face in (
        (head, struct.pack("<B4i", 4, 2, 0, 1, 0)),
        (head, struct.pack("<B3i", 2, 2, 0, 1)),
        (head.replace("float z", "double z"), struct.pack("<B3i", 3, 2, 0, 1)),
        (head.replace("binary_little", "binary_big"), struct.pack("<B3i", 3, 2, 0, 1)),
    ):
        file.write_bytes(head_.encode() + vertices + face)
        with pytest.raises(ValueError, match="one.ply"):
            sheets.read_mesh(file)
