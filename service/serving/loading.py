"""Loading of a folder of artefacts into a registry. Invalid artefacts are listed, not served."""

import hashlib
import logging
import re
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Protocol

import numpy as np
from loky import cpu_count
from pydantic import ValidationError

from rollcast.files import read_regular_file
from rollcast.manifest import (
    CARD_FILE,
    ENCODER_FILE,
    FRAMES_INPUT,
    GOLDEN_FILE,
    MANIFEST_FILE,
    Manifest,
)
from rollcast.rollout import roll_out
from rollcast.schemas import AUTO_MODEL
from service.inference.onnx_runtime import open_predictor as open_graphs
from service.inference.rollout import Predictor
from service.serving.registry import Model, Registry
from service.settings import CPU_PROVIDER

PredictorFactory = Callable[[Path, Manifest], Predictor]

Report = Callable[[str], object]
"""Takes a line for the log."""

NAME = re.compile(r"(?!\.)[A-Za-z0-9._-]{1,128}")
"""Names that requests and log lines can show; hidden folders hold no models."""

log = logging.getLogger(__name__)


class ArtefactError(Exception):
    """An artefact must not be served; the message says why."""


class Loader(Protocol):
    """Loads the models of a folder, all or those of one name."""

    def __call__(self, models_dir: Path, name: str | None = None) -> Registry:
        """Load them."""
        ...


def load_registry(
    models_dir: Path,
    name: str | None = None,
    open_predictor: PredictorFactory = open_graphs,
    report: Report = log.warning,
) -> Registry:
    """Load every ``NAME/VERSION`` under a folder; one that is refused does not stop the others.

    Parameters
    ----------
    models_dir
        Folder of the artefacts.
    name
        Only versions of this model; None loads all.
    open_predictor
        Opens the graphs of one artefact.
    report
        Takes a line for each folder that is not served.
    """
    if name is None:
        for other in _other_names(models_dir):
            report(
                f"the folder {other!a} is no model: a name consists of letters, digits and "
                f'. _ - without a dot in front, and is not "{AUTO_MODEL}"'
            )
    folders = [folder for folder in _folders(models_dir) if name in (None, folder.parent.name)]
    wanted = [folder for folder in folders if folder.name == str(int(folder.name))]
    misnamed = [_misnamed(folder, report) for folder in folders if folder not in wanted]
    # The slowest models first, so that no core ends with one of them.
    wanted.sort(key=_size_of_encoder, reverse=True)
    # A single name is loaded while the service answers: it takes one core only.
    with ThreadPoolExecutor(cpu_count() if name is None else 1) as pool:
        load = partial(_load, open_predictor=open_predictor, report=report)
        models = list(pool.map(load, wanted))
    labels = {model.label for model in models}
    # Beside the version itself, which goes on being served, the log alone tells of them.
    return Registry([*models, *(model for model in misnamed if model.label not in labels)])


def model_names(models_dir: Path) -> set[str]:
    """Return the names of all models that a folder holds a version of."""
    return {folder.parent.name for folder in _folders(models_dir)}


def begin_loading(models_dir: Path, provider: str = CPU_PROVIDER) -> Loader:
    """Begin to load the models of a folder in a thread; return a loader that hands them over.

    Its later calls load anew.

    Parameters
    ----------
    provider
        ONNX Runtime execution provider.
    """
    open_predictor = partial(open_graphs, provider=provider)
    begun: list[Future[Registry]] = [Future()]
    messages: list[str] = []  # logging may not be configured yet

    def fulfil(future: Future[Registry]) -> None:
        try:
            registry = load_registry(models_dir, None, open_predictor, messages.append)
            future.set_result(registry)
        except BaseException as error:  # is raised where the models are asked for
            future.set_exception(error)

    def load(models_dir: Path, name: str | None = None) -> Registry:
        if not begun:
            return load_registry(models_dir, name, open_predictor)
        try:
            return begun.pop().result()
        finally:
            for message in messages:
                log.warning(message)

    # A process that is stopped meanwhile need not wait for it.
    Thread(target=fulfil, args=begun, name="loading", daemon=True).start()
    return load


def _folders(models_dir: Path) -> list[Path]:
    versions = (path for path in models_dir.glob("*/*") if _is_version(path))
    return sorted(path for path in versions if _is_name(path.parent.name))


def _other_names(models_dir: Path) -> list[str]:
    """Return the folders that hold versions under a name that no request can state."""
    names = {path.parent.name for path in models_dir.glob("*/*") if _is_version(path)}
    return sorted(name for name in names if not _is_name(name))


def _is_name(name: str) -> bool:
    return name != AUTO_MODEL and NAME.fullmatch(name) is not None


def _is_version(folder: Path) -> bool:
    return re.fullmatch(r"[0-9]{1,9}", folder.name) is not None


def _misnamed(folder: Path, report: Report) -> Model:
    """Refuse a folder such as ``01``, which would stand for the same version as ``1``."""
    version = int(folder.name)
    reason = f"the folder {folder.name} of version {version} must be named {version}"
    report(f"{folder.parent.name}/{folder.name} is refused: {reason}")
    return Model(folder.parent.name, version, reason=reason)


def _size_of_encoder(folder: Path) -> int:
    path = folder / ENCODER_FILE
    return path.stat().st_size if path.is_file() else 0


def _load(folder: Path, open_predictor: PredictorFactory, report: Report) -> Model:
    name, version = folder.parent.name, int(folder.name)
    manifest = card = None
    try:
        _check_files(folder)
        manifest = _read_manifest(folder)
        _check_hashes(folder, manifest)
        card = (folder / CARD_FILE).read_text(encoding="utf-8")
        predictor = open_predictor(folder, manifest)
        _check_golden(predictor, folder / GOLDEN_FILE)
    except Exception as error:  # whatever a damaged file makes a library raise, the rest is served
        reason = str(error) if isinstance(error, ArtefactError) else f"cannot be loaded: {error}"
        report(f"{name}@{version} is refused: {reason}")
        return Model(name, version, manifest, reason=reason, card=card)
    return Model(name, version, manifest, predictor, card=card)


def _check_files(folder: Path) -> None:
    """Reject files that are not regular, such as pipes, from which a read may never return."""
    for path in sorted(folder.iterdir()):
        if path.exists() and not path.is_file():
            raise ArtefactError(f"{path.name} is not a regular file")


def _read_manifest(folder: Path) -> Manifest:
    try:
        manifest = Manifest.read(folder / MANIFEST_FILE)
    except FileNotFoundError as error:
        raise ArtefactError(f"{MANIFEST_FILE} is missing") from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ArtefactError(f"{MANIFEST_FILE} is not valid: {place}: {first['msg']}") from error
    if (manifest.name, str(manifest.version)) != (folder.parent.name, folder.name):
        raise ArtefactError(f"{MANIFEST_FILE} is that of {manifest.label}")
    return manifest


def _check_hashes(folder: Path, manifest: Manifest) -> None:
    for name, digest in manifest.files.items():
        try:
            data = read_regular_file(folder / name)
        except FileNotFoundError as error:
            raise ArtefactError(f"{name} is missing") from error
        if hashlib.sha256(data).hexdigest() != digest:
            raise ArtefactError(f"{name} is not the file that the manifest names: sha256 differs")


def _check_golden(predictor: Predictor, path: Path) -> None:
    """Compare the outputs of the graphs with those of torch, for the first golden frames.

    Hashes verify that the files are those of the export; this comparison verifies the runtime on
    this machine.
    """
    manifest = predictor.manifest
    with np.load(path) as golden:
        frames = golden[FRAMES_INPUT]
        if frames.dtype != np.uint8 or frames.shape[1:] != manifest.frames_shape:
            raise ArtefactError(f"{path.name}: frames are {frames.dtype} {frames.shape}")
        horizon = golden["positions"].shape[2]
        outputs = roll_out(predictor, frames[:1], horizon)
        for name, tolerance in manifest.golden_tolerance.items():
            expected = golden[name][:1]
            if outputs[name].shape != expected.shape:
                raise ArtefactError(
                    f"{name} has the shape {outputs[name].shape}, golden {expected.shape}"
                )
            difference = float(np.abs(outputs[name] - expected).max())
            if not difference <= tolerance:
                raise ArtefactError(
                    f"{name} differs by {difference:.3g} from the golden values, "
                    f"at most {tolerance:g} is allowed"
                )
