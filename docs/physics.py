"""Pictures of the physics: how contact is made, and what energy it costs."""

import math

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch

from docs.drawing import BLUE, GREY, GROUND, INK, ORANGE, PALE
from rollcast.scene import LARGE_RADIUS_M, Scene, Vector3
from rollcast.simulation.physics import Material, World
from rollcast.surfaces import Contact, EllipsoidalBowl, Heightfield
from rollcast.trajectory import FRAME_RATE_HZ


def contact() -> Figure:
    """Draw the planes that follow a ball, in a cut through a bowl and one through a heightfield."""
    figure = Figure(figsize=(8.4, 2.5), layout="constrained")
    bowl_axes, field_axes = figure.subplots(1, 2)
    x = np.linspace(-1, 1, 400)
    bowl = EllipsoidalBowl(1.0, 0.0)
    _cut(bowl_axes, x, bowl.height_and_normal(x, 0 * x)[0])
    way = 1 - LARGE_RADIUS_M
    for degrees, strength in ((-52, 0.3), (-30, 0.55), (-8, 1.0)):
        angle = math.radians(degrees)
        centre = (way * math.sin(angle), 0.0, 1 - way * math.cos(angle))
        _ball_on_planes(bowl_axes, centre, bowl.contacts(centre, LARGE_RADIUS_M), strength)
    bowl_axes.set(xlim=(-1.06, 1.06), ylim=(-0.08, 1.014), title="in a bowl: one plane")
    field, centre, angle = _tight_place()
    along = np.linspace(-0.7, 0.7, 500)
    x, y = centre[0] + along * math.cos(angle), centre[1] + along * math.sin(angle)
    _cut(field_axes, along, field.height_and_normal(x, y)[0] - centre[2])
    near = [
        Contact(*(_in_cut(part, angle) for part in (np.subtract(one.point, centre), one.normal)))
        for one in field.contacts(centre, LARGE_RADIUS_M)
    ]
    _ball_on_planes(field_axes, (0.0, 0.0, 0.0), near, 1.0)
    field_axes.set(
        xlim=(-0.62, 0.62), ylim=(-0.325, 0.315),
        title="on tight ground: one for every near point",
    )  # fmt: skip
    for axes in (bowl_axes, field_axes):
        axes.set_aspect("equal")
        axes.axis("off")
    return figure


def energy() -> Figure:
    """Draw the height that a ball loses where nothing brakes, for smaller and smaller steps."""
    figure = Figure(figsize=(5.2, 3.2), layout="constrained")
    axes = figure.subplots()
    rates = np.array([4, 6, 9, 14, 20, 30])
    for degrees, color in ((40, BLUE), (25, ORANGE)):
        lost = [100 * _lost_in_four_swings(degrees, int(rate)) for rate in rates]
        label = f"ball let go {degrees}° from the bottom"
        axes.plot(rates * FRAME_RATE_HZ, lost, "o-", color=color, label=label)
    axes.axvline(360, color=PALE, zorder=0)
    axes.text(372, axes.get_ylim()[1], "360 Hz, as simulated", color=GREY, va="top")
    axes.set(
        xscale="log", yscale="log", xlabel="steps a second",
        ylabel="height lost in four swings, %", xticks=rates * FRAME_RATE_HZ,
    )  # fmt: skip
    axes.xaxis.set_major_formatter("{x:.0f}")
    axes.xaxis.set_minor_locator(mpl.ticker.NullLocator())
    axes.yaxis.set_major_formatter("{x:g}")
    axes.legend(frameon=False, loc="lower left")
    return figure


def _in_cut(vector: np.ndarray, angle: float) -> tuple[float, float, float]:
    """Return a vector in axes whose x points along the cut."""
    x, y, z = map(float, vector)
    turned = x * math.cos(angle) + y * math.sin(angle), y * math.cos(angle) - x * math.sin(angle)
    return *turned, z


def _cut(axes: Axes, x: np.ndarray, height: np.ndarray) -> None:
    """Draw the ground below a line of heights."""
    axes.fill_between(x, height, -1, color=GROUND, linewidth=0)
    axes.plot(x, height, color=INK, linewidth=1.6)


def _ball_on_planes(axes: Axes, centre: Vector3, contacts: list[Contact], strength: float) -> None:
    """Draw a ball, its planes and their normals in the plane of x and z."""
    x, _, z = centre
    axes.add_patch(Circle((x, z), LARGE_RADIUS_M, facecolor="white", edgecolor=INK, alpha=strength))
    axes.plot(x, z, "o", color=INK, markersize=3, alpha=strength)
    for point, normal in contacts:
        (px, _, pz), (nx, _, nz) = point, normal
        along = 0.3 * np.array([[-nz, nx], [nz, -nx]]) + (px, pz)
        axes.plot(*along.T, color=ORANGE, linewidth=2.5, alpha=strength, solid_capstyle="round")
        axes.plot(px, pz, "o", color=ORANGE, markersize=5, alpha=strength)
        axes.add_patch(
            FancyArrowPatch(
                (px, pz), (px + 0.16 * nx, pz + 0.16 * nz), color=BLUE, arrowstyle="-|>",
                mutation_scale=10, linewidth=1.5, shrinkA=0, shrinkB=0, alpha=strength,
            )
        )  # fmt: skip


def _tight_place() -> tuple[Heightfield, tuple[float, float, float], float]:
    """Return a heightfield, a resting place with two contacts, and the direction of the cut."""
    best = None
    for offset in np.arange(-1.5, 1.5, 0.5).tolist():
        field = Heightfield(0.25, (offset, 0.37), 0.0)
        for x, y in np.mgrid[-0.8:0.8:0.05, -0.8:0.8:0.05].reshape(2, -1).T.tolist():
            centre = (x, y, field.resting_height(x, y, LARGE_RADIUS_M))
            near = field.contacts(centre, LARGE_RADIUS_M)
            if len(near) != 2 or math.dist(near[1].point, centre) > LARGE_RADIUS_M + 4e-3:
                continue
            one, other = (np.array(contact.point[:2]) - (x, y) for contact in near)
            direction = (other - one) / np.linalg.norm(other - one)
            aside = abs(one[0] * direction[1] - one[1] * direction[0])
            balance = abs(np.linalg.norm(one) - np.linalg.norm(other))
            if best is None or aside + balance < best[0]:
                angle = math.atan2(direction[1], direction[0])
                best = (aside + balance, field, centre, angle)
    assert best is not None
    return best[1:]


def _lost_in_four_swings(degrees: float, steps_per_frame: int) -> float:
    """Return the share of its height that a ball loses in four swings without resistance."""
    bowl = EllipsoidalBowl(1.0, 0.0)
    place = bowl.point_at(math.pi - math.radians(degrees), 0.3)
    centre = np.asarray(place.point) + LARGE_RADIUS_M * np.asarray(place.normal)
    scene = Scene.model_validate(
        {
            "scenario": "hemisphere", "seed": 0, "textured": False, "radius_m": LARGE_RADIUS_M,
            "rotation_rad": 0.0, "axis_ratio": 1.0, "positions_m": (tuple(centre.tolist()),),
            "velocities_m_s": ((0.0, 0.0, 0.0),), "orientations_xyzw": ((0.0, 0.0, 0.0, 1.0),),
        }
    )  # fmt: skip
    world = World(Material(rolling_resistance=0, damping=0), steps_per_frame)
    world.load(scene)
    heights = []
    for _ in range(400):
        world.step_frame()
        heights.append(world.state().centres[0][2] - LARGE_RADIUS_M)
    world.close()
    z = np.array(heights)
    tops = np.flatnonzero((z[1:-1] > z[:-2]) & (z[1:-1] >= z[2:])) + 1
    slope, bend = (z[tops + 1] - z[tops - 1]) / 2, z[tops + 1] - 2 * z[tops] + z[tops - 1]
    exact = z[tops] - slope**2 / (2 * bend)
    return float((exact[0] - exact[8]) / exact[0])
