"""How far forecasts err whose frames a camera took at another rate than most models know.

Scenes of the test split, drawn at the camera's times; the error after 20 steps of 25 ms.
"""

from collections.abc import Iterator

import numpy as np

from rollcast.camera import camera_for
from rollcast.client import Client
from rollcast.footage import Footage, SquareCrop
from rollcast.scene import Scenario
from rollcast.simulation.recording import TEST_START, Simulator
from rollcast.simulation.rendering import Renderer
from rollcast.trajectory import FIRST_FORECAST_FRAME, FRAME_RATE_HZ, OBSERVED_FRAMES, Trajectory
from training.data.frame_spacing import states_at
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
        frames = renderer.render(states_at(whole, taken))
        camera = Footage(frames, np.arange(8) / rate, SquareCrop(0, 0, SIDE))
        blended = camera.resampled(FRAME_RATE_HZ, OBSERVED_FRAMES)
        first = frames[:OBSERVED_FRAMES]
        # The last frame seen, and the distance of the steps, in frames of the simulation.
        asked = {
            WAYS[0]: (renderer.render(states_at(whole, known)), FRAME_RATE_HZ, known[-1], 1.0),
            WAYS[1]: (first, FRAME_RATE_HZ, taken[OBSERVED_FRAMES - 1], 1.0),
            WAYS[2]: (first, rate, taken[OBSERVED_FRAMES - 1], FRAME_RATE_HZ / rate),
            WAYS[3]: (blended.frames, FRAME_RATE_HZ, known[-1], 1.0),
        }
        for way, (seen, told, now, step) in asked.items():
            steps = round((STEPS - 1) / step) + 1
            forecast = client.predict(seen, horizon=steps, frame_rate=told, scenario=scenario)
            truth = states_at(whole, np.array([now + (steps - 1) * step]))
            place = camera_for(scenario, SIDE).project(truth.positions_m)[0, 0]
            off = np.linalg.norm(forecast.positions[0, -1] - place)
            found[way].append(float(off) * 128 / SIDE)
    return {way: float(np.mean(values)) for way, values in found.items()}


def _scenes(scenario: Scenario, scenes: int) -> Iterator[tuple[Trajectory, Renderer]]:
    simulator = Simulator()
    frames = TEST_START[scenario] + FIRST_FORECAST_FRAME + 2 * STEPS + 8
    for seed in seeds("test", scenes):
        sequence = simulator.sequence(scenario, 1, seed, frames, 0)
        yield sequence.trajectory, Renderer(sequence.scene, camera_for(scenario, SIDE))
    simulator.close()
