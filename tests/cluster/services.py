"""What a fleet of densecloud needs, started here: a Postgres, an S3 that is not ours, and a wire between that can break."""

import contextlib
import os
import pathlib
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
BUCKET = "densecloud-test"
# Seconds for a service to start.
PATIENCE = 60
# A user that is not root, whom Postgres refuses.
NOBODY = 65534


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_for(what: str, is_there) -> None:
    """Until something is so."""
    end = time.monotonic() + PATIENCE
    while not is_there():
        if time.monotonic() > end:
            sys.exit(f"{what} did not happen within {PATIENCE} s")
        time.sleep(0.05)


def listens(port: int) -> bool:
    """Whether somebody takes connections there."""
    with socket.socket() as probe:
        probe.settimeout(1)
        return probe.connect_ex(("127.0.0.1", port)) == 0


def postgres_folder() -> pathlib.Path:
    """Where the server's programs are: in the path, or where Debian puts them."""
    found = shutil.which("initdb")
    folders = [pathlib.Path(found).parent] if found else []
    folders += sorted(pathlib.Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    if not folders:
        sys.exit(
            "there is no Postgres: install it, such as by `apt-get install postgresql`"
        )
    return folders[0]


class Postgres:
    """A server of its own, which can be killed and started again."""

    def __init__(self, folder: pathlib.Path) -> None:
        self.programs, self.folder = postgres_folder(), folder / "postgres"
        self.port = free_port()
        self.folder.mkdir()
        self.ids = (
            {"user": NOBODY, "group": NOBODY, "extra_groups": []}
            if os.getuid() == 0
            else {}
        )
        if self.ids:
            os.chown(self.folder, NOBODY, NOBODY)
            for parent in (folder, *folder.parents):
                if parent.stat().st_mode & 0o001 == 0:
                    parent.chmod(parent.stat().st_mode | 0o011)
        made = [
            self.programs / "initdb",
            "-D",
            self.folder / "data",
            "-U",
            "densecloud",
            "-A",
            "trust",
            "-N",
        ]
        subprocess.run(made, check=True, stdout=subprocess.DEVNULL, cwd="/", **self.ids)
        self.process = None
        self.start()

    @property
    def address(self) -> str:
        """As the program takes it."""
        return f"postgres://densecloud@127.0.0.1:{self.port}/postgres?sslmode=disable"

    def start(self) -> None:
        """Starts it; after a kill as often as its shared memory is still held."""
        settings = {
            "listen_addresses": "127.0.0.1",
            "unix_socket_directories": "",
            "max_connections": "200",
        }
        options = [
            word
            for name, value in settings.items()
            for word in ("-c", f"{name}={value}")
        ]
        begin = [
            self.programs / "postgres",
            "-D",
            self.folder / "data",
            "-p",
            str(self.port),
            *options,
        ]

        def up() -> bool:
            if self.process is None or self.process.poll() is not None:
                with (self.folder.parent / "postgres.log").open("ab") as log:
                    self.process = subprocess.Popen(
                        begin,
                        stdout=log,
                        stderr=log,
                        cwd="/",
                        start_new_session=True,
                        **self.ids,
                    )
                time.sleep(0.3)
            return listens(self.port)

        wait_for("Postgres", up)

    def kill(self) -> None:
        """Ends it and all its processes at once."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def stop(self) -> None:
        """Ends it as an operator does."""
        self.process.send_signal(signal.SIGINT)
        self.process.wait()


class Store:
    """An S3 in memory, by moto."""

    def __init__(self, folder: pathlib.Path) -> None:
        told = folder / "s3"
        with (folder / "s3.log").open("wb") as log:
            words = [sys.executable, ROOT / "scripts/s3_stand_in.py", told, BUCKET]
            self.process = subprocess.Popen(words, stdout=log, stderr=log)
        wait_for("the store", lambda: told.exists() and told.read_text())
        self.endpoint = told.read_text().strip()
        self.port = int(self.endpoint.rsplit(":", 1)[1].rstrip("/"))

    def stop(self) -> None:
        """Ends it."""
        self.process.kill()
        self.process.wait()


class Wire:
    """Passes connections on to a port, until it is told to refuse them or to let them stand."""

    def __init__(self, port: int) -> None:
        self.to, self.mode, self.open = port, "pass", set()
        self.listener = socket.create_server(("127.0.0.1", 0), backlog=256)
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def set(self, mode: str) -> None:
        """`pass`, `refuse` or `stall`; what is open breaks off where it refuses."""
        self.mode = mode
        if mode == "refuse":
            for one in list(self.open):
                with contextlib.suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)

    def _accept(self) -> None:
        while True:
            client, _ = self.listener.accept()
            threading.Thread(target=self._pass, args=(client,), daemon=True).start()

    def _pass(self, client: socket.socket) -> None:
        if self.mode == "refuse":
            client.close()
            return
        try:
            server = socket.create_connection(("127.0.0.1", self.to))
        except OSError:
            client.close()
            return
        pair = {client, server}
        self.open |= pair
        threads = [
            threading.Thread(target=self._copy, args=two, daemon=True)
            for two in ((client, server), (server, client))
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self.open -= pair
        for one in pair:
            one.close()

    def _copy(self, source: socket.socket, sink: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while block := source.recv(1 << 16):
                while self.mode == "stall":
                    time.sleep(0.05)
                sink.sendall(block)
        with contextlib.suppress(OSError):
            sink.shutdown(socket.SHUT_WR)
