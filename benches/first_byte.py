"""Seconds until the first points of an answer, and until its end: `python benches/first_byte.py URL IN.ply`.

Sends the file to a running server as one POST, and reads the answer as it comes. Needs nothing but Python.
"""

import http.client
import sys
import time
import urllib.parse

# More than a file's header.
FIRST = 1 << 16


def main(url: str, path: str) -> None:
    """Prints a line."""
    parts = urllib.parse.urlsplit(url)
    server = http.client.HTTPConnection(parts.netloc)
    start = time.monotonic()
    with open(path, "rb") as body:
        server.request("POST", f"{parts.path}?{parts.query}", body=body)
    answer = server.getresponse()
    if answer.status != http.client.OK:
        sys.exit(f"{answer.status}: {answer.read().decode()}")
    read = len(answer.read(FIRST))
    first = time.monotonic() - start
    while block := answer.read(1 << 20):
        read += len(block)
    whole = time.monotonic() - start
    print(f"first {FIRST} bytes after {first:.1f} s, all {read} after {whole:.1f} s")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
