"""Measures a running service on simulated frames at other rates than the usual one.

    python -m training frame-rates http://127.0.0.1:8000

The states between two frames of a simulation are interpolated. Every forecast covers half a second,
or the first step after it; a rate's figure is the error there relative to that at the usual rate.
"""

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from rollcast.camera import NETWORK_FRAME_SIZE, camera_for
from rollcast.client import Client
from rollcast.markdown import table
from rollcast.scene import Scenario
from rollcast.simulation.recording import TEST_START
from rollcast.trajectory import FIRST_FORECAST_FRAME, FRAME_RATE_HZ
from training.data.frame_spacing import seen_states, states_at
from training.data.shards import Recording, Source, load_recordings, simulate_split
from training.data.windows import WindowMaker

RATES: Sequence[int] = (40, 15, 24, 30, 60, 120)
"""Frames a second; the first is the usual one."""
SECONDS = 0.5


def measure(
    service: Client, scenarios: Sequence[Scenario], scenes: int, workers: int, model: str
) -> Iterator[tuple[int, Mapping[Scenario, np.ndarray]]]:
    """Yield every rate with the errors of each scenario's test scenes, pixels of 128."""
    recordings: dict[Scenario, Sequence[Recording]] = {
        scenario: load_recordings(simulate_split(Source(scenario), "test", scenes, workers))
        for scenario in scenarios
    }
    for rate in RATES:
        yield rate, {name: _errors(service, some, rate, model) for name, some in recordings.items()}


def _errors(service: Client, recordings: Sequence[Recording], rate: int, model: str) -> np.ndarray:
    spacing = FRAME_RATE_HZ / rate
    step = math.ceil(SECONDS * rate)
    maker = WindowMaker(recordings, None)
    errors: list[float] = []
    for index, recording in enumerate(recordings):
        scenario = recording.scene.scenario
        start = TEST_START[scenario]
        frames = maker.renderer(index).render(seen_states(recording.trajectory, start, spacing))
        answer = service.predict(
            frames, horizon=step + 1, num_objects=1, model=model, frame_rate=rate
        )
        then = np.array([start + FIRST_FORECAST_FRAME + step * spacing])
        place = states_at(recording.trajectory, then).positions_m[0, 0]
        truth = camera_for(scenario, NETWORK_FRAME_SIZE).project(place)
        errors.append(float(np.linalg.norm(answer.positions[0, step] - truth)))
    return np.array(errors)


def results_table(measured: Sequence[tuple[int, Mapping[Scenario, np.ndarray]]]) -> str:
    """Return the table of a measurement, the usual rate first."""
    usual = {scenario: errors.mean() for scenario, errors in measured[0][1].items()}
    rows = [
        [
            str(rate),
            *(f"{errors.mean():.1f}" for errors in by_scenario.values()),
            f"{np.mean([e.mean() / usual[name] for name, e in by_scenario.items()]):.2f}",
        ]
        for rate, by_scenario in measured
    ]
    return table(["frames a second", *(f"{name}, px" for name in usual), "ratio"], rows)
