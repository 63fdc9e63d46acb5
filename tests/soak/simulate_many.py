"""Draws, simulates and renders thousands of scenes in one process and watches its memory.

python -m tests.soak.simulate_many --scenes 2000

Exits with 1 when memory grew by more than 8 MiB after the first quarter.
"""

import argparse
import resource
import sys
import time
from pathlib import Path

from rollcast.camera import camera_for
from rollcast.scene import SCENARIOS, Scenario
from rollcast.simulation.physics import World, as_trajectory
from rollcast.simulation.rendering import Renderer
from rollcast.simulation.sampling import draw_scene, scene_generator

ALLOWED_GROWTH_MIB = 8.0
REPORTS = 16


def resident_mib() -> float:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def make_scene(world: World, scenario: Scenario, objects: int, seed: int, frames: int) -> None:
    """Draw, simulate and render one scene, whatever the rejection rules would say."""
    generator = scene_generator(scenario, objects, seed)
    scene = draw_scene(scenario, objects, seed, generator, {}, lambda _: True)
    world.load(scene)
    states = [world.state()]
    for _ in range(frames):
        world.step_frame()
        states.append(world.state())
    Renderer(scene, camera_for(scenario, 32)).render(as_trajectory(states[:4]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=2000)
    parser.add_argument("--frames", type=int, default=20, help="simulated of each scene")
    arguments = parser.parse_args()
    kinds = [(scenario, objects) for scenario in SCENARIOS for objects in (1, 2, 3)]
    world = World()
    start, settled = time.monotonic(), 0.0
    every = max(arguments.scenes // REPORTS, 1)
    for seed in range(1, arguments.scenes + 1):
        make_scene(world, *kinds[seed % len(kinds)], seed, arguments.frames)
        if seed == arguments.scenes // 4:
            settled = resident_mib()
        if seed % every == 0:
            print(f"{seed:6} scenes {resident_mib():8.1f} MiB {time.monotonic() - start:7.0f} s")
    growth = resident_mib() - settled
    print(f"growth after the first quarter: {growth:.1f} MiB")
    sys.exit(growth > ALLOWED_GROWTH_MIB)


if __name__ == "__main__":
    main()
