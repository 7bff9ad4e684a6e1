"""A trained generator: saved to a file, loaded (the shipped one by default) and applied to crops.

Arrays are stored under the names of their places in the network (`params.down1.kernel`), kernels in half precision. The
network's properties (width, head, skips) are derived from the shapes of its arrays, so a file cannot contradict itself.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sonarjax.engine import PLAIN, Engine
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.safetensors import read_safetensors, write_safetensors
from sonarjax.records import record, static
from sonarjax.segment.generator import Generator, Head, to_grey
from sonarjax.segment.inputs import CHANNELS, Inputs

Storage = Literal["float16", "float32"]
"""Type in which kernels are stored. Weights are about 0.02, where float16 has eight times the precision of bfloat16."""
INPUT = "grey in [0, 1], 128 x 128, range x beam; shadow 0, background 0.5, highlight 1 out"
"""What a network takes and gives, as written in its file."""
SHIPPED = "weights"
"""Folder beside this file that holds the shipped network."""


@record
class GeneratorWeights:
    """A generator ready for use; a pytree whose network structure is static."""

    variables: Any
    """Parameters and running statistics, as `module.apply` takes them."""
    module: Generator = static()
    """The network."""


def save_generator(
    path: str | os.PathLike[str], variables: Any, about: Mapping[str, Any], storage: Storage = "float16"
) -> None:
    """Write a generator to a file, all or nothing.

    Args:
        path: The file.
        variables: The generator's variables. Kernels are stored as `storage`, smaller arrays as float32.
        about: What to store beside them, in JSON types: recipe, seed, versions, metrics.
        storage: Type of the kernels.

    Raises:
        SonarjaxError: A weight is not finite in that type, or the file cannot be written.
    """
    flat, _ = jax.tree_util.tree_flatten_with_path(variables)
    arrays = {}
    for place, leaf in flat:
        name = _filed(jax.tree_util.keystr(place, simple=True, separator="."))
        with np.errstate(over="ignore"):  # reported below, with the name of the array
            arrays[name] = np.asarray(leaf).astype(jnp.dtype(storage) if np.ndim(leaf) > 1 else np.float32)
        if not np.isfinite(arrays[name].astype(np.float32)).all():
            raise SonarjaxError(f"{os.fspath(path)}: {name}: expected values that are finite as {storage}")
    write_safetensors(path, arrays, about)


def load_generator(path: str | os.PathLike[str] | None = None) -> GeneratorWeights:
    """Load a generator that `save_generator` wrote, in float32; without `path`, the one shipped with the package.

    The shipped file is not checked against the network: that takes a second, and a test does it.

    Raises:
        SonarjaxError: The file is missing or damaged, or its arrays are not those of a generator.
    """
    file = shipped_path() if path is None else path
    return generator_of(read_safetensors(file)[0], os.fspath(file), check=path is not None)


def generator_of(arrays: Mapping[str, np.ndarray], name: str, *, check: bool) -> GeneratorWeights:
    """The generator, in float32, whose arrays a weights file of this name holds.

    Raises SonarjaxError where they are not those of a generator; `check` looks at all of them.
    """
    module = _module_of(arrays, name)
    if check:
        _check_arrays(arrays, module, name)
    return GeneratorWeights(_nested(arrays), module)


def _filed(place: str) -> str:
    """The name in a file of the array at a place: flax's `var` is called `variance` there."""
    return f"{place.removesuffix('var')}variance" if place.endswith(".var") else place


def _nested(arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Variables for `module.apply`, in float32, from arrays named by their places."""
    variables: dict[str, Any] = {}
    for place, array in arrays.items():
        *folders, leaf = place.split(".")
        inside = variables
        for folder in folders:
            inside = inside.setdefault(folder, {})
        inside["var" if leaf == "variance" else leaf] = jax.device_put(array.astype(np.float32))
    return variables


def _check_arrays(arrays: Mapping[str, np.ndarray], module: Generator, name: str) -> None:
    """Raise a SonarjaxError unless the arrays are those of the network."""
    image = jax.ShapeDtypeStruct((1, 128, 128, 1), jnp.float32)
    expected = jax.eval_shape(module.init, jax.random.key(0), image)
    flat, _ = jax.tree_util.tree_flatten_with_path(expected)
    places = [_filed(jax.tree_util.keystr(place, simple=True, separator=".")) for place, _ in flat]
    if set(places) != set(arrays):
        odd = sorted(set(places) ^ set(arrays))
        raise SonarjaxError(f"{name}: expected the arrays of a generator, {odd[0]} is missing or not one of them")
    for place, (_, leaf) in zip(places, flat, strict=True):
        if arrays[place].shape != leaf.shape:
            raise SonarjaxError(f"{name}: {place}: expected shape {leaf.shape}, got {arrays[place].shape}")


def shipped_path() -> Path:
    """Path of the weights file that came with the package.

    Raises:
        SonarjaxError: There is no such file, or more than one.
    """
    folder = resources.files("sonarjax.segment") / SHIPPED
    found = sorted(Path(str(folder)).glob("*.safetensors"))
    if len(found) != 1:
        raise SonarjaxError(f"{folder}: expected one shipped weights file, found {len(found)}: train or name another")
    return found[0]


def _module_of(arrays: Mapping[str, np.ndarray], name: str) -> Generator:
    """The network that has these arrays, from the shapes of a few; `_check_arrays` checks the rest."""
    try:
        features = [arrays[f"params.down{n}.kernel"].shape[3] for n in range(1, 8)]
        output, channels = arrays["params.up15.kernel"].shape[2:]
        width = math.gcd(*features)  # some are no multiples of the first
        multipliers = tuple(f // width for f in features)
        shown = arrays["params.down1.kernel"].shape[2]
        inputs: Inputs = next(name for name, count in CHANNELS.items() if count == shown)
    except (KeyError, IndexError, ValueError, ZeroDivisionError, StopIteration) as error:
        raise SonarjaxError(f"{name}: expected the arrays of a generator (params.down1.kernel and others)") from error
    head: Head = "tanh" if output == 1 else "classes"
    return Generator(width, head, channels == 2 * features[0], multipliers, inputs=inputs)


def segment_patch(
    weights: GeneratorWeights, images: Float[Array, "patch height width"], *, engine: Engine = PLAIN
) -> Float[Array, "patch height width"]:
    """Semantic maps of `images`, both (patch, height, width) in [0, 1]: shadow 0, background 0.5, highlight 1.

    Images are crops or a padded frame; height and width are multiples of 128. There is no dropout: the answer is the
    mean.

    Raises:
        SonarjaxError: The size is not a multiple of 128.
    """
    return engine.run(_segment_patch, weights.variables, images, module=weights.module)


@partial(jax.jit, static_argnames="module")
def _segment_patch(variables: Any, images: Array, *, module: Generator) -> Array:
    output = module.apply(variables, 2 * images[..., None] - 1)
    return (to_grey(jnp.asarray(output))[..., 0] + 1) / 2
