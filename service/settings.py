"""Settings of the service, from environment variables ``ROLLCAST_NAME``."""

import os
from pathlib import Path
from typing import Annotated

from pydantic import DirectoryPath, Field, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

PREFIX = "ROLLCAST_"
OTHER_PROGRAMS_VARIABLES = frozenset({"ROLLCAST_RUNS"})
"""Variables that the training reads: they may stand in the same environment."""

MEBI = 2**20


def keep_runtime_silent() -> None:
    """Stop ONNX Runtime from reporting its use (decision 0002), unless the user has chosen.

    Only what stands in the environment before its import counts.
    """
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")


class Settings(BaseSettings):
    """Every setting of the service; an unknown ``ROLLCAST_`` variable is refused."""

    model_config = SettingsConfigDict(
        env_prefix=PREFIX, frozen=True, extra="forbid", use_attribute_docstrings=True
    )

    models_dir: DirectoryPath = Path(__file__).resolve().parents[1] / "models"
    """Folder of the artefacts, ``NAME/VERSION/``."""
    max_body_bytes: Annotated[int, Field(ge=1)] = 64 * MEBI
    """Largest request body; a larger one is refused with 413 while it is being read."""
    inference_threads: Annotated[int, Field(ge=1)] = len(os.sched_getaffinity(0))
    """Forecasts that are computed at the same time, one thread each; by default one per core that
    this process may use."""
    inference_queue: Annotated[int, Field(ge=0)] = 64
    """Forecasts that may wait for a thread; one more is refused with 429."""
    deadline_s: Annotated[float, Field(gt=0)] = 60
    """Seconds after which a forecast that is not there is given up with 504, the wait in the queue
    included; the header X-Request-Timeout-Ms may ask for less."""
    max_batch: Annotated[int, Field(ge=1)] = 16
    """Requests that may be forecast together in one tensor of ``/v2``."""
    simulation_queue: Annotated[int, Field(ge=0)] = 8
    """Simulations that may wait for the one that runs; one more is refused with 429."""
    simulation_recycle: Annotated[int, Field(ge=1)] = 500
    """Simulations after which the process that runs them is replaced."""
    max_simulated_pixels: Annotated[int, Field(ge=1)] = 64 * MEBI
    """Largest number of pixels, all frames together, that one simulation may draw."""
    retry_after_s: Annotated[int, Field(ge=1)] = 1
    """Seconds after which a refused client is asked to come back (the header Retry-After)."""

    @model_validator(mode="after")
    def _know_every_variable(self) -> "Settings":
        known = {f"{PREFIX}{name}".upper() for name in type(self).model_fields}
        given = {name for name in os.environ if name.upper().startswith(PREFIX)}
        unknown = sorted(given - OTHER_PROGRAMS_VARIABLES - known)
        if unknown:
            raise ValueError(f"unknown settings {unknown}; known are {sorted(known)}")
        return self
