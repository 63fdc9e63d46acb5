"""Settings of the service: environment variables ``ROLLCAST_NAME``, or a file of their names."""

import math
import os
import re
import textwrap
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

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
"""Variable with the path of a TOML file of settings; other variables override the file."""
OTHER_VARIABLES = frozenset(
    {FILE_VARIABLE, "ROLLCAST_RUNS", "ROLLCAST_API_KEY", "ROLLCAST_URL", "ROLLCAST_CASES"}
)
"""Variables of this file, of the training, of the client and of the tests, all in the same
environment."""
KUBERNETES_VARIABLE = re.compile(
    r"ROLLCAST(_[A-Z0-9]+)*?_(SERVICE_HOST|SERVICE_PORT(_\w+)?|PORT|PORT_\d+_(TCP|UDP)(_\w+)?)"
)
"""Variables that Kubernetes sets in every pod for a Service named ``rollcast`` or
``rollcast-...``."""

TRACE_RECEIVERS = {"OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT"}
"""Variables of OpenTelemetry that say where traces go."""

MEBI = 2**20
CPU_PROVIDER = "CPUExecutionProvider"
MODELS_PACKAGE = "rollcast_models"
"""The wheel of the committed models (``make wheels``)."""


def keep_runtime_silent() -> None:
    """Stop ONNX Runtime from reporting its use (decision 0002), unless the user has chosen.

    The variable takes effect only before ONNX Runtime is imported.
    """
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")


def keep_products_on_one_thread() -> None:
    """Let NumPy compute matrix products on the thread that asks, unless the user has chosen.

    Forecasts share the cores already, and the threads of OpenBLAS wait in loops: cutting patches
    took four times the processor time. The variable takes effect only before NumPy is imported.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


SHARED_METRICS = "PROMETHEUS_MULTIPROC_DIR"
"""Variable with the folder of shared metrics, which Prometheus' client reads too."""
SHUTDOWN_MARGIN_S = 1
"""Time beyond ``graceful_shutdown_timeout_s`` after which a process ends without finishing its
work."""


def metrics_folder() -> Path | None:
    """Return the folder in which several processes count together, if there is one."""
    folder = os.environ.get(SHARED_METRICS)
    return None if folder is None else Path(folder)


def share_metrics(folder: str) -> None:
    """Let processes count in one folder, unless the user has named one."""
    os.environ.setdefault(SHARED_METRICS, folder)


Origin: TypeAlias = Annotated[str, Field(pattern=r"^(\*|https?://[^/\s]+)$")]


def default_models_dir() -> Path:
    """Return the models folder of this checkout, or that of the package of models.

    Raises
    ------
    ValueError
        If there is neither.
    """
    checkout = Path(__file__).resolve().parents[1] / "models"
    if checkout.is_dir():
        return checkout
    package = find_spec(MODELS_PACKAGE)
    if package is None or not package.submodule_search_locations:
        raise ValueError(
            "there are no models: install the package rollcast-models, or name their folder with "
            f"{PREFIX}MODELS_DIR"
        )
    return Path(package.submodule_search_locations[0])


class Settings(BaseSettings):
    """Settings of the service. Unknown settings are an error in every source."""

    model_config = SettingsConfigDict(
        env_prefix=PREFIX, frozen=True, extra="forbid", use_attribute_docstrings=True
    )

    models_dir: DirectoryPath = Field(default_factory=default_models_dir)
    """Folder of the artefacts, ``NAME/VERSION/``. By default that of the checkout, or else of the
    package `rollcast-models`."""
    keys_file: FilePath | None = None
    """File of API keys, written by `python -m service.auth` and reloaded when it changes. Without
    it, requests need no key."""
    allow_unauthenticated: bool = False
    """Allow unauthenticated requests on addresses beyond loopback. Without this or a key file, the
    service only starts on loopback addresses."""
    requests_per_minute: Annotated[int, Field(ge=1)] | None = None
    """Rate limit per API key, or per client address without keys; further requests get 429. By
    default there is no limit. A limit requires a single process."""
    trusted_proxies: tuple[IPvAnyNetwork, ...] = ()
    """Addresses or networks of reverse proxies, as a JSON list. Only their X-Forwarded-For and
    X-Forwarded-Proto headers determine the client's address and scheme. By default these headers
    are ignored."""
    root_path: Annotated[str, Field(pattern=r"^(/[A-Za-z0-9._~-]+)*$")] = ""
    """Path prefix of a reverse proxy, such as ``/rollcast``; required by `/docs`. The proxy may
    strip it or pass it on."""
    allowed_origins: tuple[Origin, ...] = ()
    """Origins of web pages, SCHEME://HOST[:PORT], that may call the service from a browser (CORS);
    "*" allows all of them. By default only the service's own page."""
    max_body_bytes: Annotated[int, Field(ge=1)] = 64 * MEBI
    """Maximum size of a request body; larger ones are rejected with 413 while they arrive."""
    max_total_body_bytes: Annotated[int, Field(ge=1)] = 256 * MEBI
    """Maximum size of all request bodies that a process holds at the same time. Beyond it, the
    largest body that is still arriving is rejected with 503."""
    read_timeout_s: Annotated[float, Field(gt=0)] = 60
    """Time limit for receiving the head of a request, and again for its body. A slower body gets
    408, and the connection is closed."""
    write_timeout_s: Annotated[float, Field(gt=0)] = 60
    """Close a connection whose client reads nothing for this many seconds."""
    processes: Annotated[int, Field(ge=1)] = 1
    """Worker processes that accept connections, each with all models in its memory. A supervisor
    replaces workers that exit or do not respond. By default one process serves on all cores."""
    inference_threads: Annotated[int, Field(ge=1)] = Field(default_factory=cpu_count)
    """Threads that compute forecasts, split evenly across processes, at least one in each; by
    default one per core that the service or its container may use."""
    execution_provider: Annotated[str, Field(pattern=r"^\w+ExecutionProvider$")] = CPU_PROVIDER
    """ONNX Runtime execution provider that computes the networks, such as `CUDAExecutionProvider`
    of the package `onnxruntime-gpu`. Operators that it does not implement run on the CPU. The
    service does not start without it."""
    inference_queue: Annotated[int, Field(ge=0)] = 64
    """Queue length beyond the forecasts being computed, split evenly across processes; further
    requests get 429."""
    deadline_s: Annotated[float, Field(gt=0)] = 60
    """Time limit of a forecast, including the time in the queue; later ones get 504. The header
    X-Request-Timeout-Ms may request less."""
    max_batch: Annotated[int, Field(ge=1)] = 16
    """Maximum number of forecasts in one tensor of ``/v2``, and in a batch of queued requests that
    are rolled out together."""
    simulation_queue: Annotated[int, Field(ge=0)] = 8
    """Queue length beyond the running simulation, split evenly across processes, each of which runs
    its own; further requests get 429."""
    simulation_timeout_s: Annotated[float, Field(gt=0)] = 120
    """Time limit of a simulation. A longer one gets 504, and its process is killed and replaced."""
    max_simulated_pixels: Annotated[int, Field(ge=1)] = 16 * MEBI
    """Maximum number of pixels of one simulation, all frames together. The default is enough for
    1000 frames of 128 pixels."""
    shutdown_delay_s: Annotated[float, Field(ge=0)] = 0
    """Minimum time for which a stopping service keeps accepting connections while it reports that
    it is not ready, so that load balancers notice. It always listens until its last forecast is
    answered."""
    graceful_shutdown_timeout_s: Annotated[int, Field(ge=1)] = 30
    """Time limit for finishing requests after a stop signal. The service ends at most three seconds
    later."""
    log_format: Literal["json", "text"] = "json"
    """Format of log lines: JSON objects or plain text."""
    log_requests: bool = True
    """Log every request. Failures of the service are always logged."""
    replica: Annotated[str, Field(pattern=r"^[A-Za-z0-9._:#-]{0,128}$")] = ""
    """Name of this replica, sent in the header X-Rollcast-Replica and written to log lines. By
    default there is no such header."""
    traces: bool = False
    """Export OpenTelemetry traces of requests to OTEL_EXPORTER_OTLP_ENDPOINT."""

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
            raise ValueError(f"traces requires one of {sorted(TRACE_RECEIVERS)}")
        return self

    @model_validator(mode="after")
    def _count_in_one_process(self) -> "Settings":
        if self.requests_per_minute is not None and self.processes > 1:
            raise ValueError("requests_per_minute requires processes = 1")
        return self

    @model_validator(mode="after")
    def _know_the_keys(self) -> "Settings":
        if self.keys_file is not None:
            try:
                KeyFile.read(self.keys_file)
            except (OSError, ValueError) as error:
                raise ValueError(f"{self.keys_file} is not a valid key file: {error}") from error
        return self

    @model_validator(mode="after")
    def _know_every_variable(self) -> "Settings":
        known = {f"{PREFIX}{name}".upper() for name in type(self).model_fields}
        given = {name for name in os.environ if name.upper().startswith(PREFIX)}
        unknown = sorted(
            name
            for name in given - OTHER_VARIABLES - known
            if not KUBERNETES_VARIABLE.fullmatch(name)
        )
        if unknown:
            raise ValueError(f"unknown settings {unknown}; known are {sorted(known)}")
        return self


def _file(path: str) -> Path:
    """Return the path of the settings' file: a missing one would otherwise be passed over."""
    file = Path(path)
    if not file.is_file():
        raise ValueError(f"{FILE_VARIABLE}: the file {path} does not exist")
    return file


def described() -> str:
    """Describe every setting and its default, one paragraph each."""
    parts: list[str] = []
    for name, field in Settings.model_fields.items():
        try:
            default = field.get_default(call_default_factory=True, validated_data={})
        except ValueError:  # there are no models
            default = None
        parts.append(f"{PREFIX}{name.upper()} (default {default})")
        parts.append(textwrap.indent(textwrap.fill(field.description or "", 84), 4 * " "))
    return "\n".join(parts)
