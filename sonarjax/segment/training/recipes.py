"""What a training run does from its first step to its last: networks, pairs, and how often they are used."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from sonarjax.data import PairSettings
from sonarjax.data.draws import SEEDS
from sonarjax.data.pairs import PAPER_PAIRS, PAPER_SETTINGS
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind, is_text, is_whole, shown
from sonarjax.segment.step import GanConfig


def _is_count(value: Any, least: int = 1) -> bool:
    return is_whole(value) and value >= least


def _is_real(value: Any) -> bool:
    return isinstance(value, int | float | np.integer | np.floating)  # arrays have no hash, which a recipe needs


def _is_bool(value: Any) -> bool:
    return isinstance(value, bool | np.bool_)


def _is_source(value: Any) -> bool:
    return value is None or (isinstance(value, str | os.PathLike) and bool(os.fspath(value)))


def _json_value(value: Any) -> Any:
    """A number of NumPy or a path as a JSON type. Raises TypeError for anything else."""
    return value.item() if isinstance(value, np.generic) else os.fspath(value)


Rules = tuple[tuple[str, Callable[[Any], bool], str], ...]
COUNT, BOOL = "a whole number of 1 or more", "True or False"
RULES: Rules = (
    ("batch pairs passes sets validation_pairs checkpoint_steps log_steps", _is_count, COUNT),
    ("run_seed", lambda v: _is_count(v, 0) and v < SEEDS, f"a whole number from 0 to {SEEDS - 1}"),
    ("mirrored plain", lambda v: _is_real(v) and 0 <= v <= 1, "a share from 0 to 1"),
    ("largest_loss", lambda v: _is_real(v) and v > 0, "a number above 0"),
    ("name", is_text, "a text"),
    ("discriminative", _is_bool, BOOL),
    ("source", _is_source, "a folder or None"),
    ("initial_weights", _is_source, "a weights file or None"),
)
"""Fields of a recipe, what must hold of each, and how that is said."""
NETWORK_RULES: Rules = (
    ("width discriminator_width", _is_count, COUNT),
    ("decay_steps", lambda v: _is_count(v, 0), "a whole number of 0 or more"),
    (
        "multipliers",
        lambda v: type(v) is tuple and len(v) == 7 and all(map(_is_count, v)),
        "a tuple of 7 whole numbers of 1 or more",
    ),
    ("learning_rate", lambda v: _is_real(v) and 0 < v < math.inf, "a finite number above 0"),
    (
        "distance adversarial cross_entropy",
        lambda v: _is_real(v) and 0 <= v < math.inf,
        "a finite number of 0 or more",
    ),
    ("beta1 beta2 ema_decay", lambda v: _is_real(v) and 0 <= v < 1, "a number from 0 to below 1"),
    (
        "class_weights",
        lambda v: type(v) is tuple and len(v) == 3 and all(map(_is_real, v)) and min(v) >= 0 and 0 < sum(v) < math.inf,
        "a tuple of 3 finite numbers of 0 or more, not all 0",
    ),
    ("skips saturating", _is_bool, BOOL),
)
"""The same of its networks."""
PAIR_RULES: Rules = (("tank varied", _is_bool, BOOL),)
"""The same of how pairs are made; the other fields are checked when the settings are made."""


def _check(prefix: str, values: Any, rules: Rules) -> None:
    """Raise a SonarjaxError for the first field that breaks its rule, or is none of the words of its Literal."""
    kinds = {name: kind for name, kind in get_type_hints(type(values)).items() if get_origin(kind) is Literal}
    words = [(name, get_args(kind).__contains__, f"one of {', '.join(get_args(kind))}") for name, kind in kinds.items()]
    for names, holds, expected in (*rules, *words):
        for name in names.split():
            value = getattr(values, name)
            try:
                fits = holds(value)
            except TypeError:  # it cannot be compared with numbers
                fits = False
            if not fits:
                raise SonarjaxError(f"recipe: {prefix}{name}: expected {expected}, got {shown(value)}")


@dataclass(frozen=True)
class Recipe:
    """A training run. Two runs of one recipe give the same weights, bit for bit on one kind of CPU."""

    name: str = "custom"
    """Name of the recipe."""
    networks: GanConfig = field(default_factory=GanConfig)
    """The networks, their losses and optimisers."""
    discriminative: bool = False
    """Train the U-Net on cross-entropy alone (its head must be `classes`): the paper's 'discriminative model'."""
    run_seed: int = 0
    """Seed of everything random: pairs, their order, initial weights, dropout."""
    batch: int = 8
    """Number of pairs in a step, over all devices."""
    pairs: int = 1024
    """Number of pairs in a set."""
    passes: int = 1
    """How often each set is used, each time in another order."""
    sets: int = 1
    """How many sets are made, one after the other."""
    mirrored: float = 0.5
    """Share of pairs [1] that are mirrored, port for starboard; each pass mirrors other pairs. A mirrored scene is
    as likely as the original.
    """
    plain: float = 0.04
    """Share of pairs [1] whose image is replaced by the semantic map, so that frames of `sonarjax render` can
    be recognized.
    """
    pair_settings: PairSettings = field(default_factory=PairSettings)
    """How pairs are made."""
    initial_weights: str | os.PathLike[str] | None = None
    """Weights file of the generator to begin with, to train it further; None for random weights. The discriminator
    begins with random ones.
    """
    source: str | os.PathLike[str] | None = None
    """Folder of pairs (see `import_pairs`) to train on, instead of made ones; its last pairs are for validation."""
    validation_pairs: int = 128
    """Number of pairs on which the run is evaluated after each epoch."""
    checkpoint_steps: int = 500
    """Steps between checkpoints; there is also one after the last step."""
    log_steps: int = 20
    """Steps between two logs of the losses."""
    largest_loss: float = 1e4
    """Above this a loss counts as diverged."""

    @property
    def epoch_steps(self) -> int:
        """Number of steps in one pass through a set; pairs that do not fill a batch are left out of that pass."""
        return self.pairs // self.batch

    @property
    def epochs(self) -> int:
        """Number of passes through all sets."""
        return self.sets * self.passes

    @property
    def steps(self) -> int:
        """Number of steps of the run."""
        return self.epochs * self.epoch_steps

    def checked(self) -> Recipe:
        """Check that the recipe can be followed.

        Returns:
            The recipe itself.

        Raises:
            SonarjaxError: It cannot be followed.
        """
        check_kind(self.networks, GanConfig, "recipe: networks")
        check_kind(self.pair_settings, PairSettings, "recipe: pair_settings")
        _check("", self, RULES)
        _check("networks.", self.networks, NETWORK_RULES)
        _check("pair_settings.", self.pair_settings, PAIR_RULES)
        if self.pairs < self.batch:
            raise SonarjaxError(f"recipe: pairs: expected at least one batch of {self.batch}, got {self.pairs}")
        if self.discriminative and self.networks.head != "classes":
            raise SonarjaxError("recipe: networks.head: expected `classes` for a discriminative model")
        weight, head = self.networks.cross_entropy, self.networks.head
        if weight and head != "classes":
            raise SonarjaxError(f"recipe: networks.head: expected `classes` for cross_entropy {weight:g}, got `{head}`")
        if self.source is not None and self.sets != 1:
            raise SonarjaxError(f"recipe: sets: expected 1 with a folder of pairs as source, got {self.sets}")
        return self

    def as_json(self) -> dict[str, Any]:
        """Convert the recipe to JSON types.

        Returns:
            The fields by name, those of `networks` and `pair_settings` nested.
        """
        return json.loads(json.dumps(dataclasses.asdict(self), default=_json_value))


PRESETS: dict[str, Recipe] = {
    # Takes seconds, to see whether everything runs.
    "smoke": Recipe(
        name="smoke",
        networks=GanConfig(width=4, discriminator_width=4),
        batch=4,
        pairs=16,
        passes=2,
        validation_pairs=8,
        checkpoint_steps=4,
        log_steps=1,
    ),
    # As what ships, shorter, for two cores. Cross-entropy in addition to eq. 3 makes the network choose a class for
    # each pixel; the distance alone tolerates a grey between two classes.
    "cpu": Recipe(
        name="cpu",
        networks=GanConfig(
            width=16, discriminator_width=16, head="classes", inputs="ranks", adversarial=0.25, cross_entropy=20.0
        ),
        batch=8,
        pairs=4096,
        passes=5,
        sets=9,
        validation_pairs=256,
    ),
    # §3.2 on two cores: eq. 3 alone, 30 epochs of the 6,780 pairs, at a quarter of the width.
    "paper-cpu": Recipe(
        name="paper-cpu",
        networks=GanConfig(width=16, discriminator_width=16),
        batch=4,
        pairs=PAPER_PAIRS,
        passes=30,
        mirrored=0.0,
        plain=0.0,
        pair_settings=PAPER_SETTINGS,
        validation_pairs=256,
        checkpoint_steps=1000,
        log_steps=50,
    ),
}
"""Recipes by name."""
# As `paper-cpu`, on a GPU and at the paper's width. A checkpoint takes 1 GB there, so there are few.
PRESETS["paper"] = replace(
    PRESETS["paper-cpu"],
    name="paper",
    networks=GanConfig(width=64, discriminator_width=64, dtype="bfloat16"),
    batch=32,
    checkpoint_steps=2000,
)
# The recipe of the shipped weights, for a GPU: seven times as long as `cpu`, in larger batches.
PRESETS["gpu"] = replace(
    PRESETS["cpu"],
    name="gpu",
    networks=replace(PRESETS["cpu"].networks, learning_rate=4e-4, decay_steps=20_480),
    batch=64,
    pairs=16_384,
    passes=4,
    sets=20,
    checkpoint_steps=4096,
    log_steps=64,
)

# To train one of these networks further (`initial_weights`) on more varied objects, on two cores. The discriminator is
# left out, which nearly halves the time; the seed is another, whose pairs the network has not seen.
PRESETS["further"] = replace(
    PRESETS["cpu"],
    name="further",
    networks=replace(PRESETS["cpu"].networks, adversarial=0.0, learning_rate=2e-4, decay_steps=18_432),
    run_seed=5,
    batch=16,
    pairs=3072,
    passes=8,
    sets=12,
    pair_settings=PairSettings(varied=True),
)


def find_recipe(preset: str | Recipe) -> Recipe:
    """Find a recipe by its name, or take one as it is.

    Args:
        preset: A recipe, or its name in `PRESETS`.

    Returns:
        The recipe.

    Raises:
        SonarjaxError: The name is unknown, or the recipe cannot be followed.
    """
    if isinstance(preset, Recipe):
        return preset.checked()
    check_kind(preset, str, "preset")
    if preset not in PRESETS:
        raise SonarjaxError(f"training: unknown preset {preset!r}, expected one of: {', '.join(PRESETS)}")
    return PRESETS[preset].checked()


def discriminative(recipe: Recipe) -> Recipe:
    """Change a recipe to the paper's 'discriminative model'.

    Args:
        recipe: A recipe for pix2pix.

    Returns:
        The same run with the same U-Net and pairs, trained on cross-entropy alone.
    """
    networks = replace(recipe.networks, head="classes")
    return replace(recipe, name=f"{recipe.name}-discriminative", networks=networks, discriminative=True)
