"""``POST /detect`` of the real app with the committed models."""

import base64
import io

import numpy as np
import pytest
from PIL import Image

RADIUS = 9


def frames(width=320, height=180):
    """A red disc that rolls to the right, and a blue one that rests, on grey cloth."""
    rows, columns = np.indices((height, width)) + 0.5
    made = []
    for step in range(4):
        picture = np.full((height, width, 3), (90, 110, 90), np.uint8)
        for (x, y), color in (((60 + 4 * step, 60), (210, 60, 50)), ((250, 120), (40, 60, 160))):
            picture[np.hypot(columns - x, rows - y) < RADIUS] = color
        buffer = io.BytesIO()
        Image.fromarray(picture).save(buffer, "PNG")
        made.append(base64.b64encode(buffer.getvalue()).decode())
    return made


def test_moving_and_resting_balls_are_found_in_a_wide_picture(client):
    answer = client.post("/detect", json={"frames": frames()}).json()
    assert answer["model"].startswith("any-ball@")
    assert answer["frame_size"] == [320, 180]
    seen = {
        name: [
            ball
            for ball in answer["balls"]
            if np.hypot(ball["seen"][3]["x"] - x, ball["seen"][3]["y"] - y) < RADIUS / 2
        ]
        for name, (x, y) in {"rolls": (72, 60), "rests": (250, 120)}.items()
    }
    assert len(seen["rolls"]) == len(seen["rests"]) == 1  # squares overlap
    (rolls,) = seen["rolls"]
    assert rolls["refined"]
    assert rolls["moving"] > 0.5
    np.testing.assert_allclose([at["x"] for at in rolls["seen"]], [60, 64, 68, 72], atol=1.5)
    assert rolls["visible"] == pytest.approx([1] * 4, abs=0.3)


def test_parts_of_a_form_are_read_alike(client):
    pictures = [("frames", ("f.png", base64.b64decode(frame))) for frame in frames()]
    asked = {"min_score": 0.3, "refine_still": False}
    form = {"min_score": "0.3", "refine_still": "false"}
    by_parts = client.post("/detect", files=pictures, data=form)
    by_json = client.post("/detect", json={"frames": frames(), **asked})
    assert by_parts.json() == by_json.json()


@pytest.mark.parametrize(
    ("changed", "status", "field"),
    [
        ({"model": "fieldnet"}, 422, "balls"),
        ({"model": "nonet"}, 404, "model"),
        ({"frames": frames()[:3]}, 422, "frames"),
        ({"min_score": 2}, 422, "min_score"),
    ],
)
def test_what_is_wrong_is_named(client, changed, status, field):
    answer = client.post("/detect", json={"frames": frames(), **changed})
    assert (answer.status_code, answer.json()["field"]) == (status, field)
    assert client.post("/detect", json={"frames": frames()}).status_code == 200
