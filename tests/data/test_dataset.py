"""Data sets: the folder, the formats by readers that we did not write, what a kill leaves. Frames are made up here."""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import math
import os
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image
from scipy.spatial import ConvexHull

import sonarjax as sj
from sonarjax.data import FORMATS, FrameSettings, dataset, import_pairs, make_dataset
from sonarjax.data.formats import box_of, run_lengths
from sonarjax.data.frames import CHUNK, Drawn
from sonarjax.data.layout import Layout, draw_layout, join_layout, placement_limits
from sonarjax.io import SonarjaxError, read_frames
from sonarjax.sonar import PRESETS

SHAPE = (48, 20)
SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20)).replace(
    azimuth=jnp.radians(jnp.linspace(-14.0, 14.0, SHAPE[1])), n_ranges=SHAPE[0]
)
MESHES = {"pile": sj.objects.target(), "other pile": sj.objects.non_target()}
BESIDE = MESHES["pile"].with_vertices(MESHES["pile"].vertices + jnp.array([2.0, 0.0, 0.0]))
OBJECTS = 3


def made_up(meshes, sonar, limits, chunk, settings, engine, *, key) -> Drawn:
    """Frames that depend on key and number alone: up to three rectangles of highlight, each above its shadow."""
    frames = []
    for number in range(chunk * CHUNK, (chunk + 1) * CHUNK):
        rng = np.random.default_rng([*key.tolist(), number])
        labels, instances = np.zeros((2, *SHAPE), np.uint8)
        there = np.arange(OBJECTS) < rng.integers(1, OBJECTS + 1)
        for k in np.flatnonzero(there):
            row, column = rng.integers(1, SHAPE[0] - 8), 1 + 6 * k
            instances[row : row + 7, column : column + 4] = k + 1
            labels[row : row + 2, column : column + 3], labels[row + 2 : row + 7, column + 1 : column + 4] = 1, 2
        instances[labels == 0] = 0
        pose, mesh = rng.uniform(0, 3, (OBJECTS, 3)).astype(np.float32), rng.integers(0, 2, OBJECTS)
        sensor = rng.uniform(0, 1, len(dataset.SENSOR_FIELDS)).astype(np.float32)
        frames.append((rng.integers(0, 256, SHAPE, np.uint8), labels, instances, mesh, pose, there, sensor, 0))
    return Drawn(*(np.stack(v) for v in zip(*frames, strict=True)))


@pytest.fixture
def make(monkeypatch, tmp_path):
    """`make("name", count, ...)` makes a data set of made-up frames in a folder of that name."""
    monkeypatch.setattr(dataset, "draw_chunk", made_up)

    def run(name: str, count: int = 20, seed: int = 0, format: str = "png", **options) -> Path:
        options.setdefault("settings", FrameSettings(scenes=OBJECTS))
        meshes, sonar = options.pop("meshes", MESHES), options.pop("sonar", SONAR)
        make_dataset(meshes, sonar, tmp_path / name, count, key=jax.random.key(seed), format=format, **options)
        return tmp_path / name

    return run


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def _pixels(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture)


def manifest(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "manifest.jsonl").read_text().splitlines()]


def truth(number: int, seed: int = 0) -> Drawn:
    drawn = made_up(None, None, None, number // CHUNK, None, None, key=np.asarray(jax.random.key_data(_key(seed))))
    return Drawn(*(v[number % CHUNK] for v in drawn))


def _key(seed: int) -> jax.Array:
    return jax.random.key(seed)


# ---------------------------------------------------------------- formats


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # pycocotools'
def test_coco_is_what_pycocotools_reads(make):
    coco = pytest.importorskip("pycocotools.coco")
    mask_tools = pytest.importorskip("pycocotools.mask")
    folder = make("a", 20, format="coco")
    with contextlib.redirect_stdout(io.StringIO()):
        found = coco.COCO(str(folder / "annotations.json"))
    assert len(found.getImgIds()) == 20
    assert [c["name"] for c in found.loadCats(found.getCatIds())] == [
        "pile highlight", "pile shadow", "other pile highlight", "other pile shadow"
    ]  # fmt: skip
    ids = found.getAnnIds()
    assert len(set(ids)) == len(ids) == 2 * sum(int(truth(k).there.sum()) for k in range(20))
    for image in found.loadImgs(found.getImgIds()):
        number = image["id"] - 1
        expected = truth(number)
        np.testing.assert_array_equal(_pixels(folder / image["file_name"]), expected.image)
        for entry in found.loadAnns(found.getAnnIds(imgIds=image["id"])):
            mesh, label = divmod(entry["category_id"] - 1, 2)
            assert mesh == expected.mesh[entry["instance"] - 1]
            mask = (expected.instances == entry["instance"]) & (expected.labels == label + 1)
            np.testing.assert_array_equal(found.annToMask(entry), mask)
            packed = found.annToRLE(entry)
            assert mask_tools.area(packed) == entry["area"]
            assert mask_tools.toBbox(packed).tolist() == entry["bbox"]
    with contextlib.redirect_stdout(io.StringIO()):  # the annotations found again as detections: a perfect score
        detections = [
            {"image_id": a["image_id"], "category_id": a["category_id"], "score": 1.0,
             "segmentation": mask_tools.encode(np.asfortranarray(found.annToMask(a)))}
            for a in found.loadAnns(ids)
        ]  # fmt: skip
        evaluation = pytest.importorskip("pycocotools.cocoeval").COCOeval(found, found.loadRes(detections), "segm")
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    assert evaluation.stats[0] == pytest.approx(1.0)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_run_lengths_are_those_of_pycocotools(share, rng):
    mask_tools = pytest.importorskip("pycocotools.mask")
    mask = rng.uniform(size=(13, 7)) < share
    ours = mask_tools.frPyObjects(run_lengths(mask), *mask.shape)
    assert ours == mask_tools.encode(np.asfortranarray(mask.astype(np.uint8)))
    if mask.any():
        assert box_of(mask) == mask_tools.toBbox(ours).tolist()


def test_png_is_read_as_pairs_and_instances_tell_objects_apart(make):
    folder = make("a", 5)
    pairs = import_pairs(folder)
    assert pairs.image.shape == (5, 128, 128) and set(np.unique(pairs.labels)) == {0, 1, 2}
    for line in manifest(folder):
        expected = truth(line["number"])
        np.testing.assert_array_equal(_pixels(folder / line["instances"]), expected.instances)
        np.testing.assert_array_equal(_pixels(folder / line["labels"]) == 255, expected.labels == 1)
        for entry, pose in zip(line["objects"], expected.pose, strict=False):
            assert [entry["x_m"], entry["y_m"], math.radians(entry["yaw_deg"])] == pytest.approx(pose.tolist())
        assert list(line["sensor"].values()) == pytest.approx(expected.sensor.tolist())


def test_npz_holds_all_and_can_be_recognized(make):
    folder = make("a", 3, format="npz")
    for line in manifest(folder):
        expected, path = truth(line["number"]), folder / line["frame"]
        (frame,) = read_frames(str(path))
        np.testing.assert_allclose(frame.image, expected.image / 255, atol=1e-6)
        with np.load(path) as arrays:
            count = int(expected.there.sum())
            for label, name in enumerate(("highlight_masks", "shadow_masks"), 1):
                for k in range(count):
                    mask = (expected.instances == k + 1) & (expected.labels == label)
                    np.testing.assert_array_equal(arrays[name][k], mask)
                    assert arrays["boxes"][k, label - 1].tolist() == box_of(mask)
            assert arrays["mesh"].tolist() == expected.mesh[:count].tolist()


def test_yolo_boxes_hold_exactly_their_masks(make):
    folder = make("a", 4, format="yolo")
    for line in manifest(folder):
        expected = truth(line["number"])
        size = np.array([SHAPE[1], SHAPE[0]])
        rows = [text.split() for text in (folder / line["boxes"]).read_text().splitlines()]
        assert len(rows) == 2 * expected.there.sum()
        for at, row in enumerate(rows):
            middle, extent = np.array(row[1:3], float) * size, np.array(row[3:], float) * size
            mask = (expected.instances == at // 2 + 1) & (expected.labels == int(row[0]) % 2 + 1)
            y, x = np.nonzero(mask)
            np.testing.assert_allclose(middle - extent / 2, [x.min(), y.min()], atol=1e-3)
            np.testing.assert_allclose(middle + extent / 2, [x.max() + 1, y.max() + 1], atol=1e-3)


def test_yolo_file_names_its_categories_and_no_folder_but_its_own(make):
    yaml = pytest.importorskip("yaml")
    meshes = dict(zip(("pile \U0001f6a2", "other pile"), MESHES.values(), strict=True))
    said = yaml.safe_load((make("a", 2, format="yolo", meshes=meshes) / "data.yaml").read_bytes())
    names = [f"{mesh} {kind}" for mesh in meshes for kind in ("highlight", "shadow")]
    assert said == {"train": "images", "val": "images", "names": dict(enumerate(names))}


# ---------------------------------------------------------------- the folder


@pytest.mark.parametrize("format", FORMATS)
def test_shards_and_what_was_cut_off_give_the_same_bytes(make, monkeypatch, format):
    count = 3 * CHUNK + 5
    whole = content(make("whole", count, format=format))
    for shard in ((3, 3), (1, 3), (2, 3)):
        parts = make("parts", count, format=format, shard=shard)
    assert content(parts) == whole

    def dies(name, writer):
        if str(name).endswith("00000002.jsonl"):
            raise KeyboardInterrupt
        write(name, writer)

    write = dataset.write_atomic
    with monkeypatch.context() as patch:
        patch.setattr(dataset, "write_text", lambda name, text: dies(name, lambda file: file.write(text.encode())))
        with pytest.raises(KeyboardInterrupt):
            make("cut", count, format=format)
    told = []
    cut = make("cut", count, format=format, progress=told.append)
    assert told == [CHUNK, CHUNK, CHUNK, 5]
    assert content(cut) == whole


def test_a_frame_depends_on_key_and_number_alone(make):
    few, many, other = (make(name, n, seed=s) for name, n, s in (("a", 3, 0), ("b", 40, 0), ("c", 3, 1)))
    assert manifest(few) == manifest(many)[:3]
    assert manifest(few)[0]["sensor"] != manifest(other)[0]["sensor"]


def test_the_card_counts_what_is_there(make):
    folder = make("a", 20, license="CC-BY-4.0")
    text, lines = (folder / "README.md").read_text(), manifest(folder)
    assert "Licence: CC-BY-4.0." in text and "20 frames of 48 range bins by 20 beams" in text
    for name in MESHES:
        own = [entry for line in lines for entry in line["objects"] if entry["mesh"] == name]
        assert f"| {name} | {len(own)} | {len(own)} | {len(own)} |" in text
    xs = [entry["x_m"] for line in lines for entry in line["objects"]]
    assert f"| x_m | {min(xs):.4g} | {max(xs):.4g} |" in text
    with Image.open(folder / "contact_sheet.png") as sheet:
        assert sheet.size[0] > 100
    assert sj.Sonar.from_toml(folder / "sonar.toml").shape == SHAPE


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"seed": 1}, "with key"), ({"count": 21}, "with count 20, now 21"), ({"format": "npz"}, 'with format "png"'),
        ({"settings": FrameSettings(scenes=2)}, "with settings"), ({"meshes": {"pile": MESHES["pile"]}}, "with meshes"),
        ({"sonar": SONAR.replace(tilt=0.4)}, "with sonar"), ({"license": "MIT"}, "with license"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)  # fmt: skip
def test_a_folder_of_other_settings_is_refused_and_kept(make, options, said):
    before = content(make("a"))
    with pytest.raises(SonarjaxError, match=said):
        make("a", **options)
    assert content(make("a")) == before


def test_a_set_goes_on_that_was_killed_before_its_folders_were_made(make, monkeypatch):
    def killed(path):
        raise KeyboardInterrupt

    whole = content(make("a"))
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        made = dataset.make_folder
        patched.setattr(dataset, "make_folder", lambda path: made(path) if path.endswith("b") else killed(path))
        make("b")
    assert content(make("b")) == whole


def test_a_set_whose_settings_another_shard_writes_meanwhile_is_taken_up(make, monkeypatch, tmp_path):
    make("a", shard=(1, 2))
    settings = (tmp_path / "a" / dataset.SETTINGS).read_bytes()
    (tmp_path / "a" / dataset.SETTINGS).unlink()
    listed = dataset.os.listdir

    def late(folder):
        found = listed(folder)
        (tmp_path / "a" / dataset.SETTINGS).write_bytes(settings)
        return found

    monkeypatch.setattr(dataset.os, "listdir", late)
    assert content(make("a", shard=(2, 2))) == content(make("b"))


DAMAGES = ("sheet gone", "empty", "cut off", "line gone", "no record", "manifest")


@pytest.mark.parametrize(
    ("format", "what"),
    [*((name, "file gone") for name in FORMATS), ("npz", "picture empty"), *(("coco", name) for name in DAMAGES)],
)
def test_what_is_damaged_is_drawn_again(make, format, what):
    folder = make("a", CHUNK + 3, format=format)
    whole = content(folder)
    part = folder / "parts" / "00000001.jsonl"
    lines = part.read_text().splitlines(keepends=True)
    if what == "file gone":
        last = sorted(p for p in folder.rglob(f"*{CHUNK + 2:08d}.*"))[-1]
        last.unlink()
    elif what == "picture empty":
        next(folder.rglob(f"*{CHUNK + 1:08d}.npz")).write_bytes(b"")
    elif what == "sheet gone":
        (folder / dataset.SHEET).unlink()
    elif what == "manifest":
        (folder / "manifest.jsonl").write_text("")
    else:
        text = "".join(lines)
        damaged = {"empty": "", "cut off": text[:-9], "line gone": "".join(lines[1:]), "no record": "[1]\n" * 3}
        part.write_text(damaged[what])
    assert content(make("a", CHUNK + 3, format=format)) == whole


def test_a_shard_does_not_complete_a_set_in_which_another_is_damaged(make, tmp_path):
    make("a", 2 * CHUNK, shard=(1, 2))
    (tmp_path / "a" / "images" / "00000002.png").unlink()
    make("a", 2 * CHUNK, shard=(2, 2))
    assert not (tmp_path / "a" / "manifest.jsonl").exists()
    make("a", 2 * CHUNK, shard=(1, 2))
    assert len(manifest(tmp_path / "a")) == 2 * CHUNK


@pytest.mark.parametrize("format", FORMATS)
def test_a_finished_set_is_left_as_it_is(make, format):
    folder = make("a", 3, format=format)
    (folder / "README.md").write_text("my own words")
    (folder / "data.yaml").write_text("train: images/train")
    before = {p: (p.stat().st_mtime_ns, p.stat().st_ino) for p in folder.rglob("*") if p.is_file()}
    make("a", 3, format=format)
    assert {p: (p.stat().st_mtime_ns, p.stat().st_ino) for p in folder.rglob("*") if p.is_file()} == before
    (folder / "images" / "00000001.png").unlink(missing_ok=True)  # what is drawn again changes no card either
    make("a", 3, format=format)
    assert (folder / "README.md").read_text() == "my own words"


def test_what_killed_processes_left_is_deleted(make, tmp_path):
    make("a", 2 * CHUNK, shard=(1, 2))
    names = [".sonarjax-1.tmp", "images/.sonarjax-2.tmp", "parts/.sonarjax-3.tmp", ".sonarjax-4.tmp"]
    for name in names:
        (tmp_path / "a" / name).write_text("half")
    os.utime(tmp_path / "a" / names[-1], (0, 0))
    make("a", 2 * CHUNK, shard=(2, 2))  # another shard's manifest, written at this moment, is not deleted
    assert [name for name in names if (tmp_path / "a" / name).exists()] == names[:1]
    make("a", 2 * CHUNK)
    assert not (tmp_path / "a" / names[0]).exists()


def test_a_folder_of_something_else_is_refused(make, tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "thesis.tex").write_text("words")
    with pytest.raises(SonarjaxError, match="expected an empty folder"):
        make("a")
    assert sorted(content(tmp_path / "a")) == ["thesis.tex"]
    (tmp_path / "file").write_text("")
    with pytest.raises(SonarjaxError, match="this is a file"):
        make("file")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"format": "tiff"}, "format: expected one of png, npz, coco, yolo"),
        ({"count": 0}, "count: expected a whole number from 1 to"),
        ({"shard": (3, 2)}, "shard: expected"), ({"meshes": {}}, "at least one"),
        ({"sonar": SONAR.replace(tilt=-0.5)}, "sees no floor"),
        ({"sonar": SONAR.replace(range_min=0.1, range_max=0.2)}, "0.2 m"),
        ({"meshes": {"b\udcff": MESHES["pile"]}}, r"expected names as keys, got 'b\\udcff'"),
        ({"meshes": {"pile": BESIDE}}, "pile: expected a mesh around its origin, got one around x 1.99 m"),
        ({"license": "\udcff"}, r"license: expected a text, got '\\udcff'"),
    ],
)  # fmt: skip
def test_bad_settings_are_one_clear_error(make, tmp_path, options, said):
    with pytest.raises(SonarjaxError, match=said):
        make("a", **options)
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("options", [{"scenes": 0}, {"scenes": 33}, {"sensor": "best"}, {"severity": math.nan}])
def test_bad_frame_settings_are_one_clear_error(options):
    with pytest.raises(SonarjaxError, match=next(iter(options))):
        FrameSettings(**options)


# ---------------------------------------------------------------- where objects stand


def test_objects_never_overlap_and_stand_on_lit_floor():
    meshes, limits = sj.stack_meshes(list(MESHES.values())), placement_limits(SONAR)
    draw = jax.jit(jax.vmap(lambda key: draw_layout(meshes, SONAR, limits, 4, key=key)))
    layouts = jax.tree.map(np.asarray, draw(jax.random.split(jax.random.key(1), 60)))
    counts = layouts.there.sum(axis=1)
    assert set(counts) == {1, 2, 3, 4}
    for k in range(60):
        corners = [_corners(layouts, k, n) for n in range(counts[k])]
        for one, other in itertools.combinations(corners, 2):
            assert _apart(one, other) > 0
        slant = np.hypot(np.hypot(layouts.pose.x[k], layouts.pose.y[k]), SONAR.height)[: counts[k]]
        assert (slant > limits.near - 1e-3).all() and (slant < limits.far + 1e-3).all()
        assert not layouts.there[k, counts[k] :].any()


def test_objects_keep_their_reflectivity():
    """It is also part of what a data set is made of."""
    plain = sj.objects.brick()
    painted = replace(plain, reflectivity=jnp.linspace(0.0, 1.0, plain.n_faces))
    layout = Layout(jnp.array([1, 0]), sj.Pose(x=[2.0, 2.6], y=[0.0, 0.1]), jnp.array([True, True]))
    joined, _ = join_layout(sj.stack_meshes([plain, painted]), layout, 1)
    np.testing.assert_allclose(joined.reflectivity, [*np.asarray(painted.reflectivity), *np.ones(plain.n_faces)])
    assert join_layout(sj.stack_meshes([plain, plain]), layout, 1)[0].reflectivity is None
    known = [dataset._digest(dataset._arrays(mesh)) for mesh in (plain, painted)]
    assert known[0] != known[1]


@pytest.mark.parametrize("yaw", [0.0, 0.6])
def test_objects_stand_on_the_platform(yaw):
    sonar = SONAR.replace(floor=sj.FloorPatch(2.3, 0.1, 0.8, 0.5, yaw))
    meshes, limits = sj.stack_meshes(list(MESHES.values())), placement_limits(sonar)
    draw = jax.jit(jax.vmap(lambda key: draw_layout(meshes, sonar, limits, 2, key=key)))
    layouts = jax.tree.map(np.asarray, draw(jax.random.split(jax.random.key(1), 200)))
    assert layouts.there[:, 0].all()
    x, y = layouts.pose.x[layouts.there] - 2.3, layouts.pose.y[layouts.there] - 0.1
    along, across = math.cos(yaw) * x + math.sin(yaw) * y, math.cos(yaw) * y - math.sin(yaw) * x
    for values, side in ((along, 0.8), (across, 0.5)):  # on the platform, and all over it
        assert 0.4 * side < np.abs(values).max() < 0.5 * side + 1e-5


@pytest.mark.parametrize("x", [-2.3, 8.0])
def test_a_platform_out_of_view_is_one_clear_error(x):
    with pytest.raises(SonarjaxError, match=r"floor: expected a platform in view, with places at ranges from 2\.08"):
        placement_limits(SONAR.replace(floor=sj.FloorPatch(x, 0.0, 0.8, 0.8)))


def test_objects_lie_between_the_outer_beams():
    for name in PRESETS:  # symmetric: the outer beams themselves, made smaller
        sonar = sj.Sonar.preset(name)
        assert placement_limits(sonar)[2:] == (*(float(0.9 * sonar.azimuth[k]) for k in (0, -1)),)
    beside = placement_limits(SONAR.replace(azimuth=jnp.radians(jnp.linspace(10.0, 40.0, 20))))
    assert np.degrees(beside[2:]) == pytest.approx([11.5, 38.5])


def _corners(layouts, frame: int, number: int) -> np.ndarray:
    """Vertices (vertex, 2) of an object's outline from above, hull only."""
    vertices = np.asarray(list(MESHES.values())[layouts.mesh[frame, number]].vertices)[:, :2]
    yaw, x, y = (getattr(layouts.pose, name)[frame, number] for name in ("yaw", "x", "y"))
    turned = vertices @ np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]]) + [x, y]
    return turned[ConvexHull(turned).vertices]


def _apart(one: np.ndarray, other: np.ndarray) -> float:
    """Widest gap between two convex outlines over the normals of their sides; negative where they overlap."""
    sides = np.concatenate([np.roll(p, -1, axis=0) - p for p in (one, other)])
    normals = np.stack([sides[:, 1], -sides[:, 0]], axis=1)
    a, b = one @ normals.T, other @ normals.T
    gaps = np.maximum(b.min(0) - a.max(0), a.min(0) - b.max(0)) / np.linalg.norm(normals, axis=1)
    return float(gaps.max())
