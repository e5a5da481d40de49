"""The Open Inference Protocol against Triton's own client."""

import contextlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from tritonclient import http
from tritonclient.utils import InferenceServerException, np_to_triton_dtype

from conftest import serving


@pytest.fixture(scope="module")
def server():
    with serving("--max-points-in", 5000) as address:
        yield address


@pytest.fixture
def client(server):
    with contextlib.closing(http.InferenceServerClient(server)) as client:
        yield client


def tensor(points, binary=True):
    tensor = http.InferInput("points", points.shape, np_to_triton_dtype(points.dtype))
    return tensor.set_data_from_numpy(points, binary_data=binary)


@pytest.fixture
def expected(tmp_path, upsample):
    """What the command line makes of the same points."""

    def run(points, *arguments):
        np.save(tmp_path / "source.npy", points)
        upsample(tmp_path / "source.npy", tmp_path / "result.npy", *arguments)
        return np.load(tmp_path / "result.npy")

    return run


def test_the_server_and_its_model_describe_themselves(client):
    assert client.is_server_live()
    assert client.is_server_ready()
    assert client.get_server_metadata()["name"] == "densecloud"
    assert "binary_tensor_data" in client.get_server_metadata()["extensions"]
    for version in ["", "1"]:
        assert client.is_model_ready("densecloud", version)
        metadata = client.get_model_metadata("densecloud", version)
        assert metadata["inputs"] == metadata["outputs"]
        assert metadata["inputs"] == [{"name": "points", "datatype": "FP32", "shape": [-1, 3]}]
        config = client.get_model_config("densecloud", version)
        assert config["max_batch_size"] == 0
        assert config["input"][0]["dims"] == [-1, 3]
    assert not client.is_model_ready("other")


@pytest.mark.parametrize("binary_in", [True, False])
@pytest.mark.parametrize("binary_out", [True, False])
@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_an_array_is_upsampled_as_by_the_command_line(client, sphere, expected, kind, binary_in, binary_out):
    points, normals = sphere
    source = points if kind == "f8" else normals.astype("f4")
    outputs = [http.InferRequestedOutput("points", binary_data=binary_out)]

    result = client.infer(
        "densecloud", [tensor(source, binary_in)], outputs=outputs, request_id="7", parameters={"ratio": 4, "seed": 3}
    )

    dense = result.as_numpy("points")
    assert dense.dtype == source.dtype
    assert np.array_equal(dense, expected(source, "--ratio", 4, "--seed", 3))
    assert result.get_response()["id"] == "7"
    assert result.get_response()["model_name"] == "densecloud"
    assert "model_sha256=" in result.get_response()["parameters"]["provenance"]


def test_without_outputs_and_with_a_version(client, sphere):
    _, normals = sphere
    result = client.infer("densecloud", [tensor(normals)], model_version="1", parameters={"points": "2001"})
    assert result.as_numpy("points").shape == (2001, 3)
    assert result.get_output("points")["parameters"]["binary_data_size"] == 2001 * 24


def test_without_parameters_there_are_four_times_the_points(client, sphere, expected):
    _, normals = sphere
    source = normals.astype("f4")
    dense = expected(source, "--ratio", 4)

    for one in [source, source[np.newaxis]]:
        for binary in [True, False]:
            result = client.infer("densecloud", [tensor(one, binary)])
            assert np.array_equal(result.as_numpy("points"), dense)
    hints = {"priority": 1, "sequence_id": 7, "sequence_start": True, "sequence_end": True, "timeout": 5_000_000}
    assert np.array_equal(client.infer("densecloud", [tensor(source)], **hints).as_numpy("points"), dense)


def test_the_repository_and_the_statistics_are_as_tritons(client, sphere):
    _, normals = sphere
    index = client.get_model_repository_index()
    assert index == [{"name": "densecloud", "version": "1", "state": "READY", "reason": ""}]
    for change in [client.load_model, client.unload_model]:
        with pytest.raises(InferenceServerException) as error:
            change("densecloud")
        assert error.value.status() == "409"
    before = client.get_inference_statistics("densecloud")["model_stats"][0]
    client.infer("densecloud", [tensor(normals)], parameters={"ratio": 2})
    for name, version in [("", ""), ("densecloud", ""), ("densecloud", "1")]:
        after = client.get_inference_statistics(name, version)["model_stats"][0]
        assert after["inference_count"] == before["inference_count"] + 1
        assert after["inference_stats"]["success"]["count"] == after["inference_count"]
        work = [totals["inference_stats"]["compute_infer"]["ns"] for totals in (before, after)]
        assert work[1] > work[0]


@pytest.mark.parametrize("algorithm", ["gzip", "deflate"])
def test_requests_may_be_compressed(client, sphere, algorithm):
    _, normals = sphere
    asked = [tensor(normals)]
    plain = client.infer("densecloud", asked, parameters={"ratio": 2})
    result = client.infer("densecloud", asked, parameters={"ratio": 2}, request_compression_algorithm=algorithm)
    assert np.array_equal(result.as_numpy("points"), plain.as_numpy("points"))


def test_several_at_a_time(server, sphere, expected):
    _, normals = sphere
    alone = {seed: expected(normals, "--ratio", 2, "--seed", seed) for seed in range(4)}

    def ask(seed):
        with contextlib.closing(http.InferenceServerClient(server)) as client:
            result = client.infer("densecloud", [tensor(normals)], parameters={"ratio": 2, "seed": seed})
            return np.array_equal(result.as_numpy("points"), alone[seed])

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(ask, range(4)))

    with contextlib.closing(http.InferenceServerClient(server, concurrency=4)) as client:
        asked = [
            client.async_infer("densecloud", [tensor(normals)], parameters={"ratio": 2, "seed": seed}) for seed in alone
        ]
        for seed, request in enumerate(asked):
            assert np.array_equal(request.get_result().as_numpy("points"), alone[seed])


@pytest.mark.parametrize(
    ("model", "shape", "options", "status", "text"),
    [
        ("densecloud", (100, 3), {"parameters": {"ratio": 65}}, "400", "ratio"),
        ("densecloud", (100, 3), {"parameters": {"ration": 2}}, "400", "unknown"),
        ("densecloud", (2, 50, 3), {}, "400", "2 clouds"),
        ("densecloud", (100, 4), {"parameters": {"ratio": 2}}, "400", "[N, 3]"),
        ("densecloud", (5001, 3), {"parameters": {"ratio": 2}}, "413", "--max-points-in"),
        ("densecloud", (5, 3), {"parameters": {"ratio": 2}}, "422", "5"),
        ("other", (100, 3), {"parameters": {"ratio": 2}}, "404", "densecloud"),
        (
            "densecloud",
            (100, 3),
            {"parameters": {"ratio": 2}, "outputs": [http.InferRequestedOutput("normals")]},
            "400",
            "unknown output",
        ),
    ],
)
def test_errors_are_shown_as_they_are(client, model, shape, options, status, text):
    source = np.random.default_rng(1).random(shape)
    with pytest.raises(InferenceServerException) as error:
        client.infer(model, [tensor(source)], **options)
    assert error.value.status() == status
    assert text in error.value.message()
