"""LitServe: a worker a core, each with batches of what waits.

python -m tests.bench.peers.lit PORT
"""

import sys
from typing import Any

import litserve
import numpy as np

from tests.bench.loop import CORES, MAX_BATCH
from tests.bench.peers.answer import Answer, Answers, Request


class Forecaster(litserve.LitAPI):
    def setup(self, device: Any) -> None:
        self.answers = Answers()

    def decode_request(self, request: Request) -> np.ndarray:
        return self.answers.frames(request["frames"])

    def batch(self, inputs: list[np.ndarray]) -> list[np.ndarray]:
        return inputs

    def predict(self, x: list[np.ndarray]) -> list[Answer]:
        return self.answers.forecasts(x)

    def unbatch(self, output: list[Answer]) -> list[Answer]:
        return output

    def encode_response(self, output: Answer) -> Answer:
        return output


if __name__ == "__main__":
    # No wait for a batch to fill: whatever waits already goes along.
    api = Forecaster(max_batch_size=MAX_BATCH, batch_timeout=0.0, api_path="/predict")
    server = litserve.LitServer(api, accelerator="cpu", workers_per_device=CORES)
    server.run(
        port=int(sys.argv[1]), host="127.0.0.1", generate_client_file=False, log_level="error"
    )
