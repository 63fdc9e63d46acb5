"""Models loaded and unloaded while the service answers; running forecasts keep their model."""

import asyncio
import logging

from service.errors import InvalidValueError, NotReadyError, ServiceError, UnknownModelError
from service.inference.daemon_threads import run_in_daemon_thread
from service.serving.loading import model_names
from service.serving.model_changes import Action, ModelChanges
from service.serving.registry import Model
from service.state import AppState

POLL_S = 0.25
"""Interval at which a worker looks for changes by other workers."""

log = logging.getLogger(__name__)


async def change(state: AppState, action: Action, name: str) -> None:
    """Load or unload a model in this process, and let all other processes follow.

    Raises
    ------
    UnknownModelError
        When there is neither a served model nor a folder of that name: nothing is recorded.
    InvalidValueError
        When a version to be loaded is refused; the others are loaded.
    NotReadyError
        When the change cannot be recorded for the other processes.
    """
    await _require_known(state, action, name)
    async with state.changing:
        if state.changes is not None:
            try:
                state.changes.record(action, name)
            except OSError as error:
                reason = f"it cannot be shared with other processes: {error.strerror}"
                raise NotReadyError(f"The model is not changed, {reason}.") from error
        await _apply(state, action, name)


async def follow(state: AppState, changes: ModelChanges) -> None:
    """Apply model changes of other processes until cancelled."""
    while True:
        await asyncio.sleep(POLL_S)
        async with state.changing:
            try:
                for action, name in changes.newer():
                    await _apply_others(state, action, name)
            except OSError:
                log.exception("model changes of other processes can no longer be read")
                return


async def _apply_others(state: AppState, action: Action, name: str) -> None:
    try:
        await _apply(state, action, name)
    except ServiceError as error:  # the process that was asked has answered it
        log.warning("%s of %s: %s", action, name, error.detail)


async def _require_known(state: AppState, action: Action, name: str) -> None:
    if any(model.name == name for model in state.registry.models):
        return
    known = await run_in_daemon_thread(model_names, state.settings.models_dir)
    if action == "unload" or name not in known:
        raise UnknownModelError.at("model", name, "the name of a folder of models")


async def _apply(state: AppState, action: Action, name: str) -> None:
    if action == "load":
        await _load(state, name)
    else:
        state.serve(state.registry.without(name))


async def _load(state: AppState, name: str) -> None:
    """Load every version of a model again from its folder.

    A version that is served and can no longer be loaded is served on as it was; versions whose
    folders are gone are dropped.
    """
    versions = (await run_in_daemon_thread(state.load, state.settings.models_dir, name)).models
    if not versions:
        raise UnknownModelError.at("model", name, "the name of a folder of models")
    before = {model.version: model for model in state.registry.models if model.name == name}
    kept = [_usable(model, before.get(model.version)) for model in versions]
    state.serve(state.registry.updated(name, kept))
    refused = [model for model in versions if model.reason is not None]
    if refused:
        raise InvalidValueError(
            "; ".join(f"{model.label} is rejected: {model.reason}" for model in refused)
        )


def _usable(loaded: Model, before: Model | None) -> Model:
    if before is None or before.status != "ready" or loaded.status != "invalid":
        return loaded
    return before
