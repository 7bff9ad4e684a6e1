"""Train the paper's 'discriminative model': the U-Net of a preset on the same pairs, by cross-entropy alone.

python -m experiments.train_discriminative [--preset cpu] [--run-dir RUN] [--resume]: leaves RUN/weights.safetensors.
The file of `--preset cpu` is the baseline `discriminative.safetensors` beside this script.
"""

from __future__ import annotations

import argparse

from sonarjax._cache import enable_compilation_cache
from sonarjax.segment.training import PRESETS, discriminative, find_recipe, train


def main() -> None:
    """Command line of the experiment."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", choices=tuple(PRESETS), default="cpu", help="whose networks and pairs")
    parser.add_argument("--run-dir", default="runs/discriminative", help="folder of the run")
    parser.add_argument("--resume", action="store_true", help="go on from the last checkpoint")
    settings = parser.parse_args()
    enable_compilation_cache()
    result = train(discriminative(find_recipe(settings.preset)), settings.run_dir, resume=settings.resume)
    print(f"{result.weights}: " + ", ".join(f"{name} {value:.3f}" for name, value in result.metrics.items()))


if __name__ == "__main__":
    main()
