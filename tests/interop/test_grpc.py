"""The gRPC interface against a client that is generated from its contract, and gRPC's own for health and reflection."""

import importlib
import re
import subprocess
import sys
import threading
from urllib.request import urlopen

import grpc
import numpy as np
import pytest
from google.protobuf.descriptor_pool import DescriptorPool
from google.rpc import error_details_pb2
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha.proto_reflection_descriptor_database import ProtoReflectionDescriptorDatabase
from grpc_status import rpc_status
from grpc_tools import protoc

from conftest import ROOT, serving

NUMBERS = {"f4": 1, "f8": 2, "i1": 3, "u1": 4, "i2": 5, "u2": 6, "i4": 7, "u4": 8, "i8": 9, "u8": 10}
TYPES = {number: np.dtype(f"<{name}") for name, number in NUMBERS.items()}


@pytest.fixture(scope="session")
def stubs(tmp_path_factory):
    """The generated modules: messages, and the client."""
    folder = tmp_path_factory.mktemp("stubs")
    command = ["protoc", f"-I{ROOT / 'proto'}", f"--python_out={folder}", f"--grpc_python_out={folder}"]
    assert protoc.main([*command, "densecloud/v1/densecloud.proto"]) == 0
    sys.path.insert(0, str(folder))
    try:
        yield tuple(importlib.import_module(f"densecloud.v1.densecloud_{end}") for end in ["pb2", "pb2_grpc"])
    finally:
        sys.path.remove(str(folder))


@pytest.fixture(scope="module")
def address():
    with serving("--max-points-in", 50000) as address:
        yield address


@pytest.fixture
def channel(address):
    with grpc.insecure_channel(address) as channel:
        yield channel


@pytest.fixture
def call(channel, stubs):
    """Calls `Upsample` with these messages."""
    _, services = stubs

    def call(messages, **options):
        return services.UpsamplerStub(channel).Upsample(iter(messages), timeout=300, **options)

    return call


@pytest.fixture
def columns(stubs):
    """The messages that send an array, and one more for each attribute, in chunks of some points."""
    pb, _ = stubs

    def columns(points, size=1000, attributes=None, **options):
        attributes = attributes or {}
        fields = [pb.Field(name=name, type=NUMBERS[values.dtype.str[1:]]) for name, values in attributes.items()]
        layout = pb.Layout(points=len(points), position_type=NUMBERS[points.dtype.str[1:]], fields=fields)
        yield pb.UpsampleRequest(start=pb.Start(options=pb.Options(**options), layout=layout))
        for i in range(0, len(points), size):
            chunk = slice(i, i + size)
            yield pb.UpsampleRequest(
                points=pb.PointChunk(
                    positions=points[chunk].tobytes(), fields=[v[chunk].tobytes() for v in attributes.values()]
                )
            )

    return columns


def collected(answer):
    """Positions, attributes by name, the file, the header, and the progress of an answer."""
    progress, header, chunks, file = [], None, [], b""
    for message in answer:
        match message.WhichOneof("message"):
            case "progress":
                assert header is None
                progress.append(message.progress)
            case "header":
                header = message.header
            case "points":
                chunks.append(message.points)
            case "file_chunk":
                file += message.file_chunk
    layout = header.layout
    positions = b"".join(chunk.positions for chunk in chunks)
    positions = np.frombuffer(positions, TYPES[layout.position_type]).reshape(-1, 3) if chunks else None
    attributes = {
        field.name: np.frombuffer(b"".join(chunk.fields[i] for chunk in chunks), TYPES[field.type])
        for i, field in enumerate(layout.fields)
    }
    return positions, attributes, file, header, progress


@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_an_array_is_upsampled_as_by_the_command_line(call, columns, sphere, upsample, tmp_path, kind):
    points, normals = sphere
    source = points if kind == "f8" else normals.astype("f4")
    np.save(tmp_path / "source.npy", source)
    upsample(tmp_path / "source.npy", tmp_path / "result.npy", "--ratio", 16, "--seed", 3)

    positions, attributes, _, header, progress = collected(call(columns(source, ratio=16, seed=3)))

    assert positions.dtype == source.dtype
    assert np.array_equal(positions, np.load(tmp_path / "result.npy"))
    assert not attributes
    assert (header.points_in, header.points_out, header.layout.points) == (1500, 24000, 24000)
    assert "model_sha256=" in header.provenance
    assert progress
    assert all(0 <= each.fraction <= 1 for each in progress)


def test_attributes_of_every_type_keep_it(call, columns, sphere):
    _, normals = sphere
    label = np.arange(1500) // 500
    attributes = {f"label_{kind}": label.astype(kind) for kind in NUMBERS}

    positions, dense, *_ = collected(
        call(columns(normals, attributes=attributes, ratio=4, keep_input=True, source_fields=True))
    )

    assert np.array_equal(positions[:1500], normals)
    assert list(dense) == [*attributes, "source_index", "is_generated"]
    for name, values in attributes.items():
        assert dense[name].dtype == values.dtype
        assert np.array_equal(dense[name][:1500], values)
        assert np.array_equal(dense[name], values[dense["source_index"]])


def test_a_file_goes_in_pieces_and_comes_back_as_one_or_as_numbers(call, stubs, sphere, upsample, tmp_path):
    pb, _ = stubs
    points, _ = sphere
    np.save(tmp_path / "source.npy", points)
    upsample(tmp_path / "source.npy", tmp_path / "source.laz", "--ratio", 1, "--keep-input")
    upsample(tmp_path / "source.laz", tmp_path / "result.laz", "--points", 5000)
    data = (tmp_path / "source.laz").read_bytes()

    def messages(**options):
        yield pb.UpsampleRequest(start=pb.Start(options=pb.Options(points=5000, **options)))
        for i in range(0, len(data), 1000):
            yield pb.UpsampleRequest(file_chunk=data[i : i + 1000])

    _, _, file, header, _ = collected(call(messages()))
    assert header.media_type == "application/vnd.laszip"
    assert file == (tmp_path / "result.laz").read_bytes()
    positions, *_ = collected(call(messages(as_points=True)))
    assert positions.shape == (5000, 3)
    _, _, file, header, _ = collected(call(messages(media_type="text/csv")))
    assert header.media_type.startswith("text/csv")
    assert len(file.splitlines()) in (5000, 5001)


def test_messages_may_be_compressed(call, columns, sphere):
    _, normals = sphere
    plain = collected(call(columns(normals, ratio=2)))[0]
    squeezed = collected(call(columns(normals, ratio=2), compression=grpc.Compression.Gzip))[0]
    assert np.array_equal(plain, squeezed)


@pytest.mark.parametrize(
    ("points", "options", "code", "reason", "text"),
    [
        (1500, {"ratio": 65}, "INVALID_ARGUMENT", "INVALID_PARAMETER", "from 1 to 64"),
        (1500, {}, "INVALID_ARGUMENT", "INVALID_PARAMETER", "ratio"),
        (5, {"ratio": 2}, "INVALID_ARGUMENT", "IMPOSSIBLE_CLOUD", "5"),
        (50_001, {"ratio": 2}, "RESOURCE_EXHAUSTED", "TOO_MANY_POINTS_IN", "--max-points-in"),
    ],
)
def test_errors_have_their_codes_and_details(call, columns, points, options, code, reason, text):
    source = np.random.default_rng(1).random((points, 3))
    answer = call(columns(source, **options), metadata=[("x-request-id", "mine-7")])
    with pytest.raises(grpc.RpcError) as error:
        list(answer)
    assert error.value.code().name == code
    assert text in error.value.details()
    metadata = dict([*answer.initial_metadata(), *answer.trailing_metadata()])
    assert metadata["x-request-id"] == "mine-7"
    info = error_details_pb2.ErrorInfo()
    assert any(detail.Unpack(info) for detail in rpc_status.from_call(answer).details)
    assert (info.domain, info.reason) == ("densecloud", reason)


def test_a_call_that_is_cancelled_leaves_nothing_behind(call, columns, address, sphere):
    """At every stage: before anything is sent, in the middle of the upload, and while the server works."""
    _, normals = sphere
    large = np.tile(normals, (30, 1)) * np.repeat(np.linspace(1, 2, 30), 1500)[:, None]
    waiting = threading.Event()
    before = cancelled(address)

    def half(messages, count):
        for _ in range(count):
            yield next(messages)
        waiting.wait(60)

    for count in [0, 1, 20]:
        answer = call(half(columns(large, ratio=16), count))
        threading.Timer(0.2, answer.cancel).start()
        with pytest.raises(grpc.RpcError) as error:
            list(answer)
        assert error.value.code() == grpc.StatusCode.CANCELLED
    waiting.set()
    answer = call(columns(large, ratio=16))
    assert next(answer).WhichOneof("message") == "progress"
    answer.cancel()
    wanted = {"densecloud_requests_in_flight 0", "densecloud_held_bytes 0", "densecloud_queue_points 0"}
    for _ in range(600):
        if wanted <= set(metrics(address).splitlines()):
            break
        threading.Event().wait(0.1)
    else:
        pytest.fail(metrics(address))
    assert cancelled(address) - before == 4


def metrics(address):
    with urlopen(f"http://{address}/metrics") as page:
        return page.read().decode()


def cancelled(address):
    found = re.search(r'requests_total{interface="grpc",outcome="cancelled"} (\d+)', metrics(address))
    return int(found[1]) if found else 0


def test_a_deadline_ends_the_call(channel, stubs, columns, sphere):
    _, normals = sphere
    _, services = stubs
    answer = services.UpsamplerStub(channel).Upsample(columns(normals, ratio=64), timeout=0.05)
    with pytest.raises(grpc.RpcError) as error:
        list(answer)
    assert error.value.code() == grpc.StatusCode.DEADLINE_EXCEEDED


def test_health(channel):
    stub = health_pb2_grpc.HealthStub(channel)
    for service in ["", "densecloud.v1.Upsampler"]:
        answer = stub.Check(health_pb2.HealthCheckRequest(service=service))
        assert answer.status == health_pb2.HealthCheckResponse.SERVING
        watch = stub.Watch(health_pb2.HealthCheckRequest(service=service))
        assert next(watch).status == health_pb2.HealthCheckResponse.SERVING
        watch.cancel()
    with pytest.raises(grpc.RpcError) as error:
        stub.Check(health_pb2.HealthCheckRequest(service="other"))
    assert error.value.code() == grpc.StatusCode.NOT_FOUND


def test_reflection(channel):
    database = ProtoReflectionDescriptorDatabase(channel)
    assert {"densecloud.v1.Upsampler", "grpc.health.v1.Health"} <= set(database.get_services())
    service = DescriptorPool(database).FindServiceByName("densecloud.v1.Upsampler")
    method = service.methods_by_name["Upsample"]
    assert (method.client_streaming, method.server_streaming) == (True, True)
    assert "layout" in method.input_type.fields_by_name["start"].message_type.fields_by_name


def test_the_manuals_example_runs_as_printed(tmp_path, address):
    manual = (ROOT / "docs" / "grpc.md").read_text()
    script = re.search(r"```python\n(.*?)```", manual, re.DOTALL)[1]
    assert "localhost:8080" in script
    (tmp_path / "example.py").write_text(script.replace("localhost:8080", address))
    (command,) = re.findall(r"^python (-m grpc_tools.protoc .*)$", manual, re.MULTILINE)
    command = command.replace("-Iproto", f"-I{ROOT / 'proto'}")
    subprocess.run([sys.executable, *command.split()], cwd=tmp_path, check=True)
    done = subprocess.run([sys.executable, "example.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    said = done.stdout.splitlines()[-1]
    assert said in manual, "as the manual shows it"
