"""The command line: names, refusals, and Ctrl-C in a real training."""

import os
import re
import signal
import subprocess
import sys
import time

import pytest
from typer.testing import CliRunner

from training.__main__ import main
from training.cli import application
from training.cli.train import within
from training.common.run_folder import CHECKPOINT
from training.recipes import RECIPES, summary
from training.recipes.tiny import tiny

COMMANDS = {
    "simulate", "check-world", "train", "dry-run", "plot-run", "auto-train", "evaluate",
    "error-breakdown", "export", "quantise", "fit-ood", "setup", "real", "real-clips",
    "tracked-clips", "perturbations", "frame-rates", "study", "report", "train-balls",
    "train-encounters", "train-ball-motion", "export-balls",
}  # fmt: skip


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Folder of runs with no scene of other tests: commands have whole shards to make."""
    folder = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("ROLLCAST_RUNS", str(folder))
        yield folder


def test_help_names_every_command_and_nothing_of_libraries():
    ran = subprocess.run(
        [sys.executable, "-m", "training", "--help"], capture_output=True, text=True, check=True
    )
    listed = ran.stdout[ran.stdout.index("Commands:") :].splitlines()[1:]
    assert {line.split()[0] for line in listed if re.match(r"  \S", line)} == COMMANDS
    assert ran.stdout.startswith("Usage: ")
    assert ran.stderr == ""


def test_an_environment_without_torch_is_named_with_the_remedy(tmp_path):
    (tmp_path / "torch.py").write_text("raise ModuleNotFoundError('no torch', name='torch')\n")
    command = ["env", f"PYTHONPATH={tmp_path}", sys.executable, "-m", "training", "--help"]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 1
    (line,) = ran.stderr.splitlines()
    assert line.startswith("python -m training: ")
    assert "has no torch, which training needs: run `make training`" in line


def test_failures_are_one_line_without_a_traceback(runs, capsys):
    assert main(["train", "nobody"]) == 2
    line = capsys.readouterr().err.strip()
    assert line.startswith("python -m training: ")
    assert "'nobody' is not one of tiny" in line
    assert len(line.splitlines()) == 1


def test_a_folder_that_cannot_be_written_is_told_without_a_traceback(runs, capsys, monkeypatch):
    monkeypatch.setenv("ROLLCAST_RUNS", "/dev/null/runs")
    code = main(["simulate", "hemisphere", "--scenes", "1", "--split", "training"])
    errors = capsys.readouterr().err.strip()
    assert code == 1
    assert errors.splitlines()[-1].startswith("python -m training: ")
    assert "Traceback" not in errors


def test_every_recipe_has_a_line_in_the_help_of_train():
    text = CliRunner().invoke(application(), ["train", "--help"]).output
    lines = {line.split()[0]: line for line in text.splitlines() if line.startswith("    ")}
    for name in RECIPES:
        assert lines[name].endswith(summary(name))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["train", "nobody"], "'nobody' is not one of tiny, one-ball"),
        (["train", "tiny", "--sequences", "3"], "a batch of tiny has 32"),
        (["train", "tiny", "--device", "gpu"], "every torch has the device cpu"),
        (["dry-run", "tiny", "--device", "meta:x"], "every torch has the device cpu"),
        (["setup", "tiny", "--data", "x"], "'tiny' is not one of setup-one-ball"),
        (["study", "nobody"], "'nobody' is not one of long-term"),
        (["evaluate"], "pass one model"),
        (["evaluate", "--all", "--split", "validation"], "--all measures the test split"),
        (["export", "tiny"], "run `python -m training train tiny` first"),
    ],
)
def test_a_refusal_names_the_value_and_what_would_be_right(words, said, runs):
    ran = CliRunner().invoke(application(), words)
    assert ran.exit_code in {1, 2}
    assert said in " ".join(re.sub(r"[│╭╮╰╯─]", " ", ran.output).split())


def test_a_budget_replaces_the_recipes():
    short = within(tiny(), 64, 50)
    assert (short.sequences, short.data[0].scenes, short.validation_scenes) == (64, 50, 50)
    usual = tiny()
    assert within(usual, None, None) is usual


@pytest.mark.parametrize("wait_s", [4, 8])
def test_ctrl_c_while_scenes_are_made_is_one_line(runs, wait_s):
    """In a terminal it reaches every process; those that simulate start all the time."""
    command = [sys.executable, "-m", "training", "train", "tiny", "--workers", "2"]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    time.sleep(wait_s)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    assert process.returncode in {130, -signal.SIGINT}
    assert "Traceback" not in errors, errors
    assert "pybullet" not in errors
    assert not (runs / "tiny" / CHECKPOINT).exists()


def test_a_dry_run_states_the_speed_and_keeps_nothing(runs):
    before = set(runs.iterdir())
    ran = CliRunner().invoke(
        application(), ["dry-run", "tiny", "--batches", "2", "--batch-size", "4"]
    )
    assert ran.exit_code == 0, ran.output
    assert "tiny: 2 batches of 4 sequences on" in ran.output
    share = re.search(r"GFLOP/s: (\d+)% of the [\d,.]+ GFLOP/s of a product", ran.output)
    assert share
    assert 0 < int(share[1]) < 150
    assert {path.name for path in set(runs.iterdir()) - before} <= {"data"}


def test_ctrl_c_says_how_to_go_on(runs):
    command = [sys.executable, "-m", "training", "train", "tiny", "--scenes", "10"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    events = runs / "tiny" / "events"
    deadline = time.monotonic() + 1200
    while not events.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.1)
    time.sleep(1)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=1200)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert "the same command goes on from there" in errors.splitlines()[-1]
    assert (runs / "tiny" / CHECKPOINT).exists()
