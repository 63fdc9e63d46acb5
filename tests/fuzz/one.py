"""``python -m tests.fuzz.one TARGET FOLDER [options of libFuzzer]``: fuzz one target (.venv/tools).

Writes into FOLDER what it has found so far, and ``memory.json``: resident memory now and then.
"""

import json
import logging
import resource
import sys
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["PIL", "python_multipart", "rollcast", "service"]):
    from tests.fuzz.targets import TARGETS, Cost, dictionary, seeds

REPORTED_EVERY = 100


def resident_mib() -> float:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


class Counted:
    """A target whose calls are counted and whose process's memory is watched."""

    def __init__(self, target: str, path: Path) -> None:
        self._call = TARGETS[target]()
        self._path = path
        self._calls = 0
        self._memory: list[tuple[int, float]] = []

    def __call__(self, data: bytes) -> None:
        """Call the target."""
        self._call(data)
        if self._calls % REPORTED_EVERY == 0:
            self._report()
        self._calls += 1

    def _report(self) -> None:
        self._memory.append((self._calls, round(resident_mib(), 1)))
        self._path.write_text(json.dumps(self._memory))
        if isinstance(self._call, Cost):
            self._path.with_name("cost.json").write_text(json.dumps(self._call.worst))


def main() -> None:
    logging.disable()
    target, folder, *options = sys.argv[1:]
    home = Path(folder)
    corpus = home / "corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    for index, seed in enumerate(seeds(target)):
        (corpus / f"seed-{index}").write_bytes(seed)
    words = home / "dictionary"
    words.write_text(dictionary())
    arguments = [
        sys.argv[0],
        f"-dict={words}",
        f"-artifact_prefix={home}/",
        "-timeout=30",
        "-rss_limit_mb=2048",
        f"-max_len={65536 if target == 'cost' else 4096}",
        "-print_final_stats=1",
        *options,
        str(corpus),
    ]
    atheris.Setup(arguments, Counted(target, home / "memory.json"))
    atheris.Fuzz()


if __name__ == "__main__":
    main()
