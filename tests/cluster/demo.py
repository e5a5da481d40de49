"""A fleet on this machine: one server, three workers, a large job and some small ones, and a worker that is killed.

make cluster-demo
"""

import argparse
import hashlib
import json
import pathlib
import subprocess
import sys
import tempfile
import time

from fleet import Fleet, ask
from services import Postgres, Store

LARGE, SMALL = (40_000, "ratio=4&tile_points=5000"), (1_000, "ratio=4")


def submit(fleet: Fleet, cloud: pathlib.Path, query: str) -> str:
    """The job's id."""
    status, answer = ask(fleet.servers[0].port, f"/jobs?{query}", cloud.read_bytes())
    if status != 202:
        sys.exit(f"{status}: {answer.decode()}")
    return json.loads(answer)["id"]


def job(fleet: Fleet, id: str) -> dict:
    """What the server tells of a job."""
    return json.loads(ask(fleet.servers[0].port, f"/jobs/{id}")[1])


def main() -> None:
    """Shows it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--program", default="target/release/densecloud")
    program = str(pathlib.Path(parser.parse_args().program).resolve())
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)
        alone = {}
        for points, query in (LARGE, SMALL):
            cloud, dense = folder / f"{points}.ply", folder / "dense.ply"
            subprocess.run(
                [program, "sample", "shape:knot", cloud, "--points", str(points)],
                check=True,
            )
            options = [f"--{pair.replace('_', '-')}" for pair in query.split("&")]
            print(f"one machine: {points} points, {' '.join(options)}")
            subprocess.run(
                [program, "upsample", cloud, dense, "--quiet", *options], check=True
            )
            alone[points] = hashlib.sha256(dense.read_bytes()).hexdigest()
        postgres, store = Postgres(folder), Store(folder)
        fleet = Fleet(program, folder, postgres.address, store.port, lease=4)
        try:
            fleet.start(servers=1, workers=3)
            print(
                f"a server on port {fleet.servers[0].port}, three workers, Postgres and an S3"
            )
            large = submit(fleet, folder / f"{LARGE[0]}.ply", LARGE[1])
            small = [
                submit(fleet, folder / f"{SMALL[0]}.ply", SMALL[1]) for _ in range(5)
            ]
            waiting, killed = {large, *small}, False
            while waiting:
                time.sleep(0.5)
                now = job(fleet, large)
                done = now["progress"]["fraction"]
                if not killed and 0.2 < done < 1:
                    fleet.workers[0].kill()
                    killed = True
                    print(
                        f"a worker is killed when {done:.0%} of the large job is done"
                    )
                for id in sorted(waiting):
                    one = job(fleet, id)
                    if one["state"] not in ("queued", "running"):
                        waiting.discard(id)
                        print(
                            f"{'the large job' if id == large else 'a small job'} is {one['state']}"
                        )
            for id in (large, *small):
                status, answer = ask(fleet.servers[0].port, f"/jobs/{id}/result")
                same = alone[LARGE[0] if id == large else SMALL[0]]
                if status != 200 or hashlib.sha256(answer).hexdigest() != same:
                    sys.exit(f"job {id} has not the bytes of one machine: {status}")
            if not killed:
                sys.exit("no worker was killed on the way: the large job was too quick")
            print("all results have the bytes of one machine")
        finally:
            fleet.stop()
            store.stop()
            postgres.kill()


if __name__ == "__main__":
    main()
