import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rollcast.surfaces import EllipsoidalBowl

ratios = st.floats(0.5, 1.0)
turns = st.floats(-math.pi, math.pi)
RADII = (0.04, 0.225)


def points_of(bowl: EllipsoidalBowl, count: int) -> np.ndarray:
    """Points of the lower half, densely spread."""
    polar, azimuth = np.meshgrid(
        np.linspace(math.pi / 2, math.pi, count), np.linspace(-math.pi, math.pi, 4 * count)
    )
    return np.array(
        [bowl.point_at(*angles).point for angles in zip(polar.flat, azimuth.flat, strict=True)]
    )


@given(ratios, turns, st.floats(math.pi / 2, math.pi), turns)
def test_points_satisfy_the_papers_equation(ratio, rotation, polar, azimuth):
    x, y, z = EllipsoidalBowl(ratio, rotation).point_at(polar, azimuth).point
    own_x = math.cos(rotation) * x + math.sin(rotation) * y
    own_y = math.cos(rotation) * y - math.sin(rotation) * x
    assert own_x**2 / ratio**2 + own_y**2 + (z - 1) ** 2 == pytest.approx(1)
    assert z <= 1 + 1e-12


@given(ratios, turns, st.floats(1.6, 3.1), turns)
def test_normals_agree_with_finite_differences_and_point_inwards(ratio, rotation, polar, azimuth):
    bowl = EllipsoidalBowl(ratio, rotation)
    h = 1e-6

    def point(d_polar: float, d_azimuth: float) -> np.ndarray:
        return np.array(bowl.point_at(polar + d_polar, azimuth + d_azimuth).point)

    here = bowl.point_at(polar, azimuth)
    assert math.hypot(*here.normal) == pytest.approx(1)
    assert np.dot(point(h, 0) - point(-h, 0), here.normal) / h == pytest.approx(0, abs=1e-7)
    assert np.dot(point(0, h) - point(0, -h), here.normal) / h == pytest.approx(0, abs=1e-7)
    assert np.dot(np.array([0, 0, 1]) - here.point, here.normal) > 0


@given(ratios, turns, st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_heights_and_normals_over_the_plane_are_those_of_the_points(ratio, rotation, u, v):
    bowl = EllipsoidalBowl(ratio, rotation)
    polar = math.pi - math.asin(math.hypot(u, v))
    point, normal = bowl.point_at(polar, math.atan2(v, u))
    z, normals = bowl.height_and_normal(np.array([point[0]]), np.array([point[1]]))
    np.testing.assert_allclose(z, [point[2]], atol=1e-9)
    np.testing.assert_allclose(normals, [normal], atol=1e-9)


def test_there_is_no_surface_beyond_the_rim():
    bowl = EllipsoidalBowl(0.5, math.pi / 2)
    across = bowl.height_and_normal(np.array([0.99, 1.01, 0, 0]), np.array([0, 0, 0.49, 0.51]))[0]
    np.testing.assert_array_equal(np.isnan(across), [False, True, False, True])


@given(
    ratios, turns, st.floats(math.pi / 2, math.pi), turns, st.sampled_from(RADII),
    st.floats(-0.01, 0.01),
)  # fmt: skip
def test_the_nearest_point_lies_along_the_normal(ratio, rotation, polar, azimuth, radius, gap):
    """A centre that lies ``radius + gap`` above a point has that point for its nearest.

    This holds as long as the centre stays within the tightest curvature there, a^2.
    """
    bowl = EllipsoidalBowl(ratio, rotation)
    foot, normal = bowl.point_at(polar, azimuth)
    height = min(radius + gap, 0.99 * ratio**2)
    centre = tuple(np.add(foot, np.multiply(height, normal)))
    (contact,) = bowl.contacts(centre, radius)
    np.testing.assert_allclose(contact.point, foot, atol=1e-7)
    np.testing.assert_allclose(contact.normal, normal, atol=1e-6)


@pytest.mark.parametrize("ratio", [0.5, 0.75, 1.0])
def test_no_point_of_the_bowl_is_nearer(ratio):
    bowl = EllipsoidalBowl(ratio, 0.4)
    points = points_of(bowl, 120)
    generator = np.random.default_rng(1)
    for _ in range(30):
        # Somewhere inside the bowl, by angles and a share of the way to its surface.
        foot = bowl.point_at(generator.uniform(1.7, 3.1), generator.uniform(-3, 3)).point
        centre = np.array([0, 0, 1]) + generator.uniform(0.3, 1) * (np.array(foot) - [0, 0, 1])
        (contact,) = bowl.contacts(tuple(centre), 0.1)
        found = math.dist(contact.point, centre)
        brute_force = np.linalg.norm(points - centre, axis=1).min()
        assert found <= brute_force + 1e-9
        assert found == pytest.approx(brute_force, abs=2e-3)


def test_texture_angles_follow_the_turned_bowl():
    bowl = EllipsoidalBowl(0.6, 0.9)
    contact = bowl.point_at(math.pi - 0.8, 0.3)
    polar, azimuth = bowl.angles(np.array([contact.point[0]]), np.array([contact.point[1]]))
    assert polar == pytest.approx(0.8)
    assert azimuth == pytest.approx(0.3)


def test_between_the_long_sides_either_nearest_point_will_do():
    """On the plane x = 0 a slim bowl is equally near on both sides."""
    (contact,) = EllipsoidalBowl(0.5, 0.0).contacts((0.0, 0.0, 1.0), 0.225)
    assert abs(contact.point[0]) == pytest.approx(0.5)
    assert contact.point[1:] == pytest.approx((0, 1))


@pytest.mark.parametrize(
    ("centre", "clear"),
    [
        ((0.0, 0.0, 1.0), True),
        ((0.0, 0.0, 0.225), True),
        ((0.0, 0.0, 0.1), False),
        ((0.0, 0.0, -0.3), False),
        ((0.7, 0.0, 1.0), True),
        ((0.9, 0.0, 1.0), False),
        ((1.3, 0.0, 1.0), False),
    ],
)
def test_a_ball_starts_inside_the_bowl(centre, clear):
    assert EllipsoidalBowl(1.0, 0.3).clears(centre, 0.225) == clear
