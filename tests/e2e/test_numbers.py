"""One forecast, whichever way it is asked for: the same numbers, and the same bits if alone.

The Ray deployment is compared by tests/cluster.
"""

import base64
import io
import json
from dataclasses import dataclass

import httpx2
import numpy as np
import pytest
from PIL import Image

from rollcast.client import Client
from rollcast.schemas import ModelEntry

TOGETHER_PX = 1e-2
"""Requests that share a batch may differ by so much from the same ones alone."""


@dataclass(frozen=True)
class Question:
    """A model's frames, the final one last where it reads one."""

    model: ModelEntry
    frames: np.ndarray

    @property
    def name(self) -> str:
        return f"{self.model.name}@{self.model.version}"

    @property
    def horizon(self) -> int:
        """Up to what the model was trained to."""
        step = self.model.final_step
        return int(self.model.trained_horizon or 0) if step is None else step + 1

    @property
    def options(self) -> dict[str, object]:
        final = {} if self.model.final_step is None else {"final_frame": self.frames[4]}
        return {"model": self.name, "horizon": self.horizon, **final}


@pytest.fixture(scope="module")
def questions(address) -> list[Question]:
    """One for every kind of model that is served."""
    with Client(address) as client:
        kinds = {
            (model.preset, model.objects, model.final_step is None, model.covariance_source): model
            for model in client.models()
        }
        asked = []
        for model in kinds.values():
            step = model.final_step or 0
            scene = client.simulate(
                model.scenarios[0], seed=11, num_objects=model.objects, steps=4 + step
            )
            chosen = [0, 1, 2, 3] if model.final_step is None else [0, 1, 2, 3, 3 + step]
            asked.append(Question(model, scene.frames[chosen]))
        return asked


def test_every_way_gives_the_same_bits_alone(address, questions):
    assert questions
    with Client(address) as client, httpx2.Client(base_url=address, timeout=60) as plain:
        for question in questions:
            expected = client.predict(question.frames[:4], **question.options)
            again = client.predict(question.frames[:4], **question.options)
            stream = client.predict_stream(question.frames[:4], **question.options)
            streamed = np.stack([step.positions for step in stream], axis=1)
            ways = {
                "again": again.positions,
                "stream": streamed,
                "JSON": by_json(plain, question),
                "multipart": by_multipart(plain, question),
                "V2": by_protocol(plain, question, binary=False),
                "V2 binary": by_protocol(plain, question, binary=True),
            }
            for way, positions in ways.items():
                np.testing.assert_array_equal(
                    np.float32(positions),
                    np.float32(expected.positions),
                    err_msg=f"{question.name} by {way}",
                )
            assert_covariances(expected.covariances, question.name)


def test_together_they_differ_by_no_more_than_a_hundredth_of_a_pixel(address, questions):
    with Client(address) as client:
        for question in questions:
            alone = client.predict(question.frames[:4], **question.options).positions
            options = dict(question.options)
            final = options.pop("final_frame", None)
            finals = {} if final is None else {"final_frames": [final] * 6}
            for one in client.predict_many(
                [question.frames[:4]] * 6, concurrency=6, **finals, **options
            ):
                np.testing.assert_allclose(
                    one.positions, alone, rtol=0, atol=TOGETHER_PX, err_msg=question.name
                )


def assert_covariances(covariances: np.ndarray, name: str) -> None:
    """Symmetric, positive definite, and no wider than the frame."""
    transposed = covariances.swapaxes(-1, -2)
    np.testing.assert_allclose(covariances, transposed, rtol=1e-4, atol=1e-6, err_msg=name)
    eigenvalues = np.linalg.eigvalsh(covariances)
    assert eigenvalues.min() > 0, name
    assert eigenvalues.max() < 128**2, name


def png_files(question: Question) -> list[bytes]:
    files = [io.BytesIO() for _ in question.frames]
    for file, frame in zip(files, question.frames, strict=True):
        Image.fromarray(frame).save(file, "PNG")
    return [file.getvalue() for file in files]


def positions_of(answer: httpx2.Response) -> np.ndarray:
    assert answer.status_code == 200, answer.text
    return np.array([ball["positions"] for ball in answer.json()["objects"]])


def by_json(plain: httpx2.Client, question: Question) -> np.ndarray:
    images = [base64.b64encode(file).decode() for file in png_files(question)]
    body = {"model": question.name, "horizon": question.horizon, "frames": images[:4]}
    if len(images) > 4:
        body["final_frame"] = images[4]
    return positions_of(plain.post("/predict", json=body))


def by_multipart(plain: httpx2.Client, question: Question) -> np.ndarray:
    names = ["frames"] * 4 + ["final_frame"]
    files = [
        (name, ("f.png", file)) for name, file in zip(names, png_files(question), strict=False)
    ]
    data = {"model": question.name, "horizon": str(question.horizon)}
    return positions_of(plain.post("/predict", files=files, data=data))


def by_protocol(plain: httpx2.Client, question: Question, *, binary: bool) -> np.ndarray:
    frames = question.frames[None]
    given = (
        {"parameters": {"binary_data_size": frames.nbytes}}
        if binary
        else {"data": frames.ravel().tolist()}
    )
    message = json.dumps(
        {
            "inputs": [
                {"name": "frames", "datatype": "UINT8", "shape": list(frames.shape), **given},
                {"name": "horizon", "datatype": "INT64", "shape": [1], "data": [question.horizon]},
            ],
            "outputs": [{"name": "positions", "parameters": {"binary_data": binary}}],
        }
    ).encode()
    model = question.model
    length = {"Inference-Header-Content-Length": str(len(message))} if binary else {}
    answer = plain.post(
        f"/v2/models/{model.name}/versions/{model.version}/infer",
        content=message + (frames.tobytes() if binary else b""),
        headers={"content-type": "application/octet-stream", **length},
    )
    assert answer.status_code == 200, answer.text
    if not binary:
        (output,) = answer.json()["outputs"]
        return np.array(output["data"]).reshape(output["shape"])[0]
    end = int(answer.headers["inference-header-content-length"])
    (output,) = json.loads(answer.content[:end])["outputs"]
    return np.frombuffer(answer.content[end:], "<f4").reshape(output["shape"])[0]
