"""PyBullet's import says nothing, and takes nothing of what others say."""

import subprocess
import sys

import pytest


def test_importing_the_simulator_prints_nothing():
    program = "print('before', flush=True); import rollcast.simulation; print('after')"
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert (ran.stdout, ran.stderr) == ("before\nafter\n", "")


@pytest.mark.parametrize("descriptor", [1, 2])
def test_it_can_be_imported_without_a_stdout_or_stderr(descriptor):
    program = f"import os; os.close({descriptor}); import rollcast.simulation"
    subprocess.run([sys.executable, "-c", program], check=True)
