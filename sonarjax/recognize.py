"""Fig. 1 in one function: frame → semantic map → yaw bin → refined yaw."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sonarjax._cores import side_by_side
from sonarjax.io.errors import SonarjaxError
from sonarjax.match import PreparedBank, between_bins, match_positions, peaks, prepare_bank
from sonarjax.refine import YawEstimate, refine_yaw
from sonarjax.render import (
    TemplateBank,
    bank_place,
    check_fits,
    floor_point,
    object_columns,
    template_bank,
    window_shape,
)
from sonarjax.render.region import MARGIN_BEAMS, MARGIN_BINS
from sonarjax.scene import Mesh, Pose
from sonarjax.segment import DEFAULT_SEGMENTER, semantic_map
from sonarjax.sonar import Sonar

YAW_BINS = 36  # the paper's 10°
COARSE_EVERY = 3  # the search over distance uses every third bank and yaws of about 20°
COARSE_YAWS = 18
MIN_VALID = 0.5  # least share of a template's pixels that were measured, where part of the frame is masked
MAX_DISTANCES = 1000
"""Most distances of the search, 100 m of floor: each costs a bank."""
RANGE_STEP_M = 0.1  # templates 0.3 m off in distance lose 10 points of accuracy
DECIMATION = 4  # range bins that are one in that search
HYPOTHESES = 2
# Refining starts at a match, so no blur has to widen the basin: a coarse one follows the uneven floor of a grey frame.
# What a threshold makes of speckle is no label image: a plain template (sharpness 0) does best for it.
REFINEMENT: dict[str, Any] = {
    "bounds": (math.radians(10.0), 0.06, 0.06),  # a bin of yaw [rad], some pixels of x and y [m]
    "blurs": (2.0, 0.8),
    "margin": (MARGIN_BINS, MARGIN_BEAMS),
    "sharpness": 0.0,
}
"""How `recognize` refines on the segmenter's map."""
ON_FRAME: tuple[dict[str, Any], ...] = (
    REFINEMENT | {"blurs": (1.0, 0.5)},
    REFINEMENT | {"blurs": (1.0, 0.5), "iterations": 3, "template": "echo"},
)
"""How it then goes on with the frame itself: a map says what is where, but its edges are blunt, and all of an object is
equally bright in it. The echo fits a sonar's frame (on validation frames a median of 0.3° instead of 0.5°), the
semantic image one that was drawn without a sensor; the better score decides (experiments/fit_refinement.py)."""
UNMODELLED_YAW = math.radians(0.5)
"""Standard deviation of yaw [rad] that a frame does not show: bounces, brightness and speckle that the echo template
leaves out. What `yaw_std` must be joined by on validation frames (experiments/fit_refinement.py --drawn)."""
SAME_YAW = math.radians(8.0)  # refined hypotheses closer than this are one
THRESHOLDS = {
    "pix2pix": 0.822,
    "none": 0.528,
    "otsu": 0.571,
    "otsu1": 0.382,
    "otsu3": 0.463,
    "median-otsu": 0.610,
}
"""Least score of an identified target, for each segmenter; validation frames of experiments/fit_threshold.py."""

GIVEN = "given"


@dataclass(frozen=True)
class Hypothesis:
    """One possible yaw of the target."""

    yaw: float
    """Absolute yaw [rad]."""
    score: float
    """NCC (eq. 4) of its template."""
    yaw_std: float | None
    """Standard deviation of the refined yaw [rad], given this hypothesis: `refine_yaw`'s, joined by `UNMODELLED_YAW`.

    None without refinement."""


@dataclass(frozen=True)
class Recognition:
    """What `recognize` found in one frame."""

    identified: bool
    """True when the score reaches the threshold (eq. 5)."""
    score: float
    """What the threshold judges: eq. 5's maximum over the bank."""
    score_bank: float
    """Largest NCC over the bank's yaw bins."""
    score_refined: float | None
    """NCC of the best refined template with what it was refined on; None without refinement."""
    threshold: float
    """Least score of an identified target."""
    yaw_bin: float
    """Yaw of the best template [rad], turned to the bearing at which it was found."""
    yaw: float
    """Refined absolute yaw [rad]; the bin's without refinement."""
    yaw_std: float | None
    """Standard deviation of the refined yaw [rad]."""
    x: float
    """Forward position of the target [m]."""
    y: float
    """Position of the target to port [m]."""
    scores_by_yaw: np.ndarray
    """NCC (yaw,) of each bin."""
    hypotheses: tuple[Hypothesis, ...]
    """Possible yaws, best first."""
    segmenter: str
    """What made the semantic map; `given` for one of your own."""
    semantic: np.ndarray = field(repr=False)
    """The image (range, beam) that was matched."""


class _Entry(NamedTuple):
    """A bank and what matching keeps of it."""

    bank: TemplateBank
    prepared: PreparedBank


class Match(NamedTuple):
    """How well one bank matches a frame, and where."""

    bank: TemplateBank
    """The bank that was matched."""
    scores: np.ndarray
    """NCC (yaw,) of each template."""
    rows: int
    """Range bins by which the best template is shifted from where it was rendered."""
    columns: int
    """Beams by which it is shifted."""


class Recognizer:
    """A target and a sonar with the banks that were rendered for them so far: keep one to recognize many frames."""

    def __init__(self, mesh: Mesh, sonar: Sonar, yaw_bins: int = YAW_BINS) -> None:
        """Banks of `yaw_bins` templates over the full circle are rendered when a frame first needs them.

        Raises SonarjaxError when no distance is in view or too many are, when the mesh is larger than the sonar sees
        far, or for fewer than 4 bins: peaks over yaw need neighbours.
        """
        if yaw_bins < 4:
            raise SonarjaxError(f"yaw_bins: expected 4 or more, got {yaw_bins}")
        check_fits(mesh, sonar, "target")
        self.mesh, self.sonar, self.yaw_bins = mesh, sonar, yaw_bins
        self._banks: dict[tuple[int, bool, bool], _Entry | None] = {}
        self._distances = _ground_ranges(sonar)
        near = float(self._distances[0])
        # Coarse steps, so that sonars at several tilts share compiled code.
        self._beams = min(-(-object_columns(mesh, sonar, near) // 32) * 32, sonar.n_beams)
        self._shape = (sonar.n_ranges, min(-(-window_shape(mesh, sonar, near)[1] // 32) * 32, sonar.n_beams))

    def bank(self, index: int, coarse: bool, masked: bool) -> _Entry | None:
        """The bank at distance `index`, ready to be matched; None where the object is not in view there."""
        key = (index, coarse, masked)
        if key not in self._banks:
            self._banks[key] = self._render(float(self._distances[index]), coarse, masked)
        return self._banks[key]

    def _render(self, distance: float, coarse: bool, masked: bool) -> _Entry | None:
        every = max(self.yaw_bins // COARSE_YAWS, 1) if coarse else 1
        yaws = np.arange(0, self.yaw_bins, every) * (2 * math.pi / self.yaw_bins)
        try:
            bank = template_bank(self.mesh, self.sonar, yaws, x=distance, shape=self._shape, beams=self._beams)
            if not coarse:
                return _Entry(bank, prepare_bank(bank, self.sonar.shape, masked=masked))
            frame = self.sonar.n_ranges // DECIMATION, self.sonar.n_beams
            templates = _rounded_up(_decimated(np.asarray(bank.templates)), frame)
            return _Entry(bank, prepare_bank(templates, frame, masked=masked))
        except SonarjaxError:
            return None

    def find(self, image: np.ndarray, mask: np.ndarray | None) -> Match:
        """The best match over distances: a coarse search with fewer range bins, then banks near its best."""
        small = _decimated(image), None if mask is None else _decimated(mask.astype(np.float32)) == 1
        masked = mask is not None
        indices = [k for k in range(0, len(self._distances), COARSE_EVERY) if self.bank(k, True, masked) is not None]
        if not indices:
            raise SonarjaxError("target: at no distance inside the sonar's view is any part of it visible")
        found = side_by_side(lambda k: self._match(k, True, *small), indices)
        index = self._nearest(max((m for m in found if m is not None), key=lambda m: m.scores.max()))
        best = self._match(index, False, image, mask)
        closer = self._nearest(best) if best is not None else index
        if closer != index:
            again = self._match(closer, False, image, mask)
            best = again if best is None or (again is not None and again.scores.max() > best.scores.max()) else best
        if best is None:
            raise SonarjaxError("target: no part of it is visible where it was found")
        return best

    def _nearest(self, match: Match) -> int:
        return int(np.argmin(np.abs(self._distances - math.hypot(*self.place(match)))))

    def _match(self, index: int, coarse: bool, image: np.ndarray, mask: np.ndarray | None) -> Match | None:
        entry = self.bank(index, coarse, mask is not None)
        if entry is None:
            return None
        match = match_positions(image, entry.prepared, mask, min_valid=MIN_VALID, whole=True)
        scores = np.asarray(match.scores)
        best = int(scores.argmax())
        top, left = entry.bank.offset
        row, column = int(match.row[best]), int(match.col[best])
        return Match(entry.bank, scores, (DECIMATION * row if coarse else row) - top, column - left)

    def place(self, match: Match) -> tuple[float, float]:
        """Ground (x, y) [m] of the object of a match."""
        slant, azimuth = bank_place(match.bank, self.sonar)
        centers = np.asarray(self.sonar.azimuth)
        beam = np.interp(azimuth, centers, np.arange(len(centers))) + match.columns
        found = np.interp(beam, np.arange(len(centers)), centers)
        x, y = _floor_point(slant + match.rows * float(self.sonar.range_bin), found, self.sonar)
        return float(x), float(y)


_floor_point = jax.jit(floor_point)


def _decimated(image: np.ndarray) -> np.ndarray:
    """Means of DECIMATION neighbouring range bins (..., range / DECIMATION, beam)."""
    rows = image.shape[-2] // DECIMATION
    groups = image[..., : rows * DECIMATION, :].reshape(*image.shape[:-2], rows, DECIMATION, image.shape[-1])
    return groups.mean(axis=-2)


def _rounded_up(templates: np.ndarray, frame: tuple[int, int]) -> np.ndarray:
    """Coarse templates (yaw, h, w) with background added behind and to port: few shapes, so few to be compiled."""
    sizes = zip(templates.shape[1:], frame, strict=True)
    return np.pad(templates, ((0, 0), *((0, min(-n % 8, most - n)) for n, most in sizes)), constant_values=0.5)


def _ground_ranges(sonar: Sonar) -> np.ndarray:
    """Distances [m] at which a floor object can be in view, RANGE_STEP_M apart.

    Raises SonarjaxError when there is none, or there are more than MAX_DISTANCES.
    """
    height, half = float(sonar.height), float(sonar.elevation_aperture) / 2
    steep, flat = float(sonar.tilt) + half, max(float(sonar.tilt) - half, 1e-3)
    if steep <= 0:
        raise SonarjaxError("sonar: it looks up: no part of the floor is inside its aperture")
    nearest = max(height / math.tan(min(steep, math.pi / 2 - 1e-3)), _ground(float(sonar.range_min), height))
    farthest = min(height / math.tan(flat), _ground(float(sonar.range_max), height))
    if farthest <= nearest:
        raise SonarjaxError("sonar: no part of the floor is inside its aperture and range window")
    count = math.ceil((farthest - nearest) / RANGE_STEP_M) + 1
    if count > MAX_DISTANCES:
        raise SonarjaxError(
            f"sonar: the floor in view reaches from {nearest:.4g} to {farthest:.4g} m, {count} distances of "
            f"{RANGE_STEP_M:g} m; expected at most {MAX_DISTANCES}: give a narrower range_min_m to range_max_m, "
            "or more tilt_deg"
        )
    return np.arange(nearest, farthest + RANGE_STEP_M, RANGE_STEP_M)


def _ground(slant: float, height: float) -> float:
    return math.sqrt(max(slant**2 - height**2, 0.0))


_RECOGNIZERS: list[Recognizer] = []  # the last few, so that calling `recognize` frame by frame renders no bank twice


def _recognizer(mesh: Mesh, sonar: Sonar, yaw_bins: int) -> Recognizer:
    for known in _RECOGNIZERS:
        if known.mesh is mesh and known.sonar is sonar and known.yaw_bins == yaw_bins:
            return known
    _RECOGNIZERS.append(Recognizer(mesh, sonar, yaw_bins))
    del _RECOGNIZERS[:-8]
    return _RECOGNIZERS[-1]


def recognize(
    image: Any,
    mesh: Mesh,
    sonar: Sonar,
    *,
    segmenter: str = DEFAULT_SEGMENTER,
    semantic: Any = None,
    refine: bool = True,
    threshold: float | None = None,
    mask: Any = None,
    yaw_bins: int = YAW_BINS,
) -> Recognition:
    """Find the target in a frame (range, beam) and its yaw [rad] (Fig. 1): segment, match (eq. 4–5), refine.

    Neither distance nor bearing is given: banks at several distances find them. `mask` (range, beam) is true where a
    pixel was measured. `threshold` replaces the segmenter's own, which comes from validation frames. A bank has
    `yaw_bins` templates over the full circle; refining reaches a bin's width from the best of them, 10° or more.
    A map of your own, `semantic` (range, beam) with shadow 0, background 0.5 and highlight 1, takes the place of the
    segmenter's; it needs a `threshold`.

    Raises SonarjaxError for an unknown segmenter, a shape that does not fit the sonar, values that are not finite, a
    `semantic` map without a threshold, or fewer than 4 yaw bins.
    """
    image, mask = _checked(image, mask, sonar)
    if semantic is None:
        semantic = semantic_map(image, segmenter, mask)
    else:
        semantic, segmenter = _checked(semantic, mask, sonar, "semantic")[0], GIVEN
        if threshold is None:
            raise SonarjaxError("threshold: expected a number beside a `semantic` map, there is none for it")
    recognizer = _recognizer(mesh, sonar, yaw_bins)
    match = recognizer.find(np.asarray(semantic, np.float32), mask)
    (x, y), bank, scores = recognizer.place(match), match.bank, match.scores
    yaws = np.asarray(bank.yaws) + math.atan2(y, x) - bank.bearing
    found = peaks(jnp.asarray(scores), jnp.asarray(yaws), max_peaks=HYPOTHESES)
    valid = np.asarray(found.valid)
    starts = np.where(valid, np.asarray(found.yaw), _wrap(yaws[scores.argmax()]))
    hypotheses, estimate = _hypotheses(starts, np.where(valid, np.asarray(found.score), scores.max())), None
    if refine:
        between = [between_bins(scores, int(k)) for k in np.where(valid, np.asarray(found.yaw_bin), scores.argmax())]
        turned = starts + np.array(between) * (2 * math.pi / len(scores))
        pose = Pose(np.full(HYPOTHESES, x), np.full(HYPOTHESES, y), turned)
        estimate = refine_yaw(semantic, mesh, sonar, pose, mask=mask, **REFINEMENT | {"bounds": _bounds(yaw_bins)})
        estimate = refine_on_frame(image, mesh, sonar, estimate.pose, mask)
        stds = np.hypot(np.asarray(estimate.yaw_std), UNMODELLED_YAW)
        hypotheses = _hypotheses(np.asarray(estimate.yaw), np.asarray(estimate.score), stds)
        x, y = _place_of_best(estimate)
    limit = THRESHOLDS[segmenter] if threshold is None else float(threshold)
    score = float(scores.max())
    return Recognition(
        identified=score >= limit,
        score=score,
        score_bank=score,
        score_refined=None if estimate is None else hypotheses[0].score,
        threshold=limit,
        yaw_bin=_wrap(yaws[scores.argmax()]),
        yaw=hypotheses[0].yaw if refine else _wrap(yaws[scores.argmax()]),
        yaw_std=hypotheses[0].yaw_std,
        x=x,
        y=y,
        scores_by_yaw=scores,
        hypotheses=hypotheses,
        segmenter=segmenter,
        semantic=np.asarray(semantic),
    )


def refine_on_frame(image: Any, mesh: Mesh, sonar: Sonar, start: Pose, mask: Any = None) -> YawEstimate:
    """The poses of `start` refined on the grey frame (range, beam), by the template that fits it better (`ON_FRAME`).

    Raises SonarjaxError as `refine_yaw` does.
    """
    first, second = (refine_yaw(image, mesh, sonar, start, mask=mask, **way) for way in ON_FRAME)
    # One that is NaN loses.
    return jax.tree.map(partial(jnp.where, second.score >= jnp.nan_to_num(first.score, nan=-1.0)), second, first)


def _checked(image: Any, mask: Any, sonar: Sonar, name: str = "image") -> tuple[np.ndarray, np.ndarray | None]:
    image = np.asarray(image, np.float32)
    if image.shape != sonar.shape:
        raise SonarjaxError(f"{name}: expected shape {sonar.shape} (range, beam) of the sonar, got {image.shape}")
    mask = None if mask is None else np.asarray(mask, bool)
    if mask is not None and mask.shape != image.shape:
        raise SonarjaxError(f"mask: expected the image's shape {image.shape}, got {mask.shape}")
    if not np.isfinite(image if mask is None else image[mask]).all():
        raise SonarjaxError(f"{name}: holds NaN or infinite values")
    return (image if mask is None else np.where(mask, image, 0.5).astype(np.float32)), mask


def _bounds(yaw_bins: int) -> tuple[float, float, float]:
    """How far refining goes from the best bin: `REFINEMENT`'s bounds, but a bin's width [rad] where that is more."""
    yaw, x, y = REFINEMENT["bounds"]
    return max(yaw, 2 * math.pi / yaw_bins), x, y


def _wrap(angle: Any) -> float:
    return float(np.mod(angle, 2 * math.pi))


def _place_of_best(estimate: YawEstimate) -> tuple[float, float]:
    best = int(np.nanargmax(np.asarray(estimate.score)))
    return float(estimate.x[best]), float(estimate.y[best])


def _hypotheses(yaws: Any, scores: Any, stds: Any = None) -> tuple[Hypothesis, ...]:
    """Different yaws, best first; those closer than SAME_YAW are one."""
    kept: list[Hypothesis] = []
    for k in np.argsort(-np.asarray(scores)):
        gaps = [abs((yaws[k] - other.yaw + math.pi) % (2 * math.pi) - math.pi) for other in kept]
        if all(gap > SAME_YAW for gap in gaps):
            kept.append(Hypothesis(_wrap(yaws[k]), float(scores[k]), None if stds is None else float(stds[k])))
    return tuple(kept)


def to_json(result: Recognition, frame: str, seconds: float) -> dict[str, Any]:
    """One line of the results file: angles in degrees in [0, 360), lengths in metres, schema 1."""

    def degrees(angle: float | None) -> float | None:
        return None if angle is None else math.degrees(angle)

    return {
        "frame": frame,
        "identified": result.identified,
        "score": result.score,
        "score_bank": result.score_bank,
        "score_refined": result.score_refined,
        "threshold": result.threshold,
        "yaw_bin_deg": degrees(result.yaw_bin),
        "yaw_deg": degrees(result.yaw),
        "yaw_std_deg": degrees(result.yaw_std),
        "x_m": result.x,
        "y_m": result.y,
        "scores_by_yaw": [float(score) for score in result.scores_by_yaw],
        "hypotheses": [
            {"yaw_deg": degrees(h.yaw), "score": h.score, "yaw_std_deg": degrees(h.yaw_std)} for h in result.hypotheses
        ],
        "segmenter": result.segmenter,
        "seconds": seconds,
        "schema": 1,
    }
