import pytest
from hypothesis import settings

# Machines that run tests are busy, so no example has a deadline; and the same code always passes
# or always fails.
settings.register_profile("rollcast", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("rollcast")

LONGEST = (
    "tests/e2e/test_worker_faults.py",
    "tests/training/export/test_several_balls.py",
    "tests/e2e/test_accuracy.py",
    "tests/training/reporting/test_results.py",
    "tests/training/common/test_distributed.py",
    "tests/docs/test_blocks.py",
    "tests/training/engine/test_trainer.py",
    "tests/training/export/test_export.py",
    "tests/training/networks/test_perception_state.py",
    "tests/training/recipes/test_trainable.py",
    "tests/training/baselines/test_from_frames.py",
    "tests/training/cli/test_cli.py",
    "tests/e2e/test_attacks.py",
    "tests/e2e/test_deployment.py",
)
"""Files that take longest, the longest first."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest files: none is left to one process while the others have ended."""
    places = {file: place for place, file in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.location[0], len(LONGEST)))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--address", help="a service that runs already: it is tried instead of one of our own"
    )
