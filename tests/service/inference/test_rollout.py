"""The recurrent loop and what is made of its outputs, by values that are computed by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from rollcast.manifest import CovarianceSource
from rollcast.outputs import Units
from rollcast.rollout import Step, joined, roll_out
from service.errors import DivergedError
from service.inference.rollout import CovarianceFloor, ForecastArrays, assemble
from tests.service.samples import DotPredictor, dot, manifest

FRAMES = np.stack([[dot(40 + 2 * index, 60 + index) for index in range(4)]])
PREDICTED = CovarianceSource(source="predicted")
TABLE = CovarianceSource(source="empirical", empirical=(((1, 0.5), (0.5, 2)), ((4, 0), (0, 5))))


def outputs(steps: int = 3, **changes: np.ndarray) -> dict[str, np.ndarray]:
    """One request, two balls; every number differs from every other."""
    numbers = {
        "positions": np.arange(4.0 * steps).reshape(1, 2, steps, 2),
        "covariances": 1 + np.arange(8.0 * steps).reshape(1, 2, steps, 2, 2),
        "angular_velocities": -np.arange(6.0 * steps).reshape(1, 2, steps, 3),
    }
    return numbers | changes


@pytest.mark.parametrize("horizon", [1, 2, 5])
def test_a_rollout_has_as_many_steps_as_are_asked_for(horizon):
    rolled = roll_out(DotPredictor(manifest()), FRAMES, horizon)
    assert rolled["positions"].shape == (1, 1, horizon, 2)
    steps = np.arange(horizon)
    np.testing.assert_allclose(rolled["positions"][0, 0, :, 0], 46 + 2 * steps, atol=0.1)
    np.testing.assert_allclose(rolled["positions"][0, 0, :, 1], 63 + steps, atol=0.1)


def test_steps_are_joined_and_a_final_position_is_not():
    parts = [
        {"positions": np.zeros((1, 1, 2, 2)), "final_positions": np.full((1, 2, 2), 9)},
        {"positions": np.array([1, 2]).reshape(2, 1, 1, 1) * np.ones((2, 1, 2, 2))},
    ]
    together = joined(parts)
    np.testing.assert_array_equal(together["positions"][0, 0], [[0, 0], [1, 1], [2, 2]])
    np.testing.assert_array_equal(together["final_positions"], parts[0]["final_positions"])


def test_a_predicted_covariance_is_the_networks():
    given_, made = outputs(), assemble(outputs(), PREDICTED)
    np.testing.assert_array_equal(made.covariances, given_["covariances"])
    np.testing.assert_array_equal(made.positions, given_["positions"])
    np.testing.assert_array_equal(made.outputs["angular_velocities"], given_["angular_velocities"])
    assert "final_positions" not in made.outputs


def test_a_variance_scale_is_that_of_its_step_and_the_last_is_held():
    source = CovarianceSource(source="predicted", variance_scale=(2.0, 3.0))
    made = assemble(outputs(4), source).covariances
    factors = np.array([2, 3, 3, 3])[:, None, None]
    np.testing.assert_array_equal(made, outputs(4)["covariances"] * factors)
    later = assemble(outputs(2), source, first_step=1).covariances
    np.testing.assert_array_equal(later, outputs(2)["covariances"] * 3)


@pytest.mark.parametrize(
    ("half", "first", "expected"),
    [((0.9, 0.8), 0, [0.9, 0.8, 0.8]), ((0.9, 0.8), 1, [0.8] * 3), (None, 0, [1.17741] * 3)],
)
def test_an_ellipse50_radius_is_that_of_its_step_and_without_one_a_gaussians(half, first, expected):
    source = CovarianceSource(source="predicted", ellipse50_radius=half)
    made = assemble(outputs(3), source, first_step=first)
    np.testing.assert_allclose(made.ellipse50_radii, expected, atol=1e-5)
    np.testing.assert_array_equal(made.rescaled(Units(2, 1)).ellipse50_radii, made.ellipse50_radii)


@pytest.mark.parametrize(("first", "rows"), [(0, [0, 1, 1]), (1, [1, 1, 1])])
def test_an_empirical_covariance_is_that_of_its_step_and_the_last_is_held(first, rows):
    made = assemble(outputs(), TABLE, first_step=first).covariances
    assert made.shape == (1, 2, 3, 2, 2)
    for ball in range(2):
        np.testing.assert_array_equal(made[0, ball], np.array(TABLE.empirical)[rows])


def test_a_network_without_angular_velocities_has_none():
    made = assemble({"positions": outputs()["positions"]}, TABLE)
    assert "angular_velocities" not in made.outputs
    assert "angular_velocities" not in made.rescaled(Units(2, 3)).outputs


def test_lengths_and_rates_are_rescaled():
    final = np.array([[[1.0, 2.0], [3.0, 4.0]]])
    made = assemble(outputs(final_positions=final), PREDICTED)
    larger = made.rescaled(Units(4.0, 0.5))
    np.testing.assert_array_equal(larger.positions, made.positions * 4)
    np.testing.assert_array_equal(larger.covariances, made.covariances * 16)
    np.testing.assert_array_equal(
        larger.outputs["angular_velocities"], made.outputs["angular_velocities"] / 2
    )
    np.testing.assert_array_equal(larger.outputs["final_positions"], final * 4)


@pytest.mark.parametrize("name", ["positions", "covariances", "angular_velocities"])
@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("first", [0, 5])
def test_a_number_that_is_none_ends_the_horizon(name, wrong, first):
    numbers = outputs(4)
    numbers[name][0, 1, 2] = wrong
    with pytest.raises(DivergedError) as refused:
        assemble(numbers, PREDICTED, first_step=first)
    (field_error,) = refused.value.field_errors
    assert (field_error.field, field_error.value) == ("horizon", first + 4)
    assert field_error.expected == f"at most {first + 2} for these frames"


def test_the_first_step_may_be_the_wrong_one_already():
    numbers = outputs(2)
    numbers["positions"][:] = np.nan
    with pytest.raises(DivergedError, match="at most 0 for these frames"):
        assemble(numbers, PREDICTED)


def test_what_a_request_holds_cannot_be_changed():
    made = assemble(outputs(), PREDICTED)
    for whole, name in ((made, "positions"), (Step({}, {}), "state")):
        with pytest.raises(AttributeError):
            setattr(whole, name, None)


EIGENVALUES = st.floats(1e-6, 1e6)


@given(
    arrays.arrays(np.float64, (3, 2), elements=EIGENVALUES),
    arrays.arrays(np.float64, 3, elements=st.floats(0, np.pi)),
    st.floats(0.25, 32),
    st.lists(st.floats(1e-3, 1e3), min_size=1, max_size=4),
)
def test_covariances_stay_symmetric_positive_and_bounded(values, angles, length, scale):
    """Whatever is done to those that a network may give: wide, narrow, turned, small or large."""
    turned = np.stack([np.cos(angles), -np.sin(angles), np.sin(angles), np.cos(angles)], axis=-1)
    basis = turned.reshape(3, 2, 2)
    symmetric = basis @ (values[..., None] * np.eye(2)) @ basis.swapaxes(-1, -2)
    symmetric = (symmetric + symmetric.swapaxes(-1, -2)) / 2
    numbers = {"positions": np.zeros((1, 1, 3, 2)), "covariances": symmetric[None, None]}
    source = CovarianceSource(source="predicted", variance_scale=tuple(scale))
    made = assemble(numbers, source).rescaled(Units(length)).covariances[0, 0]
    np.testing.assert_array_equal(made, made.swapaxes(-1, -2))
    most = values.max() * max(scale) * length**2
    assert np.abs(made).max() <= most * (1 + 1e-9)
    # Rounding may move an eigenvalue by the last digits of the largest.
    assert np.linalg.eigvalsh(made).min() >= -1e-9 * most
    np.testing.assert_array_less(0, made[:, [0, 1], [0, 1]])


@given(
    arrays.arrays(np.float64, (1, 2, 4, 2), elements=st.floats(width=32)),
    st.integers(0, 3),
)
def test_a_forecast_is_finite_or_refused(positions, first):
    covariances = np.broadcast_to(np.eye(2), (1, 2, 4, 2, 2))
    try:
        made = assemble({"positions": positions, "covariances": covariances}, PREDICTED, first)
    except DivergedError:
        assert not np.isfinite(positions).all()
    else:
        assert isinstance(made, ForecastArrays)
        assert np.isfinite(made.positions).all()


def test_a_forecast_stays_near_the_frame_and_its_deviations_within_half_of_it():
    made = assemble(outputs(3), PREDICTED).having(
        positions=np.array([[[[64.0, 64], [500, 64], [64, -500]]] * 2]),
        covariances=np.array([[[np.diag([9.0, 4]), np.diag([2.0e4, 1e4]), np.eye(2)]] * 2]),
    )
    bounded = made.within_frame()
    np.testing.assert_allclose(bounded.positions[0, 0], [[64, 64], [140.8, 64], [64, -12.8]])
    np.testing.assert_allclose(bounded.covariances[0, 0, 0], np.diag([9, 4]))
    np.testing.assert_allclose(bounded.covariances[0, 0, 1], np.diag([64.0**2, 64.0**2 / 2]))


@pytest.mark.parametrize("stepwise", [False, True])
def test_covariances_do_not_shrink_beyond_the_last_calibrated_step(stepwise):
    sizes = np.array([1.0, 5, 2, 3, 1, 4, 3])
    expected = np.array([1.0, 5, 2, 3, 3, 4, 4])  # three steps are calibrated
    covariances = (sizes[:, None, None] * np.eye(2))[None, None]
    made = assemble(outputs(7), PREDICTED).having(covariances=covariances)
    floor = CovarianceFloor(3)
    if stepwise:
        answers = [
            floor.apply(made.having(covariances=covariances[:, :, k : k + 1]), k).covariances
            for k in range(7)
        ]
        kept = np.concatenate(answers, axis=2)
    else:
        kept = floor.apply(made, 0).covariances
    np.testing.assert_allclose(kept[0, 0, :, 0, 0], expected)
