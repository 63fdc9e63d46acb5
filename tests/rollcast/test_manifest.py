import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from rollcast.manifest import (
    HASHED_FILES,
    MANIFEST_FILE,
    OOD_FILE,
    PERCEPTION_FILE,
    Manifest,
)

FIELDS = {
    "format_version": 3,
    "name": "probnet",
    "version": 3,
    "default": True,
    "variant": "probnet",
    "preset": "compact",
    "scenarios": ["hemisphere"],
    "objects": 2,
    "observed_frames": 4,
    "frames": 4,
    "final_step": None,
    "frame_rate_hz": 40,
    "frame_size": 128,
    "trained_horizon": 20,
    "state": [{"name": "s", "shape": [2, 32, 8, 8]}],
    "outputs": [
        {"name": "positions", "shape": [2, 2], "unit": "px"},
        {"name": "covariances", "shape": [2, 2, 2], "unit": "px^2"},
        {"name": "angular_velocities", "shape": [2, 3], "unit": "rad/s"},
    ],
    "covariance": {"source": "predicted", "variance_scale": [1.0, 1.5]},
    "angular_velocity": True,
    "training": {"seed": 1, "sequences": 100_000, "configuration": {"batch": 32}},
    "metrics": [
        {
            "split": "validation",
            "scenario": "hemisphere",
            "horizon": 20,
            "sequences": 300,
            "position_error_px": 3.5,
        }
    ],
    "validation_error_px": 3.5,
    "parity": {"max_abs_error": {"positions": 1e-5}, "tolerance": {"positions": 1e-3}},
    "golden_tolerance": {"positions": 1e-2, "covariances": 1e-1, "angular_velocities": 1e-2},
    "files": dict.fromkeys(HASHED_FILES, 64 * "a"),
    "licence": "Apache-2.0",
}

numbers = st.floats(0.01, 1e4)


@pytest.mark.parametrize("name", ["perplexity", "stays_put_px", "line_px"])
def test_former_names_of_metrics_are_rejected(name):
    row = {**FIELDS["metrics"][0], name: 2.5}
    with pytest.raises(ValueError, match=name):
        Manifest.model_validate({**FIELDS, "metrics": [row]})


@given(
    version=st.integers(1, 10**6),
    scale=st.lists(numbers, min_size=1, max_size=5),
    error=numbers,
    training=st.dictionaries(st.text(), st.integers() | st.text() | st.lists(st.booleans())),
)
def test_what_is_written_is_read_back(tmp_path_factory, version, scale, error, training):
    changes = {
        "version": version,
        "covariance": {"source": "predicted", "variance_scale": scale},
        "validation_error_px": error,
        "training": training,
    }
    manifest = Manifest.model_validate(FIELDS | changes)
    path = tmp_path_factory.mktemp("artefact") / MANIFEST_FILE
    manifest.write(path)
    assert Manifest.read(path) == manifest


def test_an_artefact_may_have_an_eye():
    files = dict.fromkeys((PERCEPTION_FILE, *HASHED_FILES), 64 * "a")
    assert Manifest.model_validate(FIELDS | {"files": files}).files == files


def test_names_of_outputs():
    manifest = Manifest.model_validate(FIELDS)
    assert manifest.label == "probnet@3"
    assert manifest.output_names == ("positions", "covariances", "angular_velocities")
    assert manifest.step_output_names == manifest.output_names
    assert manifest.frames_shape == (4, 128, 128, 3)


def final_frame_model(**changes):
    outputs = [FIELDS["outputs"][0], {"name": "final_positions", "shape": [2, 2], "unit": "px"}]
    return FIELDS | {
        "frames": 5,
        "final_step": 29,
        "outputs": outputs,
        "angular_velocity": False,
        "covariance": {"source": "empirical", "empirical": [[[1, 0], [0, 1]]]},
        "golden_tolerance": {"positions": 1e-2, "final_positions": 1e-2},
        **changes,
    }


def test_a_final_position_is_the_encoders_alone():
    manifest = Manifest.model_validate(final_frame_model())
    assert manifest.output_names == ("positions", "final_positions")
    assert manifest.step_output_names == ("positions",)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "../probnet"}, "name"),
        ({"version": 0}, "version"),
        ({"format_version": 2}, "format_version"),
        ({"scenarios": []}, "scenarios"),
        ({"scenarios": ["moon"]}, "scenarios"),
        ({"objects": 4}, "objects"),
        ({"objects": 1}, "output positions has shape"),
        ({"outputs": FIELDS["outputs"][:2]}, "outputs are"),
        ({"outputs": FIELDS["outputs"] + FIELDS["outputs"][:1]}, "outputs are"),
        ({"angular_velocity": False}, "outputs are"),
        ({"covariance": {"source": "empirical"}}, "empirical"),
        ({"covariance": {"source": "predicted", "empirical": [[[1, 0], [0, 1]]]}}, "empirical"),
        ({"covariance": {"source": "predicted", "variance_scale": [0]}}, "variance_scale"),
        ({"frames": 5}, "final_step is None with 5 frames"),
        (final_frame_model(frames=4), "final_step is 29 with 4 frames"),
        ({"golden_tolerance": {"positions": 1e-2}}, "golden_tolerance"),
        ({"files": {}}, "files are"),
        ({"validation_error_px": float("nan")}, "validation_error_px"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_parts_that_do_not_fit_are_refused(change, message):
    with pytest.raises(ValidationError, match=message):
        Manifest.model_validate(FIELDS | change)


def test_a_manifest_is_readable_line_by_line(tmp_path):
    path = tmp_path / MANIFEST_FILE
    Manifest.model_validate(FIELDS).write(path)
    text = path.read_text()
    assert text.endswith("}\n")
    assert json.loads(text)["name"] == "probnet"


ROW = FIELDS["metrics"][0]
KNOWN = {"threshold": 0.5, "false_alarm_rate": 0.02, "test_windows": 9}
WITH_OOD = {"files": dict.fromkeys((OOD_FILE, *HASHED_FILES), 64 * "a")}
ALONE = {
    "objects": 1,
    "outputs": [{"name": "positions", "shape": [1, 2], "unit": "px"}],
    "covariance": {"source": "empirical", "empirical": [[[1, 0], [0, 1]]]},
    "angular_velocity": False,
    "golden_tolerance": {"positions": 1e-2},
}
SWAPPED = {"name": "final_positions", "shape": [2, 2], "unit": "px"}


@pytest.mark.parametrize(
    "change",
    [
        ALONE,
        final_frame_model(final_step=1),
        {"trained_horizon": 1},
        {"validation_error_px": 0},
        {"version": 1},
        {"metrics": [ROW | {"horizon": 1, "sequences": 1}]},
        WITH_OOD | {"ood": KNOWN | {"false_alarm_rate": 0, "test_windows": 1}},
        WITH_OOD | {"ood": KNOWN | {"false_alarm_rate": 1}},
    ],
)
def test_what_lies_on_a_limit_is_accepted(change):
    assert Manifest.model_validate(FIELDS | change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"objects": 0}, "objects"),
        (final_frame_model(final_step=0), "final_step"),
        ({"trained_horizon": 0}, "trained_horizon"),
        ({"validation_error_px": -0.5}, "validation_error_px"),
        ({"metrics": [ROW | {"horizon": 0}]}, "horizon"),
        ({"metrics": [ROW | {"sequences": 0}]}, "sequences"),
        ({"metrics": [ROW | {"position_error_px": float("nan")}]}, "finite"),
        ({"metrics": [ROW | {"colour": "red"}]}, "colour"),
        (WITH_OOD | {"ood": KNOWN | {"false_alarm_rate": -0.1}}, "false_alarm_rate"),
        (WITH_OOD | {"ood": KNOWN | {"false_alarm_rate": 1.1}}, "false_alarm_rate"),
        (WITH_OOD | {"ood": KNOWN | {"test_windows": 0}}, "test_windows"),
        (WITH_OOD, "belong together"),
        ({"ood": KNOWN}, "belong together"),
        ({"state": []}, "state"),
        ({"state": [{"name": "", "shape": [1]}]}, "state"),
        ({"outputs": []}, "at least 1 item"),
        ({"outputs": [*FIELDS["outputs"][:2], SWAPPED]}, "outputs are"),
        ({"objects": 3}, "output positions has shape"),
        ({"files": FIELDS["files"] | {"other.onnx": 64 * "a"}}, "files are"),
        ({"golden_tolerance": FIELDS["golden_tolerance"] | {"final_positions": 1}}, "golden"),
        (
            ALONE | {"covariance": ALONE["covariance"] | {"variance_scale": [1]}},
            "variance_scale belongs to the source 'predicted'",
        ),
    ],
)
def test_what_lies_beyond_a_limit_is_refused(change, message):
    with pytest.raises(ValidationError, match=message):
        Manifest.model_validate(FIELDS | change)


def test_a_manifest_cannot_be_changed_and_is_indented_by_two(tmp_path):
    manifest = Manifest.model_validate(FIELDS)
    with pytest.raises(ValidationError, match="frozen"):
        manifest.name = "other"
    manifest.write(tmp_path / MANIFEST_FILE)
    lines = (tmp_path / MANIFEST_FILE).read_text().splitlines()
    assert lines[1] == '  "format_version": 3,'
    assert '    "hemisphere"' in lines


def test_the_error_at_a_horizon_is_interpolated_and_held_beyond_the_last():
    rows = [
        {"split": split, "scenario": scenario, "horizon": horizon, "sequences": 5,
         "position_error_px": error}
        for split, scenario, horizon, error in [
            ("validation", "hemisphere", 10, 1.0), ("validation", "hemisphere", 20, 3.0),
            ("validation", "ellipsoid", 10, 2.0), ("validation", "ellipsoid", 20, 8.0),
            ("test", "hemisphere", 10, 50.0),
        ]
    ]  # fmt: skip
    manifest = Manifest.model_validate(FIELDS | {"metrics": rows})
    assert [manifest.error_at(t) for t in (1, 10, 15, 20, 40)] == [1.5, 1.5, 3.5, 5.5, 5.5]
    without = Manifest.model_validate(FIELDS | {"metrics": []})
    assert without.error_at(20) == without.validation_error_px


def test_a_byte_order_mark_is_passed_over(tmp_path):
    path = tmp_path / MANIFEST_FILE
    path.write_text("\ufeff" + json.dumps(FIELDS), encoding="utf-8")
    assert Manifest.read(path) == Manifest.model_validate_json(json.dumps(FIELDS))
