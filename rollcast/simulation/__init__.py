"""Scenes from seeds: sampling, physics and rendering (needs the extra ``simulation``)."""

from rollcast.errors import SceneParametersError, SceneRejectedError
from rollcast.simulation.recording import Sequence, Simulator

__all__ = ["SceneParametersError", "SceneRejectedError", "Sequence", "Simulator"]
