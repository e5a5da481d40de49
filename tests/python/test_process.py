"""The package among threads, signals and processes."""

import os
import signal
import subprocess
import sys
import threading

import densecloud
import numpy as np
import pytest

from conftest import sphere

#: Takes seconds, on any machine.
LARGE = 60_000


def python(code, **options):
    return subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd="/",
        **options,
    )


@pytest.mark.skipif(os.name != "posix", reason="a signal")
def test_an_interrupt_ends_the_work_and_leaves_all_usable():
    process = python(
        f"""
import densecloud, numpy as np
points = np.random.default_rng(0).random(({LARGE}, 3))
heard = []
def hear(fraction, stage):
    # First, since the signal may come as soon as it is told.
    heard.append(fraction)
    if len(heard) == 1:
        print("begun", flush=True)
try:
    densecloud.upsample(points, ratio=16, progress=hear)
except KeyboardInterrupt:
    assert max(heard) < 1, "it came to its end"
    print(len(densecloud.upsample(points[:100])))
"""
    )
    assert process.stdout.readline() == "begun\n", process.stderr.read()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=300)
    assert (out, err, process.returncode) == ("400\n", "", 0)


@pytest.mark.skipif(os.name != "posix", reason="a signal")
def test_an_interrupt_ends_the_program(tmp_path):
    np.save(tmp_path / "in.npy", np.random.default_rng(0).random((LARGE, 3)))
    command = [sys.executable, "-m", "densecloud", "serve", "--port", "0"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    for line in process.stderr:
        if "ready" in line:
            break
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 0


def test_other_threads_go_on():
    begun, ended = threading.Event(), threading.Event()

    def work():
        begun.set()
        densecloud.upsample(np.random.default_rng(0).random((5000, 3)))
        ended.set()

    before = sys.getswitchinterval()
    # Nobody is asked to give way: who holds the interpreter keeps it.
    sys.setswitchinterval(1000)
    try:
        worker = threading.Thread(target=work)
        worker.start()
        begun.wait()
        assert not ended.is_set()
    finally:
        sys.setswitchinterval(before)
        worker.join()
    assert ended.is_set()


def test_threads_share_an_upsampler():
    upsampler, made = densecloud.Upsampler(threads=2), {}

    def work(seed):
        made[seed] = upsampler.upsample(sphere(500), seed=seed).points

    workers = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    [worker.start() for worker in workers]
    [worker.join() for worker in workers]
    for seed, points in made.items():
        assert np.array_equal(points, densecloud.upsample(sphere(500), seed=seed).points)
    assert len(made) == 4


def test_progress_is_heard_and_what_it_raises_ends_the_work():
    heard = []
    densecloud.upsample(sphere(20_000), progress=lambda fraction, stage: heard.append((fraction, stage)))
    fractions = [fraction for fraction, _ in heard]
    assert fractions == sorted(fractions) and heard[-1] == (1.0, "done")

    def stop(fraction, stage):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        densecloud.upsample(sphere(20_000), progress=stop)


def test_a_bar_is_shown(capsys):
    densecloud.upsample(sphere(300), progress=True)
    assert capsys.readouterr().err.endswith("[==============================] 100 %  done        \n")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="a fork")
def test_a_forked_process_is_refused_and_not_left_waiting():
    process = python(
        """
import os, densecloud
grid = [[x, y, 0] for x in range(9) for y in range(9)]
def child(use):
    pid = os.fork()
    if pid == 0:
        try:
            use()
        except RuntimeError as why:
            print(why, flush=True)
        os._exit(0)
    os.waitpid(pid, 0)
child(lambda: print(len(densecloud.upsample(grid)), flush=True))
densecloud.upsample(grid)
child(lambda: densecloud.upsample(grid))
"""
    )
    out, err = process.communicate(timeout=300)
    lines = out.splitlines()
    assert lines[0] == "324" and "forked" in lines[1] and "spawn" in lines[1], (out, err)


def test_the_command_is_the_program(densecloud_program, tmp_path):
    assert densecloud_program("--version").split()[1] == densecloud.__version__
    densecloud_program("sample", "shape:knot", tmp_path / "a.ply", "--points", 300)
    densecloud_program("upsample", tmp_path / "a.ply", tmp_path / "b.ply", "--quiet")
    assert len(densecloud.read(tmp_path / "b.ply")) == 1200
    assert "none.ply" in densecloud_program("inspect", tmp_path / "none.ply", code=1)
    assert "--ratio" in densecloud_program("upsample", "a", "b", "--ratio", "65", code=64)


HIDDEN = """
import importlib.util, sys
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name == "onnxruntime" else find(name, *rest)
"""


def test_a_missing_onnxruntime_is_told_with_what_to_do(tmp_path):
    work = "import densecloud\ndensecloud.upsample([[0, 0, 0]])"
    _, err = python(HIDDEN + work).communicate(timeout=300)
    assert 'DensecloudError: ONNX Runtime is missing: pip install "onnxruntime>=1.24"' in err
    files = "import densecloud\nprint(len(densecloud.read(b'0 0 0\\n1 1 1\\n')))"
    assert python(HIDDEN + files).communicate(timeout=300)[0] == "2\n", "files go without"
    path = tmp_path / "a.xyz"
    path.write_text("".join(f"{x} {y} {z}\n" for x, y, z in sphere(50)))
    command = (
        f"import densecloud\nsys.argv = ['densecloud', 'upsample', {str(path)!r}, '-']\nsys.exit(densecloud._main())"
    )
    process = python(HIDDEN + command)
    _, err = process.communicate(timeout=300)
    assert process.returncode == 1 and 'ONNX Runtime is missing: pip install "onnxruntime>=1.24"' in err


@pytest.mark.skipif(sys.platform != "linux", reason="a library's name")
def test_an_old_onnxruntime_is_told_with_what_to_do(tmp_path):
    capi = tmp_path / "onnxruntime" / "capi"
    capi.mkdir(parents=True)
    (tmp_path / "onnxruntime" / "__init__.py").touch()
    (capi / "libonnxruntime.so.1.23.2").touch()
    work = f"import sys\nsys.path.insert(0, {str(tmp_path)!r})\nimport densecloud\ndensecloud.Upsampler()"
    _, err = python(work).communicate(timeout=300)
    assert 'ONNX Runtime 1.23.2 is too old: pip install "onnxruntime>=1.24"' in err


def test_onnxruntime_of_pythons_own_lives_beside_it():
    work = "densecloud.upsample([[x, y, 0] for x in range(9) for y in range(9)])"
    for lines in (["import onnxruntime, densecloud", work], ["import densecloud", work, "import onnxruntime"]):
        providers = "print(onnxruntime.get_available_providers()[-1])"
        process = python("\n".join([*lines, providers, work]))
        out, err = process.communicate(timeout=300)
        assert (out, process.returncode) == ("CPUExecutionProvider\n", 0), err


def test_nothing_of_the_allocator_is_in_the_module():
    module = densecloud._densecloud.__file__
    with open(module, "rb") as file:
        assert b"jemalloc" not in file.read()
