"""The `Sonar` pytree: edges, shapes and what is static."""

import jax
import jax.numpy as jnp
import numpy as np

from sonarjax.sonar import FloorPatch, Sonar


def test_range_edges_span_the_window():
    sonar = Sonar.preset("didson-hf")
    assert sonar.range_edges.shape == (513,)
    np.testing.assert_allclose(sonar.range_edges[jnp.array([0, -1])], [1.5, 4.0], rtol=1e-6)
    np.testing.assert_allclose(np.diff(sonar.range_edges), 2.5 / 512, rtol=1e-3)  # float32 near 4 m


def test_azimuth_edges_lie_between_uneven_beams():
    sonar = Sonar.preset("aris-3000")
    assert sonar.azimuth_edges.shape == (129,)
    assert np.all(sonar.azimuth_edges[:-1] < sonar.azimuth)
    assert np.all(sonar.azimuth < sonar.azimuth_edges[1:])


def test_a_single_beam_is_as_wide_as_its_beam_width():
    sonar = Sonar.preset("didson-hf", azimuth=[0.1], beam_width=0.02)
    np.testing.assert_allclose(sonar.azimuth_edges, [0.09, 0.11], rtol=1e-5)


def test_stacked_sonars_have_edges_each():
    alone = [Sonar.preset("didson-hf", n_ranges=8, range_max=far) for far in (3.0, 3.5, 4.0)]
    single = [one.replace(azimuth=one.azimuth[:1], beam_width=one.range_max / 100) for one in alone]
    for sonars, beams in ((alone, 97), (single, 2)):
        batch = jax.tree.map(lambda *v: jnp.stack([jnp.asarray(one) for one in v]), *sonars)
        assert batch.azimuth_edges.shape == (3, beams) and batch.range_edges.shape == (3, 9)
        for k, one in enumerate(sonars):
            np.testing.assert_allclose(batch.azimuth_edges[k], one.azimuth_edges, rtol=1e-6)
            np.testing.assert_allclose(batch.range_edges[k], one.range_edges, rtol=1e-6)


def test_every_float_is_a_leaf_and_counts_are_static():
    sonar = Sonar.preset("didson-hf", floor=FloorPatch(2.0, 0.0, 1.0, 1.0))
    leaves = jax.tree.leaves(sonar)
    assert len(leaves) == 15 + 5
    assert 512 not in [leaf for leaf in leaves if isinstance(leaf, int)]
    rebuilt = jax.tree.map(lambda leaf: leaf, sonar)
    assert rebuilt.n_ranges == 512
    gradient = jax.grad(lambda s: s.range_edges.sum() + s.azimuth_edges.sum())(sonar)
    assert gradient.range_max != 0.0
    assert np.all(np.isfinite(gradient.azimuth))
