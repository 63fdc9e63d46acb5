"""The little of pandas that rollcast names; it ships no types of its own."""

from collections.abc import Mapping

class DataFrame:
    def __init__(self, data: Mapping[str, object]) -> None: ...
