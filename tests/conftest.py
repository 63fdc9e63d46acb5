import pytest
from hypothesis import settings

# Machines that run tests are busy, so no example has a deadline; and the same code always passes
# or always fails.
settings.register_profile("rollcast", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("rollcast")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--address", help="a service that runs already: it is tried instead of one of our own"
    )
