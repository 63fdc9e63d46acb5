"""From a folder of artefacts to a registry. What cannot prove itself is refused, not served."""

import hashlib
import logging
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Protocol

import numpy as np
from loky import cpu_count
from pydantic import ValidationError

from rollcast.manifest import (
    CARD_FILE,
    ENCODER_FILE,
    FRAMES_INPUT,
    GOLDEN_FILE,
    MANIFEST_FILE,
    Manifest,
)
from service.inference.onnx_runtime import open_predictor as open_graphs
from service.inference.rollout import Predictor, roll_out
from service.serving.registry import Model, Registry

PredictorFactory = Callable[[Path, Manifest], Predictor]

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
    proves: tuple[int, int] = (0, 1),
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
    proves
        Which artefacts have to compute their golden values: of so many processes that load the
        same, those of the n-th.
    """
    folders = sorted(path for path in models_dir.glob("*/*") if path.name.isdecimal())
    wanted = [folder for folder in folders if name in (None, folder.parent.name)]
    # Those that take longest first, so that no core is left with one of them in the end.
    wanted.sort(key=_size_of_encoder, reverse=True)
    # One name is loaded again while others answer: it takes a single core from them.
    with ThreadPoolExecutor(cpu_count() if name is None else 1) as pool:
        place, processes = proves
        proved = [index % processes == place for index in range(len(wanted))]
        load = partial(_load, open_predictor=open_predictor)
        return Registry(list(pool.map(load, wanted, proved)))


def begin_loading(models_dir: Path, proves: tuple[int, int]) -> Loader:
    """Begin to load the models of a folder in a thread; return a loader that hands them over.

    Its later calls load anew, and prove all that they load.
    """
    begun: list[Future[Registry]] = [Future()]

    def fulfil(future: Future[Registry]) -> None:
        try:
            future.set_result(load_registry(models_dir, proves=proves))
        except BaseException as error:  # is raised where the models are asked for
            future.set_exception(error)

    def load(models_dir: Path, name: str | None = None) -> Registry:
        return begun.pop().result() if begun else load_registry(models_dir, name)

    # A process that is stopped meanwhile need not wait for it.
    Thread(target=fulfil, args=begun, name="loading", daemon=True).start()
    return load


def _size_of_encoder(folder: Path) -> int:
    path = folder / ENCODER_FILE
    return path.stat().st_size if path.is_file() else 0


def _load(folder: Path, proved: bool, open_predictor: PredictorFactory) -> Model:
    name, version = folder.parent.name, int(folder.name)
    manifest = card = None
    try:
        manifest = _read_manifest(folder)
        _check_hashes(folder, manifest)
        card = (folder / CARD_FILE).read_text(encoding="utf-8")
        predictor = open_predictor(folder, manifest)
        if proved:
            _check_golden(predictor, folder / GOLDEN_FILE)
    except Exception as error:  # whatever a damaged file makes a library raise, the rest is served
        reason = str(error) if isinstance(error, ArtefactError) else f"cannot be loaded: {error}"
        log.warning("%s@%s is refused: %s", name, version, reason)
        return Model(name, version, manifest, reason=reason, card=card)
    return Model(name, version, manifest, predictor, card=card)


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
            data = (folder / name).read_bytes()
        except FileNotFoundError as error:
            raise ArtefactError(f"{name} is missing") from error
        if hashlib.sha256(data).hexdigest() != digest:
            raise ArtefactError(f"{name} is not the file that the manifest names: sha256 differs")


def _check_golden(predictor: Predictor, path: Path) -> None:
    """Compare what the graphs compute with what torch computed, for the first frames alone.

    Hashes tell whether the files are those that were proved; this tells whether the runtime
    computes on this machine what it did where they were.
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
