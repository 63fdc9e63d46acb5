"""The models that are there: chosen by name or by "auto"."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from rollcast.footage import is_among
from rollcast.manifest import Manifest
from rollcast.scene import Domain
from rollcast.schemas import AUTO_MODEL, DEFAULT_HORIZON
from service.errors import (
    InvalidValueError,
    ModelUnavailableError,
    NoSuitableModelError,
    NotReadyError,
    UnknownModelError,
)
from service.inference.rollout import Predictor
from service.inference.step_times import reads_rate


@dataclass(frozen=True)
class Model:
    """One version of one model.

    It is served when it has a predictor, refused when there is a reason, else unloaded.
    """

    name: str
    version: int
    manifest: Manifest | None = None
    predictor: Predictor | None = None
    reason: str | None = None
    card: str | None = None

    @property
    def label(self) -> str:
        """NAME@VERSION."""
        return f"{self.name}@{self.version}"

    @property
    def status(self) -> Literal["ready", "invalid", "unloaded"]:
        """True if it is served."""
        if self.predictor is not None:
            return "ready"
        return "unloaded" if self.reason is None else "invalid"

    @property
    def is_default(self) -> bool:
        """True if a bare NAME means this version."""
        return self.manifest is not None and self.manifest.default


@dataclass(frozen=True)
class ModelQuery:
    """Requirements of a request on its model."""

    model: str = AUTO_MODEL
    objects: int | None = None
    scenario: Domain | None = None
    final_frame: bool = False
    prompted: bool = False
    """Presence of prompts, whose number is ``objects``."""
    square: bool = True
    """Square frames, as models for a fixed number of balls require them."""
    horizon: int = DEFAULT_HORIZON
    frame_rate: float | None = None
    """Rate of the frames per second, if the request contains it."""


class Registry:
    """Every version of every model, in the order of their names.

    Parameters
    ----------
    models
        Served and refused ones.
    """

    def __init__(self, models: Sequence[Model]) -> None:
        self.models = tuple(sorted(models, key=lambda model: (model.name, model.version)))

    @property
    def served(self) -> list[Predictor]:
        """The predictors of all models that are ready."""
        return [model.predictor for model in self.models if model.predictor is not None]

    def without(self, name: str) -> "Registry":
        """Return the registry with every version of a name unloaded.

        Raises
        ------
        UnknownModelError
            When there is none.
        """
        unloaded = [replace(m, predictor=None, reason=None) for m in self.versions(name)]
        return self.updated(name, unloaded)

    def updated(self, name: str, versions: Sequence[Model]) -> "Registry":
        """Return the registry with other versions of a name."""
        others = [model for model in self.models if model.name != name]
        return Registry([*others, *versions])

    def versions(self, name: str) -> list[Model]:
        """Return every version of a name.

        Raises
        ------
        UnknownModelError
            When there is none.
        """
        found = [model for model in self.models if model.name == name]
        if not found:
            raise UnknownModelError.at("model", name, self._labels())
        return found

    def get(self, name: str, version: int | None = None) -> Model:
        """Return one version of a name, by default the one that its manifest marks as default.

        Raises
        ------
        UnknownModelError
            When there is no such name or version, or no version is the default.
        """
        versions = self.versions(name)
        wanted = [
            m for m in versions if (m.is_default if version is None else m.version == version)
        ]
        if not wanted:
            asked = name if version is None else f"{name}@{version}"
            raise UnknownModelError.at("model", asked, _one_of(model.label for model in versions))
        return wanted[-1]

    def predictor(self, name: str, version: str | None = None) -> Predictor:
        """Return the predictor of a name, by default of its default version.

        Raises
        ------
        UnknownModelError
            When there is no such name or version, or the version is no number.
        ModelUnavailableError
            When the version is not served.
        """
        if version is not None and not _is_number(version):
            expected = "a version that is a whole number"
            raise UnknownModelError.at("model", f"{name}@{version}", expected)
        model = self.get(name, None if version is None else int(version))
        if model.predictor is None:
            why = "" if model.reason is None else f": {model.reason}"
            raise ModelUnavailableError(f"{model.label} is {model.status}{why}")
        return model.predictor

    def choose(self, query: ModelQuery) -> Predictor:
        """Return the predictor for a request.

        Raises
        ------
        UnknownModelError, ModelUnavailableError, InvalidValueError
            When a named model is not there, not served or made for something else.
        NoSuitableModelError
            When "auto" finds none.
        NotReadyError
            When no model is served at all.
        """
        if not self.served:
            raise NotReadyError("No usable model is loaded.")
        if query.model == AUTO_MODEL:
            return self._choose_best(query)
        name, separator, version = query.model.partition("@")
        predictor = self.predictor(name, version if separator else None)
        _check_fit(predictor.manifest, query)
        return predictor

    def _choose_best(self, query: ModelQuery) -> Predictor:
        """Apply the rule for "auto" (decisions 0106 and 0143) to the default versions.

        A model for footage is trained on one set-up, so it is chosen for the scenario "footage", or
        if no other model forecasts this number of balls (decision 0129).
        """
        objects = query.objects or 1
        fitting = [p for p in self.served if p.manifest.default and p.manifest.follows(objects)]
        of_any_number = [p for p in fitting if p.manifest.max_objects is not None]
        made_for_it = [p for p in fitting if p.manifest.max_objects is None]
        # Models for a fixed number of balls accept no prompts and only square frames. If no other
        # model is served, the error for a rectangle says so.
        only_any = query.prompted or (of_any_number and not query.square)
        # Models with the frame rate as input estimate velocities correctly.
        at_other_rate = [p for p in of_any_number if _reads_other_rate(p.manifest, query)]
        choices = [made_for_it, of_any_number]
        for peers in [of_any_number] if only_any else [at_other_rate, *choices]:
            if suitable := _suitable(peers, query):
                return min(suitable, key=lambda p: p.manifest.error_at(query.horizon))
        kind = "reads a final frame" if query.final_frame else "predicts a covariance"
        raise NoSuitableModelError.at(
            "model",
            AUTO_MODEL,
            f"a model's name: none for num_objects {objects} and scenario "
            f"{query.scenario or 'unknown'} {kind}; served are {self._labels()}",
        )

    def for_ood_frames(self, wanted: Manifest) -> Predictor | None:
        """Return the model that replaces the choice of "auto" for out-of-distribution frames.

        It was trained on frames of random appearance and forecasts as many balls of the same
        scenarios and frames; None when no such model is served.
        """
        suitable = [
            predictor
            for predictor in self.served
            if predictor.manifest.random_appearances
            and predictor.manifest.follows(wanted.objects)
            and predictor.manifest.frames == wanted.frames
            and set(wanted.scenarios) <= set(predictor.manifest.scenarios)
        ]
        return min(suitable, key=lambda p: p.manifest.validation_error_px, default=None)

    def _labels(self) -> str:
        return _one_of(model.label for model in self.models)


def _suitable(peers: Sequence[Predictor], query: ModelQuery) -> list[Predictor]:
    """Return the models that know all scenarios that a request may be of, and read its frames."""
    if query.scenario is None:
        known = {scenario for peer in peers for scenario in peer.manifest.scenarios}
        scenarios = known - {"footage"} or known
    else:
        scenarios = {query.scenario}
    return [
        peer
        for peer in peers
        if scenarios <= set(peer.manifest.scenarios)
        and (peer.manifest.final_step is not None) == query.final_frame
        and (query.final_frame or peer.manifest.covariance.source == "predicted")
    ]


def _reads_other_rate(manifest: Manifest, query: ModelQuery) -> bool:
    """Tell whether frames have another rate than the usual one, which a model is told."""
    rate, usual = query.frame_rate, manifest.frame_rate_hz
    return rate is not None and not is_among(rate, (usual, usual)) and reads_rate(manifest, rate)


def _one_of(labels: Iterable[str]) -> str:
    return "one of " + ", ".join(labels)


def _is_number(text: str) -> bool:
    """Tell whether a text is a whole number, of a length that ``int`` reads."""
    return text.isascii() and text.isdigit() and len(text) <= 18


def _check_fit(manifest: Manifest, query: ModelQuery) -> None:
    if query.prompted and manifest.max_objects is None:
        expected = f"none: {manifest.label} finds its balls by itself"
        raise InvalidValueError.at("balls", query.objects, expected)
    if query.objects is not None and not manifest.follows(query.objects):
        most = manifest.max_objects
        number = f"{manifest.objects}, the number" if most is None else f"1 to {most}, the numbers"
        raise InvalidValueError.at(
            "num_objects", query.objects, f"{number} of balls of {manifest.label}"
        )
    if query.scenario is not None and query.scenario not in manifest.scenarios:
        expected = f"{' or '.join(manifest.scenarios)}, which {manifest.label} is made for"
        raise InvalidValueError.at("scenario", query.scenario, expected)
    if query.final_frame and manifest.final_step is None:
        expected = f"none: {manifest.label} reads the observed frames alone"
        raise InvalidValueError.at("final_frame", "an image", expected)
    if not query.final_frame and manifest.final_step is not None:
        expected = f"an image of step {manifest.final_step}, which {manifest.label} needs"
        raise InvalidValueError.at("final_frame", None, expected)
