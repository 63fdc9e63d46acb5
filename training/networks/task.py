"""Task of a network: number of balls, frames, outputs."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Task:
    """Task of a network.

    Attributes
    ----------
    objects
        Balls.
    final_step
        Forecast step that a fifth frame shows; None leaves that frame out.
    angular_velocity
        Whether angular velocities are forecast; without, it is the paper's "w/o ang. vel.".
    interaction
        Whether several balls know of each other.
    """

    objects: int = 1
    final_step: int | None = None
    angular_velocity: bool = True
    interaction: bool = True

    @property
    def frames(self) -> Literal[4, 5]:
        """Frames that are seen: the observed ones and perhaps the final one."""
        return 4 if self.final_step is None else 5

    @property
    def meetings(self) -> bool:
        """Whether there are others to know of."""
        return self.interaction and self.objects > 1
