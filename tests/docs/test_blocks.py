"""Every code block of the README and the guide runs as it stands, each alone."""

import re
import shlex
import subprocess
import sys

import pytest
from typer.main import get_command

from tests.docs.blocks import HOURS, NOT_RUN, ROOT, blocks, notebook_code
from training.cli import application

BLOCKS = blocks()
RUN = [block for block in BLOCKS if block.key not in NOT_RUN]
LEFT_OUT = [block for block in BLOCKS if block.key in NOT_RUN]
REFUSED = {("api-http.md", "/problems/invalid-value")}
"""Blocks that show a refusal, by page and type."""


def run(command, folder, environment):
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def asking(text, address):
    """The block with the address of the service that runs, and the command that knows it."""
    text = re.sub(r"http://(127\.0\.0\.1|localhost):8000|\blocalhost:8000", address, text)
    return re.sub(r"\S*python3? -m rollcast ", "rollcast ", text)


@pytest.mark.parametrize("block", [b for b in RUN if b.language == "python"], ids=str)
def test_python_runs(block, address, folder, environment):
    run([sys.executable, "-c", asking(block.text, address)], folder, environment)


@pytest.mark.parametrize("block", [b for b in RUN if b.language == "sh"], ids=str)
def test_shell_runs(block, address, folder, environment):
    said = run(["bash", "-euc", asking(block.text, address)], folder, environment)
    refusals = {(block.page, slug) for slug in re.findall(r"/problems/[a-z-]+", said)}
    assert refusals <= REFUSED
    assert said or "--out" in block.text or ">" in block.text


def test_the_notebook_runs(address, folder, environment):
    run([sys.executable, "-c", asking(notebook_code(), address)], folder, environment)


@pytest.mark.parametrize("block", LEFT_OUT, ids=str)
def test_what_cannot_run_is_well_formed(block):
    if block.language == "python":
        compile(block.text, str(block), "exec")
        return
    subprocess.run(["bash", "-n"], input=block.text, text=True, check=True)
    for line in block.text.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if words[:3] == ["python", "-m", "training"]:
            is_understood(words[3:])
        elif NOT_RUN[block.key] == HOURS:
            pytest.fail(f"{line} is not one of the training's commands")
        for word in words:
            if re.fullmatch(r"(docker|tools|models)/\S+", word):
                assert (ROOT / word).exists()


def is_understood(words: list[str]) -> None:
    """Parse the arguments of a training command without running it."""
    group = get_command(application())
    with group.make_context("training", words, resilient_parsing=True) as context:
        name, command, rest = group.resolve_command(context, words)
    command.make_context(name, rest).close()


def test_nothing_else_is_left_out():
    assert {block.language for block in BLOCKS} <= {"python", "sh"}
    assert {block.key for block in LEFT_OUT} == NOT_RUN.keys()


def test_a_forecast_takes_ten_lines_of_python_and_one_of_shell():
    start = [block for block in RUN if block.page == "start.md"]
    python = [block.text for block in start if block.language == "python"]
    shell = [block.text for block in start if block.language == "sh"]
    assert any("predict" in text and len(text.strip().splitlines()) <= 10 for text in python)
    assert any("predict" in text and len(text.strip().splitlines()) == 1 for text in shell)
