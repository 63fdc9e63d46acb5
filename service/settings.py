"""Settings of the service: environment variables ``ROLLCAST_NAME``, or a file of their names."""

import math
import os
import socket
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from loky import cpu_count
from pydantic import (
    DirectoryPath,
    Field,
    FilePath,
    IPvAnyNetwork,
    model_validator,
)
from pydantic_settings import (
    BaseSettings,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
    TomlConfigSettingsSource,
)

from service.auth.api_keys import KeyFile

PREFIX = "ROLLCAST_"
FILE_VARIABLE = "ROLLCAST_SETTINGS_FILE"
"""Names a TOML file of settings; variables of the environment go before it."""
OTHER_VARIABLES = frozenset({FILE_VARIABLE, "ROLLCAST_RUNS", "ROLLCAST_API_KEY", "ROLLCAST_URL"})
"""Variables of this file, of the training and of the client, all in the same environment."""

TRACE_RECEIVERS = {"OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT"}
"""Variables of OpenTelemetry that say where traces go."""

MEBI = 2**20


def keep_runtime_silent() -> None:
    """Stop ONNX Runtime from reporting its use (decision 0002), unless the user has chosen.

    Only what stands in the environment before its import counts.
    """
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")


SHARED_METRICS = "PROMETHEUS_MULTIPROC_DIR"
"""Names the folder in which several processes count; Prometheus' client reads it too."""
MOST_PROCESSES = 4
"""By default: each holds all models in memory."""


def metrics_are_shared() -> bool:
    """Tell whether several processes count together."""
    return SHARED_METRICS in os.environ


def share_metrics(folder: str) -> None:
    """Let processes count in one folder, unless the user has named one.

    Prometheus' client must not have been imported yet.
    """
    os.environ.setdefault(SHARED_METRICS, folder)


def default_processes(given: Mapping[str, Any]) -> int:
    """Return one a core up to a few; one where requests are counted or cannot be handed over."""
    if given.get("requests_per_minute") is not None or not hasattr(socket, "send_fds"):
        return 1
    return min(cpu_count(), MOST_PROCESSES)


Origin: TypeAlias = Annotated[str, Field(pattern=r"^(\*|https?://[^/\s]+)$")]


class Settings(BaseSettings):
    """Every setting of the service; one that is unknown is refused wherever it stands."""

    model_config = SettingsConfigDict(
        env_prefix=PREFIX, frozen=True, extra="forbid", use_attribute_docstrings=True
    )

    models_dir: DirectoryPath = Path(__file__).resolve().parents[1] / "models"
    """Folder of the artefacts, ``NAME/VERSION/``."""
    keys_file: FilePath | None = None
    """File of API keys, which `python -m service.auth` makes; it is read again when it changes.
    Without one nobody is asked for a key."""
    anonymous: bool = False
    """Whether everybody may ask on addresses that others reach. Without keys and without this the
    service listens to its own machine alone."""
    requests_per_minute: Annotated[int, Field(ge=1)] | None = None
    """Requests that each key may send in a minute, or without keys each address; one more is
    refused with 429. By default as many as it likes. They are counted by a single process."""
    trusted_proxies: tuple[IPvAnyNetwork, ...] = ()
    """Addresses or networks of reverse proxies, a JSON list, whose headers X-Forwarded-For and
    X-Forwarded-Proto tell the client's address and scheme. By default no such header is
    believed."""
    root_path: Annotated[str, Field(pattern=r"^(/[A-Za-z0-9._~-]+)*$")] = ""
    """Prefix under which a reverse proxy serves this service, as in ``/rollcast``; `/docs` needs
    it. The proxy may strip it or pass it on."""
    allowed_origins: tuple[Origin, ...] = ()
    """Origins of web pages, SCHEME://HOST[:PORT], that may ask the service from a browser; "*"
    stands for all of them. By default its own page alone."""
    max_body_bytes: Annotated[int, Field(ge=1)] = 64 * MEBI
    """Largest request body; a larger one is refused with 413 while it is being read."""
    max_total_body_bytes: Annotated[int, Field(ge=1)] = 256 * MEBI
    """Bytes of all request bodies that one process holds until they have been parsed and answered.
    Beyond it the largest body that is still arriving is refused with 503."""
    receive_timeout_s: Annotated[float, Field(gt=0)] = 60
    """Seconds in which the head of a request has to arrive, and then its body: a slower body is
    refused with 408, and its connection closed."""
    send_timeout_s: Annotated[float, Field(gt=0)] = 60
    """Seconds after which the connection of a client is closed that takes nothing of its answer."""
    processes: Annotated[int, Field(ge=1)] = Field(default_factory=default_processes)
    """Processes that answer, each with all models in its memory; by default one per core that the
    service or its container may use, up to four. Each connection belongs to one of them."""
    inference_threads: Annotated[int, Field(ge=1)] = Field(default_factory=cpu_count)
    """Threads that compute forecasts, of all processes together and at least one in each; by
    default one per core."""
    inference_queue: Annotated[int, Field(ge=0)] = 64
    """Forecasts that may be held beyond one a thread, in equal parts by all processes; one more is
    refused with 429."""
    deadline_s: Annotated[float, Field(gt=0)] = 60
    """Seconds after which a forecast that is not there is given up with 504, the wait in the queue
    included; the header X-Request-Timeout-Ms may ask for less."""
    max_batch: Annotated[int, Field(ge=1)] = 16
    """Forecasts that may come in one tensor of ``/v2``, and that are gathered, while more frames
    wait, before they are rolled out together."""
    simulation_queue: Annotated[int, Field(ge=0)] = 8
    """Simulations that may wait for the one that runs, in equal parts in all processes, each of
    which runs its own; one more is refused with 429."""
    simulation_recycle: Annotated[int, Field(ge=1)] = 500
    """Simulations after which the process that runs them is replaced."""
    simulation_timeout_s: Annotated[float, Field(gt=0)] = 120
    """Seconds after which a simulation is given up with 504 and its process killed; the next one
    gets a new process."""
    max_simulated_pixels: Annotated[int, Field(ge=1)] = 16 * MEBI
    """Largest number of pixels, all frames together, that one simulation may draw; by default
    enough for 1000 frames of 128 pixels."""
    retry_after_s: Annotated[int, Field(ge=1)] = 1
    """Seconds after which a refused client is asked to come back (the header Retry-After)."""
    drain_s: Annotated[float, Field(ge=0)] = 0
    """Seconds for which a service that was told to stop goes on listening, not ready any more, so
    that those who send it requests take notice; it listens until its last forecast is answered
    anyway."""
    stop_timeout_s: Annotated[int, Field(ge=1)] = 30
    """Seconds after which a service that was told to stop gives up what it still works on."""
    log_format: Literal["json", "text"] = "json"
    """Log lines as JSON objects, or as text for people."""
    log_requests: bool = True
    """Whether every request has a line in the log. Failures of the service always have one."""
    replica: Annotated[str, Field(pattern=r"^[A-Za-z0-9._:#-]{0,128}$")] = ""
    """Name of this process where there are several: it comes with every answer in the header
    X-Rollcast-Replica and stands in the log line of its request. Without one there is none."""
    traces: bool = False
    """Whether requests are traced; OTEL_EXPORTER_OTLP_ENDPOINT, a variable of OpenTelemetry's as
    there are others, says where the spans go."""

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,  # noqa: ARG003
        file_secret_settings: PydanticBaseSettingsSource,  # noqa: ARG003
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Read arguments, then the environment, then the file, if there is one."""
        path = os.environ.get(FILE_VARIABLE)
        if path is None:
            return init_settings, env_settings
        return init_settings, env_settings, TomlConfigSettingsSource(settings_cls, _file(path))

    def share(self) -> "Settings":
        """Return the settings of one process among all: its part of threads and queues."""
        return self.model_copy(
            update={
                name: math.ceil(getattr(self, name) / self.processes)
                for name in ("inference_threads", "inference_queue", "simulation_queue")
            }
        )

    @model_validator(mode="after")
    def _know_where_traces_go(self) -> "Settings":
        os.environ.setdefault("OTEL_SERVICE_NAME", "rollcast")
        if self.traces and not TRACE_RECEIVERS & os.environ.keys():
            raise ValueError(f"traces need one of {sorted(TRACE_RECEIVERS)}: where they go")
        return self

    @model_validator(mode="after")
    def _count_in_one_process(self) -> "Settings":
        if self.requests_per_minute is not None and self.processes > 1:
            raise ValueError("requests_per_minute needs processes = 1, which counts them all")
        return self

    @model_validator(mode="after")
    def _know_the_keys(self) -> "Settings":
        if self.keys_file is not None:
            try:
                KeyFile.read(self.keys_file)
            except (OSError, ValueError) as error:
                raise ValueError(f"{self.keys_file} is no file of keys: {error}") from error
        return self

    @model_validator(mode="after")
    def _know_every_variable(self) -> "Settings":
        known = {f"{PREFIX}{name}".upper() for name in type(self).model_fields}
        given = {name for name in os.environ if name.upper().startswith(PREFIX)}
        unknown = sorted(given - OTHER_VARIABLES - known)
        if unknown:
            raise ValueError(f"unknown settings {unknown}; known are {sorted(known)}")
        return self


def _file(path: str) -> Path:
    """Return the path of the settings' file: a missing one would otherwise be passed over."""
    file = Path(path)
    if not file.is_file():
        raise ValueError(f"{FILE_VARIABLE}: there is no file {path}")
    return file


def described() -> str:
    """Say what every setting means and what it is by default, a paragraph each."""
    parts: list[str] = []
    for name, field in Settings.model_fields.items():
        default = field.get_default(call_default_factory=True, validated_data={})
        parts.append(f"{PREFIX}{name.upper()} (default {default})")
        parts.append(textwrap.indent(textwrap.fill(field.description or "", 84), 4 * " "))
    return "\n".join(parts)
