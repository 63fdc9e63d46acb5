"""BentoML: a worker a core, with its adaptive batching. Its requests are lists of requests.

python -m tests.bench.peers.bento PORT
"""

import os
import sys

import bentoml

from tests.bench.loop import CORES, MAX_BATCH
from tests.bench.peers.answer import Answer, Answers, Request


@bentoml.service(workers=CORES, traffic={"timeout": 60}, logging={"access": {"enabled": False}})
class Forecaster:
    def __init__(self) -> None:
        self.answers = Answers()

    @bentoml.api(batchable=True, max_batch_size=MAX_BATCH, max_latency_ms=60_000, route="/predict")
    def predict(self, requests: list[Request]) -> list[Answer]:
        return self.answers.forecasts([self.answers.frames(one["frames"]) for one in requests])


if __name__ == "__main__":
    service = "tests.bench.peers.bento:Forecaster"
    server = [sys.executable, "-m", "bentoml", "serve", service, "--port", sys.argv[1]]
    os.execv(sys.executable, [*server, "--host", "127.0.0.1"])
