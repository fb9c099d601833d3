"""What is refused, and how: a ValueError that names the parameter, what was expected and what was found."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbrdf as jb

UP = np.array([0.0, 0.0, 1.0])
POSITIVE = {  # valid values of every parameter that must be positive, with what else the distribution needs
    jb.Beckmann: {"alpha_x": 0.3, "alpha_y": 0.2},
    jb.TrowbridgeReitz: {"alpha_x": 0.3, "alpha_y": 0.2},
    jb.Ellipsoid: {"alpha_x": 0.3, "alpha_y": 0.2},
    jb.StudentT: {"alpha": 0.3},
    jb.Exponential: {"alpha": 0.3},
    jb.ShiftedGamma: {"alpha": 0.3},
    jb.GaussianMicrofacets: {"sigma_x": 0.3, "sigma_y": 0.2},
    jb.GaussianCylinder: {"sigma": 0.3},
    jb.VGrooves: {"sigma": 0.3},
    jb.Velvet: {"sigma": 0.3},
    jb.SlantedVelvet: {"sigma": 0.3},
}
OTHERS = {
    jb.Ellipsoid: {"theta_x": 0.1, "theta_y": 0.0, "theta_z": 0.0},
    jb.StudentT: {"gamma": 2.5},
    jb.ShiftedGamma: {"p": 0.5},
    jb.VGrooves: {"angle": 0.5},
    jb.SlantedVelvet: {"slant": 0.5},
}
ROUGHNESSES = [
    (make, {**good, **OTHERS.get(make, {})}, name, bad)
    for make, good in POSITIVE.items()
    for name in good
    for bad in (0.0, -0.1)
]
PARAMETERS = [
    *ROUGHNESSES,
    (jb.StudentT, {"alpha": 0.3}, "gamma", 1.0),
    (jb.StudentT, {"alpha": 0.3}, "gamma", 0.5),
    (jb.ShiftedGamma, {"alpha": 0.3}, "p", -0.1),
    (jb.ShiftedGamma, {"alpha": 0.3}, "p", 51.0),
    (jb.BlinnPhong, {}, "exponent", -1.0),
    (jb.AnisotropicPhong, {"exponent_y": 1.0}, "exponent_x", -1.0),
    (jb.AnisotropicPhong, {"exponent_x": 1.0}, "exponent_y", -1.0),
    (jb.VGrooves, {"sigma": 0.3}, "angle", -0.1),
    (jb.VGrooves, {"sigma": 0.3}, "angle", np.pi / 2),
    (jb.SlantedVelvet, {"sigma": 0.3}, "slant", np.pi / 2),
]
every_parameter = pytest.mark.parametrize(
    ("make", "good", "name", "bad"),
    PARAMETERS,
    ids=[f"{make.__name__}-{name}-{bad:g}" for make, _, name, bad in PARAMETERS],
)


@every_parameter
def test_a_parameter_outside_its_domain(make, good, name, bad):
    with pytest.raises(ValueError, match=rf"{make.__name__}: {name} must be .*; found {bad:.3g}"):
        make(**{**good, name: bad})


@every_parameter
def test_one_bad_channel_is_enough(make, good, name, bad):
    with pytest.raises(ValueError, match=rf"{name} must be .*; found \["):
        make(**{**good, name: jnp.array([good.get(name, 1.4), bad])})


def test_inside_jit_no_parameter_is_refused():
    """There the values are not at hand; what comes out is a number or NaN, as the formula has it."""
    for make, good, name, bad in PARAMETERS:
        value = jax.jit(lambda x: make(**{**good, name: x})(UP))(bad)  # noqa: B023 (called at once)
        assert value.shape == ()


NDFS = {
    "Beckmann": jb.Beckmann(0.3),
    "Student-t": jb.StudentT(0.3, 3.0),
    "table": jb.TabulatedNDF(np.ones((5, 5))),
    "mixture": jb.mixture(jnp.array([0.5, 0.5]), [jb.Beckmann(0.3), jb.BlinnPhong(3.0)]),
}
DIRECTIONS = {
    "of length 2": ([0.0, 0.0, 2.0], r"{} must hold unit vectors; found one of length 2"),
    "NaN": ([0.0, np.nan, 1.0], r"{} must hold unit vectors; found one of length nan"),
    "of two components": ([0.0, 1.0], r"{} must hold directions .* shape \(..., 3\); found \(2,\)"),
    "of no axis": (1.0, r"{} must hold directions .* shape \(..., 3\); found \(\)"),
    "lying": (np.ones((3, 2)), r"{} must hold directions .* shape \(..., 3\); found \(3, 2\)"),
    "one of many": (
        [[0.0, 0.0, 1.0], [0.1, 0.0, 1.0]],
        r"{} must hold unit vectors; found one of length 1.00499",
    ),
}


@pytest.mark.parametrize("ndf", NDFS.values(), ids=NDFS)
@pytest.mark.parametrize(("w", "message"), DIRECTIONS.values(), ids=DIRECTIONS)
def test_what_is_no_direction(ndf, w, message):
    w = np.array(w)
    with pytest.raises(ValueError, match=message.format("m")):
        ndf(w)
    with pytest.raises(ValueError, match=message.format("w")):
        ndf.projected_area(w)
    if hasattr(ndf, "sample_visible"):
        with pytest.raises(ValueError, match=message.format("w")):
            ndf.sample_visible(np.full(2, 0.5), w)


@pytest.mark.parametrize("ndf", NDFS.values(), ids=NDFS)
@pytest.mark.parametrize("u", [0.5, np.full(3, 0.5), np.full((2, 1), 0.5)], ids=["scalar", "three", "column"])
def test_what_is_no_pair_of_random_numbers(ndf, u):
    message = r"u must hold points .* shape \(..., 2\); found \("
    with pytest.raises(ValueError, match=message):
        ndf.sample(u)
    if hasattr(ndf, "sample_visible"):
        with pytest.raises(ValueError, match=message):
            ndf.sample_visible(u, UP)


def test_inside_jit_lengths_are_not_looked_at_but_shapes_are():
    ndf = jb.Beckmann(0.3)
    evaluate = jax.jit(lambda m: ndf(m))
    assert np.isfinite(evaluate(jnp.array([0.0, 0.0, 2.0])))
    assert np.isnan(evaluate(jnp.array([0.0, np.nan, 1.0])))
    with pytest.raises(ValueError, match=r"found \(2,\)"):
        evaluate(jnp.zeros(2))


def test_a_parameter_that_a_failed_fit_left_as_nan_gives_nan():
    assert np.isnan(jb.Beckmann(np.nan)(UP))
    assert np.isnan(jb.TrowbridgeReitz(np.nan).projected_area(np.array([0.6, 0.0, 0.8])))


PARTS = [jb.Beckmann(0.3), jb.BlinnPhong(3.0)]


@pytest.mark.parametrize(
    ("weights", "ndfs", "message"),
    [
        ([0.5, -0.5], PARTS, r"weights .* at least 0.*found \[ 0.5 -0.5\]"),
        ([0.0, 0.0], PARTS, r"weights .* one above; found \[0. 0.\]"),
        ([1.0], PARTS, r"one weight for each distribution; found weights of shape \(1,\) and 2 dist"),
        ([0.2, 0.3, 0.5], PARTS, r"one weight for each distribution; found weights of shape \(3,\) and 2"),
        (1.0, PARTS, r"one weight for each distribution; found weights of shape \(\) and 2"),
        ([], [], r"one weight for each distribution; found weights of shape \(0,\) and 0"),
        ([np.nan, 1.0], PARTS, r"weights .* at least 0.*found \[nan"),
    ],
    ids=["negative", "all zero", "too few", "too many", "no axis", "none", "NaN"],
)
def test_weights_that_make_no_mixture(weights, ndfs, message):
    with pytest.raises(ValueError, match=message):
        jb.mixture(jnp.array(weights), ndfs)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.ones((4, 5)), r"image must have shape \(N, N\) or \(N, N, C\); found \(4, 5\)"),
        (np.ones(4), r"image must have shape \(N, N\) or \(N, N, C\); found \(4,\)"),
        (np.ones((2, 4, 4)), r"image must have shape \(N, N\) or \(N, N, C\); found \(2, 4, 4\)"),
        (np.eye(4) - 0.5, r"image must be at least 0; found"),
        (np.zeros((4, 4)), r"image must not be black; found no value greater than 0"),
    ],
    ids=["oblong", "one axis", "channels first", "negative", "black"],
)
def test_images_that_modulate_nothing(image, message):
    with pytest.raises(ValueError, match=message):
        jb.Modulated(jb.Beckmann(0.3), image)


@pytest.mark.parametrize("values", [np.ones((4, 5)), np.ones(4)], ids=["oblong", "one axis"])
def test_a_table_that_is_not_square(values):
    with pytest.raises(ValueError, match=rf"values must have shape .*; found \({len(values)},"):
        jb.TabulatedNDF(values)


@pytest.mark.parametrize("nodes", [(4, 20), (10, 3), (0, 0)])
def test_too_few_nodes_for_a_table_of_the_projected_area(nodes):
    with pytest.raises(ValueError, match="nodes"):
        jb.tabulate_projected_area(jb.Beckmann(0.3, 0.2), nodes)
