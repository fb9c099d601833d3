"""The references themselves: normalised, the same in every frame and by every formula; no library here."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests import references

DENSITIES = {
    "SGD": references.sgd(0.2, 1.8),
    "Beckmann": references.beckmann(0.05, 0.5),
    "Trowbridge–Reitz": references.trowbridge_reitz(0.05, 0.5),
    "ellipsoid": references.ellipsoid(0.1, 0.5, 0.3, 0.2, 0.7),
    "Student-t": references.student_t(0.3, 2.5),
    "Phong": references.blinn_phong(30.0),
    "anisotropic Phong": references.anisotropic_phong(5.0, 500.0),
    "exponential": references.exponential(0.3),
    "Gaussian": references.gaussian_microfacets(0.05, 0.5),
    "cylinder": references.gaussian_cylinder(0.3),
    "grooves": references.v_grooves(0.7, 0.1),
    "velvet": references.velvet(0.5),
    "slanted velvet": references.slanted_velvet(0.7, 0.5),
}
every_density = pytest.mark.parametrize(
    ("name", "density"), DENSITIES.items(), ids=[n.replace(" ", "-") for n in DENSITIES]
)
W = references.direction(np.array([0.2, 1.2, 1.55, 2.0]), np.array([1.0, -0.4, np.pi / 2, 0.3]))


@every_density
def test_normalised(name, density):
    """∫ D (m·n) dm = 1, signed, by two quadratures: ½ for slanted velvet, whose other half are the tops."""
    expected = 0.5 if name == "slanted velvet" else 1
    m, solid_angle = references.sphere_nodes(density)
    assert_allclose(np.sum(density(m) * m[..., 2] * solid_angle), expected, rtol=1e-9)
    assert_allclose(references.facing_normal(density)[2], expected, rtol=1e-8)


@every_density
def test_brute_force_has_converged(name, density):
    """More panels and finer ones give the same."""
    finer = references.Facets(
        tuple(
            replace(p, panels=40 if p.panels > 1 else 1, levels=p.levels + 4)
            for p in references.pieces(density)
        )
    )
    for w in W:
        assert_allclose(
            references.facing_normal(density, w), references.facing_normal(finer, w), rtol=1e-8, atol=1e-9
        )


@pytest.mark.parametrize("name", ["Beckmann", "Gaussian", "SGD"])
def test_brute_force_does_not_hang_on_the_frame(name):
    """In a frame that fits nothing, turned and stretched, the same comes out of the whole sphere."""
    density = DENSITIES[name]
    (piece,) = references.pieces(density)
    odd = piece.shape @ references.rotation("y", 0.3) @ references.rotation("z", 0.2)
    other = references.Piece(density, odd, whole=True, panels=60, levels=14)
    for w in W:
        assert_allclose(
            references.projected_area(other, w), references.projected_area(density, w), rtol=2e-4, atol=1e-9
        )


def test_projected_areas_that_have_a_name():
    ellipsoid = (0.1, 0.5, 0.3, 0.2, 0.7)
    for w in W[:3]:
        for form in ("beckmann", "trowbridge_reitz"):
            brute = references.projected_area(getattr(references, form)(0.05, 0.5), w)
            assert_allclose(brute, w[2] * (1 + references.smith_lambda(form, 0.05, 0.5, w)), rtol=1e-8)
    for w in W:
        brute = references.projected_area(references.ellipsoid(*ellipsoid), w)
        assert_allclose(
            brute, references.ellipsoid_area(references.ellipsoid_matrix(*ellipsoid), w), rtol=1e-10
        )


def test_the_shares_of_satin():
    """Ashikhmin 2000, section 6.3: of areas 0.7 and 0.3. ⟨h·n⟩ of a cylinder is π/4 ⟨cos a⟩, tan a = t_x."""

    def mean_cosine(sigma):
        def weight(a):
            return mpmath.exp(-((mpmath.tan(a) / sigma) ** 2))

        ends = [-1.5, -0.5, 0, 0.5, 1.5]
        return mpmath.quad(lambda a: mpmath.cos(a) * weight(a), ends) / mpmath.quad(weight, ends)

    flats, ends = 0.7 * mean_cosine(0.1), 0.3 * mean_cosine(0.3)
    shares = references.mixture_shares([0.7, 0.3], [(0.1, np.inf), (0.3, np.inf)])
    assert_allclose(shares, [float(flats / (flats + ends)), float(ends / (flats + ends))], rtol=1e-9)
    assert_allclose(shares, [0.7036, 0.2964], atol=1e-4)
