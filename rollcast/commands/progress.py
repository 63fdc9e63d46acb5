"""Signs of life on stderr while something takes long, on a terminal alone."""

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import TypeVar

from rich.console import Console
from rich.progress import track

T = TypeVar("T")


def counted(items: Iterable[T], total: int, what: str) -> Iterator[T]:
    """Pass items on and show how many of them have gone by."""
    console = Console(stderr=True)
    return iter(
        track(
            items,
            what,
            total=total,
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
    )


def stage(number: int, count: int, what: str) -> str:
    """Return the text of a stage: its number, the number of stages, and its name."""
    return f"{number} of {count}: {what}" if count > 1 else what


def waiting(what: str) -> AbstractContextManager[object]:
    """Show a progress indicator of unknown length."""
    console = Console(stderr=True)
    return console.status(what) if console.is_terminal else nullcontext()
