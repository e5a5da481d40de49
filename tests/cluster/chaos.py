"""Jobs on a fleet whose parts are killed, stopped and cut off: nothing is lost, nothing doubled, every byte is right.

    .venv/bin/python tests/cluster/chaos.py --program target/release/densecloud

It starts a Postgres and an S3 of its own, servers and workers, and sends jobs to the servers while faults happen at random.
In the end it compares each result with what one machine makes, and reads the tables: each job and each tile is done once.
"""

import argparse
import collections
import concurrent.futures
import hashlib
import json
import pathlib
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time

import psycopg
from fleet import Fleet, ask
from services import Postgres, Store, Wire

# Kinds of jobs: points in, and the query. One in ten is of many tiles.
SMALL = [
    (points, f"ratio=4&seed={seed}") for points in (200, 350, 500) for seed in (1, 2)
]
LARGE = [
    (4000, "ratio=2&tile_points=1000&seed=1"),
    (5000, "ratio=2&tile_points=1000&seed=2"),
]

# What happens to jobs and tiles, told by the database itself.
AUDIT = """
CREATE TABLE audit (number bigserial PRIMARY KEY, what text, id text, tile int, before text, after text);
CREATE FUNCTION note_job() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
    INSERT INTO audit (what, id, before, after) VALUES ('job', new.id, old.state, new.state); RETURN new; END $$;
CREATE FUNCTION note_tile() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
    INSERT INTO audit (what, id, tile, before, after) VALUES ('tile', new.job, new.tile, old.state, new.state);
    RETURN new; END $$;
CREATE TRIGGER audit AFTER UPDATE OF state ON densecloud.jobs FOR EACH ROW
    WHEN (old.state IS DISTINCT FROM new.state) EXECUTE FUNCTION note_job();
CREATE TRIGGER audit AFTER UPDATE OF state ON densecloud.tiles FOR EACH ROW
    WHEN (old.state IS DISTINCT FROM new.state) EXECUTE FUNCTION note_tile();
"""


def expected(program: str, folder: pathlib.Path) -> dict:
    """Each kind's cloud, and the hash of what one machine makes of it."""
    kinds = {}
    for points, query in SMALL + LARGE:
        cloud, dense = folder / f"{points}.ply", folder / "dense.ply"
        if not cloud.exists():
            subprocess.run(
                [program, "sample", "shape:knot", cloud, "--points", str(points)],
                check=True,
            )
        options = [f"--{pair.replace('_', '-')}" for pair in query.split("&")]
        subprocess.run(
            [program, "upsample", cloud, dense, "--quiet", *options], check=True
        )
        kinds[points, query] = (
            cloud.read_bytes(),
            hashlib.sha256(dense.read_bytes()).hexdigest(),
        )
    return kinds


class Run:
    """Sends jobs, and waits for their results."""

    def __init__(self, fleet: Fleet, kinds: dict, count: int, seed: int) -> None:
        self.fleet, self.kinds, self.count = fleet, kinds, count
        self.random, self.ids, self.done = random.Random(seed), {}, set()
        self.over = threading.Event()

    def kind(self, number: int) -> tuple:
        """What a job is of."""
        return (
            LARGE[number // 10 % len(LARGE)]
            if number % 10 == 0
            else SMALL[number % len(SMALL)]
        )

    def submit(self, number: int) -> None:
        """Until some server has taken it. The key makes the same of what was taken and not heard of."""
        points, query = self.kind(number)
        body, headers = (
            self.kinds[points, query][0],
            {"Idempotency-Key": f"job-{number}"},
        )
        while True:
            server = random.choice(self.fleet.servers)
            status, answer = ask(server.port, f"/jobs?{query}", body, headers)
            if status in (200, 202):
                self.ids[number] = json.loads(answer)["id"]
                return
            if status and status not in (429, 500, 503, 507):
                sys.exit(f"job {number}: {status} {answer.decode()}")
            time.sleep(0.2)

    def result(self, number: int) -> str | None:
        """The hash of a result, once it is there."""
        server = random.choice(self.fleet.servers)
        status, answer = ask(server.port, f"/jobs/{self.ids[number]}/result")
        if status == 200:
            return hashlib.sha256(answer).hexdigest()
        if status == 404:
            sys.exit(f"job {number} is lost: {answer.decode()}")
        if status == 409 and b"failed" in answer:
            _, job = ask(server.port, f"/jobs/{self.ids[number]}")
            sys.exit(f"job {number} failed: {job.decode()}")
        return None

    def follow(self) -> None:
        """Sends all, and fetches all."""
        with concurrent.futures.ThreadPoolExecutor(8) as pool:
            list(pool.map(self.submit, range(self.count)))
        while len(self.done) < self.count:
            for number in set(range(self.count)) - self.done:
                got = self.result(number)
                if got is None:
                    time.sleep(0.05)
                    continue
                if got != self.kinds[self.kind(number)][1]:
                    sys.exit(
                        f"job {number} ({self.kind(number)}) has other bytes than one machine makes"
                    )
                self.done.add(number)
        self.over.set()


class Faults:
    """What goes wrong, one thing after another."""

    def __init__(
        self,
        fleet: Fleet,
        postgres: Postgres,
        wires: list[Wire],
        lease: float,
        seed: int,
    ) -> None:
        self.fleet, self.postgres, self.wires, self.lease = (
            fleet,
            postgres,
            wires,
            lease,
        )
        self.random, self.stopped, self.happened = (
            random.Random(seed),
            {},
            collections.Counter(),
        )

    def kill(self) -> None:
        """A worker or a server is killed and started again."""
        one = self.random.choice(self.fleet.all)
        self.wake(one)
        one.kill()
        one.start()

    def stop(self) -> None:
        """One stands still for longer than its lease."""
        one = self.random.choice(self.fleet.workers)
        one.signal(signal.SIGSTOP)
        self.stopped[one.name] = (one, time.monotonic() + self.lease * 2)

    def database(self) -> None:
        """The database is killed, and comes back."""
        self.postgres.kill()
        time.sleep(self.random.uniform(0.5, 4))
        self.postgres.start()

    def store(self) -> None:
        """The store refuses connections, or lets them stand."""
        wire, mode = (
            self.random.choice(self.wires),
            self.random.choice(["refuse", "stall"]),
        )
        wire.set(mode)
        time.sleep(self.random.uniform(2, 6))
        wire.set("pass")

    def wake(self, one) -> None:
        """Lets it go on."""
        one.signal(signal.SIGCONT)
        self.stopped.pop(one.name, None)

    def run(self, counts: dict, pause: float) -> None:
        """All of them, in some order."""
        names = [name for name, count in counts.items() for _ in range(count)]
        self.random.shuffle(names)
        for name in names:
            time.sleep(self.random.uniform(0, 2 * pause))
            getattr(self, name)()
            self.happened[name] += 1
            self.fleet.supervise()
            for one, until in list(self.stopped.values()):
                if time.monotonic() > until:
                    self.wake(one)
        time.sleep(self.lease)
        for one, _ in list(self.stopped.values()):
            self.wake(one)


def check_tables(address: str, run: Run) -> str:
    """Reads what the database has, and has seen."""
    with psycopg.connect(address) as database:

        def rows(sql: str) -> list:
            return database.execute(sql).fetchall()

        jobs = dict(rows("SELECT state, count(*) FROM densecloud.jobs GROUP BY state"))
        assert jobs == {"done": run.count}, jobs
        ids = {row[0] for row in rows("SELECT id FROM densecloud.jobs")}
        assert ids == set(run.ids.values()), "a job was doubled or lost"
        ends = rows(
            "SELECT id, count(*) FROM audit WHERE what = 'job' AND after NOT IN ('queued', 'running') GROUP BY id"
        )
        assert len(ends) == run.count and all(count == 1 for _, count in ends), (
            "a job ended twice"
        )
        tiles = rows(
            "SELECT id, tile, count(*) FROM audit WHERE what = 'tile' AND after = 'done' GROUP BY id, tile"
        )
        assert all(count == 1 for *_, count in tiles), [
            row for row in tiles if row[2] != 1
        ]
        left = rows(
            "SELECT (SELECT count(*) FROM densecloud.tiles), (SELECT used - (SELECT sum(bytes) FROM densecloud.jobs) FROM densecloud.totals)"
        )
        assert left == [(0, 0)], f"rows of tiles, and bytes that nothing takes: {left}"
        attempts = rows("SELECT sum(claims), max(attempts) FROM densecloud.jobs")[0]
    return f"{len(tiles)} tiles done once each, {attempts[0]} steps claimed, {attempts[1]} attempts at one job at most"


def main() -> None:
    """Runs it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--program", default="target/release/densecloud")
    for name, count in [
        ("jobs", 300),
        ("servers", 2),
        ("workers", 4),
        ("kills", 100),
        ("stops", 20),
        ("database", 10),
        ("store", 10),
    ]:
        parser.add_argument(f"--{name}", type=int, default=count)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--pause",
        type=float,
        default=1.0,
        help="seconds between two faults, on average",
    )
    parser.add_argument("--lease", type=float, default=4.0)
    parser.add_argument("--keep", help="a folder for logs, which stay")
    args = parser.parse_args()
    program = str(pathlib.Path(args.program).resolve())
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(args.keep or temporary).resolve()
        folder.mkdir(exist_ok=True)
        kinds = expected(program, folder)
        postgres, store = Postgres(folder), Store(folder)
        wire = Wire(store.port)
        fleet = Fleet(program, folder, postgres.address, wire.port, args.lease)
        try:
            fleet.start(args.servers, args.workers)
            with psycopg.connect(postgres.address, autocommit=True) as database:
                database.execute(AUDIT)
            run = Run(fleet, kinds, args.jobs, args.seed)
            faults = Faults(fleet, postgres, [wire], args.lease, args.seed)
            begun = time.monotonic()
            following = threading.Thread(target=run.follow, daemon=True)
            following.start()
            counts = {
                "kill": args.kills,
                "stop": args.stops,
                "database": args.database,
                "store": args.store,
            }
            faults.run(counts, args.pause)
            calm = time.monotonic()
            while not run.over.wait(1):
                fleet.supervise()
                if not following.is_alive():
                    sys.exit("the run has failed")
                if time.monotonic() > calm + 600:
                    sys.exit(
                        f"{len(run.done)} of {run.count} jobs are done ten minutes after the last fault"
                    )
            fleet.wait_until_ready()
            told = check_tables(postgres.address, run)
            took = time.monotonic() - begun
            print(
                f"{run.count} jobs done in {took:.0f} s beside {dict(faults.happened)}: {told}"
            )
        finally:
            fleet.stop()
            store.stop()
            postgres.kill()


if __name__ == "__main__":
    main()
