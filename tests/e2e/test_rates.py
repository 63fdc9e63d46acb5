"""Cameras at other rates: frames that are blended forecast as those of the right rate do."""

import pytest

from tests.e2e.rates import WAYS, errors


@pytest.mark.parametrize("rate", [30, 60])
def test_blended_frames_forecast_nearly_as_well_as_those_of_the_right_rate(client, rate):
    found = errors(client, "hemisphere", rate, scenes=6)
    right, as_if, told, blended = (found[way] for way in WAYS)
    print(found)
    assert blended < 3 * right
    assert blended < as_if / 2
    assert blended < told / 2
