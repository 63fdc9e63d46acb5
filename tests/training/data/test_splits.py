import pytest

from training.data.splits import FIRST_SEED, MAX_SCENES, seeds


def test_splits_share_no_seed_and_leave_small_ones_to_users():
    ranges = [range(first, first + MAX_SCENES) for first in FIRST_SEED.values()]
    assert len(set().union(*ranges)) == 3 * MAX_SCENES
    assert min(FIRST_SEED.values()) >= 1_000_000


def test_more_scenes_begin_with_the_same_ones():
    assert list(seeds("test", 100))[:10] == list(seeds("test", 10))


@pytest.mark.parametrize("scenes", [0, MAX_SCENES + 1])
def test_a_split_has_bounds(scenes):
    with pytest.raises(ValueError, match="a split has 1 to"):
        seeds("test", scenes)
