import base64

import numpy as np
import pytest

from rollcast.perlin import noise_and_gradient
from rollcast.scene import Scene
from rollcast.surfaces import NOISE_AMPLITUDE_M
from tests.service.samples import decode_frames

SCENE = {"scenario": "ellipsoid", "seed": 3, "steps": 6}


@pytest.fixture(scope="module")
def simulator(tmp_path_factory):
    """One app for all tests here, since its simulator takes a second to start."""
    from starlette.testclient import TestClient

    from service.app import create_app
    from service.settings import Settings
    from tests.service import samples

    settings = Settings(
        models_dir=tmp_path_factory.mktemp("models"), max_simulated_pixels=1_000_000
    )
    with TestClient(create_app(settings, samples.registry)) as client:
        yield client


def test_the_answer_has_every_field_of_the_design(simulator):
    answer = simulator.post("/simulate", json=SCENE | {"image_size": 64, "num_objects": 2}).json()
    assert list(answer) == [
        "scenario",
        "seed",
        "frame_rate",
        "frame_size",
        "start_step",
        "times_s",
        "frames",
        "objects",
        "surface",
        "scene",
    ]
    assert (answer["scenario"], answer["seed"], answer["frame_rate"]) == ("ellipsoid", 3, 40)
    assert answer["frame_size"] == [64, 64]
    assert answer["times_s"] == [0, 0.025, 0.05, 0.075, 0.1, 0.125]
    assert [(ball["id"], ball["color"]) for ball in answer["objects"]] == [(0, "red"), (1, "green")]
    for ball in answer["objects"]:
        assert np.shape(ball["positions"]) == (6, 2)
        assert np.shape(ball["angular_velocities"]) == (6, 3)
        assert ball["radius_px"] == pytest.approx(answer["scene"]["radius_m"] * 64 / 2.1)
    assert set(answer["scene"]) == set(Scene.model_fields)
    images = [base64.b64decode(frame) for frame in answer["frames"]]
    frames, side = decode_frames(images, [""] * 6)
    assert (frames.shape, side) == ((6, 128, 128, 3), 64)


def test_the_same_seed_gives_the_same_bytes(simulator):
    first, second = (simulator.post("/simulate", json=SCENE).content for _ in range(2))
    assert first == second


def test_a_scene_that_came_back_can_be_posted_back(simulator):
    answer = simulator.post("/simulate", json=SCENE)
    again = simulator.post("/simulate", json={"scene": answer.json()["scene"], "steps": 6})
    assert again.content == answer.content


def test_a_shorter_answer_is_a_prefix(simulator):
    long, short = (
        simulator.post("/simulate", json=SCENE | {"steps": steps}).json() for steps in (6, 4)
    )
    assert short["frames"] == long["frames"][:4]
    assert short["objects"][0]["positions"] == long["objects"][0]["positions"][:4]


def test_parameters_of_the_scene_are_not_sampled(simulator):
    scene = {"radius_m": 0.04, "rotation_rad": 1}
    answer = simulator.post("/simulate", json=SCENE | {"scene": scene})
    assert answer.status_code == 200
    assert {name: answer.json()["scene"][name] for name in scene} == scene


def test_frames_can_be_left_out(simulator):
    answer = simulator.post("/simulate", json=SCENE | {"include_frames": False}).json()
    assert answer["frames"] is None


def surface(simulator, **asked):
    answer = simulator.post(
        "/simulate", json=asked | {"seed": 3, "include_frames": False, "include_surface": True}
    ).json()
    grid = answer["surface"]
    half = grid["half_width_m"]
    heights = np.array(grid["heights_m"], float)
    # Rows from the frame's top, which is +y, to its bottom; columns from left to right.
    x, y = np.meshgrid(np.linspace(-half, half, 65), np.linspace(half, -half, 65))
    assert heights.shape == x.shape
    return answer["scene"], half, x, y, heights


def test_the_surface_of_a_hemisphere(simulator):
    _, half, x, y, heights = surface(simulator, scenario="hemisphere")
    assert half == 1.05
    inside = x**2 + y**2 <= 1
    assert np.isnan(heights).tolist() == (~inside).tolist()
    expected = 1 - np.sqrt(1 - (x**2 + y**2)[inside])
    np.testing.assert_allclose(heights[inside], expected, rtol=0, atol=1e-6)


def test_the_surface_of_an_ellipsoid_is_turned_as_its_picture_is(simulator):
    scene, _, x, y, heights = surface(
        simulator, scenario="ellipsoid", scene={"axis_ratio": 0.6, "rotation_rad": 0.5}
    )
    assert scene["rotation_rad"] == 0.5
    along = np.cos(0.5) * x + np.sin(0.5) * y
    across = np.cos(0.5) * y - np.sin(0.5) * x
    squared = 1 - (along / 0.6) ** 2 - across**2
    assert np.isnan(heights).tolist() == (squared < 0).tolist()
    expected = 1 - np.sqrt(squared[squared >= 0])
    np.testing.assert_allclose(heights[squared >= 0], expected, rtol=0, atol=1e-6)


def test_the_surface_of_a_heightfield_is_its_noise(simulator):
    scene, half, x, y, heights = surface(simulator, scenario="heightfield")
    assert half == 1.25
    cos, sin = np.cos(scene["rotation_rad"]), np.sin(scene["rotation_rad"])
    offset, scale = scene["noise_offset_m"], scene["noise_scale"]
    noise, *_ = noise_and_gradient(
        (cos * x + sin * y + offset[0]) / scale, (cos * y - sin * x + offset[1]) / scale
    )
    np.testing.assert_allclose(heights, NOISE_AMPLITUDE_M * noise, rtol=0, atol=1e-6)


def test_the_surface_comes_only_when_it_is_asked_for(simulator):
    assert simulator.post("/simulate", json=SCENE).json()["surface"] is None


def test_the_first_step_can_be_chosen(simulator):
    default = simulator.post("/simulate", json=SCENE).json()
    later = simulator.post("/simulate", json=SCENE | {"start_step": default["start_step"] + 2})
    assert later.json()["objects"][0]["positions"][:4] == default["objects"][0]["positions"][2:]


BAD = {
    "unknown scenario": ({"scenario": "moon"}, "scenario"),
    "no seed": ({"seed": None}, "seed"),
    "negative seed": ({"seed": -1}, "seed"),
    "seed beyond doubles": ({"seed": 2**53}, "seed"),
    "three steps": ({"steps": 3}, "steps"),
    "1001 steps": ({"steps": 1001}, "steps"),
    "tiny frames": ({"image_size": 31}, "image_size"),
    "huge frames": ({"image_size": 1025}, "image_size"),
    "too many pixels": ({"image_size": 512}, "steps"),
    "unknown field": ({"colour": "red"}, "colour"),
    "unknown parameter": ({"scene": {"colour": "red"}}, "scene.colour"),
    "scene is no object": ({"scene": 1}, "scene"),
    "a parameter beside the scene": ({"radius_m": 0.1}, "radius_m"),
    "two seeds": ({"scene": {"seed": 4}}, "seed"),
    "two scenarios": ({"scene": {"scenario": "hemisphere"}}, "scenario"),
    "balls disagree": ({"num_objects": 2, "scene": {"positions_m": [[0, 0, 0]]}}, "num_objects"),
    "a number in words": ({"scene": {"radius_m": "0.1"}}, "scene.radius_m"),
    "a radius out of range": ({"scene": {"radius_m": 9}}, "scene.radius_m"),
    "not of this scenario": ({"scene": {"noise_scale": 0.5}}, None),
    "textured balls": ({"num_objects": 2, "textured": True}, "textured"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_requests(simulator, case):
    change, field = BAD[case]
    response = simulator.post("/simulate", json=SCENE | change)
    problem = response.json()
    assert response.status_code == 422, problem
    assert problem["type"] == "/problems/invalid-value"
    assert problem["expected"]
    if field is not None:
        assert problem["field"] == field
    assert simulator.post("/simulate", json=SCENE | {"include_frames": False}).status_code == 200


def test_a_scene_that_the_rules_drop_is_refused(simulator):
    up = {"scene": {"velocities_m_s": [[0, 0, 14]]}}
    response = simulator.post("/simulate", json=SCENE | up)
    assert (response.status_code, response.json()["type"]) == (422, "/problems/scene-rejected")
