import numpy as np
import torch

from training.data.ball_batch import BallBatch, BallWindow, collate
from training.networks.any_ball import Beginning, Seen
from training.networks.ball_detector import BallMaps
from training.objectives.detection import DetectionLoss, RefinementLoss, chosen


def window(balls: int) -> BallWindow:
    """Balls along the diagonal that go to the right."""
    start = np.linspace(-0.6, 0.6, balls)[:, None, None] * np.ones((1, 4, 2))
    places = start + 0.02 * np.arange(-3, 1)[None, :, None] * np.array([1, 0])
    centres = np.full((balls, 43, 3), np.nan)
    centres[:, :4, :2] = places
    ground = np.zeros((3, 32, 32))
    ground[2] = np.nan
    return BallWindow(
        np.zeros((4, 128, 128, 3), np.uint8), places, np.full(balls, 0.1), np.ones((balls, 4)),
        np.ones(balls), centres, np.full((balls, 40, 3), np.nan), ground, np.full(2, np.nan),
    )  # fmt: skip


def maps_of(batch: BallBatch) -> BallMaps:
    """Maps that say of every cell what is true of the ball nearest to it."""
    along = (torch.arange(32) + 0.5) / 16 - 1
    y, x = torch.meshgrid(along, along, indexing="ij")
    heat = torch.full((len(batch.frames), 32, 32), -9.0)
    places = torch.zeros(len(batch.frames), 4, 2, 32, 32)
    for row, there in enumerate(batch.there):
        known = batch.places[row][there > 0]
        apart = torch.stack([(x - p[3, 0]) ** 2 + (y - p[3, 1]) ** 2 for p in known])
        places[row] = known[apart.argmin(dim=0)].permute(2, 3, 0, 1)
        for ball in known:
            column, line = ((ball[3] + 1) * 16).floor().long().tolist()
            heat[row, line, column] = 9.0
    flat = torch.zeros_like(heat)
    radius = torch.full_like(heat, 0.1).log()
    return BallMaps(
        heat, flat + 9, places, radius, torch.zeros(len(heat), 3, 32, 32), torch.zeros(len(heat), 2)
    )


def test_the_truth_costs_nearly_nothing_and_every_mistake_something():
    batch = collate([window(1), window(3), window(8)])
    right = maps_of(batch)
    loss = DetectionLoss()
    known = loss(right, batch)
    assert all(part < 0.05 for part in known.values()), known
    wrong = {
        "heat": right._replace(heat=right.heat.roll(5, dims=2)),
        "votes": right._replace(places=right.places + 0.1),
        "vote radius": right._replace(log_radius=right.log_radius + 0.5),
        "moving": right._replace(moving=-right.moving),
        "ground": right._replace(ground=right.ground + 0.1),
    }
    for name, maps in wrong.items():
        assert loss(maps, batch)[name] > known[name] + 0.2, name


def test_what_is_not_known_costs_nothing():
    batch = collate([window(2)])
    maps = maps_of(batch)
    other = maps._replace(scene=maps.scene + 3)
    assert DetectionLoss()(other, batch)["scene"] == 0


def seen_of(batch: BallBatch, error: float) -> tuple[Seen, Beginning]:
    places = batch.places.nan_to_num() + error * torch.arange(4)[:, None]
    count = places.shape[:2]
    last = torch.cat([places[:, :, -1], torch.zeros(*count, 1)], dim=-1)
    velocity = last - torch.cat([places[:, :, -2], torch.zeros(*count, 1)], dim=-1)
    radii = batch.radii.nan_to_num(0.1)
    edges = 30.0 * (torch.arange(13) == 6).expand(*count, 4, 24, 13)
    seen = Seen(
        places, places, edges, radii / 2, places, radii, 9 * torch.ones(*count, 4),
        -4 * torch.ones(*count, 2), torch.zeros(*count, 128),
    )  # fmt: skip
    return seen, Beginning(last, velocity, torch.zeros(*count, 3), torch.zeros(*count, 2))


def test_patches_that_show_the_truth_cost_nearly_nothing():
    batch = collate([window(3), window(3)])
    batch = chosen(batch, torch.tensor([[0, 2], [1, 1]]))
    right = RefinementLoss()(*seen_of(batch, 0.0), batch)
    wrong = RefinementLoss()(*seen_of(batch, 0.02), batch)
    for name in ("rough", "outline", "edges", "places", "displacements", "centres", "velocities"):
        assert right[name] < 1e-3
        assert wrong[name] > right[name] + 0.3, name
    assert torch.isfinite(torch.stack(list(wrong.values()))).all()


def test_balls_that_are_not_there_teach_only_that():
    batch = chosen(collate([window(1)]), torch.tensor([[0, 5]]))
    seen, balls = seen_of(batch, 0.0)
    strange = seen.places.clone()
    strange[:, 1] += 0.7
    usual = RefinementLoss()(seen, balls, batch)
    other = RefinementLoss()(
        seen._replace(places=strange, rough=strange, outline=strange), balls, batch
    )
    assert all(torch.equal(usual[name], other[name]) for name in usual)
