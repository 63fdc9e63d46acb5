from collections.abc import Callable, Iterator

import pytest

from rollcast.simulation import Simulator
from rollcast.simulation.physics import STEPS_PER_FRAME, Material, World


@pytest.fixture
def world() -> Iterator[Callable[..., World]]:
    """Make worlds by material and step, each once a test; every open one holds some 25 MB."""
    worlds: dict[tuple[Material, int], World] = {}

    def make(material: Material, steps_per_frame: int = STEPS_PER_FRAME) -> World:
        key = (material, steps_per_frame)
        if key not in worlds:
            worlds[key] = World(material, steps_per_frame)
        return worlds[key]

    yield make
    for one in worlds.values():
        one.close()


@pytest.fixture(scope="session")
def simulator() -> Iterator[Simulator]:
    one = Simulator()
    yield one
    one.close()
