"""Every reader of input with changed pieces of good inputs; `make fuzz` does it by the million."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fuzz.targets import TARGETS, WORDS, seeds

READERS = ("frames", "multipart", "tensors", "manifest")
PIECES = st.binary(max_size=8) | st.sampled_from(WORDS)
EDITS = st.lists(st.tuples(st.floats(0, 1), st.integers(0, 8), PIECES), max_size=4)


@pytest.mark.parametrize("name", READERS)
@settings(max_examples=150)
@given(chosen=st.integers(0, 100), edits=EDITS, kept=st.floats(0.1, 1))
def test_whatever_comes_is_read_or_refused(name, chosen, edits, kept):
    good = seeds(name)
    data = bytearray(good[chosen % len(good)])
    for place, dropped, piece in edits:
        start = int(place * len(data))
        data[start : start + dropped] = piece
    TARGETS[name]()(bytes(data[: int(kept * len(data)) + 1]))


@pytest.mark.parametrize("name", READERS)
def test_what_the_fuzzer_begins_with_is_read(name):
    for seed in seeds(name):
        TARGETS[name]()(seed)
