"""Appearances: functions of their generator, immutable, within what they say of themselves."""

import dataclasses

import numpy as np
import pytest

from rollcast.simulation.appearance import (
    BALL_PATTERNS,
    CLUTTER_KINDS,
    GROUND_PATTERNS,
    Appearance,
    CameraPose,
    Sensor,
    draw_appearance,
    draw_ball,
    draw_sensor,
    mean_color,
)


@pytest.fixture(scope="module")
def drawn() -> list[Appearance]:
    generator = np.random.default_rng(1)
    return [draw_appearance(generator) for _ in range(400)]


def test_the_generator_alone_decides():
    one, other = (draw_appearance(np.random.default_rng(5)) for _ in range(2))
    assert one == other
    assert one != draw_appearance(np.random.default_rng(6))


def test_they_are_immutable_and_hashable(drawn):
    with pytest.raises(dataclasses.FrozenInstanceError):
        drawn[0].ball = drawn[1].ball
    assert len({hash(appearance) for appearance in drawn}) == len(drawn)


def test_every_pattern_and_every_kind_of_clutter_is_drawn(drawn):
    assert {a.ball.pattern for a in drawn} == set(BALL_PATTERNS)
    assert {a.ground.pattern for a in drawn} == set(GROUND_PATTERNS)
    assert {thing.kind for a in drawn for thing in a.clutter} == set(CLUTTER_KINDS)


def test_colors_and_shares_lie_between_zero_and_one(drawn):
    for a in drawn:
        colors = (*a.ball.colors, *a.ground.colors, *a.surroundings.colors)
        assert 0 <= np.min(colors) <= np.max(colors) <= 1
        shares = (a.lamp.ambient, a.lamp.falloff, a.lamp.shadow, a.sensor.shutter)
        assert 0 <= min(shares) <= max(shares) <= 1
        assert np.linalg.norm(a.lamp.direction) == pytest.approx(1)
        assert 1 <= a.sensor.quality <= 100


def test_grounds_and_balls_are_white_black_grey_and_colored(drawn):
    balls = np.array([a.ball.colors[0] for a in drawn])
    grounds = np.array([mean_color(a.ground) for a in drawn])
    for colors in (balls, grounds):
        spread = np.ptp(colors, axis=1)
        assert np.mean(spread > 0.3) > 0.2
        assert np.mean(spread < 0.1) > 0.1
    assert np.mean(balls.min(axis=1) > 0.75) > 0.1
    assert np.mean(balls.max(axis=1) < 0.2) > 0.03


def test_a_ball_can_be_told_from_its_ground():
    generator = np.random.default_rng(2)
    beneath = (0.1, 0.5, 0.3)
    apart = [
        np.linalg.norm(np.subtract(draw_ball(generator, beneath).colors[0], beneath))
        for _ in range(300)
    ]
    assert np.mean(np.array(apart) > 0.18) > 0.99


def test_every_effect_is_absent_in_most_windows(drawn):
    for field in ("gamma", "noise", "blur", "vignette", "flicker", "shake", "codec"):
        usual = getattr(Sensor(), field)
        absent = np.mean([getattr(a.sensor, field) == usual for a in drawn])
        assert 0.4 < absent < 0.95, field


def test_without_strength_camera_and_sensor_do_nothing():
    generator = np.random.default_rng(3)
    appearance = draw_appearance(generator, strength=0)
    assert appearance.camera == CameraPose()
    sensor = draw_sensor(generator, strength=0)
    ignored = {"reflection_at", "noise_cell", "quality", "seed"}
    for field in {field.name for field in dataclasses.fields(Sensor)} - ignored:
        assert getattr(sensor, field) == getattr(Sensor(), field), field


def test_the_last_frame_is_the_reference_of_a_shaking_camera(drawn):
    assert {a.sensor.shake[-1] for a in drawn} == {(0.0, 0.0)}
