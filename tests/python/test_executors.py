"""The tiles of a cloud on other processes: those of Python, and of a cluster of Dask, one of whose workers dies."""

import multiprocessing
import os
import signal
from concurrent.futures import ProcessPoolExecutor

import densecloud
import numpy as np
import pytest

from conftest import library

TILES = {"ratio": 2, "tile_points": 1500}


@pytest.fixture
def planned(tmp_path):
    """A work in tiles, and the bytes that one process makes of it."""
    points = np.random.default_rng(1).random((12_000, 3)) * [40, 20, 0.01]
    densecloud.write(
        tmp_path / "a.ply", densecloud.Cloud(points, attributes={"intensity": np.arange(12_000, dtype="u2")})
    )
    densecloud.upsample_file(tmp_path / "a.ply", tmp_path / "whole.laz", **TILES)
    tiling = densecloud.tiles.plan(tmp_path / "a.ply", tmp_path / "work", output="b.laz", **TILES)
    assert len(tiling) > 4
    return tiling, (tmp_path / "whole.laz").read_bytes()


def joined(tiling, tmp_path):
    tiling.join(tmp_path / "b.laz")
    return (tmp_path / "b.laz").read_bytes()


def test_processes_make_the_same(planned, tmp_path, monkeypatch):
    tiling, whole = planned
    heard = []
    monkeypatch.chdir(tmp_path)
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as executor:
        densecloud.tiles.load("work").run_all(executor, progress=lambda *now: heard.append(now))
    assert tiling.not_done() == [] and joined(tiling, tmp_path) == whole
    assert len(heard) == len(tiling) + 1 and heard[-1] == (1.0, "done") and heard[0][1] == "tiles"


def test_what_fails_in_a_process_is_raised_and_what_is_done_stays(planned, tmp_path):
    tiling, whole = planned
    tiling.run(0)

    def stop(fraction, stage):
        raise RuntimeError("enough")

    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as executor:
        with pytest.raises(ValueError, match="threads: 0"):
            tiling.run_all(executor, threads=0)
        with pytest.raises(RuntimeError, match="enough"):
            tiling.run_all(executor, progress=stop)
        assert 0 < len(tiling.not_done()) < len(tiling)
        tiling.run_all(executor)
        tiling.run_all(executor)
    assert joined(tiling, tmp_path) == whole


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_cluster_makes_the_same_where_a_worker_dies(planned, tmp_path):
    library("dask")
    from distributed import Client, LocalCluster

    tiling, whole = planned
    workers, killed = {}, []

    def kill(fraction, stage):
        """Once a tile is done and others are not."""
        if not killed:
            killed.append(next(iter(workers.values())))
            os.kill(killed[0], signal.SIGKILL)

    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=tmp_path) as cluster,
        Client(cluster) as client,
    ):
        workers.update(client.run(os.getpid))
        tiling.run_all(client.get_executor(retries=3), progress=kill)
        assert killed and tiling.not_done() == []
    assert joined(tiling, tmp_path) == whole
