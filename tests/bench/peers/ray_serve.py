"""Ray Serve: a replica a core, with batches of what waits.

python -m tests.bench.peers.ray_serve PORT
"""

import sys
import time

import ray
from ray import serve
from starlette.requests import Request as HttpRequest

from tests.bench.loop import CORES, MAX_BATCH
from tests.bench.peers.answer import Answer, Answers, Request


@serve.deployment(max_ongoing_requests=64, logging_config={"enable_access_log": False})
class Forecaster:
    def __init__(self) -> None:
        self.answers = Answers()

    @serve.batch(max_batch_size=MAX_BATCH, batch_wait_timeout_s=0.0)
    async def together(self, requests: list[Request]) -> list[Answer]:
        return self.answers.forecasts([self.answers.frames(one["frames"]) for one in requests])

    async def __call__(self, request: HttpRequest) -> Answer:
        return await self.together(await request.json())


if __name__ == "__main__":
    ray.init(num_cpus=CORES + 2, include_dashboard=False, log_to_driver=False)
    serve.start(http_options={"host": "127.0.0.1", "port": int(sys.argv[1])})
    replicas = Forecaster.options(num_replicas=CORES, ray_actor_options={"num_cpus": 1})
    serve.run(replicas.bind(), route_prefix="/predict")
    while True:
        time.sleep(60)
