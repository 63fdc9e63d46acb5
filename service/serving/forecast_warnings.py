"""Warnings of forecasts: horizon, frame rate, motion, lost balls, distribution."""

from rollcast.footage import is_among
from rollcast.manifest import Manifest, PlaceUncertainty
from rollcast.ood import FrameStats
from service.inference.rollout import Predictor
from service.inference.step_times import frame_spacing, reads_rate


def limit_warnings(
    predictor: Predictor,
    horizon: int,
    frame_rate: float,
    seen: FrameStats,
) -> list[str]:
    """Return the warnings of a forecast, except that of out-of-distribution frames."""
    manifest = predictor.manifest
    return [
        *_of_horizon(manifest, horizon, frame_spacing(manifest, frame_rate)),
        *_of_rate(manifest, frame_rate),
        *_of_stillness(seen),
    ]


def replaced(chosen: Manifest, used: Manifest) -> str:
    """Return the warning that the model for OOD frames has replaced the usual choice."""
    return (
        f"{used.label} forecasts in place of {chosen.label}: it was trained on frames of random "
        "appearance. Name a model to use another one."
    )


def lost_ball(manifest: Manifest, known: PlaceUncertainty, sigma_px: float) -> list[str]:
    """Return the warning of a ball whose position at t = 0 is uncertain, if it is.

    Parameters
    ----------
    sigma_px
        Standard deviation of the place at t = 0, pixels of 128.
    """
    if sigma_px <= known.threshold_px:
        return []
    percent = 100 * known.false_alarm_rate
    return [
        f"{manifest.label} may have lost a ball: the standard deviation of its position at t = 0 "
        f"is {sigma_px:.2g} px of 128, above {known.threshold_px:.2g} (false-alarm rate "
        f"{percent:.2g} %). The forecast may follow another object."
    ]


def left_frame(step: int) -> str:
    """Return the warning of a ball whose forecast leaves the frame."""
    return (
        f"The forecast leaves the frame at step {step}: the model has no data beyond it, and "
        "later positions stay within a tenth of the frame around it."
    )


def _of_horizon(manifest: Manifest, horizon: int, spacing: float) -> list[str]:
    found: list[str] = []
    trained = 1 + int((manifest.trained_horizon - 1) / spacing)
    if horizon > trained:
        found.append(
            f"The horizon of {horizon} steps exceeds the {trained} steps that "
            f"{manifest.label} was trained on: later steps are extrapolated."
        )
    known = manifest.covariance.empirical
    if known is not None and horizon > len(known):
        found.append(
            f"The empirical covariances of {manifest.label} end with step {len(known) - 1}: "
            "later steps repeat the last one."
        )
    return found


def _of_rate(manifest: Manifest, given: float) -> list[str]:
    rate = manifest.frame_rate_hz
    if is_among(given, (rate, rate)) or reads_rate(manifest, given):
        return []
    if manifest.frame_rates_hz is not None:
        lowest, highest = manifest.frame_rates_hz
        return [
            f"The frames are {given:g} a second and {manifest.label} was trained on {lowest:g} to "
            f"{highest:g}: the forecast assumes {rate:g}."
        ]
    return [
        f"The frames are {given:g} a second and {manifest.label} was trained on "
        f"{rate:g}: the forecast assumes {rate:g}."
    ]


def _of_stillness(seen: FrameStats) -> list[str]:
    if not seen.is_still:
        return []
    return [
        "Nothing moves in the four frames: their largest change is "
        f"{seen.largest_change:.1f} of 255 levels of brightness."
    ]


def out_of_distribution(predictor: Predictor, seen: FrameStats) -> list[str]:
    """Return the warning of frames that are out of distribution for a model, if they are."""
    known, ood_detector = predictor.manifest.ood, predictor.ood_detector
    if known is None or ood_detector is None:
        return []
    score = ood_detector.score(seen)
    if score <= known.threshold:
        return []
    percent = 100 * known.false_alarm_rate
    return [
        f"The frames look unlike the training data of {predictor.manifest.label}: their "
        f"out-of-distribution score of {score:.1f} exceeds {known.threshold:.1f} (false-alarm "
        f"rate {percent:.2g} %). The forecast and its covariances may be far off."
    ]
