"""`train`: it learns, leaves what it says it leaves, stops when asked, and says why when it cannot go on."""

from __future__ import annotations

import json
import os
import signal
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from sonarjax.data import Pairs, split_key
from sonarjax.io import SonarjaxError
from sonarjax.io.safetensors import read_safetensors
from sonarjax.segment.step import GanConfig, create_state
from sonarjax.segment.training import PRESETS, Recipe, batches, discriminative, find_recipe, loop, train
from sonarjax.segment.training.batches import Batches, validation_set
from sonarjax.segment.training.devices import device_mesh, make_step
from sonarjax.segment.training.evaluate import predict
from sonarjax.segment.weights import save_generator
from tests.segment.training_runs import plain_pairs, recorded, tiny_recipe

SLOW = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return plain_pairs(tmp_path_factory.mktemp("pairs") / "plain")


@pytest.fixture(scope="module")
def done(folder, tmp_path_factory):
    """A finished run: folder and result."""
    run = tmp_path_factory.mktemp("runs") / "done"
    return run, train(tiny_recipe(folder), run)


@pytest.mark.slow
def test_leaves_what_it_says(done):
    run, result = done
    assert result.finished and result.step == 12 and result.weights == run / "weights.safetensors"
    lines = recorded(run)
    assert [line["epoch"] for line in lines] == [1, 2, 3]
    assert lines[-1]["loss_distance"] < lines[0]["loss_distance"]
    for epoch in (1, 2, 3):
        with Image.open(run / "samples" / f"epoch_{epoch:04d}.png") as picture:
            assert picture.size == (4 * 128, 3 * 128)
    config = json.loads((run / "config.json").read_text())
    assert config["recipe"]["networks"]["width"] == 2 and config["versions"]["jax"]
    assert sum(file.stat().st_size for file in (run / "events").iterdir()) > 10_000  # scalars and pictures


@pytest.mark.slow
def test_a_run_is_not_overwritten(done, folder):
    with pytest.raises(SonarjaxError, match="already holds a run"):
        train(tiny_recipe(folder), done[0])
    with pytest.raises(SonarjaxError, match=r"these fields differ: networks, run_seed"):
        recipe = tiny_recipe(folder, run_seed=1)
        train(replace(recipe, networks=replace(recipe.networks, width=3)), done[0], resume=True)


@pytest.mark.parametrize("resume", [False, True])
@pytest.mark.parametrize("name", ["metrics.jsonl", "weights.safetensors", "checkpoints"])
def test_what_another_program_left_is_kept(folder, tmp_path, name, resume):
    left = tmp_path / name / "5" if name == "checkpoints" else tmp_path / name
    left.parent.mkdir(exist_ok=True)
    left.write_text('{"epoch": 3}\nfree text\n')
    with pytest.raises(SonarjaxError, match=f"holds {name} of something else .no config.json.: expected another"):
        train(tiny_recipe(folder), tmp_path, resume=resume)
    assert left.read_text() == '{"epoch": 3}\nfree text\n' and os.listdir(tmp_path) == [name]


def test_a_network_is_trained_further(folder, tmp_path):
    """At a step size of next to nothing the average stays what was given."""
    given = create_state(tiny_recipe(folder).networks, key=jax.random.key(5)).weights()
    save_generator(tmp_path / "given.safetensors", given, {}, storage="float32")
    still = replace(tiny_recipe(folder).networks, learning_rate=1e-12)
    recipe = tiny_recipe(folder, networks=still, passes=1, initial_weights=tmp_path / "given.safetensors")
    result = train(recipe, tmp_path / "run")
    assert result.finished and result.weights is not None
    arrays, about = read_safetensors(result.weights)
    assert about["recipe"]["initial_weights"] == str(tmp_path / "given.safetensors")
    np.testing.assert_allclose(arrays["params.up15.kernel"], given["params"]["up15"]["kernel"], atol=1e-4)


def test_weights_of_another_network_are_refused_before_the_run_begins(folder, tmp_path):
    given, run = tmp_path / "given.safetensors", tmp_path / "run"
    networks = replace(tiny_recipe(folder).networks, width=3)
    save_generator(given, create_state(networks, key=jax.random.key(5)).weights(), {})
    with pytest.raises(SonarjaxError, match=r"given.*: channels: expected \[2, .*as in the recipe, got \[3, "):
        train(tiny_recipe(folder, initial_weights=given), run)
    with pytest.raises(SonarjaxError, match="nowhere"):
        train(tiny_recipe(folder, initial_weights=tmp_path / "nowhere"), run)
    assert not run.exists()


@pytest.mark.slow
def test_stops_when_told_and_goes_on(done, folder, tmp_path, monkeypatch):
    batch = Batches.batch

    def told(self, step):
        if step == 4:
            os.kill(os.getpid(), signal.SIGTERM)
        return batch(self, step)

    monkeypatch.setattr(Batches, "batch", told)
    result = train(tiny_recipe(folder), tmp_path / "run")
    assert (result.finished, result.step, result.weights) == (False, 5, None)
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    monkeypatch.undo()
    again = train(tiny_recipe(folder), tmp_path / "run", resume=True)
    assert again.finished and recorded(tmp_path / "run") == recorded(done[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "loss", "weight", "log_steps", "complaint"),
    [
        (5, np.nan, np.nan, 1, "step 5: the loss `distance` is nan; the last good .* step 4"),
        pytest.param(6, 1.0, np.nan, 1, "step 6: a weight is not finite; the last good .* step 4", marks=SLOW),
        # The next look at the losses would be at step 8, the end of an epoch, and a checkpoint comes before.
        pytest.param(5, 1e6, 1.0, 100, r"step 6: the loss `distance` is [\de+.]+; the last good .* step 4", marks=SLOW),
    ],
)
def test_divergence_stops_with_the_last_good_checkpoint_kept(
    folder, tmp_path, monkeypatch, first, loss, weight, log_steps, complaint
):
    """From the step `first` on, the distance and the generator's weights are those of the run times these."""
    advance = loop.make_step

    def poisoned(recipe, mesh):
        step = advance(recipe, mesh)

        def wrong(state, *rest):
            state, losses = step(state, *rest)
            if int(state.step) < first:
                return state, losses
            broken = jax.tree.map(lambda v: weight * v, state.generator)
            return replace(state, generator=broken), losses | {"distance": loss * losses["distance"]}

        return wrong

    monkeypatch.setattr(loop, "make_step", poisoned)
    with pytest.raises(SonarjaxError, match=complaint):
        train(tiny_recipe(folder, log_steps=log_steps), tmp_path / "run")


@pytest.fixture
def cheap_pairs(monkeypatch):
    """Pairs that only say which key and number they have; records what was made."""
    made = []

    def make(count, settings, *, key, first=0, engine=None):
        made.append((first, count, jax.random.key_data(key).tolist()))
        shade = (first + np.arange(count) + 100 * int(jax.random.key_data(key)[1] % 2)) % 256
        image = np.broadcast_to(shade[:, None, None] / 255, (count, 128, 128))
        return Pairs(jnp.asarray(image, jnp.float32), jnp.zeros(image.shape, jnp.uint8))

    monkeypatch.setattr(batches, "make_pairs", make)
    monkeypatch.setattr(batches, "AT_ONCE", 8)
    return made


def test_batch_depends_on_its_number_only(cheap_pairs):
    recipe = Recipe(batch=4, pairs=20, passes=2, sets=3, plain=0.0)
    with Batches(recipe) as in_order:
        all_of_them = [in_order.batch(step).image[:, 0, 0].tolist() for step in range(recipe.steps)]
    with Batches(recipe) as late:
        assert late.batch(23).image[:, 0, 0].tolist() == all_of_them[23]
        assert late.batch(7).image[:, 0, 0].tolist() == all_of_them[7]  # going back is possible too
    for epoch in range(6):  # each set twice, in another order
        seen = [shade for batch in all_of_them[5 * epoch : 5 * epoch + 5] for shade in batch]
        first = all_of_them[0][0] - all_of_them[0][0] % 100
        assert sorted(seen) == [first + (epoch // 2) * 20 + n for n in range(20)]
    assert all_of_them[0:5] != all_of_them[5:10]


@pytest.mark.parametrize(("mirrored", "plain"), [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
def test_mirrored_and_plain_pairs(folder, mirrored, plain):
    recipe = tiny_recipe(folder)
    with Batches(replace(recipe, mirrored=0.0, plain=0.0)) as as_made:
        image, labels = as_made.batch(1)
    with Batches(replace(recipe, mirrored=mirrored, plain=plain)) as changed:
        other, other_labels = changed.batch(1)
    if mirrored:
        image, labels = image[:, :, ::-1], labels[:, :, ::-1]
    np.testing.assert_array_equal(other_labels, labels)
    np.testing.assert_array_equal(other, np.array([128, 255, 0])[labels] if plain else image)
    with Batches(replace(recipe, mirrored=0.5, plain=0.0)) as mixed:
        some = mixed.batch(1).image
    kept = [any((one == each).all() for each in (here, here[:, ::-1])) for one, here in zip(some, image, strict=True)]
    assert all(kept)


def test_pairs_are_made_from_the_keys_of_their_split(cheap_pairs):
    recipe = Recipe(batch=4, pairs=8, validation_pairs=8, run_seed=3)
    validation_set(recipe)
    with Batches(recipe) as batches_of_it:
        batches_of_it.batch(0)
    keys = [jax.random.key_data(split_key(3, split)).tolist() for split in ("validation", "train")]
    assert [key for _, _, key in cheap_pairs] == keys


def test_pairs_of_validation_are_no_pairs_of_training(folder):
    shown = validation_set(tiny_recipe(folder)).image
    with Batches(tiny_recipe(folder, mirrored=0.0, plain=0.0)) as from_folder:
        trained = np.concatenate([from_folder.batch(step).image for step in range(4)])
    assert not any((trained == image).all(axis=(1, 2)).any() for image in shown)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"batch": 0}, "batch: expected a whole number of 1 or more, got 0"),
        ({"run_seed": -1}, "run_seed: expected a whole number from 0 to 4294967295, got -1"),
        ({"largest_loss": float("nan")}, "largest_loss: expected a number above 0, got nan"),
        ({"pairs": 4}, "at least one batch of 8"),
        ({"discriminative": True}, "networks.head: expected `classes`"),
        ({"sets": 2}, "sets: expected 1 "),
        ({"mirrored": -0.1}, "mirrored: expected a share from 0 to 1, got -0.1"),
        ({"plain": 1.5}, "plain: expected a share from 0 to 1, got 1.5"),
        ({"plain": float("nan")}, "plain: expected a share"),
        ({"networks": GanConfig(width=0)}, "networks.width: expected a whole number of 1 or more, got 0"),
        ({"networks": GanConfig(decay_steps=-5)}, "networks.decay_steps: expected a whole number of 0 or more, got -5"),
        ({"networks": GanConfig(multipliers=(1, 2))}, "networks.multipliers: expected a tuple of 7 whole numbers"),
        ({"networks": GanConfig(learning_rate=-1.0)}, "networks.learning_rate: expected a finite number above 0"),
        ({"networks": GanConfig(distance=float("nan"))}, "networks.distance: expected a finite number of 0 or more"),
        ({"networks": GanConfig(ema_decay=2.0)}, "networks.ema_decay: expected a number from 0 to below 1, got 2.0"),
        ({"networks": GanConfig(class_weights=(0.0, 0.0, 0.0))}, "networks.class_weights: expected a tuple of 3 "),
        ({"networks": GanConfig(class_weights=(1.0, -1.0, 1.0))}, "networks.class_weights: expected a tuple of 3 "),
        (
            {"networks": GanConfig(cross_entropy=20.0)},
            "networks.head: expected `classes` for cross_entropy 20, got `tanh`",
        ),
    ],
)
def test_recipes_that_cannot_be_followed(tmp_path, changes, complaint):
    with pytest.raises(SonarjaxError, match=complaint):
        train(tiny_recipe(tmp_path, **changes), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_presets(tmp_path):
    assert set(PRESETS) == {"smoke", "cpu", "paper-cpu", "paper", "gpu", "further"}
    assert find_recipe("paper").pairs == 6780 and find_recipe("further").pair_settings.varied
    assert find_recipe("paper").epochs == 30 and find_recipe("paper").networks.width == 64
    for name, recipe in PRESETS.items():
        assert recipe.name == name and recipe.networks.beta1 == 0.5
        assert recipe.networks.learning_rate == (4e-4 if name == "gpu" else 2e-4)
        assert discriminative(recipe).checked().networks.head == "classes"
    with pytest.raises(SonarjaxError, match="smoke, cpu, paper-cpu, paper, gpu, further"):
        train("huge", tmp_path)


def test_step_size_falls_along_half_a_cosine():
    """Adam's first step of a constant gradient is the step size, whatever the gradient."""
    config = GanConfig(learning_rate=0.1, decay_steps=4)
    optimiser, value = config.optimiser(), jnp.zeros(())
    state, moved = optimiser.init(value), []
    for _ in range(5):
        update, state = optimiser.update(jnp.ones(()), state, value)
        moved.append(-float(update))
    np.testing.assert_allclose(moved, 0.05 * (1 + np.cos(np.pi * np.arange(5) / 4)), atol=1e-6)
    assert all(find_recipe(name).networks.decay_steps == find_recipe(name).steps for name in ("gpu", "further"))


def test_folder_must_be_there_and_hold_enough_before_the_run_begins(folder, tmp_path):
    with pytest.raises(SonarjaxError, match="expected 104 pairs or more, got 36"):
        train(tiny_recipe(folder, pairs=100), tmp_path / "run")
    with pytest.raises(SonarjaxError, match="nowhere"):
        train(tiny_recipe(tmp_path / "nowhere"), tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_discriminative_model_is_trained_on_labels(folder):
    """Only traced, not compiled: its step is tested beside the networks."""
    recipe = discriminative(tiny_recipe(folder))
    state = jax.eval_shape(lambda key: create_state(recipe.networks, key=key), jax.random.key(0))
    pairs = [jax.ShapeDtypeStruct((8, 128, 128), jnp.uint8)] * 2
    after, losses = jax.eval_shape(make_step(recipe, device_mesh(8)), state, *pairs, np.zeros(2, np.uint32))
    assert set(losses) == {"cross_entropy"}
    grey = jax.eval_shape(
        lambda weights, image: predict(recipe.networks, weights, image), after.weights(), jnp.zeros((2, 128, 128))
    )
    assert grey.shape == (2, 128, 128)
