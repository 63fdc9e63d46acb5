"""Trained network with the metadata of its export."""

from collections.abc import Mapping
from dataclasses import dataclass

from rollcast.manifest import CameraSetup
from rollcast.scene import Domain
from rollcast.trajectory import FRAME_RATE_HZ
from training.networks.recurrent import Network
from training.recipes.recipe import Recipe

LICENCE = "Apache-2.0"


@dataclass(frozen=True)
class FootageSpec:
    """The footage that a network was trained on."""

    setup: CameraSetup
    frame_rate_hz: float
    windows: Mapping[str, int]
    """Training windows, by clip."""


@dataclass(frozen=True)
class Trained:
    """A network ready to be exported: the member ``name`` of a recipe."""

    recipe: Recipe
    name: str
    predictor: Network
    sequences: int
    """Training sequences that its weights have seen."""
    horizon: int
    """Steps of the longest rollouts that trained its weights."""
    filmed: FootageSpec | None = None
    """Footage of the training; None for simulated scenes."""

    @property
    def scenarios(self) -> tuple[Domain, ...]:
        """Domains of the network."""
        return self.recipe.scenarios if self.filmed is None else ("footage",)

    @property
    def frame_rate_hz(self) -> float:
        """Frame rate of the training data, in Hz."""
        return FRAME_RATE_HZ if self.filmed is None else self.filmed.frame_rate_hz

    @property
    def licence(self) -> str:
        """Licence of the weights; not stated for weights from a user's own clips."""
        return LICENCE if self.filmed is None else "not stated"

    @property
    def sources(self) -> dict[str, int]:
        """Training scenes by kind, or windows by clip."""
        if self.filmed is not None:
            return dict(self.filmed.windows)
        return {part.source.name: part.scenes for part in self.recipe.data}
