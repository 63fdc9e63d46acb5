"""A plain FastAPI handler: a process a core, the work in its pool of threads.

python -m tests.bench.peers.plain_fastapi PORT
"""

import sys

import orjson
import uvicorn
from fastapi import FastAPI, Response
from pydantic import BaseModel

from tests.bench.loop import CORES
from tests.bench.peers.answer import Answers

app = FastAPI()
answers = Answers()


class Asked(BaseModel):
    frames: list[str]
    horizon: int


@app.post("/predict")
def predict(asked: Asked) -> Response:
    return Response(orjson.dumps(answers.answer(asked.frames)), media_type="application/json")


if __name__ == "__main__":
    uvicorn.run(
        "tests.bench.peers.plain_fastapi:app",
        port=int(sys.argv[1]), workers=CORES, log_level="error", access_log=False,
    )  # fmt: skip
