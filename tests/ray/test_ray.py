"""The function for Ray on a cluster of three nodes, processes of this machine."""

import contextlib
import importlib
import os
import pathlib
import subprocess
import sys
import threading
import time

import boto3
import pytest
import ray
from ray.cluster_utils import Cluster

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "deploy" / "ray"))
densecloud_ray = importlib.import_module("densecloud_ray")

TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
PROGRAM = str(pathlib.Path(os.environ.get("DENSECLOUD", TARGET / "release" / "densecloud")).resolve())
OPTIONS = {"ratio": 4, "tile_points": int(os.environ.get("DENSECLOUD_RAY_TILE_POINTS", "2000"))}
POINTS = os.environ.get("DENSECLOUD_RAY_POINTS", "16000")


@pytest.fixture
def endpoint(tmp_path):
    """That of an S3 in memory."""
    file = tmp_path / "endpoint"
    script, log = ROOT / "scripts" / "s3_stand_in.py", subprocess.DEVNULL
    stand_in = subprocess.Popen([sys.executable, script, file, "densecloud-test"], stderr=log)
    try:
        while not file.exists():
            assert stand_in.poll() is None, "it has started"
            time.sleep(0.05)
        yield file.read_text()
    finally:
        stand_in.terminate()
        stand_in.wait()


@pytest.fixture
def store(monkeypatch, endpoint):
    """A client of the store; the environment is that of whoever has its credentials."""
    keys = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_REGION": "us-east-1"}
    for name, value in {**keys, "AWS_ENDPOINT_URL": endpoint, "AWS_ALLOW_HTTP": "true"}.items():
        monkeypatch.setenv(name, value)
    return boto3.client("s3", endpoint_url=endpoint, region_name="us-east-1")


@pytest.fixture
def cluster(store):
    """A head that runs nothing, and three nodes of one processor."""
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    memory = 100_000_000
    nodes = [cluster.add_node(num_cpus=1, object_store_memory=memory) for _ in range(3)]
    cluster.wait_for_nodes()
    ray.init(address=cluster.address, log_to_driver=False)
    yield cluster, nodes
    ray.shutdown()
    cluster.shutdown()


def run(*arguments):
    subprocess.run([PROGRAM, *map(str, arguments)], check=True, capture_output=True)


def own_seconds():
    """Seconds of a processor that Ray's daemons and workers have taken, without the steps that these start."""
    total = 0
    for stat in pathlib.Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            words = stat.with_name("cmdline").read_bytes()
            if b"ray::" in words or b"site-packages/ray/" in words:
                fields = stat.read_text().rsplit(")", 1)[1].split()
                total += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return total


def names(store, prefix):
    return [one["Key"] for one in store.list_objects_v2(Bucket="densecloud-test", Prefix=prefix).get("Contents", [])]


def parts(store, prefix):
    return sum(name.endswith(".done") for name in names(store, prefix))


def test_a_cluster_that_loses_a_node_gives_the_bytes_of_one_machine(tmp_path, store, cluster):
    cluster, nodes = cluster
    sparse, dense = tmp_path / "in.ply", tmp_path / "out.ply"
    run("sample", "shape:knot", sparse, "--points", POINTS)
    flags = densecloud_ray.flags(OPTIONS)
    used = densecloud_ray.processor_seconds()
    run("upsample", sparse, dense, "--quiet", "--threads", 1, *flags)
    alone = densecloud_ray.processor_seconds() - used
    store.upload_file(str(sparse), "densecloud-test", "ray/in.ply")
    at = "s3://densecloud-test/ray"

    def upsample(output):
        return densecloud_ray.upsample(f"{at}/in.ply", f"{at}/{output}", program=PROGRAM, **OPTIONS)

    begin, own = time.monotonic(), own_seconds()
    figures = upsample("calm.ply")
    wall, own = time.monotonic() - begin, own_seconds() - own
    # Killed when some tiles are done and others are at work, however long that takes.
    lost = threading.Event()

    def kill():
        while parts(store, "ray/lossy.ply.tiles/") < 2:
            time.sleep(0.05)
        cluster.remove_node(nodes[0], allow_graceful=False)
        lost.set()

    killer = threading.Thread(target=kill)
    killer.start()
    upsample("lossy.ply")
    killer.join()
    assert lost.is_set()
    for output in ["calm.ply", "lossy.ply"]:
        made = store.get_object(Bucket="densecloud-test", Key=f"ray/{output}")["Body"].read()
        assert made == dense.read_bytes(), output
    assert sorted(names(store, "ray/")) == ["ray/calm.ply", "ray/in.ply", "ray/lossy.ply"]
    steps = figures["plan"] + figures["run"] + figures["join"]
    print(f"\nalone {alone:.1f} s of a processor; steps {figures}: {steps:.1f} s; Ray's own {own:.1f} s")
    print(f"{wall:.1f} s by the clock")


def test_what_is_refused_is_not_tried_again(tmp_path, store, cluster):
    with pytest.raises(densecloud_ray.Refused, match="ratio"):
        densecloud_ray.upsample("s3://densecloud-test/none.ply", str(tmp_path / "o.ply"), ratio=-1, program=PROGRAM)
    with pytest.raises(densecloud_ray.DensecloudError, match="s3://densecloud-test/none.ply"):
        densecloud_ray.upsample("s3://densecloud-test/none.ply", str(tmp_path / "o.ply"), program=PROGRAM, retries=0)
