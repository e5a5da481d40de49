"""What documents and types promise."""

import doctest
import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import densecloud
import pytest
from densecloud import _densecloud, _options

from conftest import LIBRARIES, ROOT, library

PACKAGE = Path(densecloud.__file__).parent


def blocks(text):
    return re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("name", sorted(path.stem for path in PACKAGE.glob("*.py") if path.stem != "__main__"))
def test_docstrings_run(name):
    module = densecloud if name == "__init__" else importlib.import_module(f"densecloud.{name}")
    if name[1:] in LIBRARIES:
        library(name[1:])
    assert doctest.testmod(module, optionflags=doctest.NORMALIZE_WHITESPACE).failed == 0


@pytest.mark.parametrize("document", ["README.md", "docs/python.md"])
@pytest.mark.filterwarnings("ignore::densecloud.DensecloudWarning")
def test_lines_of_documents_run(document, tmp_path, monkeypatch, densecloud_program):
    monkeypatch.chdir(tmp_path)
    densecloud_program("sample", "shape:knot", "scan.ply", "--points", "2500")
    densecloud.read("scan.ply").write("scan.laz")
    lines = [
        block for block in blocks((ROOT / document).read_text()) if "densecloud" in block and "triton" not in block
    ]
    assert lines
    names = {"__name__": "__main__"}
    for block in lines:
        exec(compile(block, document, "exec"), names)


def test_the_options_are_the_programs():
    table = {name for name, _, _ in _densecloud.parameters()}
    ours = {_options.RENAMED.get(name, name) for name in densecloud.FileOptions.__optional_keys__} | {"ratio"}
    assert ours == table
    reading = {name for name, _, topic in _densecloud.parameters() if topic == "reading"}
    assert set(densecloud.Reading.__optional_keys__) == reading
    switches = {name for name, value, _ in _densecloud.parameters() if value is None}
    assert switches == {name for name, kind in densecloud.Making.__annotations__.items() if "bool" in str(kind)}


def test_all_that_is_public_says_what_it_is():
    for name in densecloud.__all__:
        assert name == "CloudLike" or inspect.getdoc(getattr(densecloud, name)), name


@pytest.mark.parametrize(
    "checker",
    [
        ["mypy", "--strict", "-p", "densecloud"],
        ["mypy", "--strict", "examples/array.py"],
        ["mypy.stubtest", "densecloud._densecloud"],
        ["pyright", "--pythonpath", sys.executable, str(PACKAGE)],
        ["pyright", "--pythonpath", sys.executable, "examples/array.py"],
    ],
    ids=lambda checker: f"{checker[0]} {Path(checker[-1]).name}",
)
def test_types_hold(checker, tmp_path):
    command = [sys.executable, "-m", *checker]
    if checker[0] == "mypy":
        command += ["--cache-dir", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_example_runs():
    done = subprocess.run([sys.executable, "examples/array.py"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.startswith("2500 -> 10000"), done.stderr
