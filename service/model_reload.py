"""Models that come and go while the service answers: what has begun goes on with its own."""

from typing import Literal

from service.errors import InvalidValueError, UnknownModelError
from service.inference.daemon_threads import run_in_daemon_thread
from service.serving.registry import Model
from service.state import State


async def change(state: State, what: Literal["load", "unload"], name: str) -> None:
    """Load or unload a model in all processes that answer; raises what this one's does."""
    if state.siblings is None:
        await change_here(state, what, name)
    else:
        await state.siblings.everywhere(what, name)


async def change_here(state: State, what: str, name: str) -> None:
    """Load or unload a model in this process."""
    await (load if what == "load" else unload)(state, name)


async def load(state: State, name: str) -> None:
    """Load every version of a model again from its folder.

    A version that is served and can no longer be loaded is served on as it was; versions whose
    folders are gone are dropped.

    Raises
    ------
    UnknownModelError
        When there is no such folder.
    InvalidValueError
        When a version is refused; the others are loaded.
    """
    async with state.changing:
        versions = (await run_in_daemon_thread(state.load, state.settings.models_dir, name)).models
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


async def unload(state: State, name: str) -> None:
    """Stop serving a model, and free its memory once nothing uses it.

    Raises
    ------
    UnknownModelError
        When there is no such model.
    """
    async with state.changing:
        state.serve(state.registry.without(name))


def _usable(loaded: Model, before: Model | None) -> Model:
    if before is None or before.status != "ready" or loaded.status != "refused":
        return loaded
    return before
