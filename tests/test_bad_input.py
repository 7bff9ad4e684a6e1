"""What Python users give by mistake: a path, a tuple, a rendered frame, text. Each is one clear line.

In a process of its own: here the annotations are checked as well, and those checks would speak first.
"""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

PREPARED = """
import json, sys
import numpy as np, trimesh
import sonarjax as sj
import jax, math
from dataclasses import replace
from sonarjax.io import Frame
from sonarjax.segment.step import GanConfig
from sonarjax.segment.training import PRESETS, find_recipe, train
from sonarjax.sensor import observe_scene

path = sys.argv[1]
box = trimesh.creation.box((0.2, 0.1, 0.06))
box.export(path)
beams = np.linspace(-0.2, 0.2, 16)
s = sj.Sonar.preset("didson-hf", tilt=0.35, n_ranges=64, range_min=2.0, range_max=3.0, azimuth=beams)
m, p, im = sj.Mesh.load(path), sj.Pose(2.3, 0.0, 0.8), np.full(s.shape, 0.5, np.float32)
frame = sj.SonarFrame(im, im, im, im > 0, 0, s)
two, both, key = sj.stack_meshes([m, m]), sj.Pose([2.3, 2.4], 0.0, 0.8), jax.random.key(0)
tilted, model, smoke = s.replace(tilt=np.array([0.3, 0.4])), sj.SensorModel(), PRESETS["smoke"]
frames = sj.SonarFrame(*[np.stack([v, v]) for v in (im, im, im, im > 0)], np.zeros(2, int), s)
bank = lambda **given: sj.template_bank(**{"mesh": m, "sonar": s, "yaws": [0.3], "x": 2.3} | given)
networks = lambda **given: find_recipe(replace(smoke, networks=GanConfig(**given)))
recognizer = sj.Recognizer(m, s, segmenter="none", refine=None)
network = sj.load_segmenter()
found = {}
for call in json.load(sys.stdin):
    try:
        found[call] = f"no error: {eval(call)}"
    except sj.SonarjaxError as error:
        found[call] = str(error)
    except Exception as error:
        found[call] = f"{type(error).__name__}: {error}"
print(json.dumps(found))
"""
MESH = "expected a Mesh (from Mesh.load(path) or Mesh.from_arrays(vertices, faces)), got "
POSE = "expected a Pose (such as Pose(x=2.0, y=0.0, yaw=0.5)), got "
SONAR = "expected a Sonar (from Sonar.from_toml(path) or Sonar.preset(name)), got "
WEIGHTS = "weights: expected a GeneratorWeights (such as load_segmenter().weights), got "
ONE = "image: expected one frame (range, beam), got shape (64, 16, 1)"
READ = " (sonarjax.io.read_frames(path) reads files)"
CASES = {
    # Something else in place of a mesh, a pose or a sonar
    "sj.render(box, p, s)": f"mesh: {MESH}a Trimesh",
    "sj.render('x.stl', p, s)": f"mesh: {MESH}'x.stl'",
    "sj.render([m, 'x.stl'], [p, p], s)": f"mesh[1]: {MESH}'x.stl'",
    "sj.render(m, (2.3, 0.0, 0.8), s)": f"pose: {POSE}a tuple",
    "sj.render(m, [p], s)": f"pose: {POSE}a list",
    "sj.render([m], [2.3], s)": f"pose[0]: {POSE}2.3",
    "sj.render([m, m], p, s)": "pose: expected as many poses as meshes, got 1 and 2",
    "sj.render(m, p, 's.toml')": f"sonar: {SONAR}'s.toml'",
    "sj.Recognizer('x.stl', s)": f"targets: {MESH}'x.stl'",
    "sj.Recognizer({'a': 'x.stl'}, s)": f"targets['a']: {MESH}'x.stl'",
    "sj.Recognizer(box, s)": f"targets: {MESH}a Trimesh",
    "sj.Recognizer(m, 's.toml')": f"sonar: {SONAR}'s.toml'",
    "sj.Recognizer(m, s, segmenter=network.weights)": "segmenter: expected one of pix2pix, ",
    "sj.recognize(im, m, 's.toml')": f"sonar: {SONAR}'s.toml'",
    "sj.refine_yaw(im, m, s, (2.3, 0.0, 0.8))": f"start: {POSE}a tuple",
    "sj.refine_pose(im[None], m, s, p, sonar_poses=(0, 0, 0))": f"sonar_poses: {POSE}a tuple",
    "sj.plan_refinement(m, s, (2.3, 0.0, 0.8), sj.RefineConfig())": f"start: {POSE}a tuple",
    "sj.Mesh.load(box)": "path: expected that of a mesh file, got a Trimesh: Mesh.from_arrays takes arrays",
    "sj.track([im], m)": "recognizer: expected a Recognizer, got a Mesh",
    "recognizer(im, starts=[(2.3, 0.0, 0.8)])": f"starts[0]: {POSE}a tuple",
    "sj.PoseFinder(m, 's.toml')": f"sonar: {SONAR}'s.toml'",
    "sj.PoseFinder('x.stl', s)": f"mesh: {MESH}'x.stl'",
    "sj.calibrate([im], m, 's.toml')": f"sonar: {SONAR}'s.toml'",
    "sj.calibrate([im], 'x.stl', s)": f"mesh: {MESH}'x.stl'",
    "sj.fit_size([im], 'x.stl', s, p)": f"mesh: {MESH}'x.stl'",
    "sj.fit_surface([im], m, s, [p])": f"poses: {POSE}a list",
    "sj.calibrate([im], m, s, poses=sj.Pose(x=[2300.0]))": "poses[0]: expected the object in view, got x 2.3e+03 m",
    # A batch in place of one, or the other way round
    "sj.render(m, p, tilted)": "sonar: expected one sonar, got a batch: use jax.vmap",
    "sj.render([two, m], [p, p], s)": "mesh: expected a sequence of single meshes and poses, got a batch in it",
    "sj.render([m, m], [p, both], s)": "mesh: expected a sequence of single meshes and poses, got a batch in it",
    "sj.render(two, sj.Pose([2.3, 2.4, 2.5]), s)": "pose: expected a shape that broadcasts with (2,) of the meshes, ",
    "sj.render(m, sj.Pose(np.zeros(0)), s)": "pose: expected one or more, got shape (0,)",
    "sj.observe(frames, model, key=key)": "frame: expected one frame, got shape (2, 64, 16): use jax.vmap",
    "sj.observe(frame, model, key=jax.random.split(key))": "key: expected one key (such as jax.random.key(0)), got ",
    "observe_scene(m, both, s, model, key=key)": "pose: expected one pose of one mesh, got shapes (2,) and ()",
    "observe_scene(m, p, tilted, model, key=key)": "sonar: expected one sonar, got a batch: use jax.vmap",
    "bank(mesh=two)": "mesh: expected one mesh, got a stack of shape (2,)",
    "bank(sonar=tilted)": "sonar: expected one sonar, got a batch: use jax.vmap",
    # Banks, noise and training
    "bank(mesh='m.stl')": f"mesh: {MESH}'m.stl'",
    "bank(sonar=None)": f"sonar: {SONAR}None",
    "bank(yaws='a')": "yaws: expected numbers, got 'a'",
    "bank(x=math.nan)": "x: expected a finite number of metres, got nan",
    "bank(x='2')": "x: expected a finite number of metres, got '2'",
    "bank(z='q')": "z: expected numbers, got 'q'",
    "bank(margin=(-5, -5))": "margin: expected two whole numbers of 0 or more, got '(-5, -5)'",
    "bank(quality=3)": "quality: expected a RenderQuality, got 3",
    "bank(size=sj.WindowSize((8, 8)))": "size: expected one that holds WindowSize(shape=(",
    "sj.render(m, p, s, quality=3)": "quality: expected a RenderQuality, got 3",
    "sj.RenderQuality(math.nan)": "RenderQuality: sub_beams: expected a whole number of 1 or more, got nan",
    "sj.RenderQuality(2, 1.5)": "RenderQuality: elevations: expected a whole number of 1 or more, got 1.5",
    "sj.observe(None, model, key=key)": "frame: expected a SonarFrame, got None",
    "sj.observe(frame, None, key=key)": "model: expected a SensorModel, got None",
    "sj.observe(frame, model, key=0)": "key: expected one key (such as jax.random.key(0)), got 0",
    "observe_scene(m, p, None, model, key=key)": f"sonar: {SONAR}None",
    "observe_scene(m, p, s, model, key=0)": "key: expected one key (such as jax.random.key(0)), got 0",
    "networks(normaliser='bogus')": "recipe: networks.normaliser: expected one of affine, per_image, got 'bogus'",
    "networks(head='bogus')": "recipe: networks.head: expected one of tanh, classes, got 'bogus'",
    "networks(inputs=None)": "recipe: networks.inputs: expected one of grey, ranks, got None",
    "networks(backend='bogus')": "recipe: networks.backend: expected one of auto, ",
    "networks(dtype='bogus')": "recipe: networks.dtype: expected one of float32, bfloat16, got 'bogus'",
    "networks(learning_rate='1')": "recipe: networks.learning_rate: expected a finite number above 0, got '1'",
    "find_recipe(replace(smoke, batch=2.5))": "recipe: batch: expected a whole number of 1 or more, got 2.5",
    "find_recipe(['smoke'])": "preset: expected a str, got a list",
    "train('smoke', None)": "run_dir: expected a folder, got None",
    # Something else in place of an image
    "sj.calibrate(['a.npy'], m, s)": f"frames[0]: expected numbers, got 'a.npy'{READ}",
    "sj.calibrate('folder', m, s)": "frames: expected a sequence of images (range, beam), got 'folder'",
    "recognizer('t0.npy')": f"image: expected numbers, got 't0.npy'{READ}",
    "recognizer(frame)": "image: expected numbers, got a SonarFrame (its `semantic()` is a map, ",
    "recognizer(Frame(im, None, 'a', 'a'))": "image: expected numbers, got a Frame (its field `image` holds them)",
    "recognizer(im, 'mask.npy')": "mask: expected numbers, got 'mask.npy'",
    "sj.track(['t0.npy'], recognizer)": f"frames[0]: expected numbers, got 't0.npy'{READ}",
    "sj.track('folder', recognizer)": "frames: expected a sequence of images (range, beam), got 'folder'",
    "sj.refine_yaw('t0.npy', m, s, p)": f"image: expected numbers, got 't0.npy'{READ}",
    "sj.refine_yaw(im, m, s, p, mask='m')": "mask: expected numbers, got 'm'",
    "sj.segment(im, 'pix2pix')": f"{WEIGHTS}'pix2pix'",
    "sj.segment(im, network)": f"{WEIGHTS}a Segmenter",
    "sj.segment('t0.npy', network.weights)": f"image: expected numbers, got 't0.npy'{READ}",
    "network.labels(im[:, :, None])": ONE,
    "sj.load_segmenter('otsu').labels(im[:, :, None])": ONE,
    "network.semantic(im, im[1:] > 0)": "mask: expected the image's shape (64, 16), got (63, 16)",
    # Numbers
    "sj.Pose(x='2.6')": "Pose: x: expected numbers, got '2.6'",
    "sj.Pose(yaw=None)": "Pose: yaw: expected numbers, got None",
    "sj.Pose([[1, 2], [1]])": "Pose: x: expected an array of numbers, got a list",
    "recognizer(im, threshold='0.3')": "threshold: expected a number, got '0.3'",
    "recognizer(im, threshold=float('nan'))": "threshold: expected a number, got nan",
    "recognizer(255 * im)": "image: expected values in [0, 1], got 127.5 to 127.5; divide 8-bit values by 255",
    "recognizer(im - 2)": "image: expected values in [0, 1], got -1.5 to -1.5",
    "recognizer(im, semantic=9 * im, threshold=0.5)": "semantic: expected values in [0, 1], got 4.5 to 4.5",
    "recognizer(im, im > 1)": "mask: expected at least one pixel that was measured, all are False",
    "sj.Mesh.load(path, 'mm')": "unit_m must be a positive number of metres (0.001 for millimetres), got 'mm'",
    "sj.Mesh.from_arrays('vertices', [[0, 1, 2]])": "mesh: vertices: expected numbers, got 'vertices'",
    "sj.Turning(rate_std='5')": "rate_std: expected a number of 0 or more, got '5'",
    "sj.TrackConfig(components=24.5)": "TrackConfig: expected components of 2 or more and ",
    "sj.calibrate([im], m, s.replace(range_min=0.0), free=['range_offset'])": "free: range_offset: expected a window ",
    "s.replace(tlt=0.3)": "sonar: unknown field tlt, expected one of: azimuth, range_min, ",
}


@pytest.fixture(scope="module")
def said(tmp_path_factory) -> dict[str, str]:
    """What the package said to each call."""
    path = tmp_path_factory.mktemp("bad") / "box.stl"
    done = subprocess.run(
        [sys.executable, "-c", PREPARED, str(path)], input=json.dumps(list(CASES)), capture_output=True, text=True,
        timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout)


@pytest.mark.parametrize("call", CASES)
def test_a_wrong_argument_is_one_clear_line(call, said):
    assert CASES[call] in said[call] and "\n" not in said[call]
    assert "Error: " not in said[call], "no error of the package's own"
