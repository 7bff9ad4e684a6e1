"""Formats of a data set: what a frame without objects looks like, and names in other scripts."""

from __future__ import annotations

import io

import numpy as np
import pytest

from sonarjax.data.formats import FORMATS, Axes, Item, yaml_text

SHAPE = (8, 6)


def arrays_of(count: int) -> dict[str, np.ndarray]:
    """The arrays that the NPZ of a frame with `count` objects holds."""
    grey = np.zeros(SHAPE, np.uint8)
    item = Item(0, grey, grey, grey, [0] * count, [[2.0, 0.0, 0.5]] * count)
    files, _ = FORMATS["npz"](item, Axes(np.arange(6.0), np.arange(9.0), ("box",)))
    with np.load(io.BytesIO(files["frames/00000000.npz"])) as arrays:
        return {name: arrays[name] for name in arrays.files}


@pytest.mark.parametrize("count", [0, 1, 3])
def test_arrays_of_a_frame_have_one_rank_and_type_whatever_it_shows(count: int) -> None:
    arrays = arrays_of(count)
    found = {name: (arrays[name].shape, str(arrays[name].dtype)) for name in arrays}
    masks = ((count, *SHAPE), "bool")
    assert found["highlight_masks"] == found["shadow_masks"] == masks
    assert found["boxes"] == ((count, 2, 4), "int32")
    assert found["mesh"] == ((count,), "int32")
    assert found["pose"] == ((count, 3), "float32")


@pytest.mark.parametrize(
    "name", ["\U0001f6a2", "é \U00010348\U0010ffff", 'a "b" \\c: #', "\x7f\x85\u2028\ufeff\uffff\n\t\0"]
)
def test_names_in_any_script_come_back_from_yaml(name: str) -> None:
    yaml = pytest.importorskip("yaml")
    assert yaml.safe_load(f"names:\n  0: {yaml_text(name)}\n".encode()) == {"names": {0: name}}
