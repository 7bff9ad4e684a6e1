"""Training of the segmenter: recipes, `train`, and the files that a run leaves. Slow to import."""

from sonarjax.segment.training.loop import TrainResult, train
from sonarjax.segment.training.recipes import PRESETS, Recipe, discriminative, find_recipe

__all__ = ["PRESETS", "Recipe", "TrainResult", "discriminative", "find_recipe", "train"]
