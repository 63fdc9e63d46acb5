"""The network for any number of balls: its initial weights and its training scenes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from rollcast.scene import SMALL_RADIUS_M
from training.data.ball_windows import BallSource, BallWindowMaker
from training.data.scene_cache import load_scene_cache
from training.data.shards import Source, Variety, load_recordings, simulate_split
from training.data.splits import Split
from training.networks.any_ball import AnyBallNet
from training.recipes.recipe import DataShare

ANY_BALL_DATA = (
    DataShare(Source("hemisphere"), 600, 0.14, 200),
    DataShare(Source("ellipsoid"), 1000, 0.26, 200),
    DataShare(Source("heightfield"), 400, 0.24, 140),
    DataShare(Source("hemisphere", radius_m=SMALL_RADIUS_M), 100, 0.02, 200),
    DataShare(Source("ellipsoid", radius_m=SMALL_RADIUS_M), 100, 0.02, 200),
    DataShare(Source("hemisphere", variety=Variety()), 500, 0.08, 200),
    DataShare(Source("ellipsoid", variety=Variety()), 600, 0.1, 200),
    DataShare(Source("heightfield", variety=Variety()), 300, 0.1, 140),
    DataShare(Source("ellipsoid", 2), 500, 0.17, 200),
    DataShare(Source("ellipsoid", 3), 400, 0.17, 200),
    DataShare(Source("table"), 1000, 0.16, 140),
    DataShare(Source("table", 2), 500, 0.08, 140),
    DataShare(Source("table", 3), 400, 0.08, 140),
)
"""Scenes of one, two and three balls; planar scenes have up to eight."""
VALIDATION_DATA = tuple(replace(part, scenes=50) for part in ANY_BALL_DATA)
"""Validation scenes of the same kinds, fewer of each."""


def ball_sources(
    data: Sequence[DataShare] = ANY_BALL_DATA, split: Split = "training", workers: int = 1
) -> list[BallSource]:
    """Return the simulated scenes, simulating missing ones."""
    sources: list[BallSource] = []
    for part in data:
        shards = simulate_split(part.source, split, part.scenes, workers)
        maker = BallWindowMaker(load_recordings(shards), load_scene_cache(shards, workers))
        sources.append(BallSource(maker, part.share, part.latest_start))
    return sources


def warm_network(one_ball: Mapping[str, Tensor], several: Mapping[str, Tensor]) -> AnyBallNet:
    """Return a network initialised from networks for a fixed number of balls.

    Perception, motion and covariance are those of FieldNet for one ball, pair interactions those
    for several. A ball without close neighbours moves exactly as in FieldNet for one ball.

    Parameters
    ----------
    one_ball, several
        Parameters of exported networks (:func:`training.export.load.read_parameters`).
    """
    network = AnyBallNet()
    own = network.state_dict()
    names = {
        "perception.first.": "perception.detector.",
        "perception.closer.": "perception.refiner.",
    }
    taken: dict[str, Tensor] = {}
    for name, value in one_ball.items():
        new = name
        for old, instead in names.items():
            new = new.replace(old, instead)
        if new not in own:
            continue
        shape = own[new].shape
        if value.shape != shape:
            # Inputs for encounters, or for the frames' spacing, are the last columns.
            wide = several[name] if several[name].shape == shape else torch.zeros(shape)
            value = torch.cat([value, wide[:, value.shape[1] :]], dim=1)
        taken[new] = value
    taken |= {name: value for name, value in several.items() if "pair_interaction" in name}
    network.load_state_dict(own | taken)
    return network
