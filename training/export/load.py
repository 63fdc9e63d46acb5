"""Parameters of deployed artefacts, from which training continues."""

from pathlib import Path

import onnx
import torch

from rollcast.manifest import ENCODER_FILE, MANIFEST_FILE, PERCEPTION_FILE, ROLLOUT_FILE, Manifest
from training.common.run_folder import BEST, current_name, read_best
from training.engine.warm_start import Initial, placed
from training.export.weight_rounding import stored_weights
from training.networks.any_ball import AnyBallNet
from training.networks.presets import PRESETS
from training.networks.recurrent import Network
from training.networks.task import Task
from training.recipes.any_ball import warm_network


def read_parameters(folder: Path) -> dict[str, torch.Tensor]:
    """Parameters of an exported model by torch's current names: its graphs' initialisers."""
    parameters: dict[str, torch.Tensor] = {}
    for file in (PERCEPTION_FILE, ENCODER_FILE, ROLLOUT_FILE):
        if (folder / file).exists():
            stored = stored_weights(onnx.load(folder / file).graph)
            parameters |= {current_name(name): value for name, value in stored.items()}
    return parameters


def read_initial(folder: Path) -> Initial:
    """Return the initial network of a training that continues an exported model."""
    manifest = Manifest.read(folder / MANIFEST_FILE)
    sequences = manifest.training["sequences"]
    assert isinstance(sequences, int)
    return Initial(manifest.name, read_parameters(folder), sequences)


def initial_networks(folder: Path) -> list[Initial]:
    """Return the initial networks of a training: an exported model, or the best of a run."""
    if not (folder / BEST).exists():
        return [read_initial(folder)]
    best = read_best(folder)
    return [Initial(name, weights, best["sequences"]) for name, weights in best["weights"].items()]


def any_ball_from(models: Path) -> AnyBallNet:
    """Return the network for any number of balls with the parameters of committed models."""
    one, several = (read_parameters(models / name / "1") for name in ("fieldnet", "fieldnet-3"))
    return warm_network(one, several)


def load_exported(folder: Path) -> tuple[Manifest, Network]:
    """Rebuild the torch network of ``models/NAME/VERSION``.

    Raises
    ------
    ValueError
        When a parameter of the network is missing in the graphs, or the model follows any number
        of balls.
    """
    manifest = Manifest.read(folder / MANIFEST_FILE)
    if manifest.max_objects is not None:
        raise ValueError(
            f"{manifest.label} follows any number of balls: `export-balls` measures it on "
            "simulated scenes, `real-clips` on clips"
        )
    task = Task(
        manifest.objects,
        manifest.final_step,
        manifest.angular_velocity,
        bool(manifest.training.get("interaction", True)),
    )
    family = PRESETS[manifest.preset]({manifest.name: manifest.variant}, task)
    predictor = family.networks()[manifest.name]
    stored = placed(predictor, read_parameters(folder))
    own = predictor.state_dict()
    missing = sorted(own.keys() - stored.keys())
    if missing:
        raise ValueError(f"{folder} lacks the parameters {', '.join(missing)}")
    predictor.load_state_dict({name: stored[name] for name in own})
    return manifest, predictor.eval()
