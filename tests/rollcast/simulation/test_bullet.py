"""PyBullet's import says nothing, and takes nothing of what others say."""

import subprocess
import sys


def test_importing_the_simulator_prints_nothing():
    program = "print('before', flush=True); import rollcast.simulation; print('after')"
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert ran.stdout == "before\nafter\n"


def test_it_can_be_imported_without_a_stdout():
    program = "import os; os.close(1); import rollcast.simulation"
    subprocess.run([sys.executable, "-c", program], check=True)
