"""The README's Python example, run as it stands against a real server."""

import re
from pathlib import Path

README = Path(__file__).parents[2] / "README.md"


def test_the_python_example_runs(address, capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    assert "http://127.0.0.1:8000" in example
    exec(compile(example.replace("http://127.0.0.1:8000", address), str(README), "exec"), {})
    printed = capsys.readouterr().out
    assert "(1, 20, 2)" in printed
