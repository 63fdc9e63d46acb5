"""NPE and IFS against what is known of them without any scene."""

from functools import partial

import pytest
import torch

from training.baselines.fitting import FitConfig, fit
from training.baselines.ifs import Ifs
from training.baselines.interaction import (
    CODE,
    InteractionDynamics,
    SideBySide,
    annealed_weights,
)
from training.baselines.learner import Learner
from training.baselines.npe import Npe
from training.baselines.states import States
from training.objectives.schedules import Exponential

LEARNERS = [partial(Npe, angular_velocity=True), partial(Npe, angular_velocity=False),
            partial(Ifs, angular_velocity=True), partial(Ifs, angular_velocity=False)]  # fmt: skip


def spring(sequences: int, frames: int, seed: int) -> States:
    """Two equal bodies that a spring pulls together, near enough to feel each other always."""
    generator = torch.Generator().manual_seed(seed)
    middle = 0.3 * torch.randn(sequences, 2, generator=generator)
    apart = 0.1 * torch.randn(sequences, 2, generator=generator)
    drift = 0.01 * torch.randn(sequences, 2, generator=generator)
    swing = 0.02 * torch.randn(sequences, 2, generator=generator)
    times = torch.arange(-1, frames)[None, :, None]
    config = 0.3
    offset = (
        apart[:, None] * (config * times).cos() + swing[:, None] / config * (config * times).sin()
    )
    centre = middle[:, None] + drift[:, None] * times
    positions = torch.stack([centre + offset, centre - offset], dim=1)
    return States(
        positions[:, :, 1:],
        positions[:, :, 1:] - positions[:, :, :-1],
        torch.zeros(sequences, 2, frames, 3),
        torch.zeros(sequences, 3),
    )


@pytest.mark.parametrize("build", LEARNERS)
def test_the_order_of_the_balls_does_not_matter(build):
    torch.manual_seed(0)
    learner: Learner[States] = build().eval()
    given = spring(3, 4, seed=1)
    swapped = States(
        given.positions.flip(1), given.velocities.flip(1), given.spins.flip(1), given.bowl
    )
    with torch.inference_mode():
        plain, other = learner.forecast(given, 6), learner.forecast(swapped, 6)
    torch.testing.assert_close(plain.positions, other.positions.flip(1), atol=1e-4, rtol=0)


@pytest.mark.parametrize("build", LEARNERS)
def test_nothing_after_the_first_four_states_is_looked_at(build):
    torch.manual_seed(0)
    learner: Learner[States] = build().eval()
    long = spring(2, 12, seed=2)
    with torch.inference_mode():
        told = learner.forecast(long.until(4), 9)
        forecast = learner.forecast(long, 9)
    assert torch.equal(told.positions, forecast.positions)
    # t = 0 is given.
    torch.testing.assert_close(forecast.positions[:, :, 0], 64 * (1 + long.positions[:, :, 3]))
    assert (forecast.angular_velocities is None) == (not learner.sees_spin)


def plain(perceptron: SideBySide, core: int, x: torch.Tensor) -> torch.Tensor:
    """Apply the perceptron of one core, layer by layer."""
    for index, (weights, biases) in enumerate(
        zip(perceptron.weights, perceptron.biases, strict=True)
    ):
        x = (x if index == 0 else x.relu()) @ weights[core] + biases[core]
    return x


@pytest.mark.parametrize("balls", [1, 2, 3])
def test_folded_layers_do_what_the_published_ones_do(balls):
    """Each core: a ball's own dynamics and what the others do to it, then affector and output."""
    torch.manual_seed(balls)
    dynamics = InteractionDynamics().double()
    codes = torch.randn(2, balls, 4, CODE, dtype=torch.float64)
    cores = dynamics.cores
    history = list(codes.unbind(2))
    for _ in range(3):
        made: list[torch.Tensor] = []
        for ball in range(balls):
            of_cores: list[torch.Tensor] = []
            for core, offset in enumerate((1, 2, 4)):
                known = history[-offset]
                effects = plain(cores.alone, core, known[:, ball])
                for other in set(range(balls)) - {ball}:
                    pair = torch.cat([known[:, ball], known[:, other]], -1)
                    effects = effects + plain(cores.relation, core, pair)
                affected = plain(cores.affector, core, effects)
                seen = torch.cat([known[:, ball], affected], -1)
                of_cores.append(plain(cores.output, core, seen))
            made.append(dynamics.join(torch.cat(of_cores, -1)))
        history.append(torch.stack(made, 1))
    torch.testing.assert_close(dynamics.roll_out(codes, 3), torch.stack(history[4:], 2))


def test_steps_that_weigh_nothing_are_not_rolled_out():
    early, late = annealed_weights(16, 0.1), annealed_weights(16, 1.0)
    assert len(early) == 3
    assert 1 - early.sum() < 16e-3
    torch.testing.assert_close(late, torch.full((16,), 1 / 16))


def test_an_untrained_engine_that_predicts_no_change_goes_straight_on():
    engine = Npe(angular_velocity=False).eval()
    for parameter in engine.decoder[-1].parameters():
        torch.nn.init.zeros_(parameter)
    given = spring(2, 4, seed=3)
    with torch.inference_mode():
        path = engine.forecast(given, 5).positions / 64 - 1
    steps = torch.arange(5)[:, None]
    straight = given.positions[:, :, 3:4] + given.velocities[:, :, 3:4] * steps
    torch.testing.assert_close(path, straight, atol=1e-5, rtol=0)


@pytest.mark.parametrize(
    ("build", "frames", "rate", "batches"),
    [(LEARNERS[1], 3, 1e-3, 1500), (LEARNERS[3], 10, 2e-3, 800)],
    ids=["npe", "ifs"],
)
def test_a_spring_is_learned_from_a_thousand_samples(build, frames, rate, batches, tmp_path):
    samples = spring(1000, frames, seed=4)
    unseen = spring(100, 14, seed=5)
    truth = 64 * (1 + unseen.positions[:, :, 3:])

    def stream(first: int):
        for number in range(first, batches):
            rows = torch.randint(1000, (50,), generator=torch.Generator().manual_seed(number))
            yield States(*(part[rows] for part in samples))

    def error(learner: Learner[States]) -> float:
        made = learner.forecast(unseen, 11).positions
        return float((made - truth)[:, :, 10].norm(dim=-1).mean().detach())

    fit_config = FitConfig(
        batches, stream, lambda p: torch.optim.Adam(p, rate), lambda: Exponential(0.05), 50
    )
    learner = fit(build, fit_config, tmp_path, error).learner
    straight = unseen.positions[:, :, 3] + 10 * unseen.velocities[:, :, 3]
    line = float((64 * (1 + straight) - truth[:, :, 10]).norm(dim=-1).mean())
    assert error(learner) < line / 5


def test_a_training_that_was_stopped_ends_as_one_that_was_not(tmp_path):
    samples = spring(200, 10, seed=6)

    def stream(first: int):
        number = first
        while True:
            rows = torch.randint(200, (8,), generator=torch.Generator().manual_seed(number))
            yield States(*(part[rows] for part in samples))
            number += 1

    class StoppedError(Exception):
        pass

    def stopping(first: int):
        for number, batch in enumerate(stream(first), first):
            if number == 12:
                raise StoppedError
            yield batch

    def fit_config(batches) -> FitConfig[States]:
        return FitConfig(
            20, batches, lambda p: torch.optim.Adam(p, 1e-3), lambda: Exponential(0.5), 8
        )

    def error(learner: Learner[States]) -> float:
        return float(learner.loss(samples, 1.0).detach())

    build = LEARNERS[2]
    whole = fit(build, fit_config(stream), tmp_path / "whole", error)
    with pytest.raises(StoppedError):
        fit(build, fit_config(stopping), tmp_path / "stopped", error, checkpoint_seconds=0)
    resumed = fit(build, fit_config(stream), tmp_path / "stopped", error)
    pairs = zip(whole.learner.parameters(), resumed.learner.parameters(), strict=True)
    for one, other in pairs:
        assert torch.equal(one, other)
