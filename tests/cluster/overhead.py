"""What sharing a job costs: one large job on 1, 2 and 4 workers, beside one machine that has it alone.

    .venv/bin/python tests/cluster/overhead.py --program target/release/densecloud

Tells seconds of processor of the program itself, and seconds by the clock, for the same tiles: medians of rounds that
have each kind once, so that a machine which becomes slower does so for all. Workers have a thread each.
"""

import argparse
import json
import os
import pathlib
import resource
import statistics
import subprocess
import sys
import tempfile
import time

from fleet import Fleet, ask
from services import Postgres, Store


def processor(pid: int) -> float:
    """Seconds of processor that a process has taken, of its threads that are over as well."""
    fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def alone(program: str, cloud: pathlib.Path, options: list[str]) -> tuple[float, float]:
    """Seconds of processor and by the clock of one machine with one thread."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    words = [
        program,
        "upsample",
        cloud,
        cloud.with_name("dense.ply"),
        "--quiet",
        "--threads",
        "1",
        *options,
    ]
    subprocess.run(words, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    took = sum(
        getattr(after, kind) - getattr(before, kind)
        for kind in ("ru_utime", "ru_stime")
    )
    return took, time.monotonic() - start


def shared(fleet: Fleet, cloud: pathlib.Path, query: str) -> tuple[float, float]:
    """The same of a fleet: from the job's 202 to its end."""
    port = fleet.servers[0].port
    before = sum(processor(one.process.pid) for one in fleet.all)
    status, answer = ask(port, f"/jobs?{query}", cloud.read_bytes())
    if status != 202:
        sys.exit(f"{status}: {answer.decode()}")
    start, id = time.monotonic(), json.loads(answer)["id"]
    while (state := json.loads(ask(port, f"/jobs/{id}")[1])["state"]) in (
        "queued",
        "running",
    ):
        time.sleep(0.1)
    took = time.monotonic() - start
    if state != "done":
        sys.exit(f"the job is {state}")
    return sum(processor(one.process.pid) for one in fleet.all) - before, took


def main() -> None:
    """Measures it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--program", default="target/release/densecloud")
    parser.add_argument("--points", type=int, default=400_000)
    parser.add_argument("--tile-points", type=int, default=40_000)
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    program, query = (
        str(pathlib.Path(args.program).resolve()),
        f"ratio=4&tile_points={args.tile_points}",
    )
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)
        cloud = folder / "cloud.ply"
        subprocess.run(
            [
                program,
                "sample",
                "shape:knot",
                cloud,
                "--points",
                str(args.points),
                "--method",
                "uniform",
            ],
            check=True,
        )
        options = [f"--{pair.replace('_', '-')}" for pair in query.split("&")]
        postgres, store = Postgres(folder), Store(folder)
        try:
            rounds = []
            for _ in range(args.rounds):
                rounds.append({0: alone(program, cloud, options)})
                for workers in (1, 2, 4):
                    fleet = Fleet(
                        program, folder, postgres.address, store.port, lease=30
                    )
                    try:
                        fleet.start(servers=1, workers=workers)
                        rounds[-1][workers] = shared(fleet, cloud, query)
                    finally:
                        fleet.stop()
        finally:
            store.stop()
            postgres.kill()
    tell(rounds)


def tell(rounds: list[dict[int, tuple[float, float]]]) -> None:
    """Medians, and the least and most that a round has more than one machine in the same round."""
    for workers in rounds[0]:
        took, wall = (
            statistics.median(one[workers][k] for one in rounds) for k in (0, 1)
        )
        more = sorted(one[workers][0] / one[0][0] - 1 for one in rounds)
        name = f"{workers} workers" if workers else "one machine"
        print(
            f"{name}: {took:.1f} s of processor, {wall:.1f} s; more than alone"
            f" {statistics.median(more):+.1%} ({more[0]:+.1%} to {more[-1]:+.1%})"
        )


if __name__ == "__main__":
    main()
