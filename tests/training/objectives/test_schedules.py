import pytest

from training.objectives.schedules import Cosine, Plateau


def test_cosine_rises_then_falls_to_zero():
    schedule = Cosine(0.1)
    assert schedule.factor(0) == 0
    assert schedule.factor(0.1) == 1
    assert schedule.factor(1) == pytest.approx(0)
    assert not schedule.finished


def epochs(schedule: Plateau, losses: list[float]) -> None:
    for loss in losses:
        schedule.observe(loss, 50)
        schedule.observe(loss, 50)


def test_plateau_lowers_the_rate_and_then_ends():
    schedule = Plateau(epoch_sequences=100, patience=3, end_after=6)
    epochs(schedule, [5, 4, 3, 3, 3])
    assert schedule.factor(0) == 1
    epochs(schedule, [3.1])
    assert schedule.factor(0) == pytest.approx(0.1)
    epochs(schedule, [2.5, 3, 3])
    assert schedule.factor(0) == pytest.approx(0.1)
    epochs(schedule, [3, 3, 3])
    assert not schedule.finished
    epochs(schedule, [3])
    assert schedule.finished


def test_plateau_goes_on_from_its_state():
    one = Plateau(epoch_sequences=100, patience=2)
    epochs(one, [5, 6])
    one.observe(7, 50)
    other = Plateau(epoch_sequences=100, patience=2)
    other.restore(one.state())
    one.observe(7, 50)
    other.observe(7, 50)
    assert one.factor(0) == other.factor(0) == pytest.approx(0.1)
