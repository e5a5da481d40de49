"""Gaussian splatting's parts: against plain sums, and on scenes of a few pixels. No program, no meshes."""

import struct
from dataclasses import replace

import numpy as np
import pytest
import torch

from densecloud_training import native
from densecloud_training.score.splats import colmap, experiment, fit, view
from densecloud_training.score.splats.composite import LEAST, MOST, Composite, pairs
from densecloud_training.score.splats.gaussians import BLUR, Seeds, from_seeds, project, render, rotations
from densecloud_training.score.splats.surface import Surface, disturbed
from densecloud_training.score.splats.view import SKY, looking, nearest, photograph

# A pyramid of four triangles.
CORNERS = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0.5, 0.5, 2]], float)[
    [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
]


def few(count: int = 12, seed: int = 0) -> dict:
    """Gaussians of all kinds before a camera, in double precision."""
    random = np.random.default_rng(seed)
    made = {
        "position": random.normal(size=(count, 3)) * 0.5,
        "scale": random.normal(size=(count, 3)) * 0.5 - 1.5,
        "rotation": random.normal(size=(count, 4)),
        "opacity": random.normal(size=count) + 1,
        "colour": random.normal(size=(count, 3)),
    }
    return {name: torch.tensor(values, dtype=torch.float64, requires_grad=True) for name, values in made.items()}


def brute_force(centre, conic, opacity, colour, order, size, behind) -> torch.Tensor:
    """Each pixel by itself, all Gaussians front to back."""
    rows = []
    for pixel in range(size * size):
        left, total = torch.ones((), dtype=centre.dtype), torch.zeros(3, dtype=centre.dtype)
        for g in order:
            dx, dy = pixel % size + 0.5 - centre[g, 0], pixel // size + 0.5 - centre[g, 1]
            power = -0.5 * (conic[g, 0] * dx * dx + conic[g, 2] * dy * dy) - conic[g, 1] * dx * dy
            alpha = (opacity[g] * power.exp()).clamp(max=MOST)
            if alpha < LEAST:
                continue
            total, left = total + colour[g] * alpha * left, left * (1 - alpha)
        rows.append(total + left * torch.tensor(behind))
    return torch.stack(rows).reshape(size, size, 3)


def arguments(gaussians: dict, size: int) -> list:
    """Of Composite, by a camera; leaves, so that each has its own gradient."""
    seen = project(gaussians, looking(0.7, 0.4, size))
    values = [seen.centre, seen.conic, torch.sigmoid(gaussians["opacity"]), gaussians["colour"].abs()]
    leaves = [tensor.detach().clone().requires_grad_(True) for tensor in values]
    return [*leaves, np.argsort(seen.depth.detach().numpy()), size, SKY]


def test_pictures_and_their_gradients_are_those_of_a_plain_sum():
    ours, plain = (arguments(few(), 14) for _ in range(2))
    wanted = torch.tensor(np.random.default_rng(1).normal(size=(14, 14, 3)))
    one, other = Composite.apply(*ours), brute_force(*plain)
    assert torch.allclose(one, other, atol=1e-12)
    (one * wanted).sum().backward()
    (other * wanted).sum().backward()
    for mine, theirs in zip(ours[:4], plain[:4]):
        assert theirs.grad.abs().max() > 1e-3
        assert torch.allclose(mine.grad, theirs.grad, atol=1e-10)


@pytest.mark.skipif(not native.usable(torch.zeros(1)), reason="no compiler: the test above is of what runs then")
def test_the_kernels_are_the_plain_sum_too():
    ours, plain = (arguments(few(), 14) for _ in range(2))
    leaves = [tensor.detach().float().requires_grad_(True) for tensor in ours[:4]]
    wanted = torch.tensor(np.random.default_rng(1).normal(size=(14, 14, 3)))
    one, other = native.Splats.apply(*leaves, *ours[4:]), brute_force(*plain)
    assert torch.allclose(one.double(), other, atol=1e-5)
    (one * wanted.float()).sum().backward()
    (other * wanted).sum().backward()
    for mine, theirs in zip(leaves, plain[:4]):
        assert torch.allclose(mine.grad.double(), theirs.grad, rtol=1e-3, atol=1e-4)


def test_an_opaque_gaussian_hides_what_is_behind_and_takes_no_gradient_where_it_is_cut_off():
    given = arguments(few(2), 9)
    with torch.no_grad():
        given[0][:] = 4.5
        given[1][:] = torch.tensor([1e-6, 0, 1e-6])
        given[2][:] = 1.0
    image = Composite.apply(*given)
    front, back = given[4]
    share = torch.stack([given[3][front], given[3][back]]) * torch.tensor([[MOST], [(1 - MOST) * MOST]])
    assert torch.allclose(image, share.sum(0) + (1 - MOST) ** 2 * torch.tensor(SKY), atol=1e-9)
    image.sum().backward()
    assert given[2].grad.abs().max() == 0


def test_pairs_are_all_pixels_that_a_gaussian_reaches_and_no_others():
    centre, conic, opacity, _, order, size, _ = arguments(few(), 20)
    centre, conic, opacity = (tensor.detach().numpy() for tensor in (centre, conic, opacity))
    found = pairs(centre, conic, opacity, order, size)
    y, x = np.divmod(np.arange(size * size), size)
    dx, dy = x + 0.5 - centre[:, :1], y + 0.5 - centre[:, 1:]
    power = 0.5 * (conic[:, :1] * dx**2 + conic[:, 2:] * dy**2) + conic[:, 1:2] * dx * dy
    wanted = opacity[:, None] * np.exp(-power) >= LEAST
    assert set(zip(found.gaussian, found.pixel)) == set(zip(*np.nonzero(wanted)))
    assert (np.diff(found.pixel) >= 0).all() and found.counts.tolist() == wanted.sum(0).tolist()


def test_nothing_to_draw_is_the_sky():
    gaussians = few(3)
    with torch.no_grad():
        gaussians["opacity"][:] = -50
    camera = looking(0, 0.3, 8)
    assert torch.allclose(render(gaussians, camera, project(gaussians, camera)), torch.tensor(SKY).expand(8, 8, 3))


def test_the_projection_of_a_small_gaussian_is_that_of_its_points():
    gaussians = few(4)
    with torch.no_grad():
        gaussians["scale"] -= 3.5
    camera = looking(1.1, 0.5, 400)
    seen = project(gaussians, camera)
    turn = rotations(gaussians["rotation"]).detach().numpy()
    random = np.random.default_rng(0)
    for g in range(4):
        balls = random.normal(size=(200_000, 3)) * gaussians["scale"][g].detach().exp().numpy()
        at, depth = camera.project(gaussians["position"][g].detach().numpy() + balls @ turn[g].T)
        xx, xy, yy = np.linalg.inv(np.cov(at.T) + BLUR * np.eye(2))[[0, 0, 1], [0, 1, 1]]
        assert seen.centre[g].tolist() == pytest.approx(at.mean(0), abs=0.05)
        assert seen.conic[g].tolist() == pytest.approx([xx, xy, yy], rel=0.03, abs=0.01)
        assert float(seen.depth[g]) == pytest.approx(depth.mean(), rel=1e-3)


def test_gradients_go_through_to_every_parameter():
    gaussians = few(5)
    names, size = list(gaussians), 7
    camera = replace(looking(0.2, 0.6, size))

    def picture(*values: torch.Tensor) -> torch.Tensor:
        made = dict(zip(names, values))
        return render(made, camera, project(made, camera))

    # Where a Gaussian ends, at LEAST, the picture has a step, which differences would see: none here is near one.
    assert torch.autograd.gradcheck(picture, [gaussians[name] for name in names], eps=1e-7, atol=1e-4, nondet_tol=1e-12)


def test_rotations_are_rotations():
    found = rotations(few()["rotation"]).detach()
    assert torch.allclose(found @ found.transpose(1, 2), torch.eye(3, dtype=found.dtype).expand_as(found))
    assert torch.allclose(torch.det(found), torch.ones(len(found), dtype=found.dtype))
    quarter = torch.tensor([[1.0, 0, 0, 1.0]])
    assert torch.allclose(rotations(quarter)[0] @ torch.tensor([1.0, 0, 0]), torch.tensor([0, 1.0, 0]), atol=1e-6)


def test_ssim_is_one_of_the_same_and_that_of_a_plain_window():
    random = np.random.default_rng(0)
    one, other = (torch.tensor(random.random((16, 16, 3))) for _ in range(2))
    assert float(fit.ssim(one, one)) == pytest.approx(1)
    weights = np.exp(-(np.arange(-5, 6) ** 2) / 4.5)
    window = np.outer(weights, weights) / weights.sum() ** 2
    a, b = (np.pad(t.numpy(), ((5, 5), (5, 5), (0, 0))) for t in (one, other))
    values = []
    for y, x, c in np.ndindex(16, 16, 3):
        p, q = a[y : y + 11, x : x + 11, c], b[y : y + 11, x : x + 11, c]
        m, n = (window * p).sum(), (window * q).sum()
        vp, vq, vpq = (window * p * p).sum() - m * m, (window * q * q).sum() - n * n, (window * p * q).sum() - m * n
        values.append((2 * m * n + 1e-4) * (2 * vpq + 9e-4) / ((m * m + n * n + 1e-4) * (vp + vq + 9e-4)))
    assert float(fit.ssim(one, other)) == pytest.approx(np.mean(values), rel=1e-6)


def test_the_nearest_triangle_is_that_of_a_ray_by_ray_search():
    surface = Surface.of(CORNERS, 0)
    camera = looking(0.5, 0.6, 24)
    face, depth = nearest(surface.corners, camera)
    y, x = np.divmod(np.arange(24 * 24), 24)
    for pixel, ray in enumerate(camera.rays(x + 0.5, y + 0.5)):
        best = (np.inf, -1)
        for f, (a, b, c) in enumerate(surface.corners):
            t, u, v = np.linalg.solve(np.stack([ray, a - b, a - c], 1), a - camera.centre)
            if t > 0 and min(u, v, 1 - u - v) >= 0:
                best = min(best, (t, f))
        assert depth[pixel] == pytest.approx(best[0]) and face[pixel] == best[1]


def scene(size: int = 20, count: int = 8):
    """A small surface and its photographs."""
    surface = Surface.of(CORNERS, 0)
    return surface, [photograph(surface, camera) for camera in view.around(count, size)]


def test_a_point_is_seen_from_its_own_side():
    surface, photographs = scene(40)
    top = surface.corners.reshape(-1, 3)[surface.corners[..., 2].argmax()][None]
    assert all(picture.sees(top + [[0, 0, 0.01]])[0] for picture in photographs)
    below = np.array([[0, 0, surface.corners[..., 2].min() - 0.3]])
    assert not any(picture.sees(below)[0] for picture in photographs)
    assert not photographs[0].sees(photographs[0].view.centre[None] * 2)[0], "behind the camera"


def test_seeds_are_on_the_surface_and_more_where_the_pattern_is_rich():
    surface, photographs = scene(40)
    random = np.random.default_rng(0)
    points, faces, seen = experiment.visible(surface, photographs, 400, random)
    a, normal = surface.corners[faces, 0], surface.normals()[faces]
    assert np.abs(np.einsum("ij,ij->i", points - a, normal)).max() < 1e-9
    assert (seen.sum(0) >= experiment.SEEN_BY).all() and seen.shape == (8, 400)
    even = surface.corners[random.choice(len(surface.corners), 4000, p=surface.areas() / surface.areas().sum())].mean(1)
    assert surface.richness(points).mean() > 1.3 * surface.richness(even).mean()
    off = np.linalg.norm(disturbed(points, random) - points, axis=1)
    assert 0.006 < np.median(off) < 0.012 < off.max()


def tiny_seeds(count: int = 60) -> "tuple[Seeds, list]":
    surface, photographs = scene()
    points, faces, _ = experiment.visible(surface, photographs, count, np.random.default_rng(0))
    return Seeds(points, surface.colours(points, faces)), photographs


@pytest.mark.parametrize("densify", [False, True])
def test_a_tiny_scene_is_learned(densify: bool, monkeypatch):
    monkeypatch.setattr(fit, "EACH", 20)
    seeds, photographs = tiny_seeds()
    checks = fit.Fit(seeds, photographs[1:], 80, densify, seed=0).run(photographs[:1])
    assert checks[-1].psnr > checks[0].psnr + 3 and checks[-1].ssim > checks[0].ssim
    assert (checks[-1].gaussians > 60) == densify and checks[-1].step == 80
    again = fit.Fit(seeds, photographs[1:], 80, densify, seed=0).run(photographs[:1])
    assert [(c.psnr, c.ssim) for c in again] == [(c.psnr, c.ssim) for c in checks]


def test_the_large_are_split_the_small_cloned_the_faint_removed():
    seeds, photographs = tiny_seeds(4)
    run = fit.Fit(seeds, photographs, 10, True, seed=0)
    run.step(0)
    with torch.no_grad():
        large = float(np.log(fit.LARGE * run.radius))
        run.gaussians["scale"][:] = torch.tensor([large + 1, large - 1, large + 1, large - 1])[:, None]
        run.gaussians["opacity"][:] = torch.tensor([0.0, 0.0, 0.0, -9.0])
    before = {name: tensor.detach().clone() for name, tensor in run.gaussians.items()}
    moment = run.adam.state[run.gaussians["scale"]]["exp_avg"].clone()
    run.pulled, run.times = torch.tensor([1.0, 1.0, 0.0, 1.0]), torch.ones(4)
    run.grow()
    # Kept: the second and the third; then the clone of the second; then the halves of the first.
    after = run.gaussians
    assert torch.equal(after["position"][:3], before["position"][[1, 2, 1]])
    assert torch.allclose(after["scale"][3:], before["scale"][[0, 0]] - np.log(fit.SMALLER))
    assert (after["position"][3:] - before["position"][0]).norm(dim=1).min() > 0
    kept = run.adam.state[after["scale"]]["exp_avg"]
    assert torch.equal(kept[:2], moment[[1, 2]]) and not kept[2:].any()
    run.step(1)


def test_seeds_begin_as_balls_as_large_as_their_neighbours_are_near():
    made = from_seeds(Seeds(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float), np.full((4, 3), 0.5)))
    assert made["scale"][0].exp().tolist() == pytest.approx([1, 1, 1])
    assert torch.sigmoid(made["opacity"]).tolist() == pytest.approx([0.1] * 4) and not made["colour"].any()


def test_a_model_is_written_as_colmap_reads_it(tmp_path):
    surface, photographs = scene()
    found = experiment.found_by_motion(surface, photographs, np.random.default_rng(0))
    file = colmap.write_model(tmp_path, photographs, found)
    seeds = colmap.read_points(file)
    assert np.array_equal(seeds.points, found.seeds.points)
    assert np.abs(seeds.colours - found.seeds.colours).max() <= 0.5 / 255 + 1e-9
    assert len(list((tmp_path / "images").iterdir())) == len(photographs)
    # A track's entry and the image's point refer to each other.
    images, points = (file.with_name("images.bin").read_bytes(), file.read_bytes())
    key, *_, length = colmap.POINT.unpack_from(points, 8)
    image, place = struct.unpack_from("<2i", points, 8 + colmap.POINT.size)
    assert key == 1 and length == found.seen[:, 0].sum() and image == np.flatnonzero(found.seen[:, 0])[0] + 1
    at = 8
    for _ in range(image - 1):
        at = images.index(b"\0", at + 64) + 1
        at += 8 + 24 * struct.unpack_from("<Q", images, at)[0]
    at = images.index(b"\0", at + 64) + 1
    assert struct.unpack_from("<2dQ", images, at + 8 + 24 * place)[2] == key
    file.write_bytes(points[:-3])
    with pytest.raises(ValueError, match="points3D.bin"):
        colmap.read_points(file)


def test_controls_have_four_times_the_points_and_colours_of_their_own():
    random = np.random.default_rng(0)
    seeds = Seeds(random.random((50, 3)), random.random((50, 3)))
    for denser in (experiment.halfway(seeds), experiment.copied(seeds, random)):
        assert len(denser.points) == len(denser.colours) == 200
        assert np.array_equal(denser.points[:50], seeds.points) and np.array_equal(denser.colours[:50], seeds.colours)
    middle = experiment.halfway(seeds)
    pair = experiment.midpoint_pairs(seeds.points)[0]
    assert middle.points[50].tolist() == pytest.approx(seeds.points[pair].mean(0).tolist())
    assert middle.colours[50].tolist() == pytest.approx(seeds.colours[pair].mean(0).tolist())


def curve(scene: str, arm: str, densify: bool, psnr: float, seconds: float) -> experiment.Run:
    return experiment.Run(scene, arm, densify, [fit.Check(0, 0, 5, 10, 0.2), fit.Check(100, seconds, 5, psnr, 0.8)])


def test_the_table_pairs_scenes_and_reads_equal_time_off_the_curve():
    runs = []
    for scene, more in (("a", 2.0), ("b", -1.0)):
        for arm, densify in experiment.ARMS:
            gain, seconds = (more, 20) if arm == "densecloud" else (0, 10)
            runs.append(curve(scene, arm, densify, 20 + gain, seconds))
    found = next(line for line in experiment.text(runs).splitlines() if line.startswith("| no | densecloud"))
    assert "| 20.50 ± 1.50 / 0.800 ± 0.000 | +0.50 ± 1.50, 1 of 2 | 15.25 ± 0.75" in found
    assert "| no | sparse | 5 | 10.0 | 11.00 | 13.00 | 20.00 ±" in experiment.text(runs)
