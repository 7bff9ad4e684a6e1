"""What Python users give by mistake: a path, a tuple, a rendered frame, text. Each is one clear line.

In a process of its own: here the annotations are checked as well, and those checks would speak first.
"""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

PREPARED = """
import json, math, os, pathlib, sys
from dataclasses import replace
import jax, numpy as np, trimesh
import sonarjax as sj
from sonarjax.data import FrameSettings, Pairs, PairSettings, export_pairs, make_dataset, make_pairs, split_key
from sonarjax.io import Frame
from sonarjax.render import RenderQuality
from sonarjax.segment import to_grey
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
two = sj.stack_meshes([m, m])
coarse = sj.SearchConfig(decimation=65)
listed = sj.RefineConfig(blurs=[3, 1], margin=[8, 2])
painted = replace(m, reflectivity=np.ones(3))
both = sj.Pose([2.3, 2.4], 0.0, 0.8)
tilted, model, smoke = s.replace(tilt=np.array([0.3, 0.4])), sj.SensorModel(), PRESETS["smoke"]
frames = sj.SonarFrame(*[np.stack([v, v]) for v in (im, im, im, im > 0)], np.zeros(2, int), s)
bank = lambda **given: sj.template_bank(**{"mesh": m, "sonar": s, "yaws": [0.3], "x": 2.3} | given)
networks = lambda **given: find_recipe(replace(smoke, networks=GanConfig(**given)))
kept = lambda **given: find_recipe(replace(smoke, **given)).as_json()
recognizer = sj.Recognizer(m, s, segmenter="none", refine=None)
network, otsu, none = sj.load_segmenter(), sj.load_segmenter("otsu"), sj.load_segmenter("none")
to_polar, to_fan, fan = sj.io.fan_to_polar, sj.io.polar_to_fan, sj.io.fan_around(0.4, 2.0, 3.0, 0.02)[0]
edges, out, key = np.linspace(2, 3, 65), path + ".set", jax.random.key(0)
make = lambda meshes={"a": m}, sonar=s, count=4, key=key, **o: make_dataset(meshes, sonar, out, count, key=key, **o)
crops, labels = np.full((2, 128, 128), 0.5), np.zeros((2, 128, 128), int)
holed = np.where(np.arange(im.size).reshape(im.shape) == 500, np.nan, im)
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
MESHES = "meshes: expected a mapping from names to meshes, such as {'box': mesh}, got "
KEY = "key: expected one JAX key, such as jax.random.key(0), got "
ONE = "image: expected one frame (range, beam), got shape (64, 16, 1)"
FACTORS = "expected a reflectivity of 12 factors, one for each triangle and padding, got shape "
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
    "sj.refine_yaw(im, m, s, sj.Pose(2.3, 0.0, float('nan')))": "pose: yaw: expected a number from -1e+06 to 1e+06 rad",
    "sj.refine_yaw(im, m, s, sj.Pose(x=np.zeros(0)))": "start: expected at least one pose, got shape (0,)",
    "sj.refine_yaw(im, sj.stack_meshes([m, m]), s, p)": "mesh: expected a single one, got a batch of shape (2,)",
    "sj.refine_yaw(im, m, s, p, config=None)": "config: expected a RefineConfig, got None",
    "sj.refine_yaw(im, m, s, p, window=sj.WindowSize((65, 16)))": "window: expected at most the frame's (64, 16)",
    "sj.refine_pose(im, m, s, p, free=3)": "free: expected names, got 3",
    "sj.refine_pose(im[None], m, s, p, sonar_poses=[p])": f"sonar_poses: {POSE}a list",
    "sj.Recognizer(m, s, segmenter='none', search=None)": "search: expected a SearchConfig, got None",
    "recognizer(im, starts=[sj.Pose(x=[2.2, 2.3])])": "starts: expected single poses, got a batch of them in one Pose",
    "sj.Mesh.load(box)": "path: expected that of a mesh file, got a Trimesh: Mesh.from_arrays takes arrays",
    "sj.track([im], m)": "recognizer: expected a Recognizer, got a Mesh",
    "sj.track([im, im], recognizer, sonar_poses=3)": "sonar_poses: expected one for each frame, got 3",
    "sj.track([im, im], recognizer, masks=True)": "masks: expected one for each frame, got True",
    "sj.track([im, im], recognizer, masks=[None, im[:9] > 0])": "masks[1]: expected the frame's shape (64, 16), got (9",
    "sj.track([im, im], recognizer, masks=[None, [[1, 2], [3]]])": "masks[1]: expected an array of numbers, got a list",
    "sj.Tracker(recognizer).take(im)": "found: expected a Recognition, got ",
    "recognizer(im, starts=[(2.3, 0.0, 0.8)])": f"starts[0]: {POSE}a tuple",
    "sj.PoseFinder(m, 's.toml')": f"sonar: {SONAR}'s.toml'",
    "sj.PoseFinder(two, s)": "target: expected one mesh, got a stack of shape (2,)",
    "sj.Recognizer(two, s, segmenter='none')": "target: expected one mesh, got a stack of shape (2,)",
    "sj.Recognizer(m, tilted, segmenter='none')": "sonar: expected one sonar, got a batch",
    "sj.calibrate([im], two, s)": "mesh: expected one mesh, got a stack of shape (2,)",
    "sj.calibrate([im], m, tilted)": "sonar: expected one sonar, got a batch",
    "sj.calibrate([im], m, s, search=3)": "search: expected a SearchConfig, got 3",
    "sj.calibrate([255 * im, im], m, s)": "frames[0]: expected values in [0, 1], got 127.5 to 127.5; divide 8-bit",
    "sj.calibrate([im], m, s, masks=[im < 0])": "masks[0]: expected at least one pixel that was measured, all",
    "sj.stack_meshes([two])": "stack_meshes: expected at least one mesh, none stacked",
    "sj.stack_meshes([])": "stack_meshes: expected at least one mesh, got none",
    "sj.stack_meshes([m, box])": f"meshes[1]: {MESH}a Trimesh",
    "sj.Tracker(recognizer, config=None)": "config: expected a TrackConfig, got None",
    "sj.TrackConfig(memory=0.01)": "memory: expected 0.1 frames or more, got 0.01",
    "sj.SearchConfig(quality=3)": "quality: expected a RenderQuality, got 3",
    "sj.RefineConfig(quality=3)": "quality: expected a RenderQuality, got 3",
    "sj.refine_yaw(im, m, s, p, window=(64, 16))": "window: expected a WindowSize, got a tuple",
    "sj.LeanSearchConfig(lean='x')": "lean: expected an angle above 0 and below π/2 [rad], got 'x'",
    "sj.template_bank(m, s, [0.0], x=2.3, size=(96, 24))": "size: expected a WindowSize, got a tuple",
    "sj.fit_surface([im], m, s, sj.Pose(x=[2.3], yaw=np.nan))": "pose: yaw: expected a number from -1e+06 to 1e+06 rad",
    "sj.calibrate([im], m, s, poses=sj.Pose(x=[2.3], yaw=np.nan))": "pose: yaw: expected a number from -1e+06 to ",
    "sj.fit_surface([im], m, s, sj.Pose(x=[2.3]), config={'iterations': 1})": "config: expected a SurfaceConfig, got a",
    "sj.PoseFinder(m, s, segmenter='none', error_bar='x')": "error_bar: expected a PoseErrorBar, got 'x'",
    "sj.PoseFinder(m, s, segmenter='none').views([im, im[:9]], both)": "image: expected ",
    "make_dataset({'a': m}, s, '', 3, key=key)": "folder: expected a path, got ''",
    "make_pairs(2.5, key=key)": "count: expected a whole number of 1 or more, got 2.5",
    "make_pairs('3', key=key)": "count: expected a whole number of 1 or more, got '3'",
    "make_pairs(1, key=3)": f"{KEY}3",
    "make_pairs(1, {}, key=key)": "settings: expected a PairSettings, got ",
    "split_key('a', 'train')": "run_seed: expected a whole number from 0 to 4294967295, got 'a'",
    "split_key(2**32, 'train')": "run_seed: expected a whole number from 0 to 4294967295, got 4294967296",
    "make_pairs(4, key=key, first=2**32 - 2)": "first: expected pairs with numbers below 4294967296, got up to 4294",
    "make(key=jax.random.key(0, impl='rbg'))": "key: expected a key of 2 words, as jax.random.key(0) makes, got 4",
    "sj.segment(im, network.weights, closer=-1)": "closer: expected a whole number of 0 or more, got -1",
    "sj.segment(im, network.weights, tile=256)": "tile: expected two numbers of pixels (range, beam), got 256",
    "max(np.ptp(network.semantic(v) - network.semantic(im)) for v in (im.tolist(), im.astype('>f4')))": "no error: 0.0",
    "sj.segment(im, network.weights, tile=[256, 64]).shape": "no error: (64, 16)",
    "RenderQuality(np.int64(1), 16).sub_beams.__class__": "no error: <class 'int'>",
    "to_grey([[255, 0]])": "labels: expected whole numbers: 0 background, 1 highlight, 2 shadow",
    "to_grey([[-1, 0]])": "labels: expected whole numbers: 0 background, 1 highlight, 2 shadow",
    "to_grey([[0.5, 1.0]])": "labels: expected whole numbers: 0 background, 1 highlight, 2 shadow",
    "PairSettings(n_ranges=-3)": "n_ranges: expected a whole number of 1 or more, got -3",
    "PairSettings(odd=2.0)": "odd: expected a share from 0 to 1, got 2.0",
    "PairSettings(severity=(2.0, 1.0))": "severity: expected two numbers of 0 or more in order, got ",
    "sj.Sonar.preset('didson-hf', floor=(0, 0, 1, 1))": "floor: expected a FloorPatch (such as FloorPatch(x=2.0, y=0.0",
    "sj.Sonar.preset('didson-hf', geometry_std={'tilt': 0.1})": "geometry_std: expected a GeometryStd (such as Geometr",
    "to_polar(im, fan, (4.0, 3.0))": "fan: shape: expected two whole numbers, got ",
    "to_polar(im, fan, 20)": "fan: shape: expected two whole numbers, got 20",
    "sj.io.read_frames(None)": "frame: expected the name of a file, got None",
    "sj.io.read_frames(path.encode())": "frame: expected the name of a file, got b'",
    "sj.Sonar.preset('didson-hf', roll=2.0)": "roll must be between -90° and 90°, got 114.592°",
    "sj.Recognizer(m, s.replace(tilt=1.5), segmenter='none')": "tilt plus half of elevation_aperture must be ",
    "sj.PoseFinder('x.stl', s)": f"mesh: {MESH}'x.stl'",
    "sj.calibrate([im], m, 's.toml')": f"sonar: {SONAR}'s.toml'",
    "sj.calibrate([im], 'x.stl', s)": f"mesh: {MESH}'x.stl'",
    "sj.fit_size([im], 'x.stl', s, p)": f"mesh: {MESH}'x.stl'",
    "sj.fit_surface([im], m, s, [p])": f"poses: {POSE}a list",
    "sj.calibrate([im], m, s, poses=sj.Pose(x=[2300.0]))": "poses[0]: expected the object in view, got x 2.3e+03 m",
    "sj.render(painted, p, s)": f"mesh: {FACTORS}(3,)",
    "sj.render([m, painted], [p, p], s)": f"mesh: {FACTORS}(3,)",
    "sj.render(replace(two, reflectivity=np.ones((2, 3))), p, s)": f"mesh: {FACTORS}(2, 3)",
    "jax.jit(lambda r: sj.render(replace(m, reflectivity=r), p, s))(np.ones(3))": f"mesh: {FACTORS}(3,)",
    "sj.template_bank(painted, s, [0.0], x=2.3)": f"mesh: {FACTORS}(3,)",
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
    "sj.RenderQuality(math.nan)": "sub_beams: expected a whole number of 1 or more, got nan",
    "sj.RenderQuality(2, 1.5)": "elevations: expected a whole number of 1 or more, got 1.5",
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
    "find_recipe(replace(smoke, source=3))": "recipe: source: expected a folder or None, got 3",
    "find_recipe(replace(smoke, source=''))": "recipe: source: expected a folder or None, got ''",
    "find_recipe(replace(smoke, name=None))": "recipe: name: expected a text, got None",
    "find_recipe(replace(smoke, discriminative='no'))": "recipe: discriminative: expected True or False, got 'no'",
    "find_recipe(replace(smoke, mirrored=np.array(0.5)))": "recipe: mirrored: expected a share from 0 to 1, got a",
    "find_recipe(replace(smoke, networks={}))": "recipe: networks: expected a GanConfig, got a dict",
    "find_recipe(replace(smoke, pair_settings=None))": "recipe: pair_settings: expected a PairSettings, got None",
    "find_recipe(replace(smoke, pair_settings=PairSettings(varied=1)))": "recipe: pair_settings.varied: expected True ",
    "find_recipe(replace(smoke, pair_settings=PairSettings(tank=0)))": "recipe: pair_settings.tank: expected True or ",
    "networks(skips=1)": "recipe: networks.skips: expected True or False, got 1",
    "networks(beta1=jax.numpy.float32(0.5))": "recipe: networks.beta1: expected a number from 0 to below 1, got a",
    "kept(source=pathlib.Path('pairs')) == kept(source='pairs')": "no error: True",
    "kept(batch=np.int64(2), plain=np.float32(0.5)) == kept(batch=2, plain=0.5)": "no error: True",
    "kept(pair_settings=PairSettings(np.int64(64), odd=np.float32(1)))['pair_settings']['n_ranges']": "no error: 64",
    "networks(learning_rate=np.float32(0.5)).as_json()['networks']['learning_rate']": "no error: 0.5",
    "train('smoke', None)": "run_dir: expected a path, got None",
    "train('smoke', '')": "run_dir: expected a path, got ''",
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
    "sj.io.write_bag(path + '.bag', Frame(im, None, 'a', 'a'))": "frames: expected frames one after another, such as",
    "sj.io.write_bag(path + '.bag', ['f.npz'])": "frames[0]: expected a Frame, got 'f.npz'",
    "sj.io.write_bag(path + '.bag', [], topic=5)": "topic: expected a name such as '/sonar_image', got 5",
    "sj.match.match_low_rank('abc', sj.match.low_rank_bank(np.eye(8)[None], (9, 9), 1))": "image: expected ",
    # Fan pictures
    "to_polar(im[:, :, None], fan)": "fan: picture: expected one grey image of two axes, got shape (64, 16, 1)",
    "to_polar('fan.png', fan)": "fan: picture: expected numbers, got 'fan.png'",
    "to_polar(im, fan, order=2)": "fan: order: expected 0, 1 or 3, got 2",
    "to_polar(im * np.nan, fan)": "fan: expected finite values in all pixels that were measured",
    "to_polar(im, fan, azimuth=[0.1, 'x'])": "fan: azimuth: expected numbers, got a list",
    "to_polar(im, fan, azimuth=[-0.1, 0.1])[0].shape[1]": "no error: 2",
    "to_fan(im, list(beams), list(edges), fan, (9, 9))[0].shape": "no error: (9, 9)",
    "to_fan(im[0], beams, edges, fan, (9, 9))": "fan: image: expected one grey image of two axes, got shape (16,)",
    "to_fan(im, beams, edges, fan, (9, 9), im[1:] > 0)": "fan: mask: expected the image's shape (64, 16), got (63, 16)",
    "to_fan(im, beams, edges, fan, (9, 9), order=2)": "fan: order: expected 0, 1 or 3, got 2",
    "to_fan(im * np.inf, beams, edges, fan, (9, 9))": "fan: expected finite values in all pixels that were measured",
    # Data sets
    "make([m])": f"{MESHES}a list",
    "make(m)": f"{MESHES}a Mesh",
    "make({'a': 'box.stl'})": f"meshes['a']: {MESH}'box.stl'",
    "make({1: m})": "meshes: expected names as keys, got 1",
    "make(sonar='s.toml')": f"sonar: {SONAR}'s.toml'",
    "make(key=0)": f"{KEY}0",
    "make(key='seed')": f"{KEY}'seed'",
    "make(key=jax.random.split(key))": KEY,
    "make(settings={'scenes': 2})": "settings: expected a FrameSettings, got a dict",
    "make(count=4.0)": "count: expected a whole number from 1 to 2147483648, got 4.0",
    "make(count='4')": "count: expected a whole number from 1 to 2147483648, got '4'",
    "make(shard=2)": "shard: expected (i, n) with i from 1 to n, got 2",
    "make(format=['png'])": "format: expected one of png, npz, coco, yolo, got a list",
    "make(license=None)": "license: expected a text, got None",
    "FrameSettings(scenes=1.5)": "scenes: expected a whole number from 1 to 32, got 1.5",
    "FrameSettings(np.int64(3), severity=np.float32(1))": "no error: FrameSettings(scenes=3, sensor='drawn', sever",
    "FrameSettings(scenes='2')": "scenes: expected a whole number from 1 to 32, got '2'",
    "FrameSettings(severity='1')": "severity: expected a number from 0 to 10, got '1'",
    "FrameSettings(quality=2)": "quality: expected a RenderQuality, got 2",
    "export_pairs(im, out)": "pairs: expected a Pairs, got a ndarray",
    "export_pairs(Pairs(crops, 1.0 * labels), out)": "pairs: labels: expected whole numbers from 0 to 2, got float64",
    "export_pairs(Pairs(crops, labels + 9), out)": "pairs: labels: expected whole numbers from 0 to 2, got 9 to 9",
    "export_pairs(Pairs(crops, labels - 1), out)": "pairs: labels: expected whole numbers from 0 to 2, got -1 to -1",
    "export_pairs(Pairs(crops, labels[1:]), out)": "pairs: expected images and labels (pair, range, beam) of the same ",
    "export_pairs(Pairs(crops * 255, labels), out)": "pairs: image: expected values in [0, 1]",
    "export_pairs(Pairs('a.png', labels), out)": "pairs: image: expected numbers, got 'a.png'",
    "export_pairs(Pairs(crops, labels), out, key=3)": f"{KEY}3",
    "export_pairs(Pairs(crops, labels), out, settings={})": "settings: expected a PairSettings, got a dict",
    "export_pairs(Pairs(crops, labels), '')": "folder: expected a path, got ''",
    "export_pairs(Pairs(crops, labels), out, first='4')": "first: expected a whole number of 0 or more, got '4'",
    "os.path.exists(out)": "no error: False",
    # Numbers
    "sj.Pose(x='2.6')": "Pose: x: expected numbers, got '2.6'",
    "sj.Pose(yaw=None)": "Pose: yaw: expected numbers, got None",
    "sj.Pose([[1, 2], [1]])": "Pose: x: expected an array of numbers, got a list",
    "recognizer(im, threshold='0.3')": "threshold: expected a number, got '0.3'",
    "recognizer(im, threshold=float('nan'))": "threshold: expected a number, got nan",
    "recognizer(255 * im)": "image: expected values in [0, 1], got 127.5 to 127.5; divide 8-bit values by 255",
    "recognizer(im - 2)": "image: expected values in [0, 1], got -1.5 to -1.5",
    "recognizer(im, semantic=9 * im, threshold=0.5)": "semantic: expected values in [0, 1], got 4.5 to 4.5",
    "recognizer(im, im > 1)": "mask: expected at least one pixel that was measured, all",
    "sj.Mesh.load(path, 'mm')": "unit_m must be a positive number of metres (0.001 for millimetres), got 'mm'",
    "sj.Mesh.from_arrays('vertices', [[0, 1, 2]])": "mesh: vertices: expected numbers, got 'vertices'",
    "sj.Mesh.from_arrays(np.eye(3), [[0, 1, 1.5]])": "mesh: faces: expected whole vertex numbers, got fractions or NaN",
    "m.with_vertices([[0.0, 0.0, 0.0]])": "vertices: expected shape (8, 3), got (1, 3)",
    "m.with_vertices('v.npy')": "vertices: expected numbers, got 'v.npy'",
    "two.with_vertices(two.vertices)": "with_vertices: expected one mesh, got a batch of shape (2,)",
    "sj.reduce_mesh(m, 'a')": "tolerance: expected a positive number of metres, got 'a'",
    "sj.reduce_mesh(box, 0.01)": f"mesh: {MESH}a Trimesh",
    "sj.match_bank('a', np.zeros((3, 8, 8)))": f"image: expected numbers, got 'a'{READ}",
    "sj.match_bank(im, 'bank.npy')": "templates: expected numbers, got 'bank.npy'",
    "sj.match_bank(im, np.zeros((3, 8, 8)), 'mask.npy')": "mask: expected numbers, got 'mask.npy'",
    "sj.Turning(rate_std='5')": "rate_std: expected a number of 0 or more, got '5'",
    "sj.TrackConfig(components=24.5)": "components: expected a whole number of 2 or more, got 24.5",
    "sj.SearchConfig(range_step=float('inf'))": "range_step: expected a positive number of metres, got inf",
    "sj.SearchConfig(decimation=2.5)": "decimation: expected a whole number of 1 or more, got 2.5",
    "sj.SearchConfig(yaw_bins=36.5)": "yaw_bins: expected a whole number of 4 or more, got 36.5",
    "sj.SearchConfig(hypotheses=True)": "hypotheses: expected a whole number of 1 or more, got True",
    "sj.SearchConfig(lead=float('nan'))": "lead: expected a number of 0 or more, got nan",
    "sj.Recognizer(m, s, segmenter='none', search=coarse)": "decimation: expected at most the 64 range bins of a ",
    "sj.RenderQuality(sub_beams=1.5)": "sub_beams: expected a whole number of 1 or more, got 1.5",
    "sj.RefineConfig(iterations=2.7)": "iterations: expected a whole number of 1 or more, got 2.7",
    "sj.RefineConfig(margin=(5,))": "margin: expected two whole numbers (bins, beams), got (5,)",
    "sj.RefineConfig(margin=(-100, -5))": "margin[0]: expected a whole number of 0 or more, got -100",
    "sj.RefineConfig(margin=5)": "margin: expected two whole numbers (bins, beams), got 5",
    "sj.RefineConfig(blurs=2.0)": "blurs: expected positive numbers of range bins, got 2.0",
    "sj.RefineConfig(bounds=.1)": "bounds: expected three positive numbers [rad, m, m], got 0.1",
    "sj.RefineConfig(sharpness='a')": "sharpness: expected a number of 0 or more, got 'a'",
    "sj.RefineConfig(template=['echo'])": "template: expected one of semantic, ",
    "sj.SurfaceConfig(blurs=6.0)": "blurs: expected positive numbers of range bins, got 6.0",
    "sj.SurfaceConfig(iterations=1.5)": "iterations: expected a whole number of 1 or more, got 1.5",
    "sj.fit_size([im], m, s, p, prior={'object_length': 'a'})": "prior: object_length: expected a positive ",
    "sj.fit_size([im], m, s, p, prior=0.1)": "prior: expected standard deviations by name, got 0.1",
    "sj.fit_size([im], m, s, p, masks=True)": "masks: expected a sequence of images (range, beam), got True",
    "sj.fit_size([im], m, s, p, masks=['a'])": "masks[0]: expected numbers, got 'a'",
    # Images that are none
    "sj.recognize(frame.labels() + 1, m, s)": "image: expected values in [0, 1], got whole numbers from ",
    "sj.recognize(im, m, s, semantic=2 * (im > 0), threshold=0.5)": "semantic: expected values in [0, 1], got whole ",
    "sj.refine_yaw(holed, m, s, p)": "image: holds NaN or infinite values where it was measured (a mask",
    "sj.refine_yaw(holed, m, s, p, mask=np.isfinite(holed)).yaw.shape": "no error: ()",
    "sj.refine_pose(np.stack([im, holed]), m, s, p, sonar_poses=both)": "image: holds NaN or infinite values",
    "sj.match_bank(holed, np.eye(8)[None])": "image: holds NaN or infinite values",
    "sj.match_positions(holed, np.eye(8)[None], mask=im > 0)": "image: holds NaN or infinite values",
    "sj.match_bank(holed, np.eye(8)[None], mask=np.isfinite(holed)).shape": "no error: (1,)",
    "sj.segment(holed, network.weights)": "image: holds NaN or infinite values",
    "sj.load_segmenter('otsu').labels(holed)": "image: holds NaN or infinite values",
    "sj.segment(255 * im, network.weights)": "image: expected values in [0, 1], got 127.5 to 127.5; divide 8-bit",
    "network.labels((255 * im).astype(np.uint8))": "image: expected values in [0, 1], got 127 to 127; divide 8-bit",
    "otsu.labels((255 * im).astype(np.uint8))": "image: expected values in [0, 1], got 127 to 127; divide 8-bit",
    "none.semantic(255 * im, im > 0)": "image: expected values in [0, 1], got 127.5 to 127.5; divide 8-bit",
    "otsu.labels(frame.labels() + 1)": "image: expected values in [0, 1], got whole numbers from ",
    "none.labels(im + 0.6).max()": "no error: 1",
    "none.labels(np.where(holed > 0, holed, 300), np.isfinite(holed)).max()": "no error: 0",
    "none.labels(255 * im, im > 1).max()": "no error: 0",
    "network.labels(im[:0])": "image: expected one frame (range, beam), got shape (0, 16)",
    # The map of `none` is an array of its own, whatever was given
    "{type(none.semantic(v)) for v in (im, im.tolist(), jax.numpy.asarray(im))} == {np.ndarray}": "no error: True",
    "jax.jit(none.semantic)(im.astype(np.float16)).dtype": "no error: float32",
    "sj.calibrate([im], m.standing(), s)": "frames: expected at least one that shows something, but each is",
    # Something else in place of an engine
    "sj.Recognizer(m, s, segmenter='none', engine='cpu')": "engine: expected an Engine, got 'cpu'",
    "sj.PoseFinder(m, s, segmenter='none', engine='cpu')": "engine: expected an Engine, got 'cpu'",
    "sj.calibrate([im], m, s, engine='cpu')": "engine: expected an Engine, got 'cpu'",
    "sj.fit_size([im], m, s, p, engine='cpu')": "engine: expected an Engine, got 'cpu'",
    "sj.fit_surface([im], m, s, p, engine='cpu')": "engine: expected an Engine, got 'cpu'",
    "sj.refine_yaw(im, m, s, p, engine='cpu')": "engine: expected an Engine, got 'cpu'",
    "sj.refine_pose(im[None], m, s, p, sonar_poses=sj.Pose([0.0]), engine=0)": "engine: expected an Engine, got 0",
    "bank(engine='cpu')": "engine: expected an Engine, got 'cpu'",
    "make(engine='cpu')": "engine: expected an Engine, got 'cpu'",
    "make_pairs(1, key=key, engine='cpu')": "engine: expected an Engine, got 'cpu'",
    "train(smoke, out, engine='cpu')": "engine: expected an Engine, got 'cpu'",
    # Sonars
    "make(sonar=tilted)": "sonar: expected one sonar, got a batch",
    "make_dataset({'a': m}, s, None, 3, key=key)": "folder: expected a path, got None",
    "sj.Sonar.from_toml(None)": "path: expected that of a TOML file, got None",
    "sj.Recognizer(m, s.replace(azimuth=[0.0, 0.1]), segmenter='none')": "sonar: azimuth: expected an array (beam,), ",
    # Lists in place of tuples
    "[listed.blurs, listed.margin, hash(listed) == hash(replace(listed))]": "no error: [(3.0, 1.0), (8, 2), True]",
    "hash(sj.SurfaceConfig(blurs=[3, 1])) == hash(sj.SurfaceConfig(blurs=(3.0, 1.0)))": "no error: True",
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
