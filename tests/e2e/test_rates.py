"""Cameras at other rates: frames whose rate is told, or that are blended, forecast well."""

import pytest

from tests.e2e.rates import WAYS, errors


@pytest.mark.parametrize("rate", [30, 60])
def test_frames_of_another_rate_forecast_nearly_as_well_as_those_of_the_right_rate(client, rate):
    found = errors(client, "hemisphere", rate, scenes=6)
    right, as_if, told, blended = (found[way] for way in WAYS)
    print(found)
    for error in (told, blended):
        assert error < 3 * right
        assert error < as_if / 2
