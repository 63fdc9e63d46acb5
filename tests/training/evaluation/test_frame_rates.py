"""Forecasts at other frame rates, against a service that knows the answer."""

import numpy as np
import pytest

from rollcast.client import Client
from rollcast.client.testing import FakeService
from tests.training.conftest import SCENES
from training.evaluation import frame_rates
from training.evaluation.frame_rates import RATES, measure, results_table


@pytest.mark.usefixtures("runs")
def test_every_rate_is_told_and_covers_half_a_second(monkeypatch):
    rates = (40, 15)
    assert set(rates) < set(RATES)
    monkeypatch.setattr(frame_rates, "RATES", rates)
    service = FakeService()
    with Client(transport=service) as client:
        measured = list(measure(client, ("hemisphere",), SCENES, 1, "auto"))
    assert [rate for rate, _ in measured] == list(rates)
    assert all(len(errors) == SCENES for _, by in measured for errors in by.values())
    told = [
        (float(request.fields["frame_rate"]), int(request.fields["horizon"]))
        for request in service.requests
    ]
    assert [rate for rate, _ in told] == [rate for rate in rates for _ in range(SCENES)]
    for rate, horizon in told:
        assert 0.5 <= (horizon - 1) / rate < 0.5 + 1 / rate


def test_ratios_are_means_over_the_scenarios():
    measured = [
        (40, {"hemisphere": np.array([1.0, 3.0]), "ellipsoid": np.array([4.0])}),
        (20, {"hemisphere": np.array([3.0, 3.0]), "ellipsoid": np.array([2.0])}),
    ]
    usual, other = results_table(measured).splitlines()[2:]
    assert usual.split("|")[-2].strip() == "1.00"
    assert other.split("|")[-2].strip() == "1.00"
    assert other.split("|")[2].strip() == "3.0"
