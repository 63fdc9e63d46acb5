"""What the benchmarks send: one scene's four frames in every form that the service reads."""

import base64
import io
import json
from dataclasses import dataclass
from typing import Literal

import numpy as np
from PIL import Image

from rollcast.simulation import Simulator
from tests.bench.loop import HORIZON, MODEL

Kind = Literal["binary", "multipart", "json", "listed"]
KINDS: tuple[Kind, ...] = ("binary", "multipart", "json")
"""That the service reads; "listed" is JSON inside a list, as BentoML's batches want it."""


@dataclass(frozen=True)
class Payload:
    """A request that is ready to be sent."""

    path: str
    headers: dict[str, str]
    body: bytes


def frames(seed: int = 7) -> np.ndarray:
    """Four frames of a hemisphere, uint8 [4, 128, 128, 3]."""
    simulator = Simulator()
    try:
        return simulator.sequence("hemisphere", 1, seed, 4).render(128)
    finally:
        simulator.close()


def png_files(images: np.ndarray) -> list[bytes]:
    """Encode every frame."""
    files = [io.BytesIO() for _ in images]
    for file, image in zip(files, images, strict=True):
        Image.fromarray(image).save(file, "PNG")
    return [file.getvalue() for file in files]


def payload(kind: Kind, images: np.ndarray) -> Payload:
    """Make the request for a forecast of HORIZON steps."""
    if kind == "binary":
        return _binary(images)
    if kind == "multipart":
        return _multipart(images)
    encoded = [base64.b64encode(file).decode() for file in png_files(images)]
    asked = {"model": MODEL, "frames": encoded, "horizon": HORIZON}
    body = json.dumps({"requests": [asked]} if kind == "listed" else asked).encode()
    return Payload("/predict", {"Content-Type": "application/json"}, body)


def simulation() -> Payload:
    """Make the request for a short simulation."""
    body = json.dumps({"scenario": "ellipsoid", "num_objects": 1, "seed": 7, "steps": 24}).encode()
    return Payload("/simulate", {"Content-Type": "application/json"}, body)


def _binary(images: np.ndarray) -> Payload:
    tensor = images[None].tobytes()
    header = json.dumps(
        {
            "parameters": {"binary_data_output": True},
            "inputs": [
                {
                    "name": "frames",
                    "datatype": "UINT8",
                    "shape": [1, *images.shape],
                    "parameters": {"binary_data_size": len(tensor)},
                },
                {"name": "horizon", "datatype": "INT64", "shape": [1], "data": [HORIZON]},
            ],
        }
    ).encode()
    headers = {
        "Content-Type": "application/octet-stream",
        "Inference-Header-Content-Length": str(len(header)),
    }
    return Payload(f"/v2/models/{MODEL}/infer", headers, header + tensor)


def _multipart(images: np.ndarray) -> Payload:
    boundary = "rollcast-benchmark"
    parts = [("model", "", MODEL.encode()), ("horizon", "", str(HORIZON).encode())]
    parts += [("frames", '; filename="frame.png"', file) for file in png_files(images)]
    lines = [
        f'--{boundary}\r\nContent-Disposition: form-data; name="{name}"{more}\r\n\r\n'.encode()
        + content
        + b"\r\n"
        for name, more, content in parts
    ]
    headers = {"Content-Type": f"multipart/form-data; boundary={boundary}"}
    return Payload("/predict", headers, b"".join(lines) + f"--{boundary}--\r\n".encode())
