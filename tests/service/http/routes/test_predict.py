import numpy as np
import pytest

from tests.service.samples import body, moving_dot, parts, registry, served


def test_the_answer_has_every_field_of_the_design(client):
    response = client.post("/predict", json=body(horizon=3))
    assert response.status_code == 200
    answer = response.json()
    assert set(answer.pop("timing_ms")) == {"decode", "encode", "rollout", "total"}
    assert answer == {
        "model": {"name": "dot", "version": 1, "variant": "dotnet", "trained_horizon": 20},
        "frame_size": [128, 128],
        "frame_rate": 40.0,
        "step_rate": 40.0,
        "objects": [
            {
                "id": 0,
                "color": "red",
                "positions": [[46.0, 63.0], [48.0, 64.0], [50.0, 65.0]],
                "covariances": [[[1.0, 0.0], [0.0, 1.0]]] * 3,
                "covariance_source": "predicted",
                "angular_velocities": [[1.0, 1.0, 1.0]] * 3,
                "score": None,
                "seen": None,
                "warnings": [],
                "motion": "network",
                "alternative": None,
            }
        ],
        "times_s": [0.0, 0.025, 0.05],
        "ellipse50_radii": [pytest.approx(1.1774, abs=1e-4)] * 3,
        "final_positions": None,
        "warnings": [],
    }


def test_multipart_gives_the_same_answer_as_json(client):
    by_json = client.post("/predict", json=body(horizon=7, frame_rate=40.5)).json()
    by_parts = client.post(
        "/predict", files=parts(moving_dot()), data={"horizon": "7", "frame_rate": "40.5"}
    ).json()
    del by_json["timing_ms"], by_parts["timing_ms"]
    assert by_json == by_parts


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["f0.png", "f1.png", "f2.png", "f5.png"], "2 images are missing from the numbering"),
        (["f3.png", "f2.png", "f1.png", "f0.png"], "not the order of their numbers"),
    ],
)
def test_numbers_of_files_that_speak_against_the_frames_are_told(client, names, said):
    files = [("frames", (name, image)) for name, image in zip(names, moving_dot(), strict=True)]
    answer = client.post("/predict", files=files, data={"horizon": "3"}).json()
    assert [said in warning for warning in answer["warnings"]] == [True]


@pytest.mark.parametrize(
    "names",
    [
        ["7.png", "8.png", "9.png", "10.png"],
        ["frame.png"] * 4,
        ["1" * 300, "2", "3", "4"],
        list("ab²c"),
    ],
)
def test_names_of_files_mean_nothing_else(client, names):
    files = [("frames", (name, image)) for name, image in zip(names, moving_dot(), strict=True)]
    answer = client.post("/predict", files=files, data={"horizon": "3"}).json()
    assert answer["warnings"] == []


def test_the_horizon_is_40_by_default(client):
    answer = client.post("/predict", json=body()).json()
    assert len(answer["times_s"]) == len(answer["objects"][0]["positions"]) == 40


@pytest.mark.parametrize("side", [32, 64, 256, 1000])
def test_positions_are_pixels_of_the_frames_that_were_sent(client, side):
    answer = client.post("/predict", json=body(moving_dot(side), horizon=2)).json()
    scale = side / 128
    assert answer["frame_size"] == [side, side]
    ball = answer["objects"][0]
    np.testing.assert_allclose(
        ball["positions"], [[46 * scale, 63 * scale], [48 * scale, 64 * scale]], atol=0.03 * scale
    )
    np.testing.assert_allclose(ball["covariances"][0], np.eye(2) * scale**2, rtol=1e-6)


def test_several_balls_are_ordered_by_color(client):
    answer = client.post("/predict", json=body(num_objects=2)).json()
    assert [(ball["id"], ball["color"]) for ball in answer["objects"]] == [(0, "red"), (1, "green")]
    assert answer["model"]["name"] == "pair"


def test_a_horizon_beyond_training_is_warned_about(client):
    answer = client.post("/predict", json=body(horizon=21)).json()
    assert answer["warnings"] == [
        "The horizon of 21 steps exceeds the 20 steps that dot@1 was trained on: "
        "later steps are extrapolated."
    ]


def test_empirical_covariances_are_held_beyond_their_end_with_a_warning(client):
    answer = client.post("/predict", json=body(model="line", horizon=3)).json()
    ball = answer["objects"][0]
    assert ball["covariance_source"] == "empirical"
    assert ball["covariances"] == [[[1, 0.5], [0.5, 1]], [[4, 0], [0, 4]], [[4, 0], [0, 4]]]
    assert ball["angular_velocities"] is None
    assert answer["warnings"] == [
        "The empirical covariances of line@1 end with step 1: later steps repeat the last one."
    ]


def test_a_variance_scale_widens_the_predicted_covariance(start):
    covariance = {"source": "predicted", "variance_scale": [1, 4]}
    client = start(lambda _: registry_of(served(covariance=covariance)))
    answer = client.post("/predict", json=body(horizon=3)).json()
    assert [c[0][0] for c in answer["objects"][0]["covariances"]] == [1, 4, 4]


def test_ellipse50_radii_are_the_models(start):
    covariance = {"source": "predicted", "ellipse50_radius": [0.9, 0.8]}
    client = start(lambda _: registry_of(served(covariance=covariance)))
    answer = client.post("/predict", json=body(horizon=3)).json()
    assert answer["ellipse50_radii"] == [0.9, 0.8, 0.8]


def registry_of(*models):
    return type(registry(None))(models)


@pytest.mark.parametrize(("rate", "warned"), [(40, 0), (41.9, 0), (42.1, 1), (30, 1)])
def test_steps_are_as_far_apart_as_the_frames(client, rate, warned):
    answer = client.post("/predict", json=body(horizon=2, frame_rate=rate)).json()
    assert answer["frame_rate"] == rate
    assert answer["times_s"] == [0, 1 / rate]
    assert len(answer["warnings"]) == warned
    turning = answer["objects"][0]["angular_velocities"][0][0]
    assert turning == pytest.approx(rate / 40), "the angle per frame is what was seen"


def test_a_final_frame_fixes_the_horizon(client):
    images = moving_dot(frames=5)
    answer = client.post(
        "/predict", files=[*parts(images[:4]), ("final_frame", ("f.png", images[4]))]
    ).json()
    assert answer["model"]["name"] == "between"
    assert len(answer["times_s"]) == 10
    assert answer["final_positions"] == [[48.0, 64.0]]


def test_the_same_frames_give_the_same_answer(client):
    first, second = (client.post("/predict", json=body()).json() for _ in range(2))
    assert first["objects"] == second["objects"]


def test_a_forecast_that_diverges_is_refused_with_the_horizon_that_is_left(start):
    client = start(lambda _: registry_of(exploding()))
    response = client.post("/predict", json=body(horizon=9))
    assert response.status_code == 422
    problem = response.json()
    assert problem["type"] == "/problems/forecast-diverged"
    assert (problem["field"], problem["value"]) == ("horizon", 9)
    assert problem["expected"] == "at most 3 for these frames"
    assert client.post("/predict", json=body(horizon=3)).status_code == 200


def exploding():
    model = served()

    class Exploding(type(model.predictor)):
        def step(self, state):
            step = super().step(state)
            if step.state["position"][0, 0, 0] > 51:
                step.outputs["positions"] = step.outputs["positions"] * np.inf
            return step

    return type(model)(
        model.name, model.version, model.manifest, Exploding(model.manifest), card="#"
    )


def test_steps_may_be_as_far_apart_as_is_asked(client):
    usual = client.post("/predict", json=body(horizon=9)).json()
    finer = client.post("/predict", json=body(horizon=17, step_rate=80)).json()
    assert (usual["step_rate"], finer["step_rate"], finer["frame_rate"]) == (40, 80, 40)
    assert finer["times_s"][::2] == pytest.approx(usual["times_s"])
    path, fine = (np.array(told["objects"][0]["positions"]) for told in (usual, finer))
    assert np.array_equal(fine[::2], path)
    assert np.allclose(fine[1::2], (path[1:] + path[:-1]) / 2, atol=1e-3)
    covariances = np.array(finer["objects"][0]["covariances"])
    assert (np.linalg.eigvalsh(covariances) > 0).all()


def test_a_final_frame_fixes_the_times_of_the_steps(client):
    images = moving_dot(frames=5)
    answer = client.post(
        "/predict",
        files=[*parts(images[:4]), ("final_frame", ("f.png", images[4]))],
        data={"step_rate": "80"},
    )
    assert answer.status_code == 422
    assert answer.json()["field"] == "step_rate"
    assert "40, the frames a second" in answer.json()["detail"]


def test_steps_are_not_so_far_apart_that_a_forecast_never_ends(client):
    answer = client.post("/predict", json=body(horizon=1000, step_rate=1))
    assert answer.status_code == 422
    assert answer.json()["field"] == "horizon"
    assert "at most 100 at 1 steps a second" in answer.json()["detail"]
    assert client.post("/predict", json=body(horizon=100, step_rate=1)).status_code == 200
