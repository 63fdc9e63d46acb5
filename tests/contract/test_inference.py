"""The Open Inference Protocol with the real models."""

import base64
import io

import numpy as np
from PIL import Image


def test_every_model_answers_as_predict_does(client):
    scene = client.post("/simulate", json={"scenario": "hemisphere", "seed": 7}).json()
    images = scene["frames"][:4]
    files = [io.BytesIO(base64.b64decode(image)) for image in images]
    frames = np.stack([np.asarray(Image.open(file)) for file in files])
    models = client.get("/models").json()["models"]
    suitable = [model for model in models if (model["frames"], model["objects"]) == (4, 1)]
    assert suitable
    for model in suitable:
        name = model["name"]
        by_predict = client.post(
            "/predict", json={"model": name, "frames": images, "horizon": 10}
        ).json()["objects"][0]
        message = (
            b'{"inputs": [{"name": "frames", "datatype": "UINT8", "shape": [1, 4, 128, 128, 3],'
            b' "parameters": {"binary_data_size": 196608}},'
            b' {"name": "horizon", "datatype": "INT64", "shape": [1], "data": [10]}]}'
        )
        answer = client.post(
            f"/v2/models/{name}/infer",
            content=message + frames.tobytes(),
            headers={"inference-header-content-length": str(len(message))},
        )
        assert answer.status_code == 200, answer.text
        for output in answer.json()["outputs"]:
            values = np.array(output["data"]).astype(np.float32).reshape(output["shape"])
            expected = np.array(by_predict[output["name"]]).astype(np.float32)
            np.testing.assert_array_equal(values[0, 0], expected, err_msg=output["name"])
