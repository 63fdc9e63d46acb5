"""Workers that share a folder end with the same models, whatever the order of their changes."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from service.serving.model_changes import ModelChanges

WORKERS, NAMES = 3, ("posnet", "dispnet")


def test_a_worker_sees_what_others_change_once(tmp_path):
    mine, other = ModelChanges(tmp_path), ModelChanges(tmp_path)
    mine.record("unload", "posnet")
    assert list(mine.newer()) == []
    assert list(other.newer()) == [("unload", "posnet")]
    assert list(other.newer()) == []
    other.record("unload", "posnet")  # the same again is another change
    assert list(mine.newer()) == [("unload", "posnet")]


def test_a_worker_that_starts_later_knows_what_is_unloaded(tmp_path):
    first = ModelChanges(tmp_path)
    first.record("unload", "posnet")
    first.record("unload", "dispnet")
    first.record("load", "dispnet")
    late = ModelChanges(tmp_path)
    assert late.unloaded == ["posnet"]
    assert list(late.newer()) == []


@given(
    steps=st.lists(
        st.tuples(
            st.integers(0, WORKERS - 1), st.sampled_from(["load", "unload", "look"]),
            st.sampled_from(NAMES),
        ),
        max_size=20,
    )
)  # fmt: skip
def test_all_workers_end_with_the_same_models(tmp_path_factory, steps):
    folder = tmp_path_factory.mktemp("shared")
    workers = [ModelChanges(folder) for _ in range(WORKERS)]
    served = [dict.fromkeys(NAMES, "load") for _ in workers]
    everybody_looks = zip(range(WORKERS), itertools.repeat("look"), itertools.repeat(NAMES[0]))
    for worker, step, name in [*steps, *everybody_looks]:
        if step == "look":
            served[worker].update({name: action for action, name in workers[worker].newer()})
        else:
            workers[worker].record(step, name)
            served[worker][name] = step
    assert all(one == served[0] for one in served)
