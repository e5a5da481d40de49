#!/usr/bin/env python3
"""Collects the licences of the crates that are compiled into the program: python3 scripts/licences.py FOLDER

Each crate's own files (LICENSE, COPYING, NOTICE, also of C libraries inside it) go to FOLDER/NAME-VERSION/, that of
the standard library to FOLDER/rust.html. FOLDER/crates.txt has all crates with their licences, and says which bring no
file.
"""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

TEXTS = re.compile(r"(licen[cs]e|copying|copyright|notice|unlicense)([-._].*)?$", re.IGNORECASE)
CODE = {".rs", ".c", ".h", ".py", ".sh"}


def output(*command):
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def main(folder):
    host = re.search(r"^host: (.*)$", output("rustc", "-vV"), re.MULTILINE)[1]
    command = ("cargo", "metadata", "--format-version=1", "--locked", f"--filter-platform={host}")
    metadata = json.loads(output(*command))
    packages = {package["id"]: package for package in metadata["packages"]}
    nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}

    # From the program along dependencies that are linked: neither those of build scripts nor of tests.
    linked = set()
    todo = [
        name
        for name in metadata["workspace_members"]
        if any("bin" in target["kind"] and target["name"] == "densecloud" for target in packages[name]["targets"])
    ]
    while todo:
        name = todo.pop()
        if name not in linked:
            linked.add(name)
            todo += [d["pkg"] for d in nodes[name]["deps"] if any(kind["kind"] is None for kind in d["dep_kinds"])]

    folder.mkdir(parents=True)
    lines = []
    others = (packages[name] for name in linked if packages[name]["source"])
    for package in sorted(others, key=lambda p: (p["name"], p["version"])):
        source = Path(package["manifest_path"]).parent
        title = f"{package['name']}-{package['version']}"
        found = [
            path
            for pattern in ("*", "*/*", "*/*/*")
            for path in sorted(source.glob(pattern))
            if TEXTS.match(path.name) and path.suffix not in CODE and path.is_file()
        ]
        for path in found:
            target = folder / title / path.relative_to(source)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        line = f"{title}: {package['license'] or package['license_file']}"
        if not found:
            by = ", ".join(package["authors"]) or "its authors"
            line += f" (by {by}; no file in the crate; {package['repository']})"
        lines.append(line)

    rust = Path(output("rustc", "--print=sysroot").strip()) / "share/doc/rust"
    shutil.copyfile(rust / "COPYRIGHT-library.html", folder / "rust.html")
    (folder / "crates.txt").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
