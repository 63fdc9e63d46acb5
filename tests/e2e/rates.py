"""How far forecasts err whose frames a camera took at another rate than the models know.

python -m tests.e2e.rates ADDRESS --scenes 60

Scenes of the test split, drawn at the camera's times; the error after 20 steps of 25 ms.
"""

import argparse
from collections.abc import Iterator

import numpy as np

from rollcast import markdown
from rollcast.camera import camera_for
from rollcast.client import Client
from rollcast.footage import Footage, SquareCrop
from rollcast.scene import SCENARIOS, Scenario
from rollcast.simulation.recording import TEST_START, Simulator
from rollcast.simulation.rendering import Renderer
from rollcast.trajectory import FIRST_FORECAST_FRAME, FRAME_RATE_HZ, OBSERVED_FRAMES, Trajectory
from training.data.splits import seeds

SIDE = 256
STEPS = 20
WAYS = ("at the models' rate", "as if at the models' rate", "told", "blended")


def errors(client: Client, scenario: Scenario, rate: float, scenes: int) -> dict[str, float]:
    """Mean error in 128-pixel units by what is done with the camera's frames."""
    found: dict[str, list[float]] = {way: [] for way in WAYS}
    for whole, renderer in _scenes(scenario, scenes):
        begun = TEST_START[scenario]
        known = np.arange(OBSERVED_FRAMES) + begun
        taken = begun + np.arange(8) * FRAME_RATE_HZ / rate
        frames = renderer.render(at(whole, taken))
        camera = Footage(frames, np.arange(8) / rate, SquareCrop(0, 0, SIDE))
        blended = camera.resampled(FRAME_RATE_HZ, OBSERVED_FRAMES)
        first = frames[:OBSERVED_FRAMES]
        # The last frame seen, and the distance of the steps, in frames of the simulation.
        asked = {
            WAYS[0]: (renderer.render(at(whole, known)), FRAME_RATE_HZ, known[-1], 1.0),
            WAYS[1]: (first, FRAME_RATE_HZ, taken[OBSERVED_FRAMES - 1], 1.0),
            WAYS[2]: (first, rate, taken[OBSERVED_FRAMES - 1], FRAME_RATE_HZ / rate),
            WAYS[3]: (blended.frames, FRAME_RATE_HZ, known[-1], 1.0),
        }
        for way, (seen, told, now, step) in asked.items():
            steps = round((STEPS - 1) / step) + 1
            forecast = client.predict(seen, horizon=steps, frame_rate=told, scenario=scenario)
            truth = at(whole, np.array([now + (steps - 1) * step]))
            place = camera_for(scenario, SIDE).project(truth.positions_m)[0, 0]
            off = np.linalg.norm(forecast.positions[0, -1] - place)
            found[way].append(float(off) * 128 / SIDE)
    return {way: float(np.mean(values)) for way, values in found.items()}


def at(whole: Trajectory, times: np.ndarray) -> Trajectory:
    """Return the states at times between frames, by cubics through four of them."""
    first = np.floor(times).astype(int)
    share = times - first

    def cubic(values: np.ndarray) -> np.ndarray:
        before, here, after, later = (values[first + k] for k in (-1, 0, 1, 2))
        u = share.reshape(-1, *[1] * (values.ndim - 1))
        bend = 2 * before - 5 * here + 4 * after - later + u * (3 * (here - after) + later - before)
        return here + u / 2 * (after - before + u * bend)

    turned = whole.orientations_xyzw.copy()
    for index in range(1, len(turned)):  # a quaternion and its negative are one orientation
        turned[index] *= np.where((turned[index] * turned[index - 1]).sum(-1) < 0, -1, 1)[:, None]
    orientations = cubic(turned)
    orientations /= np.linalg.norm(orientations, axis=-1, keepdims=True)
    return Trajectory(cubic(whole.positions_m), orientations, cubic(whole.angular_velocities_rad_s))


def _scenes(scenario: Scenario, scenes: int) -> Iterator[tuple[Trajectory, Renderer]]:
    simulator = Simulator()
    frames = TEST_START[scenario] + FIRST_FORECAST_FRAME + 2 * STEPS + 8
    for seed in seeds("test", scenes):
        sequence = simulator.sequence(scenario, 1, seed, frames, 0)
        yield sequence.trajectory, Renderer(sequence.scene, camera_for(scenario, SIDE))
    simulator.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("address")
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--rates", type=float, nargs="+", default=[24, 25, 30, 50, 60])
    given = parser.parse_args()
    print(markdown.header(("scenario", "rate", *WAYS)))
    with Client(given.address) as client:
        for scenario in SCENARIOS:
            for rate in given.rates:
                found = errors(client, scenario, rate, given.scenes)
                cells = [f"{found[way]:.1f}" for way in WAYS]
                print(markdown.row((scenario, f"{rate:g}", *cells)), flush=True)


if __name__ == "__main__":
    main()
