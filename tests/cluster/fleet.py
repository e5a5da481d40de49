"""Servers and workers of densecloud, as processes of this machine."""

import contextlib
import http.client
import json
import os
import pathlib
import signal
import subprocess
import urllib.error
import urllib.request

from services import BUCKET, free_port, wait_for


class Program:
    """One server or worker."""

    def __init__(self, fleet: "Fleet", role: str, name: str) -> None:
        self.fleet, self.role, self.name, self.port = fleet, role, name, free_port()
        self.process = None
        self.start()

    def start(self) -> None:
        """Starts it; it is ready some time later."""
        words = [
            self.fleet.program,
            self.role,
            "--port",
            str(self.port),
            *self.fleet.options,
        ]
        if self.role == "serve":
            words += ["--jobs-running", "0"]
        with (self.fleet.folder / f"{self.name}.log").open("ab") as log:
            self.process = subprocess.Popen(
                words, env=self.fleet.environment, stdout=log, stderr=log
            )

    def signal(self, number: signal.Signals) -> None:
        """Sends it a signal, if it runs."""
        with contextlib.suppress(ProcessLookupError):
            self.process.send_signal(number)

    def kill(self) -> None:
        """Ends it at once."""
        self.signal(signal.SIGKILL)
        self.process.wait()

    def is_ready(self) -> bool:
        """Whether it says so."""
        return ask(self.port, "/readyz")[0] == 200


class Fleet:
    """All of them, over one database and one store."""

    def __init__(
        self,
        program: str,
        folder: pathlib.Path,
        database: str,
        s3_port: int,
        lease: float,
    ) -> None:
        self.program, self.folder = program, folder
        self.options = [
            "--threads=1",
            f"--job-lease={lease}",
            "--job-attempts=1000",
            "--drain-timeout=5",
            "--max-jobs=10000",
            "--client-jobs=10000",
            "--keep-alive-timeout=5",
        ]
        self.environment = {
            **os.environ,
            "DENSECLOUD_DATABASE": database,
            "DENSECLOUD_STORE": f"s3://{BUCKET}/jobs",
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{s3_port}",
            "AWS_ALLOW_HTTP": "true",
            "AWS_ACCESS_KEY_ID": "test",
            "AWS_SECRET_ACCESS_KEY": "test",
            "AWS_REGION": "us-east-1",
        }
        self.servers, self.workers = [], []

    def start(self, servers: int, workers: int) -> None:
        """Starts so many, and waits until they are ready."""
        self.servers += [Program(self, "serve", f"server-{i}") for i in range(servers)]
        self.workers += [Program(self, "worker", f"worker-{i}") for i in range(workers)]
        self.wait_until_ready()

    def wait_until_ready(self) -> None:
        """Until all are; where one never is, its log is shown."""
        try:
            wait_for("the fleet", lambda: all(one.is_ready() for one in self.all))
        except SystemExit:
            for one in self.all:
                if not one.is_ready():
                    print((self.folder / f"{one.name}.log").read_text()[-2000:])
            raise

    def supervise(self) -> None:
        """Starts again what has ended, as whatever runs it does."""
        for one in self.all:
            if one.process.poll() is not None:
                one.start()

    @property
    def all(self) -> list[Program]:
        """Servers and workers."""
        return self.servers + self.workers

    def stop(self) -> None:
        """Ends all."""
        for one in self.all:
            one.signal(signal.SIGCONT)
            one.kill()


def ask(
    port: int,
    path: str,
    body: bytes | None = None,
    headers: dict | None = None,
    method: str | None = None,
):
    """Status and body of an answer; 0 where there is none."""
    request = urllib.request.Request(
        f"http://127.0.0.1:{port}{path}", body, headers or {}, method=method
    )
    try:
        with urllib.request.urlopen(request, timeout=20) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read()
    except (OSError, http.client.HTTPException) as error:
        return 0, str(error).encode()


def job_of(body: bytes) -> dict:
    """A job as JSON tells it."""
    return json.loads(body)
