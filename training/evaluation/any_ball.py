"""How well a network for any number of balls sees and forecasts, against what is true."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Float, UInt8
from scipy.optimize import linear_sum_assignment

from rollcast.ball_finding import Arrays, Balls, find_balls
from rollcast.camera import NETWORK_FRAME_SIZE
from training.networks.any_ball import AnyBallNet, Seen
from training.networks.ball_detector import peaks

HALF = NETWORK_FRAME_SIZE / 2


class TorchFinder:
    """A network's functions as :func:`rollcast.ball_finding.find_balls` asks for them."""

    def __init__(self, network: AnyBallNet) -> None:
        self.network = network.eval()

    def detect(self, frames: UInt8[np.ndarray, "1 4 128 128 3"]) -> Arrays:
        """Frames to candidates, votes and maps."""
        with torch.inference_mode():
            maps = self.network.eye.detector.maps(torch.from_numpy(np.ascontiguousarray(frames)))
            found = peaks(maps)
            votes = torch.cat(
                [
                    maps.places.flatten(1, 2), maps.log_radius[:, None],
                    maps.heat[:, None].sigmoid(), maps.moving[:, None].sigmoid(),
                ],
                dim=1,
            )  # fmt: skip
        said = {**found._asdict(), "votes": votes, "ground": maps.ground, "scene": maps.scene}
        return {name: value.numpy() for name, value in said.items()}

    def refine(
        self, patches: Float[np.ndarray, "balls 4 3 32 32"], wanted: Sequence[str]
    ) -> Arrays:
        """Patches to what is wanted of them."""
        with torch.inference_mode():
            said = self.network.eye.refiner(torch.from_numpy(patches.astype(np.float32)))
        return {name: getattr(said, name).numpy() for name in wanted}

    def find(
        self,
        frames: UInt8[np.ndarray, "4 height width 3"],
        prompts: Float[np.ndarray, "balls 2"] | None = None,
    ) -> tuple[Balls, Arrays]:
        """Find balls, see :func:`rollcast.ball_finding.find_balls`."""
        return find_balls(self.detect, self.refine, frames, prompts)

    def forecast(self, balls: Balls, said: Arrays, horizon: int) -> dict[str, np.ndarray]:
        """Positions [N, T, 2] in px of 128, covariances and angular velocities of the steps."""

        def tensor(array: np.ndarray) -> torch.Tensor:
            return torch.from_numpy(np.asarray(array, np.float32))[None]

        with torch.inference_mode():
            places = tensor(balls.places)
            seen = Seen(
                places, places, tensor(balls.radii), tensor(balls.visible),
                tensor(balls.log_sigmas), tensor(balls.features),
            )  # fmt: skip
            ground, scene = tensor(said["ground"][0]), tensor(said["scene"][0])
            beginning = self.network.eye.begin(seen, ground, scene)
            state = self.network.state(seen, beginning, ground)
            made = self.network.roll_out(state, horizon)
        assert made.covariances is not None
        assert made.angular_velocities is not None
        return {
            "positions": made.positions[0].numpy(),
            "covariances": made.covariances[0].numpy(),
            "angular_velocities": made.angular_velocities[0].numpy(),
        }


def matched(found: Float[np.ndarray, "found 2"], truth: Float[np.ndarray, "balls 2"]) -> np.ndarray:
    """Index of the found ball that is each true one, by the least sum of distances."""
    apart = np.linalg.norm(found[None] - truth[:, None], axis=-1)
    rows, columns = linear_sum_assignment(apart)
    index = np.full(len(truth), -1)
    index[rows] = columns
    return index


def scene_errors(
    finder: TorchFinder,
    windows: Sequence[tuple[np.ndarray, np.ndarray]],
    horizon: int,
    *,
    prompted: bool = False,
) -> Mapping[str, np.ndarray]:
    """Errors in px of windows (frames, true positions [N, T, 2]) whose balls all move.

    Balls that were not found count as lost and as far off as the middle of the frame.
    """
    errors: list[np.ndarray] = []
    lost = 0
    for frames, truth in windows:
        prompts = (truth[:, 0] - HALF) / HALF if prompted else None
        balls, said = finder.find(frames, prompts)
        if not prompted:
            order = np.argsort(-balls.scores * balls.moving, kind="stable")
            balls = balls.taken(order[: len(truth)])
        made = finder.forecast(balls, said, horizon)["positions"]
        index = matched(made[:, 0], truth[:, 0])
        for ball, one in enumerate(index.tolist()):
            way = made[one] if one >= 0 else np.full((horizon, 2), HALF)
            off = np.linalg.norm(way - truth[ball, :horizon], axis=-1)
            lost += int(off[0] > 5)
            errors.append(off)
    return {"errors": np.array(errors), "lost": np.array(lost)}
