"""Weights in files: what comes back, how small it is, what damaged files say; the network in use."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.safetensors import read_safetensors, write_safetensors
from sonarjax.segment import weights as module
from sonarjax.segment.classical import from_grey
from sonarjax.segment.generator import Generator
from sonarjax.segment.initial import draw_variables
from sonarjax.segment.weights import (
    GeneratorWeights,
    load_generator,
    save_generator,
    segment_patch,
    shipped_path,
)

ABOUT = {"recipe": "test", "seed": 3, "metrics": {"iou": 0.5}}
MULTIPLIERS = (1, 2, 2, 2, 2, 2, 2)


def drawn(**options: Any) -> GeneratorWeights:
    network = Generator(4, multipliers=MULTIPLIERS, **options)
    variables = draw_variables(network, jnp.zeros((1, 128, 128, 1)), key=jax.random.key(1))
    return GeneratorWeights(jax.tree.map(lambda v: v + 0.01, variables), network)


def file_types(path: Path) -> set[str]:
    return {str(v.dtype) for v in read_safetensors(path)[0].values()}


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "g.safetensors"
    save_generator(path, drawn().variables, ABOUT)
    return path


@pytest.mark.parametrize("options", [{}, {"head": "classes"}, {"skips": False}])
@pytest.mark.parametrize(("storage", "precision"), [("float16", 2**-11), ("float32", 0)])
def test_what_is_saved_comes_back(options: dict[str, Any], storage: Any, precision: float, tmp_path: Path) -> None:
    given = drawn(**options)
    save_generator(tmp_path / "g.safetensors", given.variables, ABOUT, storage)
    found = load_generator(tmp_path / "g.safetensors")
    assert found.module == given.module
    assert jax.tree.structure(found.variables) == jax.tree.structure(given.variables)
    assert storage == "float32" or file_types(tmp_path / "g.safetensors") == {storage, "float32"}
    for one, other in zip(*map(jax.tree.leaves, (found.variables, given.variables)), strict=True):
        assert one.dtype == jnp.float32
        np.testing.assert_allclose(one, other, rtol=precision, atol=1e-7)


@pytest.mark.parametrize("skips", [True, False])
def test_widths_that_are_no_multiples_of_the_first_come_back(skips: bool, tmp_path: Path) -> None:
    network = Generator(2, "classes", skips, (2, 3, 4, 4, 4, 4, 4))
    variables = draw_variables(network, jnp.zeros((1, 128, 128, 1)), key=jax.random.key(1))
    save_generator(tmp_path / "m.safetensors", variables, ABOUT)
    again = load_generator(tmp_path / "m.safetensors")
    assert again.module == network
    assert jax.tree.map(jnp.shape, again.variables) == jax.tree.map(jnp.shape, variables)


def test_file_is_half_as_large_and_the_same_each_time(saved: Path, tmp_path: Path) -> None:
    count = sum(v.size for v in jax.tree.leaves(drawn().variables))
    assert saved.stat().st_size < 2.5 * count + 10000
    save_generator(tmp_path / "again", drawn().variables, dict(reversed(ABOUT.items())))
    assert (tmp_path / "again").read_bytes() == saved.read_bytes()
    assert read_safetensors(saved)[1] == ABOUT


def test_file_is_safetensors(saved: Path) -> None:
    from safetensors import safe_open

    with safe_open(saved, "np") as file:
        assert json.loads(file.metadata()["sonarjax"]) == ABOUT
        kernel = file.get_tensor("params.down2.kernel")
    np.testing.assert_array_equal(kernel, np.asarray(drawn().variables["params"]["down2"]["kernel"], np.float16))


def damaged(saved: Path, how: str) -> None:
    data = saved.read_bytes()
    arrays, about = read_safetensors(saved)
    if how == "missing":
        saved.unlink()
    elif how == "folder":
        saved.unlink()
        saved.mkdir()
    elif how == "another kind":
        saved.write_bytes(b"PK\x03\x04" + data[4:])
    elif how == "header of gigabytes":
        saved.write_bytes(struct.pack("<Q", 2**60) + data[8:])
    elif how == "array missing":
        write_safetensors(saved, {k: v for k, v in arrays.items() if "norm4" not in k}, about)
    elif how == "wrong shape":
        write_safetensors(saved, {**arrays, "params.down3.kernel": np.zeros((4, 4, 8, 7), np.float32)}, about)
    elif how == "no generator":
        write_safetensors(saved, {"weight": np.zeros(3, np.float32)}, about)
    else:
        saved.write_bytes(data[: int(how)])


CASES = "missing,folder,another kind,header of gigabytes,array missing,wrong shape,no generator,0,7,100,5000,30000"


@pytest.mark.parametrize("how", CASES.split(","))
def test_damaged_file_is_one_line_with_its_name(how: str, saved: Path) -> None:
    damaged(saved, how)
    with pytest.raises(SonarjaxError, match=r"g\.safetensors") as caught:
        load_generator(saved)
    assert "\n" not in str(caught.value)


def test_weights_that_overflow_are_refused(saved: Path) -> None:
    before = saved.read_bytes()
    variables = jax.tree.map(lambda v: v * 1e7, drawn().variables)
    with pytest.raises(SonarjaxError, match="finite as float16"):
        save_generator(saved, variables, ABOUT)
    assert saved.read_bytes() == before
    with pytest.raises(SonarjaxError, match="cannot be stored"):
        save_generator(saved, drawn().variables, {"metric": float("nan")})


def test_shipped_file_is_found_in_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, saved: Path) -> None:
    monkeypatch.setattr(module.resources, "files", lambda _: tmp_path)
    with pytest.raises(SonarjaxError, match="expected one shipped weights file, found 0"):
        shipped_path()
    (tmp_path / "weights").mkdir()
    saved.rename(tmp_path / "weights" / "g.safetensors")
    assert shipped_path() == tmp_path / "weights" / "g.safetensors"
    assert load_generator().module == load_generator(shipped_path()).module


@pytest.mark.parametrize("head", ["tanh", "classes"])
def test_patches_and_their_labels(head: Any, rng: np.random.Generator) -> None:
    given = drawn(head=head)
    given = GeneratorWeights(jax.tree.map(lambda v: 3 * v, given.variables), given.module)
    images = jnp.asarray(rng.uniform(0, 1, (2, 128, 128)), jnp.float32)

    @jax.jit  # together they are compiled once
    def everything(w: GeneratorWeights) -> tuple[jax.Array, jax.Array]:
        return segment_patch(w, images), w.module.apply(w.variables, 2 * images[..., None] - 1)

    grey, output = map(np.asarray, everything(given))
    assert grey.shape == images.shape
    assert (float(grey.min()) >= 0, float(grey.max()) <= 1, float(grey.std()) > 0) == (True, True, True)
    if head == "tanh":
        np.testing.assert_allclose(grey, (output[..., 0] + 1) / 2, atol=1e-5)
        np.testing.assert_array_equal(
            from_grey(grey), np.select([output[..., 0] > 0.5, output[..., 0] < -0.5], [1, 2], 0)
        )
    else:
        share = np.asarray(jax.nn.softmax(output, -1))
        np.testing.assert_allclose(grey, 0.5 * share[..., 0] + share[..., 1], atol=1e-5)
        # Background against one other class, the third out of the question, and no tie.
        ordered = np.sort(share, -1)
        of_two = (share[..., 1:].min(-1) < 1e-3) & (ordered[..., 2] - ordered[..., 1] > 0.01)
        assert of_two.sum() > 100
        np.testing.assert_array_equal(from_grey(grey)[of_two], output.argmax(-1)[of_two])
