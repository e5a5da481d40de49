"""The description, docs/openapi.json: valid, and true of the server, by schemathesis."""

import json
import os
import pathlib
import re
import subprocess
import sys

import openapi_spec_validator

from conftest import ROOT, serving

HERE = pathlib.Path(__file__).parent


def test_it_is_openapi():
    description = json.loads((ROOT / "docs" / "openapi.json").read_text())
    assert description["openapi"].startswith("3.1.")
    openapi_spec_validator.validate(description)


def test_schemathesis_finds_nothing(tmp_path):
    limits = ["--max-points-in", 500, "--max-points-out", 5000, "--data-dir", tmp_path / "jobs"]
    with serving(*limits) as address:
        command = [pathlib.Path(sys.executable).with_name("schemathesis"), "--config-file"]
        command += [HERE / "schemathesis.toml", "run", f"http://{address}/openapi.json", "--no-color"]
        command += ["--seed", "1", "--max-examples", "25", "--generation-database", "none"]
        command += ["--continue-on-failure"]
        environment = os.environ | {"SCHEMATHESIS_HOOKS": "schemathesis_hooks", "PYTHONPATH": str(HERE)}
        done = subprocess.run(
            list(map(str, command)),
            check=False,
            capture_output=True,
            text=True,
            timeout=1200,
            cwd=tmp_path,
            env=environment,
        )
    print(done.stdout)
    assert done.returncode == 0, done.stdout[-20_000:] + done.stderr
    # It ends well where it has done nothing, too. The description itself it does not ask for again.
    paths = json.loads((ROOT / "docs" / "openapi.json").read_text())["paths"]
    operations = sum(len(item.keys() & {"get", "post", "delete"}) for item in paths.values())
    assert f"Tested: {operations - 1}\n" in done.stdout
    # From a job that it left to what can be done with that.
    assert int(re.search(r"API Links: +(\d+) covered", done.stdout)[1]) > 3
