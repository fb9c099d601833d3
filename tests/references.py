r"""Independent truths: what the tests compare the library with. Nothing here imports jaxbrdf or JAX.

mpmath where a function has a name, plain numpy quadrature where it has none. Directions are (..., 3),
angles in radians. A *density* is a numpy function from directions (..., 3) to D (...), 1/sr.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise

import mpmath
import numpy as np
from scipy.stats import chi2

Density = Callable[[np.ndarray], np.ndarray]
PUBLISHED_LOBES = [(1e-5, 0.5), (0.0148, 0.459), (0.05, 1.0), (0.2, 1.8), (0.9, 0.1), (1.0, 0.0), (1.0, 2.0)]


def direction(theta, phi) -> np.ndarray:
    theta, phi = np.broadcast_arrays(theta, phi)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def rotation(axis: str, angle: float) -> np.ndarray:
    """The active right-handed rotation R_x(t), R_y(t) or R_z(t)."""
    c, s = np.cos(angle), np.sin(angle)
    if axis == "x":
        return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    if axis == "y":
        return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def half_difference(wi: np.ndarray, wo: np.ndarray) -> tuple[float, float, float, float]:
    """Rusinkiewicz's (θ_h, φ_h, θ_d, φ_d) of one pair, by rotation matrices: d = R_y(−θ_h) R_z(−φ_h) wi."""
    h = (wi + wo) / np.linalg.norm(wi + wo)
    theta_h, phi_h = np.arccos(h[2]), np.arctan2(h[1], h[0])
    d = rotation("y", -theta_h) @ rotation("z", -phi_h) @ wi
    return theta_h, phi_h, np.arccos(d[2]), np.arctan2(d[1], d[0])


@cache
def log_upper_gamma(s: float, x: float) -> tuple[float, float, float]:
    """log Γ(s, x) and its derivatives by s and by x, from 60 digits (gammainc cancels for negative s)."""
    with mpmath.workdps(60):
        s, x = mpmath.mpf(s), mpmath.mpf(x)
        gamma = mpmath.gammainc(s, x)
        by_s = mpmath.diff(lambda a: mpmath.gammainc(a, x), s) / gamma
        by_x = -(x ** (s - 1)) * mpmath.exp(-x) / gamma
        return float(mpmath.log(gamma)), float(by_s), float(by_x)


def sgd_factor(alpha: float, p: float) -> float:
    """The published tables' K = 1 / (α Γ(1−p, α)), with D = K exp(−a) / (π a^p cos⁴θ), a = α + tan²θ/α."""
    with mpmath.workdps(60):
        return float(1 / (mpmath.mpf(alpha) * mpmath.gammainc(1 - mpmath.mpf(p), alpha)))


def sgd(alpha: float, p: float) -> Density:
    """The shifted gamma density, in the form that the published tables use."""
    factor = sgd_factor(alpha, p)

    def density(m):
        above = m[..., 2] > 0
        cos = np.where(above, m[..., 2], 1)
        a = alpha + (m[..., 0] ** 2 + m[..., 1] ** 2) / (cos**2 * alpha)
        return np.where(above, factor * np.exp(-a) / (np.pi * a**p * cos**4), 0)

    return density


@cache
def sgd_projected_area(alpha: float, p: float, theta: float) -> float:
    r"""σ(θ) = cos θ (1 + Λ) of the shifted gamma distribution, by the paper's own section 4.3 in mpmath:

    P_2(r) = U(p, p + 1/2, α + r²/α) exp(−α − r²/α) / (√(πα) Γ(1−p, α)),
    Λ(θ) = ∫_{cot θ}^∞ (r tan θ − 1) P_2(r) dr
    """
    with mpmath.workdps(20):
        alpha, p, theta = mpmath.mpf(alpha), mpmath.mpf(p), mpmath.mpf(theta)
        cot, width = mpmath.cos(theta) / mpmath.sin(theta), mpmath.sqrt(alpha)

        def integrand(r):
            z = alpha + r**2 / alpha
            return (r / cot - 1) * mpmath.hyperu(p, p + 0.5, z) * mpmath.exp(-z)

        ends = [cot + width * f for f in (0, 1e-3, 1e-2, 0.1, 0.5, 1, 2, 4, 8)]
        scale = mpmath.sqrt(mpmath.pi * alpha) * mpmath.gammainc(1 - p, alpha)
        return float(mpmath.cos(theta) * (1 + mpmath.quad(integrand, ends) / scale))


# Brute force over the facets


@dataclass(frozen=True)
class Piece:
    r"""A density and the linear map m' ↦ m = A m' / ‖A m'‖ which makes it round: brute force works there.

    Facets facing w are those with (Aᵀw)·m' > 0, and dm = |A| / ‖A m'‖³ dm'. `whole`: m' fills the sphere and
    not only the upper half of it; `panels`: how many the azimuth of m' is cut into, 1 where D is quite round.
    """

    density: Density
    shape: np.ndarray = field(default_factory=lambda: np.eye(3))
    whole: bool = False
    panels: int = 1
    levels: int = 8  # of panels that shrink towards the ends of the polar angle

    def __call__(self, m):
        return self.density(m)

    def scaled(self, factor: float) -> "Piece":
        return self.times(lambda m: factor, self.panels)

    def times(self, function: Density, panels: int) -> "Piece":
        return Piece(lambda m: function(m) * self(m), self.shape, self.whole, panels, self.levels)

    def turned(self, angle: float) -> "Piece":
        """D(R_y(−angle) m): the surface turned by R_y(angle)."""
        turn = rotation("y", angle)
        return Piece(lambda m: self(m @ turn), turn @ self.shape, self.whole, self.panels, self.levels)

    def normals(self, theta, phi) -> tuple[np.ndarray, np.ndarray]:
        """m and the solid angle of dθ' dφ' there."""
        m = direction(theta, phi) @ self.shape.T
        length = np.linalg.norm(m, axis=-1)
        return m / length[..., None], np.abs(np.linalg.det(self.shape)) / length**3 * np.sin(theta)

    def angles(self, m) -> tuple[np.ndarray, np.ndarray]:
        """(θ', φ') of normals m."""
        m = m @ np.linalg.inv(self.shape).T
        return np.arctan2(np.hypot(m[..., 0], m[..., 1]), m[..., 2]), np.arctan2(m[..., 1], m[..., 0])


@dataclass(frozen=True)
class Facets:
    """A density that is a sum of pieces."""

    pieces: tuple[Piece, ...]

    def __call__(self, m):
        return sum(piece(m) for piece in self.pieces)


def pieces(density: Density) -> tuple[Piece, ...]:
    """What to integrate one by one; a bare function is taken to be isotropic, however sharp."""
    if isinstance(density, Facets):
        return density.pieces
    return (density if isinstance(density, Piece) else Piece(density, levels=20),)


def facing_normal(density: Density, w: np.ndarray | None = None) -> np.ndarray:
    r"""∫ m D(m) dm over the facets that face w (3,), or over all of them: σ(w) = w · it, ∂σ/∂w = it.

    In the frame where D is round: at each θ' the facets that face w' = Aᵀw fill |φ' − φ_w| < φ_0 =
    arccos(−cot θ_w cot θ'). Gauss–Legendre in both angles; θ' in panels that shrink towards the peak, the
    horizon and the angle where φ_0 leaves π.
    """
    return sum((_facing_normal(piece, w) for piece in pieces(density)), np.zeros(3))


def _facing_normal(piece: Piece, w: np.ndarray | None) -> np.ndarray:
    w = np.zeros(3) if w is None else piece.shape.T @ w
    theta_w, phi_w = np.arctan2(np.hypot(w[0], w[1]), w[2]), np.arctan2(w[1], w[0])
    bend = abs(np.pi / 2 - theta_w) if np.any(w) else np.pi / 4
    ends = [0, bend, np.pi - bend, np.pi] if piece.whole else [0, bend, np.pi / 2]
    theta, d_theta = graded_nodes(ends, 16, piece.levels)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = -np.cos(theta_w) / np.sin(theta_w) / np.tan(theta)
    everywhere = np.isnan(cosine) | (not np.any(w))
    phi_0 = np.arccos(np.clip(np.where(everywhere, -1, cosine), -1, 1))
    phi, d_phi = _azimuths(phi_w - phi_0, phi_w + phi_0, piece.panels)
    m, solid_angle = piece.normals(theta[:, None], phi)
    return np.einsum("ij,ijk->k", piece(m) * solid_angle * d_theta[:, None] * d_phi, m)


def _azimuths(lower, upper, panels):
    """Nodes and weights between `lower` and `upper` (T,): 48 at once, or 20 a panel that ends at the axes."""
    borders = [lower + (upper - lower) * t for t in np.linspace(0, 1, panels + 1)]
    if panels > 1:
        borders += [np.clip(k * np.pi / 2, lower, upper) for k in range(-4, 5)]
    borders = np.sort(np.stack(borders, axis=-1), axis=-1)
    x, weight = np.polynomial.legendre.leggauss(20 if panels > 1 else 48)
    half = np.diff(borders)[..., None] / 2
    flat = (len(lower), -1)
    return (borders[:, :-1, None] + half * (1 + x)).reshape(flat), (half * weight).reshape(flat)


def projected_area(density: Density, w: np.ndarray) -> float:
    """σ(w) = ∫ (w·m)+ D(m) dm by brute force, for one direction w (3,)."""
    return float(w @ facing_normal(density, w))


def sphere_nodes(density: Density) -> tuple[np.ndarray, np.ndarray]:
    """Normals (T, 128, 3) wherever D is not zero and their solid angles (T, 128): a quadrature."""
    piece = pieces(density)[0]
    ends = [0, np.pi / 2, np.pi] if piece.whole or len(pieces(density)) > 1 else [0, np.pi / 2]
    theta, d_theta = graded_nodes(ends, levels=piece.levels)
    phi = (np.arange(128) + 0.5) * (2 * np.pi / 128)
    m, solid_angle = piece.normals(theta[:, None], phi[None, :])
    return m, solid_angle * d_theta[:, None] * (2 * np.pi / 128)


def graded_nodes(ends: list[float], nodes: int = 20, levels: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """Gauss–Legendre nodes and weights between the first and the last of `ends`, gathered at each of them."""
    steps = np.concatenate([[0], 0.25 ** np.arange(levels, 0, -1) * 2])  # 0 … 1/2 of an interval
    borders = {end for a, b in pairwise(ends) for s in steps for end in (a + (b - a) * s, b - (b - a) * s)}
    borders = np.array(sorted(borders))
    x, weight = np.polynomial.legendre.leggauss(nodes)
    width = np.diff(borders)[:, None] / 2
    return (borders[:-1, None] + width * (1 + x)).reshape(-1), (width * weight).reshape(-1)


# Histograms of normals


@dataclass(frozen=True)
class Bins:
    """Rings and sectors about equally probable under a density, in the frame of its first piece."""

    piece: Piece
    rings: np.ndarray  # borders of θ'
    sectors: np.ndarray  # which sector each cell of azimuth is in, a row a ring
    share: np.ndarray  # the probability of each sector of each ring

    def chi_squared(self, m: np.ndarray) -> float:
        """The probability of a histogram as far off as that of the normals m, were they of this density."""
        theta, phi = self.piece.angles(m)
        ring = np.clip(np.searchsorted(self.rings, theta) - 1, 0, len(self.share) - 1)
        cells = self.sectors.shape[1]
        cell = np.clip((phi / (2 * np.pi) % 1 * cells).astype(int), 0, cells - 1)
        counts = np.zeros(self.share.shape)
        np.add.at(counts, (ring, self.sectors[ring, cell]), 1)
        expected = len(m) * self.share
        return float(chi2.sf(np.sum((counts - expected) ** 2 / expected), counts.size - 1))


def bins(density: Density, weight: Density, rings: int = 12, sectors: int = 8, cells: int = 720) -> Bins:
    """Bins for normals drawn with a probability ∝ weight(m) D(m), such as (m·n)+ D or (w·m)+ D."""
    piece = pieces(density)[0]
    phi = (np.arange(cells) + 0.5) * (2 * np.pi / cells)

    def mass(theta, d_theta):
        m, solid_angle = piece.normals(theta[:, None], phi[None, :])
        return weight(m) * density(m) * solid_angle * d_theta[:, None]

    whole = piece.whole or len(pieces(density)) > 1
    theta, d_theta = graded_nodes([0, np.pi / 2, np.pi] if whole else [0, np.pi / 2], levels=piece.levels)
    cumulative = np.cumsum(np.sum(mass(theta, d_theta), axis=1))
    quantiles = np.linspace(0, cumulative[-1], rings + 1)[1:-1]
    borders = np.concatenate([[0], np.interp(quantiles, cumulative, theta), [np.pi if whole else np.pi / 2]])
    in_ring = np.stack([mass(*graded_nodes([a, b], 8, 12)).sum(axis=0) for a, b in pairwise(borders)])
    before = np.cumsum(in_ring, axis=1) / in_ring.sum(axis=1, keepdims=True)
    sector = np.minimum((before * sectors * (1 - 1e-12)).astype(int), sectors - 1)
    share = np.stack([np.bincount(s, x, minlength=sectors) for s, x in zip(sector, in_ring, strict=True)])
    return Bins(piece, borders, sector, share / share.sum())


# The distributions


def _upper(m) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Whether m is above the horizon, t_x, t_y and cos θ; 0, 0 and 1 where it is not."""
    above = m[..., 2] > 0
    cos = np.where(above, m[..., 2], 1)
    return above, np.where(above, m[..., 0], 0) / cos, np.where(above, m[..., 1], 0) / cos, cos


def beckmann(alpha_x: float, alpha_y: float | None = None) -> Piece:
    """exp(−(t_x²/α_x² + t_y²/α_y²)) / (π α_x α_y cos⁴θ)."""
    alpha_y = alpha_x if alpha_y is None else alpha_y

    def density(m):
        above, t_x, t_y, cos = _upper(m)
        bell = np.exp(-((t_x / alpha_x) ** 2) - (t_y / alpha_y) ** 2)
        with np.errstate(over="ignore", invalid="ignore"):
            return np.where(above & (bell > 0), bell / (np.pi * alpha_x * alpha_y * cos**4), 0)

    return Piece(density, np.diag([alpha_x, alpha_y, 1]))


def trowbridge_reitz(alpha_x: float, alpha_y: float | None = None) -> Piece:
    """1 / (π α_x α_y (m_x²/α_x² + m_y²/α_y² + m_z²)²)."""
    alpha_y = alpha_x if alpha_y is None else alpha_y

    def density(m):
        e = (m[..., 0] / alpha_x) ** 2 + (m[..., 1] / alpha_y) ** 2 + m[..., 2] ** 2
        return np.where(m[..., 2] > 0, 1 / (np.pi * alpha_x * alpha_y * e**2), 0)

    return Piece(density, np.diag([alpha_x, alpha_y, 1]))


def ellipsoid_matrix(alpha_x, alpha_y, theta_x, theta_y, theta_z) -> np.ndarray:
    """Dong 2015, eq. 11 and 12: A = S R_x(θ_x) R_y(θ_y) R_z(θ_z)."""
    turn = rotation("x", theta_x) @ rotation("y", theta_y) @ rotation("z", theta_z)
    return np.diag([alpha_x, alpha_y, 1]) @ turn


def ellipsoid(alpha_x, alpha_y, theta_x, theta_y, theta_z) -> Piece:
    """Dong 2015, eq. 10: χ(m·n) / (π |A| ‖An‖ ‖A^{−T}m‖⁴); round in Aᵀ Q m', Q turning z to An."""
    A = ellipsoid_matrix(alpha_x, alpha_y, theta_x, theta_y, theta_z)
    inverse, factor = np.linalg.inv(A), 1 / (np.pi * np.linalg.det(A) * np.linalg.norm(A[:, 2]))

    def density(m):
        return np.where(m[..., 2] > 0, factor / np.sum((m @ inverse) ** 2, axis=-1) ** 2, 0)

    basis, _ = np.linalg.qr(np.column_stack([A[:, 2], *np.eye(3)[:2]]))
    normal = A[:, 2] / np.linalg.norm(A[:, 2])
    return Piece(density, A.T @ np.column_stack([basis[:, 1], basis[:, 2], normal]))


def student_t(alpha: float, gamma: float) -> Piece:
    """(γ−1)^γ α^{2γ−2} / (π cos⁴θ ((γ−1) α² + tan²θ)^γ), in logarithms."""

    def density(m):
        above, t_x, t_y, cos = _upper(m)
        spread = np.log1p((t_x**2 + t_y**2) / ((gamma - 1) * alpha**2))
        return np.where(above, np.exp(-gamma * spread - 4 * np.log(cos)) / (np.pi * alpha**2), 0)

    return Piece(density, np.diag([alpha, alpha, 1]), levels=20)


def blinn_phong(exponent: float) -> Piece:
    """(e+2)/(2π) cos^e θ."""

    def density(m):
        above, t_x, t_y, _ = _upper(m)  # from the slopes: a cosine has no digits for a high power of it
        log_cos = -np.log1p(t_x**2 + t_y**2) / 2
        return np.where(above, (exponent + 2) / (2 * np.pi) * np.exp(exponent * log_cos), 0)

    width = np.sqrt(2 / (exponent + 2))
    return Piece(density, np.diag([width, width, 1]))


def anisotropic_phong(exponent_x: float, exponent_y: float) -> Piece:
    """√((e_x+2)(e_y+2))/(2π) cos^(e_x cos²φ + e_y sin²φ) θ."""
    factor = np.sqrt((exponent_x + 2) * (exponent_y + 2)) / (2 * np.pi)

    def density(m):
        phi = np.arctan2(m[..., 1], m[..., 0])
        exponent = exponent_x * np.cos(phi) ** 2 + exponent_y * np.sin(phi) ** 2
        return np.where(m[..., 2] > 0, factor * np.maximum(m[..., 2], 0) ** exponent, 0)

    widths = np.sqrt(2 / (np.array([exponent_x, exponent_y]) + 2))
    return Piece(density, np.diag([*widths, 1]), panels=4)


def exponential(alpha: float) -> Piece:
    """exp(−tan θ/α) / (2π α² cos⁴θ), Bagher 2012, Table 1."""

    def density(m):
        above, t_x, t_y, cos = _upper(m)
        fall = np.exp(-np.hypot(t_x, t_y) / alpha - 4 * np.log(cos))
        return np.where(above, fall / (2 * np.pi * alpha**2), 0)

    return Piece(density, np.diag([alpha, alpha, 1]), levels=16)


@cache
def gaussian_moments(sigma_x: float, sigma_y: float) -> tuple[float, float]:
    r"""(∫ g, ∫ g cos θ) over the hemisphere of g = exp(−t_x²/σ_x² − t_y²/σ_y²), by mpmath in one dimension.

    With k = cos²φ/σ_x² + sin²φ/σ_y² and c = cos θ the inner integrals are ∫_0^1 exp(−k (c^{−2} − 1)) c^n dc,
    n = 0 and 1; that of n = 1 is e^k E_2(k) / 2.
    """

    def over_phi(inner):
        def integrand(phi):
            return inner((mpmath.cos(phi) / sigma_x) ** 2 + (mpmath.sin(phi) / sigma_y) ** 2)

        return float(4 * mpmath.quad(integrand, [0, mpmath.pi / 4, mpmath.pi / 2]))

    def area(k):  # ∫_0^1 exp(−k (c^{−2} − 1)) dc = 1 − √(πk) e^k erfc √k
        return 1 - mpmath.sqrt(mpmath.pi * k) * mpmath.exp(k) * mpmath.erfc(mpmath.sqrt(k))

    with mpmath.workdps(30):
        return over_phi(area), over_phi(lambda k: mpmath.exp(k) * mpmath.expint(2, k) / 2)


def gaussian_microfacets(sigma_x: float, sigma_y: float | None = None) -> Piece:
    """Ashikhmin 2000, eq. 34: exp(−t_x²/σ_x² − t_y²/σ_y²) over solid angle, over its own signed mean."""
    sigma_y = sigma_x if sigma_y is None else sigma_y
    _, mean = gaussian_moments(sigma_x, sigma_y)

    def density(m):
        above, t_x, t_y, _ = _upper(m)
        return np.where(above, np.exp(-((t_x / sigma_x) ** 2) - (t_y / sigma_y) ** 2) / mean, 0)

    if sigma_x == sigma_y:
        return Piece(density, np.diag([sigma_x, sigma_x, 1]))
    if np.isfinite(sigma_y):
        return Piece(density, np.diag([sigma_x, sigma_y, 1]), panels=4)
    # m_x / m_z is a function of the azimuth about y: polar angles about y, and cot φ' = t_x / σ_x
    return Piece(density, np.array([[sigma_x, 0, 0], [0, 0, 1], [0, 1, 0]]), whole=True, panels=8)


def gaussian_cylinder(sigma: float) -> Piece:
    """The same with σ_y infinite (Ashikhmin 2000, section 6.3)."""
    return gaussian_microfacets(sigma, np.inf)


def v_grooves(angle: float, sigma: float) -> Facets:
    """Two round Gaussians tilted by ± angle about y (Ashikhmin 2000, section 6.2)."""
    side = gaussian_microfacets(sigma).scaled(1 / (2 * np.cos(angle)))
    return Facets((side.turned(angle), side.turned(-angle)))


def velvet(sigma: float) -> Piece:
    """exp(−cot²θ/σ²) over solid angle (Ashikhmin 2000, section 6.4); ∫ … cos θ = π e^k E_2(k), k = 1/σ²."""
    k = mpmath.mpf(sigma) ** -2
    mean = float(mpmath.pi * mpmath.exp(k) * mpmath.expint(2, k))

    def density(m):
        sin2 = m[..., 0] ** 2 + m[..., 1] ** 2
        above = (m[..., 2] > 0) & (sin2 > 0)
        cot2 = m[..., 2] ** 2 / np.where(above, sin2, 1)
        return np.where(above, np.exp(-cot2 / sigma**2) / mean, 0)

    return Piece(density)


def slanted_velvet(slant: float, sigma: float) -> Facets:
    """A cylindrical Gaussian slanted about y, ⟨h·n⟩ doubled for the tops of the bundles (section 6.4)."""
    return Facets((gaussian_cylinder(sigma).scaled(1 / (2 * np.cos(slant))).turned(slant),))


def mixture_shares(weights: list[float], sigmas: list[tuple[float, float]]) -> np.ndarray:
    """w_i ⟨h·n⟩_i over their sum, of Gaussian microfacets (σ_x, σ_y): ⟨h·n⟩ = ∫ g cos θ / ∫ g."""
    moments = [gaussian_moments(*sigma) for sigma in sigmas]
    shares = np.array([w * mean / area for w, (area, mean) in zip(weights, moments, strict=True)])
    return shares / shares.sum()


def mixture(shares, densities) -> Facets:
    """Σ s_i D_i."""
    return Facets(
        tuple(p.scaled(s) for s, density in zip(shares, densities, strict=True) for p in pieces(density))
    )


def modulated(density: Piece, image: np.ndarray) -> Piece:
    """D × the image at (m_x, m_y), bilinear between the cells' centres, over what that integrates to."""

    def brightness(m):
        x, y = ((m[..., k] + 1) * (len(image) / 2) - 0.5 for k in (0, 1))
        x, y = (np.clip(a, 0, len(image) - 1) for a in (x, y))
        j, i = (np.minimum(a.astype(int), len(image) - 2) for a in (x, y))
        x, y = x - j, y - i
        lower = (1 - x) * image[i, j] + x * image[i, j + 1]
        upper = (1 - x) * image[i + 1, j] + x * image[i + 1, j + 1]
        return (1 - y) * lower + y * upper

    product = density.times(brightness, panels=16)
    return product.scaled(1 / facing_normal(product)[2])


# Projected areas that have a name


def smith_lambda(form: str, alpha_x: float, alpha_y: float, w: np.ndarray) -> float:
    """Λ of Beckmann's ("beckmann") and Trowbridge–Reitz' distribution for one w above the horizon, by mpmath.

    a = 1/(α(φ) tan θ), α(φ)² = α_x² cos²φ + α_y² sin²φ; Λ = (erf a − 1)/2 + exp(−a²)/(2a√π) for the one,
    (√(1 + a^{−2}) − 1)/2 for the other.
    """
    with mpmath.workdps(30):
        x, y, z = (mpmath.mpf(float(c)) for c in w)
        a = z / mpmath.sqrt((alpha_x * x) ** 2 + (alpha_y * y) ** 2)
        if form == "beckmann":
            return float((mpmath.erf(a) - 1) / 2 + mpmath.exp(-(a**2)) / (2 * a * mpmath.sqrt(mpmath.pi)))
        return float((mpmath.sqrt(1 + a**-2) - 1) / 2)


def ellipsoid_area(A: np.ndarray, w: np.ndarray) -> float:
    """Dong 2015, eq. 14: (‖Aw‖‖An‖ + Aw·An) / (2‖An‖²)."""
    u, n = A @ w, A[:, 2]
    return float((np.linalg.norm(u) * np.linalg.norm(n) + u @ n) / (2 * n @ n))


# Reflectance


def cook_torrance(wi, wo, *, rho_d, rho_s, alpha, p, f0, f1) -> float:
    """Bagher 2012, eq. 1 with the shifted gamma distribution, exact Smith masking and eq. 11; one pair."""
    h = (wi + wo) / np.linalg.norm(wi + wo)
    density = sgd(alpha, p)
    cos_d = wi @ h
    F = f0 + (1 - f0) * (1 - cos_d) ** 5 - f1 * cos_d
    G = wi[2] / projected_area(density, wi) * wo[2] / projected_area(density, wo)
    return float(rho_d / np.pi + rho_s / np.pi * F * density(h) * G / (wi[2] * wo[2]))


def albedo(brdf: Callable[[np.ndarray, np.ndarray], np.ndarray], theta_i: float, n: int = 600) -> float:
    """∫ f cos θ_o dω_o by the trapezoid rule in (θ_o, φ_o); brdf takes wi, wo (..., 3) of one shape."""
    theta, phi = np.linspace(0, np.pi / 2, n), np.linspace(0, 2 * np.pi, n, endpoint=False)
    wo = direction(theta[:, None], phi[None, :])
    f = np.asarray(brdf(np.broadcast_to(direction(theta_i, 0.0), wo.shape), wo))
    inner = f.sum(axis=1) * (2 * np.pi / n) * np.cos(theta) * np.sin(theta)
    return float(np.trapezoid(inner, theta))


def mask_approximation(theta: float, lam: float, c: float, k: float) -> tuple[float, float]:
    """G1(θ) and θ_0 of Bagher 2012, eq. 9, in 50 digits: c reaches 1e109."""
    with mpmath.workdps(50):
        theta, lam, c, k = (mpmath.mpf(v) for v in (theta, lam, c, k))
        theta_0 = mpmath.pi / 2 - (mpmath.log(1 + 1 / lam) / c) ** (1 / k)
        beyond = theta - theta_0
        G1 = 1 + lam * (1 - mpmath.exp(c * beyond**k)) if beyond > 0 else mpmath.mpf(1)
        return float(G1), float(theta_0)
