"""Maps of distributions: images of what was fitted to patches, and textures that vary as they do."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbrdf as jb
from fitting import fit_ndf_patches

ANY = jb.Ellipsoid(*(jnp.array(value) for value in (0.2, 0.2, 0.0, 0.0, 0.0)))


@pytest.fixture(scope="module")
def patches():
    """Of a surface that is rougher in the middle, with a corner that was not measured."""
    surface = jb.gaussian_surface(jax.random.key(3), (96, 160), 0.5, 0.2, (6.0, 2.0))
    z = surface.z * (0.4 + jnp.sin(jnp.linspace(0, np.pi, 160)))[None, :]
    mask = np.ones(z.shape, bool)
    mask[:20, :20] = False
    return jb.patch_ndfs(jb.Heightfield(z, 0.5, 0.5, mask), 10.0, (5.0, 8.0), cells=33)


@pytest.fixture(scope="module")
def result(patches):
    return fit_ndf_patches(ANY, patches, loss="likelihood")


@pytest.fixture(scope="module")
def measured(patches, result):
    return jb.ndf_map(patches, result, "made up")


def test_images_are_those_of_the_patches(patches, result, measured):
    assert measured.shape == patches.shape
    assert measured.names == ("alpha_x", "alpha_y", "theta_x", "theta_y", "theta_z")
    assert (measured.step, measured.size, measured.name) == (patches.stride, patches.size, "made up")
    rows, columns = patches.shape
    for i, j in ((0, 0), (rows - 1, columns - 2)):
        k = i * columns + j
        np.testing.assert_array_equal(measured.ndf.alpha_x[i, j], result.model.alpha_x[k])
        assert measured.status[i, j] == result.status[k]
        assert measured.counts[i, j] == patches.counts[k]
        assert measured.success[i, j] == result.success[k]
    assert not measured.success[0, 0]
    assert measured.success[3:, 5:].all()


def test_one_map_of_many_shapes_is_refused():
    images = [jnp.ones((3, 4))] * 4
    with pytest.raises(ValueError, match=r"one shape.*\(3, 4\), \(3, 5\)"):
        jb.NDFMap(jb.Ellipsoid(*images, jnp.ones((3, 5))), (1.0, 1.0))
    with pytest.raises(ValueError, match="ndf_map"):
        jb.NDFMap(ANY, (1.0, 1.0))


def test_a_texture_varies_as_its_exemplar(measured):
    """Mean and spread of every parameter, of α in logarithms; patches that were not fitted do not count."""
    texture = jb.ndf_texture(jax.random.key(0), measured, (64, 96))
    assert texture.shape == (64, 96)
    assert texture.step == measured.step
    assert texture.success.all()
    for name in measured.names:
        of_both = [np.asarray(getattr(item.ndf, name))[item.success] for item in (measured, texture)]
        if name.startswith("alpha"):
            assert np.min(of_both[1]) > 0
            of_both = [np.log(values) for values in of_both]
        np.testing.assert_allclose(np.mean(of_both[1]), np.mean(of_both[0]), atol=1e-10)
        np.testing.assert_allclose(np.std(of_both[1]), np.std(of_both[0]), rtol=1e-8)


def test_options_reach_the_synthesis(measured):
    key = jax.random.key(1)
    texture = jb.ndf_texture(key, measured, (40, 40), marginals=True)
    known = np.asarray(measured.ndf.alpha_x)[measured.success]
    assert known.min() * (1 - 1e-9) <= texture.ndf.alpha_x.min()
    assert texture.ndf.alpha_x.max() <= known.max() * (1 + 1e-9)
    again = jb.ndf_texture(key, measured, (40, 40), marginals=True)
    np.testing.assert_array_equal(texture.ndf.theta_x, again.ndf.theta_x)


def test_strips_in_pieces_are_one_strip(measured):
    """Two maps of a row each, and one of a column."""
    first, second = (jax.tree.map(lambda leaf, i=i: leaf[i : i + 1, 4:], measured.ndf) for i in (3, 4))
    column = jax.tree.map(lambda leaf: leaf[2:, 6:7], measured.ndf)
    along, across = [jb.NDFMap(row, (5.0, 8.0)) for row in (first, second)], [jb.NDFMap(column, (5.0, 8.0))]
    joined = jax.tree.map(lambda *leaves: jnp.concatenate(leaves, axis=1), first, second)
    key = jax.random.key(2)
    pieces = jb.ndf_texture_of_strips(key, along, across, (30, 50))
    whole = jb.ndf_texture_of_strips(key, [jb.NDFMap(joined, (5.0, 8.0))], across, (30, 50))
    for a, b in zip(jax.tree.leaves(pieces), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(a, b)
    strips = [np.stack(jax.tree.leaves(ndf), axis=-1).reshape(-1, 5) for ndf in (joined, column)]
    logs = [np.concatenate([np.log(strip[:, :2]), strip[:, 2:]], axis=1) for strip in strips]
    plain = jb.synthesize_texture(key, *logs, (30, 50))
    np.testing.assert_allclose(pieces.ndf.alpha_y, np.exp(plain[..., 1]), rtol=1e-12)
    np.testing.assert_allclose(pieces.ndf.theta_z, plain[..., 4], rtol=1e-12)


def test_maps_are_named_by_the_orientation_of_all():
    """One map brushed along y, a larger one along x: both are named like the larger one."""
    turn = np.array([[1.2]]), np.full((2, 3), 0.1)
    maps = [
        jb.NDFMap(
            jb.Ellipsoid(*(jnp.full(t.shape, v) for v in (0.05, 0.3, 0.0, 0.0)), jnp.asarray(t)), (1.0, 1.0)
        )
        for t in turn
    ]
    small, large = jb.aligned_maps(maps)
    np.testing.assert_allclose(large.ndf.theta_z, 0.1, atol=1e-12)
    np.testing.assert_allclose(small.ndf.theta_z, 1.2 - np.pi / 2, atol=1e-12)
    np.testing.assert_allclose([small.ndf.alpha_x[0, 0], small.ndf.alpha_y[0, 0]], [0.3, 0.05])
    other = jb.NDFMap(jb.Beckmann(jnp.ones((1, 1))), (1.0, 1.0))
    assert jb.aligned_maps([other])[0] is other


def test_a_texture_is_a_surface_to_be_lit(measured):
    texture = jb.ndf_texture(jax.random.key(4), measured, (16, 24))
    surface = jb.SpatiallyVaryingBRDF(jb.Microfacet(texture.ndf, jb.Constant(1.0), jb.Uncorrelated()))
    wi, wo = jb.spherical(0.4, 0.3), jb.spherical(0.2, -1.0)
    ellipsoid = jax.tree.map(lambda leaf: leaf[5, 7], texture.ndf)
    expected = jb.Microfacet(ellipsoid, jb.Constant(1.0), jb.Uncorrelated())(wi, wo)
    np.testing.assert_allclose(surface(7.5 / 24, 5.5 / 16, wi, wo), expected, rtol=1e-12)
