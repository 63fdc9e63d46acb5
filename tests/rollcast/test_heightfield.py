import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rollcast.surfaces import Contact, Heightfield

scales = st.floats(0.2, 0.7)
places = st.floats(-1.25, 1.25)
offsets = st.tuples(st.floats(-2, 2), st.floats(-2, 2))
turns = st.floats(-math.pi, math.pi)


def distances_around(surface: Heightfield, centre: np.ndarray, reach: float) -> np.ndarray:
    """Distances from a point to the ground around it, on a grid of 4 mm."""
    steps = np.arange(-reach, reach, 4e-3)
    x, y = np.meshgrid(centre[0] + steps, centre[1] + steps, indexing="ij")
    z, _ = surface.height_and_normal(x, y)
    return np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2)


def grid_minima(distances: np.ndarray) -> np.ndarray:
    """Distances of the grid points that are nearer than all their eight neighbours."""
    inner = distances[1:-1, 1:-1]
    lowest = np.ones_like(inner, dtype=bool)
    rows, columns = inner.shape
    for i in range(3):
        for j in range(3):
            if (i, j) != (1, 1):
                lowest &= inner < distances[i : i + rows, j : j + columns]
    return np.sort(inner[lowest])


def distances(contacts: list[Contact], centre: np.ndarray) -> list[float]:
    return [math.dist(contact.point, centre) for contact in contacts]


@given(scales, offsets, turns, places, places)
def test_normals_agree_with_finite_differences_and_point_up(scale, offset, rotation, x, y):
    surface = Heightfield(scale, offset, rotation)
    h = 1e-6
    z, normals = surface.height_and_normal(
        np.array([x, x + h, x - h, x, x]), np.array([y, y, y, y + h, y - h])
    )
    normal = normals[0]
    assert np.linalg.norm(normal) == pytest.approx(1)
    assert normal[2] > 0
    assert -normal[0] / normal[2] == pytest.approx((z[1] - z[2]) / (2 * h), abs=1e-6)
    assert -normal[1] / normal[2] == pytest.approx((z[3] - z[4]) / (2 * h), abs=1e-6)


@given(scales, offsets, turns, places, places)
def test_one_point_and_many_agree(scale, offset, rotation, x, y):
    surface = Heightfield(scale, offset, rotation)
    contact = surface.contact_at(x, y)
    z, normals = surface.height_and_normal(np.array([x]), np.array([y]))
    np.testing.assert_allclose(contact.point, [x, y, z[0]], atol=1e-12)
    np.testing.assert_allclose(contact.normal, normals[0], atol=1e-12)


def test_turn_and_offset_move_the_landscape_under_the_camera():
    """The point of the noise plane under the camera is the offset, whatever the turn."""
    still, turned = Heightfield(0.4, (1.3, -0.7), 0.0), Heightfield(0.4, (1.3, -0.7), 0.9)
    assert turned.contact_at(0, 0).point == pytest.approx(still.contact_at(0, 0).point)
    moved = Heightfield(0.4, (0.0, 0.0), 0.0).contact_at(1.3, -0.7)
    assert still.contact_at(0, 0).point[2] == pytest.approx(moved.point[2])
    x, y = 0.3, 0.5
    c, s = math.cos(0.9), math.sin(0.9)
    same = still.contact_at(c * x + s * y, c * y - s * x)
    assert turned.contact_at(x, y).point[2] == pytest.approx(same.point[2])


@given(
    scales, offsets, turns, places, places, st.sampled_from([0.04, 0.225]),
    st.floats(-0.005, 0.02),
)  # fmt: skip
def test_every_contact_lies_along_its_normal(scale, offset, rotation, x, y, radius, gap):
    """Nearest points are where the line to the centre stands upright on the ground."""
    surface = Heightfield(scale, offset, rotation)
    centre = (x, y, surface.resting_height(x, y, radius) + gap)
    for contact in surface.contacts(centre, radius):
        towards = np.subtract(centre, contact.point)
        np.testing.assert_allclose(
            towards / np.linalg.norm(towards), contact.normal, atol=1e-5 / radius
        )


@pytest.mark.parametrize("scale", [0.2, 0.3, 0.5, 0.7])
@pytest.mark.parametrize("radius", [0.04, 0.225])
def test_the_first_contact_is_the_nearest_point_of_all(scale, radius):
    surface = Heightfield(scale, (0.4, -0.8), 0.5)
    generator = np.random.default_rng(3)
    for x, y in generator.uniform(-1, 1, (12, 2)):
        centre = np.array([x, y, surface.resting_height(x, y, radius)])
        nearest = distances_around(surface, centre, radius + 0.05).min()
        assert distances(surface.contacts(tuple(centre), radius), centre)[0] == pytest.approx(
            nearest, abs=4e-4
        )


def test_a_ball_in_a_tight_landscape_touches_several_points():
    surface = Heightfield(0.2, (0.4, -0.8), 0.5)
    radius = 0.225
    generator = np.random.default_rng(4)
    counts: list[int] = []
    for x, y in generator.uniform(-1, 1, (15, 2)):
        centre = np.array([x, y, surface.resting_height(x, y, radius)])
        reach = radius + 0.02
        expected = grid_minima(distances_around(surface, centre, reach + 0.05))
        found = distances(surface.contacts(tuple(centre), radius), centre)
        assert found == sorted(found)
        for distance in expected[expected < reach]:
            assert np.abs(np.array(found) - distance).min() < 1e-3
        counts.append(int(np.sum(expected < reach)))
    assert max(counts) >= 3


@settings(max_examples=20)
@given(scales, offsets, turns, places, places, st.sampled_from([0.04, 0.225]))
def test_a_ball_let_down_touches_and_never_sinks_in(scale, offset, rotation, x, y, radius):
    surface = Heightfield(scale, offset, rotation)
    centre = np.array([x, y, surface.resting_height(x, y, radius)])
    nearest = distances_around(surface, centre, radius + 0.05).min()
    assert nearest == pytest.approx(radius, abs=4e-4)
    for higher in (0.05, 0.2):
        assert (
            distances_around(surface, centre + np.array([0, 0, higher]), radius + 0.05).min()
            > radius
        )


def test_a_ball_starts_above_the_ground_and_within_the_walls():
    surface = Heightfield(0.5, (0.4, -0.8), 0.5)
    z = surface.resting_height(0.3, -0.2, 0.225)
    assert surface.clears((0.3, -0.2, z), 0.225)
    assert surface.clears((0.3, -0.2, z + 0.5), 0.225)
    assert not surface.clears((0.3, -0.2, z - 0.05), 0.225)
    assert not surface.clears((0.3, -0.2, z - 1), 0.225)
    assert surface.clears((1.0, 0.0, 1.5), 0.225)
    assert not surface.clears((1.1, 0.0, 1.5), 0.225)


def test_no_contact_is_overlooked_where_two_hollows_meet():
    """A ball that has rolled between the spikes of the tightest landscape (seed 9, frame 68)."""
    surface = Heightfield(
        0.2, (-0.014277640932801372, 0.7494813409743952), rotation_rad=-2.292663027916217
    )
    centre = np.array([-0.494, -0.785, 0.195])
    nearest = distances_around(surface, centre, 0.25).min()
    assert distances(surface.contacts(tuple(centre), 0.225), centre)[0] == pytest.approx(
        nearest, abs=1e-3
    )
