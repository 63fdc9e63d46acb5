"""PyBullet leaks with shapes and clients; simulating must not. Several thousand: tests/soak.

Measured in processes of their own: what other tests freed can be taken again at any time.
"""

import multiprocessing
import tracemalloc
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

from rollcast.scene import SCENARIOS, Scene
from rollcast.simulation.physics import World
from tests.soak.simulate_many import resident_mib


def in_a_process(measure: Callable[..., float], *args: object) -> float:
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
        return process.submit(measure, *args).result()


def growth_over_scenes(scenes: list[Scene], settling: int, count: int) -> float:
    """By how many MiB memory grows while ``count`` scenes are loaded into one world in turn."""
    world = World()

    def simulate(count: int) -> float:
        for index in range(count):
            world.load(scenes[index % len(scenes)])
            world.step_frame()
        return resident_mib()

    settled = simulate(settling)
    return simulate(count) - settled


def growth_over_worlds(scene: Scene, settling: int, count: int) -> float:
    """By how many MiB memory grows while ``count`` worlds are opened and closed."""

    def use_and_close(count: int) -> float:
        for _ in range(count):
            world = World()
            world.load(scene)
            world.step_frame()
            world.close()
        return resident_mib()

    settled = use_and_close(settling)
    return use_and_close(count) - settled


def test_memory_stays_flat_over_several_hundred_scenes(simulator):
    scenes = [
        simulator.sequence(scenario, objects, 3, 4).scene
        for scenario in SCENARIOS
        for objects in (1, 2)
    ]
    assert in_a_process(growth_over_scenes, scenes, 100, 300) < 1


def test_memory_is_given_back_with_the_client(simulator):
    scene = simulator.sequence("hemisphere", 1, 3, 4).scene
    assert in_a_process(growth_over_worlds, scene, 4, 12) < 4


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_memory_of_rendering_grows_with_the_frame_alone(simulator, scenario):
    sequence = simulator.sequence(scenario, 1, 3, 4)
    tracemalloc.start()
    try:
        (frame, *_) = sequence.render(1024)
        peak_mib = tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()
    assert peak_mib < 150  # 1,024 x 1,024 points and colours as float32 are 40
    (whole, *_) = sequence.render(128)
    of_blocks = frame.reshape(128, 8, 128, 8, 3).mean(axis=(1, 3))
    assert np.abs(of_blocks - whole).mean() < 3, "the strips fit together"
