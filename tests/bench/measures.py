"""What is promised of the service, measured: every function returns lines of the report."""

import time

import httpx2
import psutil

from tests.bench.harness import (
    Finding,
    answering,
    ask,
    asked,
    bare,
    heard,
    median_ms,
    service,
)
from tests.bench.loop import CORES, MODEL
from tests.bench.payloads import KINDS, Kind

MIB = 2**20
NO_TARGET = "none"


def one_at_a_time(address: str, rounds: int, seconds: float) -> list[Finding]:
    """Difference of medians over HTTP and in the bare loop."""
    over: dict[Kind, list[float]] = {"binary": [], "multipart": [], "json": []}
    for _ in range(rounds):
        plain, decoding = (median_ms(bare(seconds, *options)[0]) for options in ([], ["--decode"]))
        for kind, found in over.items():
            answers = asked(address, seconds, kind)
            assert not answers.failures, answers.times.keys()
            found.append(1e3 * answers.quantile(0.5) - (plain if kind == "binary" else decoding))
    limits: dict[Kind, float] = {"binary": 2.5, "multipart": 3, "json": 3}
    return [
        Finding(
            f"1 connection, {kind}: p50 minus that of the bare loop"
            + ("" if kind == "binary" else " with decoding"),
            "ms", tuple(found), f"at most {limits[kind]:g}", lambda x, most=limits[kind]: x <= most,
        )
        for kind, found in over.items()
    ]  # fmt: skip


def throughput(address: str, rounds: int, seconds: float) -> list[Finding]:
    """Answers a second at 16 connections relative to the bare loop on every core."""
    shares: dict[Kind, list[float]] = {"binary": [], "multipart": []}
    own: list[float] = []
    for _ in range(rounds):
        alone = sum(len(times) for times in bare(seconds, processes=CORES)) / seconds
        for kind, found in shares.items():
            answers = asked(address, seconds, kind, "--connections", "16")
            assert not answers.failures, answers.times.keys()
            found.append(answers.rate / alone)
            own.append(answers.client_s / answers.wall_s)
    findings = [
        Finding(
            f"16 connections, {kind}: throughput relative to the bare loop on {CORES} cores", "",
            tuple(found), f"at least {least:g}", lambda x, least=least: x >= least,
        )
        for (kind, found), least in zip(shares.items(), (0.85, 0.75), strict=True)
    ]  # fmt: skip
    client = Finding("CPU use of the client, in cores", "", tuple(own), NO_TARGET, lambda _: True)
    return [*findings, client]


def overload(rounds: int, seconds: float) -> list[Finding]:
    """Twice as many requests as can be answered; requests without a free core are rejected."""
    with service(ROLLCAST_INFERENCE_QUEUE="0") as (address, _):
        slower: list[float] = []
        answered: list[float] = []
        after: list[float] = []
        for _ in range(rounds):
            quiet = asked(address, seconds / 4, "binary")
            full = asked(address, seconds / 4, "binary", "--connections", str(CORES))
            loaded = asked(address, seconds, "binary", "--rate", str(2 * full.rate))
            assert set(loaded.times) == {200, 429}, loaded.times.keys()
            again = asked(address, seconds / 4, "binary")
            answered.append(loaded.rate / full.rate)
            slower.append(loaded.quantile(0.99) / quiet.quantile(0.99))
            after.append(again.quantile(0.5) / quiet.quantile(0.5))
    return [
        Finding(
            "load of twice the capacity: p99 of accepted requests relative to the unloaded p99", "",
            tuple(slower), "at most 3", lambda x: x <= 3,
        ),
        Finding(
            "throughput under this load relative to the capacity", "",
            tuple(answered), NO_TARGET, lambda _: True,
        ),
        Finding(
            "p50 after this load relative to before", "", tuple(after), "about 1", lambda x: x < 1.1
        ),
    ]  # fmt: skip


def cold_start(rounds: int) -> Finding:
    """Seconds from the start of the process to readiness."""
    found: list[float] = []
    for _ in range(rounds):
        begun = time.perf_counter()
        with service():
            found.append(time.perf_counter() - begun)
    return Finding(
        "cold start to ready, all models", "s", tuple(found), "under 2.5", lambda x: x < 2.5
    )


def memory(address: str, process: psutil.Process, requests: int) -> list[Finding]:
    """Resident memory over many requests of all kinds, simulations among them."""
    part = requests // 10
    resident: list[float] = []
    for _ in range(10):
        options = ("--kinds", *KINDS, "--simulate", "50", "--connections", "8")
        answers = heard(ask(address, *options, "--requests", str(part)))
        assert not answers.failures, answers.times.keys()
        resident.append(max(one.memory_info().rss for one in answering(process)) / MIB)
    return [
        Finding(
            "resident memory of the largest serving process, all models loaded", "MiB",
            tuple(resident), "under 400", lambda x: x < 400,
        ),
        Finding(
            f"peak memory over {requests} mixed requests relative to that after the first {part}",
            "", (max(resident) / resident[0],), "at most 1.05", lambda x: x <= 1.05,
        ),
    ]  # fmt: skip


def reload(address: str, seconds: float) -> list[Finding]:
    """Answers while the very model that answers is loaded again and again."""
    quiet = asked(address, seconds, "binary", "--connections", "4")
    client = ask(address, "--connections", "4", "--seconds", str(seconds))
    loads = 0
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        httpx2.post(f"{address}/v2/repository/models/{MODEL}/load").raise_for_status()
        loads += 1
        time.sleep(1)
    busy = heard(client)
    slower = busy.quantile(0.99) / quiet.quantile(0.99)
    return [
        Finding(
            f"{loads} reloads of the model at 4 connections: failed requests", "",
            (float(busy.failures),), "0", lambda x: x == 0,
        ),
        Finding(
            "p99 during the reloads relative to before", "", (slower,), NO_TARGET, lambda _: True
        ),
    ]  # fmt: skip
