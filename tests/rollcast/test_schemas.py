import base64
import inspect
import json

import pytest
from pydantic import ValidationError

from rollcast.client import Client
from rollcast.client.calls import SimulationOptions
from rollcast.scene import Scene
from rollcast.schemas import PredictRequest, SimulateRequest, SimulateResponse

IMAGE = base64.b64encode(b"an image").decode()


def test_frames_are_decoded_from_base64():
    request = PredictRequest.model_validate({"frames": [IMAGE] * 4})
    assert request.frames == [b"an image"] * 4
    assert (request.model, request.horizon, request.num_objects, request.frame_rate) == (
        "auto",
        None,
        None,
        None,
    )


def test_frames_that_are_bytes_already_are_left_alone():
    assert PredictRequest.model_validate({"frames": [b"IMG"] * 4}).frames == [b"IMG"] * 4


def test_text_becomes_numbers_only_when_asked_for():
    fields = {"frames": [IMAGE] * 4, "horizon": "7", "frame_rate": "30"}
    with pytest.raises(ValidationError):
        PredictRequest.model_validate(fields)
    request = PredictRequest.model_validate(fields, strict=False)
    assert (request.horizon, request.frame_rate) == (7, 30)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_numbers_are_finite(value):
    with pytest.raises(ValidationError):
        PredictRequest.model_validate({"frames": [IMAGE] * 4, "frame_rate": value})


SCENE = Scene(
    scenario="hemisphere",
    seed=7,
    textured=False,
    radius_m=0.1,
    rotation_rad=0.5,
    axis_ratio=1.0,
    positions_m=((0, 0, 0.1), (0.5, 0, 0.3)),
    velocities_m_s=((1, 0, 0), (0, 1, 0)),
    orientations_xyzw=((0, 0, 0, 1), (0, 0, 0, 1)),
)


def test_a_returned_scene_is_a_whole_request():
    scene = json.loads(SCENE.model_dump_json())
    request = SimulateRequest.model_validate({"scene": scene})
    assert (request.scenario, request.seed, request.textured) == ("hemisphere", 7, False)
    assert request.balls == 2
    assert "seed" not in request.parameters
    assert Scene.model_validate(request.parameters | {"scenario": "hemisphere", "seed": 7}) == SCENE


def test_what_stands_twice_must_be_the_same():
    twice = {"scenario": "ellipsoid", "seed": 1}
    same = SimulateRequest.model_validate(twice | {"scene": {"radius_m": 0.1, "seed": 1}})
    assert same.scene.radius_m == 0.1
    with pytest.raises(ValidationError, match=r"seed and scene\.seed differ"):
        SimulateRequest.model_validate(twice | {"scene": {"seed": 2}})


@pytest.mark.parametrize("name", ["radius_m", "positions_m", "friction"])
def test_a_parameter_of_the_scene_has_one_place(name):
    with pytest.raises(ValidationError, match=f"{name} is a parameter of the scene"):
        SimulateRequest.model_validate({"scenario": "ellipsoid", "seed": 1, name: 0.1})


def test_a_null_is_no_second_value():
    request = SimulateRequest.model_validate(
        {"scenario": "ellipsoid", "seed": 1, "scene": {"seed": None, "axis_ratio": None}}
    )
    assert request.parameters == {}
    assert SimulateRequest.model_validate(
        {"scenario": "ellipsoid", "seed": 1, "textured": False, "scene": None}
    ).parameters == {"textured": False}


def test_the_client_has_every_option_of_a_simulation_with_its_default():
    options = inspect.signature(Client.simulate).parameters
    fields = SimulateRequest.model_fields
    assert set(options) - {"self"} == set(fields)
    assert set(SimulationOptions.__annotations__) | {
        "scenario",
        "include_frames",
        "include_surface",
    } == set(fields)
    for name in ("steps", "image_size", "include_frames", "include_surface"):
        assert options[name].default == fields[name].default, name


def test_a_client_reads_the_answer_of_a_newer_service():
    answer = {
        "scenario": "hemisphere",
        "seed": 7,
        "frame_rate": 40,
        "frame_size": [128, 128],
        "start_step": 80,
        "times_s": [],
        "frames": None,
        "objects": [],
        "scene": json.loads(SCENE.model_dump_json()),
        "invented_later": 1,
    }
    assert SimulateResponse.model_validate(answer).scene == SCENE
