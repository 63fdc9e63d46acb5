"""Simulations: one process of its own holds the simulator, and is replaced now and then.

PyBullet leaks with every shape and client, holds the processor for long and is not safe in
threads, so it never lives in the process that serves.
"""

import base64
import functools
import math
import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np
from jaxtyping import UInt8

from rollcast.camera import Camera, camera_for
from rollcast.frames import encode_png
from rollcast.scene import COLORS, Scene
from rollcast.schemas import SimulatedObject, SimulateRequest, SimulateResponse, SurfaceGrid
from rollcast.surfaces import surface_of
from rollcast.trajectory import FRAME_RATE_HZ
from service.errors import DeadlineExceededError

if TYPE_CHECKING:
    from rollcast.simulation import Simulator

P = ParamSpec("P")
T = TypeVar("T")

SURFACE_POINTS = 65
"""Heights along a side of the frame: every 3 cm of a bowl, every 4 cm of a heightfield."""

RECYCLE_AFTER = 500
"""Calls after which the simulation process is replaced. PyBullet leaks with every scene: with 500,
the process stays below 130 MiB (``docs/reliability.md``), and its start of half a second is rare
(decision 0104)."""

ABANDONED_S = 0.5
"""Seconds for which a simulation goes on whose client has left: a new process costs more."""


def is_installed() -> bool:
    """Return whether PyBullet (extra ``simulation``) can be imported."""
    return find_spec("pybullet") is not None


@functools.cache
def _simulator() -> "Simulator":
    """Return this process's only simulator: it owns a PyBullet client."""
    # Imported here because the process that serves must not load PyBullet.
    from rollcast.simulation import Simulator

    return Simulator()


def simulate(request: SimulateRequest) -> bytes:
    """Simulate and draw a scene, in the process that holds the simulator.

    Returns
    -------
    bytes
        A ``rollcast.schemas.SimulateResponse`` as JSON, which crosses to the other process cheaply.

    Raises
    ------
    rollcast.errors.SceneParametersError, rollcast.errors.SceneRejectedError
        When no such scene exists.
    """
    sequence = _simulator().sequence(
        scenario=request.scenario,
        objects=request.balls,
        seed=request.seed,
        steps=request.steps,
        start_step=request.start_step,
        parameters=request.parameters,
    )
    scene, size = sequence.scene, request.image_size
    camera = camera_for(scene.scenario, size)
    positions_px = camera.project(sequence.trajectory.positions_m)
    turning = sequence.trajectory.angular_velocities_rad_s
    response = SimulateResponse(
        scenario=scene.scenario,
        seed=scene.seed,
        frame_rate=FRAME_RATE_HZ,
        frame_size=(size, size),
        start_step=sequence.start_step,
        times_s=[index / FRAME_RATE_HZ for index in range(request.steps)],
        frames=_png_files(sequence.render(size)) if request.include_frames else None,
        objects=[
            SimulatedObject(
                id=ball,
                color=COLORS[ball],
                radius_px=scene.radius_m * camera.pixels_per_metre,
                positions=positions_px[:, ball].tolist(),
                angular_velocities=turning[:, ball].tolist(),
            )
            for ball in range(scene.objects)
        ],
        surface=_surface(scene, camera) if request.include_surface else None,
        scene=scene,
    )
    return response.model_dump_json().encode("utf-8")


def _surface(scene: Scene, camera: Camera) -> SurfaceGrid:
    edges_px = np.linspace(0, camera.image_size, SURFACE_POINTS)
    columns, rows = np.meshgrid(edges_px, edges_px)
    plane_m = camera.unproject(np.stack([columns, rows], axis=-1))
    heights_m, _ = surface_of(scene).height_and_normal(plane_m[..., 0], plane_m[..., 1])
    rounded = [[round(height, 6) for height in row] for row in heights_m.tolist()]
    return SurfaceGrid(
        half_width_m=camera.half_width_m,
        heights_m=[[None if math.isnan(height) else height for height in row] for row in rounded],
    )


def _png_files(frames: UInt8[np.ndarray, "steps S S 3"]) -> list[str]:
    return [base64.b64encode(encode_png(frame)).decode("ascii") for frame in frames]


class RecycledProcess:
    """An executor with one process, started on demand and replaced after a number of calls.

    It has one call at a time: a process that dies, or is killed because it takes too long, takes
    that call with it and no other. ``ProcessPoolExecutor(max_tasks_per_child=...)`` recycles too
    and can deadlock in Python 3.11 (CPython issue 115634).

    Parameters
    ----------
    timeout_s
        Seconds that a call may take.
    recycle_after
        Calls after which the process is replaced.
    """

    def __init__(self, timeout_s: float, recycle_after: int = RECYCLE_AFTER) -> None:
        self._thread = ThreadPoolExecutor(1, "simulation")
        self._recycle_after = recycle_after
        self._timeout_s = timeout_s
        self._calls = 0
        self._process: ProcessPoolExecutor | None = None

    def submit(
        self, abandoned: Future[None], call: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs
    ) -> Future[T]:
        """Hand a call to the process; arguments, result and exceptions are pickled.

        Once ``abandoned`` is done, the process is killed if the call goes on. The future raises
        ``BrokenProcessPool`` when the process dies or none can be started (there are no descriptors
        left, or no memory), ``DeadlineExceededError`` when it takes too long.
        """
        return self._thread.submit(self._run, abandoned, call, *args, **kwargs)

    def close(self) -> None:
        """Drop waiting calls and kill the process with the running one."""
        self._thread.shutdown(wait=False, cancel_futures=True)
        self._discard()
        self._thread.shutdown()

    def _run(
        self, abandoned: Future[None], call: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs
    ) -> T:
        try:
            future = self._handed_over(call, *args, **kwargs)
        except (OSError, RuntimeError) as error:
            self._discard()
            raise BrokenProcessPool("No simulation process can be started.") from error
        ends: list[Future[Any]] = [future, abandoned]
        wait(ends, self._timeout_s, FIRST_COMPLETED)
        if abandoned.done():
            wait([future], ABANDONED_S)
        if not future.done():
            self._discard()
            if abandoned.done():
                raise CancelledError
            raise DeadlineExceededError(
                f"The simulation was not complete after {self._timeout_s:g} s."
            )
        return future.result()

    def _handed_over(self, call: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        if self._calls == self._recycle_after:
            self._discard()
        try:
            return self._started().submit(call, *args, **kwargs)
        except BrokenProcessPool:
            self._discard()
            return self._started().submit(call, *args, **kwargs)

    def _started(self) -> ProcessPoolExecutor:
        # Its semaphores need room in shared memory: without it, calls fail and not the service.
        if self._process is None:
            self._process, self._calls = _new_process(), 0
        self._calls += 1
        return self._process

    def _discard(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            _kill(process)


def _kill(pool: ProcessPoolExecutor) -> None:
    """End a pool with its process, which may be stuck in code that hears no signal but this one."""
    # ProcessPoolExecutor.kill_workers comes with Python 3.14.
    for process in [*(pool._processes or {}).values()]:  # pyright: ignore[reportPrivateUsage]
        process.kill()
    pool.shutdown(wait=False, cancel_futures=True)


def _new_process() -> ProcessPoolExecutor:
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, context, initializer=_prepare_process)


def _prepare_process() -> None:
    """Leave Ctrl-C to the parent, and never outlive it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_die_with_parent, daemon=True).start()


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    multiprocessing.connection.wait([parent.sentinel])
    os._exit(1)
