"""PyBullet leaks with shapes and clients; simulating must not. Several thousand: tests/soak."""

from rollcast.scene import SCENARIOS
from rollcast.simulation.physics import World
from tests.soak.simulate_many import resident_mib


def test_memory_stays_flat_over_several_hundred_scenes(simulator):
    scenes = [
        simulator.sequence(scenario, objects, 3, 4).scene
        for scenario in SCENARIOS
        for objects in (1, 2)
    ]
    world = World()

    def simulate(count: int) -> float:
        for index in range(count):
            world.load(scenes[index % len(scenes)])
            world.step_frame()
        return resident_mib()

    try:
        settled = simulate(100)
        assert simulate(300) < settled + 4
    finally:
        world.close()


def test_memory_is_given_back_with_the_client(simulator):
    scene = simulator.sequence("hemisphere", 1, 3, 4).scene

    def use_and_close(count: int) -> float:
        for _ in range(count):
            world = World()
            world.load(scene)
            world.step_frame()
            world.close()
        return resident_mib()

    settled = use_and_close(4)
    assert use_and_close(12) < settled + 30
