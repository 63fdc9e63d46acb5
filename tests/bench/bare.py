"""Times the bare loop on the committed graphs.

python -m tests.bench.bare --seconds 5 [--decode]

Prints the times of its forecasts as JSON. With ``--decode`` every forecast begins with four PNG
files, as a request does.
"""

import argparse
import json
import time

from tests.bench.loop import BareLoop, decoded
from tests.bench.payloads import frames, png_files


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=5)
    parser.add_argument("--decode", action="store_true")
    arguments = parser.parse_args()
    loop = BareLoop()
    images = frames()
    files = png_files(images)
    loop.forecast(images[None])
    times: list[float] = []
    end = time.perf_counter() + arguments.seconds
    while (begun := time.perf_counter()) < end:
        seen = decoded(files) if arguments.decode else images
        loop.forecast(seen[None])
        times.append(time.perf_counter() - begun)
    print(json.dumps(times))


if __name__ == "__main__":
    main()
