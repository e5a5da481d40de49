"""Points of COLMAP, by pycolmap in both directions."""

import shutil

import numpy as np
import pycolmap
import pytest


def model(folder, positions):
    """A model of points alone, as text and as records; keys count from 1."""
    reconstruction = pycolmap.Reconstruction()
    for row, position in enumerate(positions):
        colour = np.array([row % 256, 10, 20], np.uint8)
        reconstruction.add_point3D(position, pycolmap.Track(), colour)
    for form, write in (("txt", reconstruction.write_text), ("bin", reconstruction.write_binary)):
        (folder / form).mkdir()
        write(folder / form)
    return reconstruction


@pytest.mark.parametrize("form", ["txt", "bin"])
@pytest.mark.parametrize("result", ["txt", "bin"])
def test_points_keep_their_keys_and_new_ones_have_their_own(tmp_path, upsample, sphere, form, result):
    source = model(tmp_path, sphere[0])
    dense = tmp_path / "dense"
    shutil.copytree(tmp_path / result, dense)
    upsample(tmp_path / form / f"points3D.{form}", dense / f"points3D.{result}", "--ratio", 3, "--keep-input")
    points = pycolmap.Reconstruction(dense).points3D
    assert len(points) == 4500
    for key, point in source.points3D.items():
        assert np.array_equal(points[key].xyz, point.xyz)
        assert np.array_equal(points[key].color, point.color)
    assert sorted(points) == list(range(1, 4501))
    for point in points.values():
        assert point.error == -1
        assert point.track.length() == 0
        assert np.array_equal(point.color[1:], [10, 20])


def test_other_clouds_become_points(tmp_path, upsample, sphere):
    np.savetxt(tmp_path / "cloud.xyz", sphere[0])
    model(tmp_path, sphere[0][:1])
    upsample(tmp_path / "cloud.xyz", tmp_path / "bin" / "points3D.bin", "--ratio", 2)
    points = pycolmap.Reconstruction(tmp_path / "bin").points3D
    assert sorted(points) == list(range(1, 3001))
    centre = np.array([465_123.25, 5_204_987.5, 812.125])
    distances = [np.linalg.norm(point.xyz - centre) for point in points.values()]
    assert np.allclose(distances, 10, atol=0.1)
