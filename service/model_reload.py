"""Models loaded and unloaded while the service answers; running forecasts keep their model."""

import asyncio
import logging

from service.errors import InvalidValueError, ServiceError, UnknownModelError
from service.serving.loading import model_names
from service.serving.model_changes import Action
from service.serving.registry import Model
from service.state import State

POLL_S = 0.25
"""Interval at which a worker looks for changes that other workers have recorded."""

log = logging.getLogger(__name__)


async def change(state: State, action: Action, name: str) -> None:
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
        if state.changes is None:
            await _apply(state, action, name)
        else:
            await _apply_newer(state, await state.changes.record(action, name))


async def follow(state: State) -> None:
    """Apply the changes of other processes until cancelled."""
    while True:
        await asyncio.sleep(POLL_S)
        async with state.changing:
            try:
                await _apply_newer(state)
            except Exception:  # a later change may well succeed
                log.exception("a change of a model could not be applied")


async def _require_known(state: State, action: Action, name: str) -> None:
    if any(model.name == name for model in state.registry.models):
        return
    known = await asyncio.to_thread(model_names, state.settings.models_dir)
    if action == "unload" or name not in known:
        raise UnknownModelError.at("model", name, "the name of a folder of models")


async def _apply_newer(state: State, own: int | None = None) -> None:
    """Apply what has been recorded since; raise what a request's own change raises."""
    assert state.changes is not None
    failure: ServiceError | None = None
    for recorded in state.changes.newer():
        try:
            await _apply(state, recorded.action, recorded.name)
        except ServiceError as error:
            if recorded.generation == own:
                failure = error
            else:
                log.warning("%s of %s: %s", recorded.action, recorded.name, error.detail)
        finally:
            state.changes.mark_applied(recorded)
    if failure is not None:
        raise failure


async def _apply(state: State, action: Action, name: str) -> None:
    if action == "load":
        await _load(state, name)
    else:
        state.serve(state.registry.without(name))


async def _load(state: State, name: str) -> None:
    """Load every version of a model again from its folder.

    A version that is served and can no longer be loaded is served on as it was; versions whose
    folders are gone are dropped.
    """
    versions = (await asyncio.to_thread(state.load, state.settings.models_dir, name)).models
    if not versions:
        raise UnknownModelError.at("model", name, "the name of a folder of models")
    before = {model.version: model for model in state.registry.models if model.name == name}
    kept = [_usable(model, before.get(model.version)) for model in versions]
    state.serve(state.registry.updated(name, kept))
    refused = [model for model in versions if model.reason is not None]
    if refused:
        raise InvalidValueError(
            "; ".join(f"{model.label} is refused: {model.reason}" for model in refused)
        )


def _usable(loaded: Model, before: Model | None) -> Model:
    if before is None or before.status != "ready" or loaded.status != "refused":
        return loaded
    return before
