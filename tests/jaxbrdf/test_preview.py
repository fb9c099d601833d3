"""Pictures against the cosine law, brute-force integrals and colour-science; how different they look."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxbrdf as jb
from jaxbrdf import preview
from jaxbrdf.preview import Appearance, to_lab, to_srgb
from jaxbrdf.scene import Lamp, Scene, Surroundings

SIZE = 24
LIGHT = np.array([-0.48, 0.6, 0.64])


def sphere_normals(size=SIZE):
    """The normals (P, 3) of the pixels that show the sphere, row by row, and which pixels these are."""
    rows, columns = np.divmod(np.arange(size**2), size)
    x, y = (2 * columns + 1) / size - 1, 1 - (2 * rows + 1) / size
    inside = x**2 + y**2 < 1
    x, y = x[inside], y[inside]
    return np.stack([x, y, np.sqrt(1 - x**2 - y**2)], axis=-1), np.stack([rows, columns], axis=-1)[inside]


NORMALS, PIXELS = sphere_normals()


def one_lamp(irradiance=2.0):
    """The sphere under parallel light, in frames of its own: for surfaces that look alike from all sides."""

    def at(cos):
        return np.stack([np.sqrt(1 - cos**2), np.zeros_like(cos), cos], axis=-1)

    wi = at(NORMALS @ LIGHT)[:, None]
    return Scene(wi, at(NORMALS[:, 2]), np.full((len(NORMALS), 1), irradiance), PIXELS, (SIZE, SIZE))


def lit(scene):
    return np.asarray((scene.wi[..., 2] > 0).any(axis=1))


def metal(alpha_x, alpha_y, f0):
    return jb.Microfacet(jb.TrowbridgeReitz(alpha_x, alpha_y), jb.Constant(f0), jb.Uncorrelated())


def plastic(albedo, alpha, f0=0.05):
    return jb.Lambertian(albedo) + metal(alpha, alpha, f0)


@pytest.fixture(scope="module")
def scene():
    return jb.lit_sphere()


# Light


def test_a_diffuse_sphere_under_one_lamp_follows_the_cosine_law():
    albedo = np.array([0.2, 0.5, 0.8])
    expected = 2.0 / np.pi * np.maximum(NORMALS @ LIGHT, 0)[:, None] * albedo
    assert_allclose(jb.render(jb.Lambertian(albedo), one_lamp()), expected, rtol=1e-12)


def test_a_soft_lamp_alone_follows_it_too():
    """∫ e^{κ (w·l − 1)} w dω = 2π l (1/κ − 1/κ²), e^{−2κ} being nothing, where all is above the horizon."""
    kappa, nothing = 60.0, jnp.array(0.0)
    lamp, dark = (Lamp(jnp.asarray(LIGHT), jnp.array(a), jnp.array(kappa)) for a in (3.0, 0.0))
    scene = jb.lit_sphere(SIZE, Surroundings(nothing, nothing, (lamp, dark, dark)))
    cos = NORMALS @ LIGHT
    expected = 3 * 2 * (1 / kappa - 1 / kappa**2) * cos[cos > 0.5]
    found = jb.render(jb.Lambertian(1.0), scene)[cos > 0.5, 0]
    assert_allclose(found, expected, rtol=5e-2)
    assert_allclose(np.mean(found), np.mean(expected), rtol=1e-2)


def radiance(w):
    """The studio, written down once more."""
    lamps = [
        (np.array([-0.55, 0.55, 0.63]), 30, 80),
        (np.array([0.75, 0.25, -0.6]), 40, 80),
        (np.array([0.6, -0.1, 0.8]), 5, 40),
    ]
    sky = 0.12 + 0.48 / (1 + np.exp(-8 * w[:, 1]))
    return sky + sum(a * np.exp(kappa * (w @ l / np.linalg.norm(l) - 1)) for l, a, kappa in lamps)


def test_each_point_gathers_the_light_of_all_directions(scene):
    """Σ f L cos θ_i dω by brute force, 160,000 directions each; the channels are cloth and two metals."""
    brdf = plastic([1.0, 0.0, 0.0], np.array([0.3, 0.05, 0.3]), [0.0, 0.6, 0.6])
    c, phi = np.meshgrid((np.arange(400) + 0.5) / 200 - 1, (np.arange(400) + 0.5) * np.pi / 200)
    sin = np.sqrt(1 - c**2)
    w = np.stack([sin * np.cos(phi), c, sin * np.sin(phi)], axis=-1).reshape(-1, 3)
    points = np.array([3, 100, 245, 390])
    n = NORMALS[points]
    s = np.stack([n[:, 2], 0 * n[:, 0], -n[:, 0]], axis=-1) / np.hypot(n[:, 0], n[:, 2])[:, None]
    frames = np.stack([s, np.cross(n, s), n], axis=-1)
    flux = np.broadcast_to(radiance(w) * 4 * np.pi / len(w), (4, len(w)))
    brute = Scene(w @ frames, np.array([0.0, 0, 1]) @ frames, flux, PIXELS[points], (SIZE, SIZE))
    found = jb.render(brdf, scene)[points]
    assert_allclose(found, jb.render(brdf, brute), rtol=4e-2)


def test_frames_turn_along_circles_of_latitude(scene):
    """s ∝ up × n and t = n × s: the viewer is at (−n_x, −n_y n_z) / ρ, n_z with ρ = √(n_x² + n_z²)."""
    x, y, z = NORMALS.T
    rho = np.hypot(x, z)
    expected = np.stack([-x / rho, -y * z / rho, z], axis=-1)
    assert_allclose(scene.wo, expected, atol=1e-12)


def test_a_surface_is_any_picture_of_normals():
    x = np.linspace(-0.9, 0.9, len(NORMALS) // 2)
    normals = np.zeros((2, len(x) + 1, 3))
    normals[:, :-1] = np.stack([x, 0 * x, np.sqrt(1 - x**2)], axis=-1)
    cylinder = jb.lit_surface(normals)
    light = jb.render(jb.Lambertian(1.0), cylinder)
    picture = preview.image(light, cylinder, background=7.0)
    assert picture.shape == normals.shape
    assert_array_equal(picture[:, -1], 7)
    assert_allclose(picture[0], picture[1], rtol=1e-12)
    assert_array_equal(picture[:, :-1].reshape(-1, 3), light)
    assert_array_equal(preview.image(light[:, 0], cylinder)[:, :-1], picture[:, :-1, 0])
    with pytest.raises(ValueError, match="normals must hold unit vectors"):
        jb.lit_surface(2 * normals)


def test_grooves_look_different_along_and_across(scene):
    along, across = metal(0.1, 0.4, 0.6), metal(0.4, 0.1, 0.6)
    assert jb.lab_difference(along, across, scene) > 3


# Colours


COLOURS = np.array(
    [[1, 1, 1], [0, 0, 0], [0.18, 0.18, 0.18], [0.9, 0.1, 0.02], [1e-4, 2e-3, 1e-3], [0.02, 0.3, 0.9]], float
)


def colour_lab(rgb):
    with np.printoptions():
        import colour
    matrix = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    return colour.XYZ_to_Lab(rgb @ matrix.T, colour.XYZ_to_xy(matrix.sum(axis=1)))


def test_lab_is_that_of_colour_science():
    assert_allclose(to_lab(jnp.asarray(COLOURS)), colour_lab(COLOURS), atol=1e-9)
    assert_allclose(to_lab(jnp.ones(3)), [100, 0, 0], atol=1e-12)


def test_lab_has_its_gradient_even_at_black_and_outside_the_gamut():
    """Against central differences of colour-science, and of itself where a component is negative."""
    outside = np.array([[-0.2, 0.1, 0.3], [-0.1, -0.1, -0.1]])
    h = 1e-6
    found = jax.jit(jax.vmap(jax.jacfwd(to_lab)))(jnp.asarray(np.concatenate([COLOURS, outside])))
    for i, step in enumerate(h * np.eye(3)):
        inside = (colour_lab(COLOURS + step) - colour_lab(COLOURS - step)) / (2 * h)
        beyond = (to_lab(jnp.asarray(outside + step)) - to_lab(jnp.asarray(outside - step))) / (2 * h)
        assert_allclose(found[..., i], np.concatenate([inside, beyond]), rtol=1e-5, atol=1e-5)
    assert_allclose(to_lab(jnp.full(3, -0.1)), [-0.1 * 116 / 3 * (29 / 6) ** 2, 0, 0], atol=1e-12)


def test_display_encoding_is_that_of_colour_science():
    with np.printoptions():
        import colour
    assert_allclose(to_srgb(jnp.asarray(COLOURS)), colour.cctf_encoding(COLOURS, "sRGB"), atol=1e-7)
    assert_allclose(to_srgb(jnp.array([-1.0, 2.0])), [0, 1], atol=1e-12)
    assert np.all(np.isfinite(jax.grad(lambda x: to_srgb(x).sum())(jnp.zeros(3))))


def test_a_grey_reflectance_makes_grey(scene):
    grey, rgb = (jb.render(jb.Lambertian(albedo), scene) for albedo in (0.5, [0.2, 0.5, 0.7]))
    single = jb.render(jb.Lambertian([0.5]), scene)
    assert grey.shape == rgb.shape == single.shape == (len(NORMALS), 3)
    for channel in (grey[:, 0], grey[:, 2], rgb[:, 1], single[:, 1]):
        assert_allclose(channel, grey[:, 1], rtol=1e-12)


@pytest.mark.parametrize("channels", [2, 4])
def test_other_numbers_of_channels_are_refused(scene, channels):
    with pytest.raises(ValueError, match=rf"R, G and B; found {channels} channels.*to_rgb"):
        jb.render(jb.Lambertian(np.full(channels, 0.5)), scene)


def test_wavelengths_are_no_colours(scene):
    grid = jb.merl_grid()
    spectrum = jb.MeasuredBRDF(
        np.ones((*grid.shape, 3), np.float32), np.ones(3), grid, wavelengths=np.array([0.4, 0.5, 0.6])
    )
    with pytest.raises(ValueError, match="wavelengths: make colours"):
        jb.render(spectrum, scene)


# Differences


def test_exposure_brings_nine_points_of_ten_to_four_fifths():
    scene = one_lamp()
    appearance = Appearance.of(jb.Lambertian([0.1, 0.05, 0.02]), scene)
    exposed = appearance.exposure * appearance.picture[lit(scene), 0]
    assert_allclose(np.quantile(exposed, 0.9), 0.8, rtol=1e-12)


def expected_difference(factor):
    """Of a grey diffuse sphere from one `factor` times as bright, by the cosine law."""
    cos = (NORMALS @ LIGHT)[NORMALS @ LIGHT > 0]
    Y = 0.8 * cos / np.quantile(cos, 0.9)
    L = [colour_lab(np.minimum(y, 1)[:, None] * np.ones(3))[:, 0] for y in (Y, factor * Y)]
    return np.mean(np.abs(L[0] - L[1]))


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_difference_of_brightness_alone(factor):
    found = jb.lab_difference(factor * jb.Lambertian(0.3), 1.0 * jb.Lambertian(0.3), one_lamp())
    assert_allclose(found, expected_difference(factor), atol=1e-9)


def test_difference_of_mid_grey_from_its_double():
    """One flat tone: 0.4 of white, half of what 0.8 is, so ΔL = 116 (0.8^⅓ − 0.4^⅓)."""
    plate = jb.lit_surface(np.tile([0.0, 0.0, 1.0], (16, 28, 1)))
    found = jb.lab_difference(0.5 * jb.Lambertian(0.4), 1.0 * jb.Lambertian(0.4), plate)
    assert_allclose(found, 116 * (np.cbrt(0.8) - np.cbrt(0.4)), rtol=1e-9)


class Holed(jb.AbstractBRDF):
    """A reflectance without a value where the light is on one side; `name` is for show."""

    brdf: jb.AbstractBRDF
    name: str = eqx.field(static=True, default="")
    traced = []  # noqa: RUF012

    @property
    def anonymous(self):
        return Holed(self.brdf)

    def _reflectance(self, wi, wo):
        self.traced.append(self.name)
        return jnp.where(wi[..., 0] > 0.2, jnp.nan, self.brdf._reflectance(wi, wo))


def pictures(f, rho, scene):
    """Those of a measurement f and a model ρ (P, L, C) at the pairs where f is known, and where some are."""
    known = np.isfinite(f).all(axis=-1)
    weight = np.where(known & (scene.wi[..., 2] > 0), scene.wi[..., 2] * scene.flux, 0)
    assert 0.05 < known.mean() < 0.95
    m, r = (np.einsum("pl,plc->pc", weight, np.nan_to_num(a)) for a in (f, rho))
    return m, r, (weight > 0).any(axis=1)


def test_cells_without_a_sample_are_in_neither_picture(scene):
    """A table in which a block of cells was not measured, at grazing angles only in green."""
    edges = [np.linspace(0, upper, n + 1) for n, upper in ((12, np.pi / 2), (12, np.pi / 2), (8, np.pi))]
    centres = [(e[1:] + e[:-1]) / 2 for e in edges]
    raw = 0.1 + np.random.default_rng(0).uniform(size=(12, 12, 8, 3))
    raw[3:7, 2:6] = -1
    raw[:, 9:, :, 1] = -1
    measured = jb.MeasuredBRDF(raw, np.array([0.3, 0.2, 0.1]), jb.HalfDifferenceGrid(*centres, *edges))
    albedo = np.array([0.3, 0.25, 0.1])
    f = np.asarray(jax.jit(lambda wi, wo: measured(wi, wo))(scene.wi, scene.wo[:, None]))
    m, r, known = pictures(f, np.broadcast_to(albedo / np.pi, f.shape), scene)
    exposure = 0.8 / np.quantile(m.max(axis=1)[known], 0.9)
    lab = [colour_lab(np.minimum(exposure * a, 1)) for a in (m, r)]
    appearance = Appearance.of(measured, scene)
    assert_allclose(appearance.picture, m, rtol=1e-9)
    expected = np.linalg.norm(lab[0] - lab[1], axis=-1)[known].mean()
    assert_allclose(appearance.difference(jb.Lambertian(albedo)), expected, rtol=1e-9)


def test_holes_are_dark_in_a_picture_and_forgotten_in_a_difference(scene):
    whole, brdf = jb.Lambertian(0.3), Holed(jb.Lambertian(0.3))
    f = np.where(scene.wi[..., :1] > 0.2, np.nan, 0.3 / np.pi)
    m, *_ = pictures(f, np.nan_to_num(f), scene)
    assert_allclose(jb.render(brdf, scene), np.tile(m, 3), rtol=1e-9)
    appearance = Appearance.of(brdf, scene)
    assert_allclose([appearance.difference(brdf), appearance.difference(whole)], 0, atol=1e-9)
    assert np.isnan(jb.lab_difference(brdf, whole, scene))


def test_names_compile_nothing_anew(scene):
    Holed.traced.clear()
    for name in ("one", "other"):
        brdf = Holed(jb.Lambertian(0.3), name)
        Appearance.of(brdf, scene).difference(brdf)
    assert len(Holed.traced) <= 2
    assert not any(Holed.traced)


def test_points_without_a_sample_are_left_out():
    """Half the points have no value: the mean is over the others, and NaN where there are none."""
    scene = one_lamp()
    whole = Appearance.of(jb.Lambertian(0.3), scene)
    model = jb.Lambertian(0.2)
    differences = [
        Appearance(scene, whole.used & some[:, None], whole.picture, whole.exposure).difference(model)
        for some in (PIXELS[:, 0] < 9, PIXELS[:, 0] >= 9, PIXELS[:, 0] < 0)
    ]
    counts = [np.sum(lit(scene) & some) for some in (PIXELS[:, 0] < 9, PIXELS[:, 0] >= 9)]
    assert_allclose(np.average(differences[:2], weights=counts), whole.difference(model), rtol=1e-12)
    assert np.isnan(differences[2])


MODELS = [(0.4, 0.3, 0.05), (0.0, 0.2, 0.0), (0.9, 0.02, 0.5), (0.3, 1.0, 0.02), (0.3, 0.25, 0.04)]


@jax.jit
@partial(jax.vmap, in_axes=(0, None))
def differences(p, appearance):
    """The difference of each model and its gradient by albedo, roughness and f0."""
    return jax.value_and_grad(lambda p: appearance.difference(plastic(p[0], p[1], p[2])))(p)


def test_gradients_are_those_of_finite_differences(scene):
    """The second model is black, the last is the measurement, where the difference has a kink."""
    appearance = Appearance.of(plastic(0.3, 0.25, 0.04), scene)
    p, h = jnp.array(MODELS), 1e-6
    _, gradient = differences(p, appearance)
    ends = [
        [differences(p + sign * step, appearance)[0] for sign in (1, -1)] for step in h * np.eye(3)[:, None]
    ]
    numeric = np.stack([(above - below) / (2 * h) for above, below in ends], axis=-1)
    assert np.all(np.isfinite(gradient))
    assert_allclose(gradient[:-1], numeric[:-1], rtol=1e-4, atol=1e-4)


def test_a_black_measurement_has_an_exposure_too(scene):
    appearance = Appearance.of(plastic(0.0, 0.2, 0.0), scene)
    assert appearance.exposure == 1
    difference, gradient = differences(jnp.array(MODELS), appearance)
    assert difference[1] == 0
    assert np.all(np.delete(difference, 1) > 1)
    assert np.all(np.isfinite(gradient))


def test_a_batch_of_models_by_vmap(scene):
    models = eqx.filter_vmap(lambda a: plastic(a * jnp.ones(3), 0.3))(jnp.linspace(0.1, 0.5, 5))
    appearance = Appearance.of(plastic([0.3, 0.3, 0.3], 0.3), scene)
    found = jax.vmap(appearance.difference)(models)
    assert_allclose(found[0], appearance.difference(jax.tree.map(lambda leaf: leaf[0], models)), rtol=1e-10)
    assert found.shape == (5,)
    assert_allclose(found[2], 0, atol=1e-6)
    assert np.all(np.diff(found[:3]) < 0)
    assert np.all(np.diff(found[2:]) > 0)


def test_the_standard_scene_is_cheap_and_reaches_grazing_views(scene):
    assert 50_000 < scene.flux.size < 150_000
    assert np.min(scene.wo[:, 2]) < 0.2
    assert np.all(np.isfinite(scene.flux))
    assert np.all(scene.flux >= 0)
