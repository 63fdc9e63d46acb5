"""Another output: one more row of the table reaches every answer, client and table.

The packages are copied, and the copy of ``rollcast/outputs.py`` has one more row: the squared
angular velocity. Its model is a committed one with a node more in each graph.
"""

import hashlib
import json
import shutil
import subprocess
import sys

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from rollcast.client import Client
from tests.e2e.conftest import ROOT, start_service, stop_service, wait_until_ready

MODEL = ROOT / "models/fieldnet/1"
HORIZON, RATE = 5, 20.0
END_OF_TABLE = ')\n"""All outputs,'
ROW = """    OutputSpec(
        name="energies",
        shape=(),
        unit="rad^2/s^2",
        tolerance=1e-1,
        quantised_tolerance=1.0,
        rescale=lambda values, units: values * units.rate**2,
        columns={"energy_rad2_s2": ()},
        description="Squared angular velocity, rad^2/s^2; None when the model has none.",
    ),
"""
CALLS = """
import base64, io, json, sys
import httpx2
import numpy as np
from PIL import Image
from rollcast.client import Client
from rollcast.client.testing import FakeService

address, golden, horizon, rate = sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4])
frames = np.load(golden)["frames"][0]
pngs = []
for frame in frames:
    file = io.BytesIO()
    Image.fromarray(frame).save(file, "PNG")
    pngs.append(base64.b64encode(file.getvalue()).decode())
options = {"horizon": horizon, "frame_rate": rate, "model": "fieldnet"}
body = httpx2.post(f"{address}/predict", json={"frames": pngs, **options}, timeout=60).json()
tensors = httpx2.post(
    f"{address}/v2/models/fieldnet/infer",
    timeout=60,
    json={
        "inputs": [
            {"name": "frames", "datatype": "UINT8", "shape": [1, *frames.shape],
             "data": frames.ravel().tolist()},
            {"name": "horizon", "datatype": "INT64", "shape": [1], "data": [horizon]},
        ]
    },
).json()
with Client(address) as client:
    forecast = client.predict(frames, **options)
    stream = client.predict_stream(frames, **options)
    steps = [step.outputs["energies"].tolist() for step in stream]
with Client(transport=FakeService()) as client:
    fake = client.predict(frames, horizon=horizon)
json.dump({
    "body": body["objects"][0],
    "tensors": {one["name"]: one for one in tensors["outputs"]},
    "metadata": httpx2.get(f"{address}/v2/models/fieldnet").json()["outputs"],
    "client": forecast.outputs["energies"].tolist(),
    "again": json.loads(forecast.to_json())["objects"][0]["energies"],
    "steps": steps,
    "streamed": stream.forecast.outputs["energies"].tolist(),
    "column": forecast.to_dataframe()["energy_rad2_s2"].tolist(),
    "fake": fake.outputs["energies"].tolist(),
    "fake_column": fake.to_dataframe()["energy_rad2_s2"].tolist(),
}, sys.stdout)
"""


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """The packages with one more row in the table, and one model that has the output."""
    folder = tmp_path_factory.mktemp("checkout")
    for package in ("rollcast", "service"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, folder / package, ignore=ignored)
    table = folder / "rollcast/outputs.py"
    text = table.read_text("utf-8")
    assert text.count(END_OF_TABLE) == 1
    table.write_text(text.replace(END_OF_TABLE, ROW + END_OF_TABLE), "utf-8")
    add_output(folder / "models/fieldnet/1")
    return folder


def add_output(folder):
    shutil.copytree(MODEL, folder)
    for name in ("encoder.onnx", "rollout.onnx"):
        model = onnx.load(folder / name)
        graph = model.graph
        (spins,) = (one for one in graph.output if one.name == "angular_velocities")
        axes = [one.dim_param or one.dim_value for one in spins.type.tensor_type.shape.dim[:-1]]
        graph.initializer.append(helper.make_tensor("last_axis", TensorProto.INT64, [1], [-1]))
        graph.node.append(helper.make_node("Mul", [spins.name, spins.name], ["squares"]))
        graph.node.append(
            helper.make_node("ReduceSum", ["squares", "last_axis"], ["energies"], keepdims=0)
        )
        graph.output.append(helper.make_tensor_value_info("energies", TensorProto.FLOAT, axes))
        onnx.checker.check_model(model)
        onnx.save(model, folder / name)
    with np.load(folder / "golden.npz") as golden:
        arrays = dict(golden)
    arrays["energies"] = np.square(arrays["angular_velocities"]).sum(axis=-1)
    np.savez_compressed(folder / "golden.npz", allow_pickle=False, **arrays)
    manifest = json.loads((folder / "manifest.json").read_text("utf-8"))
    manifest["outputs"].append({"name": "energies", "shape": [1], "unit": "rad^2/s^2"})
    manifest["golden_tolerance"]["energies"] = 1.0
    manifest["files"] = {
        name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in manifest["files"]
    }
    (folder / "manifest.json").write_text(json.dumps(manifest), "utf-8")


@pytest.fixture(scope="module")
def answers(checkout):
    """Answers of a service and results of a client that run in that checkout."""
    process, address = start_service(
        prefix=("env", "-C", str(checkout)), ROLLCAST_MODELS_DIR=str(checkout / "models")
    )
    with Client(address) as client:
        wait_until_ready(client)
    golden = checkout / "models/fieldnet/1/golden.npz"
    made = subprocess.run(
        [sys.executable, "-c", CALLS, address, str(golden), str(HORIZON), str(RATE)],
        cwd=checkout,
        capture_output=True,
        text=True,
        check=False,
    )
    stop_service(process)
    assert made.returncode == 0, made.stderr
    return json.loads(made.stdout)


@pytest.fixture(scope="module")
def expected(answers):
    """Squared angular velocities of the same answer, whose unit follows the frame rate, too."""
    return np.square(answers["body"]["angular_velocities"]).sum(axis=-1)


def test_it_arrives_in_json(answers, expected):
    assert expected.shape == (HORIZON,)
    assert expected.min() > 0
    np.testing.assert_allclose(answers["body"]["energies"], expected, rtol=1e-4)


def test_it_arrives_in_tensors(answers):
    tensors = answers["tensors"]
    assert tensors["energies"]["shape"] == [1, 1, HORIZON]
    spins = np.reshape(tensors["angular_velocities"]["data"], (HORIZON, 3))
    np.testing.assert_allclose(
        tensors["energies"]["data"], np.square(spins).sum(axis=-1), rtol=1e-4
    )
    described = {"name": "energies", "datatype": "FP32", "shape": [-1, 1, -1]}
    assert described in answers["metadata"]


def test_it_arrives_in_the_stream(answers, expected):
    np.testing.assert_allclose(answers["steps"], expected[:, None], rtol=1e-4)
    np.testing.assert_allclose(answers["streamed"], expected[None], rtol=1e-4)


def test_it_arrives_in_the_client_and_its_table(answers, expected):
    np.testing.assert_allclose(answers["client"], expected[None], rtol=1e-4)
    np.testing.assert_allclose(answers["again"], expected, rtol=1e-4)
    np.testing.assert_allclose(answers["column"], expected, rtol=1e-4)


def test_the_fake_service_has_it(answers):
    assert answers["fake"] == [[0] * HORIZON]
    assert answers["fake_column"] == [0] * HORIZON
