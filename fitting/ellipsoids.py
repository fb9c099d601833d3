r"""Ellipsoids fitted to many tables at once.

D^{−1/2} = q·φ(m) is linear in the six monomials φ of m, whatever the ellipsoid is, so that all of a block of
tables share matrix products: [tables, 6] × [6, cells] makes the densities, and [tables, cells] × [cells, 21]
all of JᵀJ, from the products of two monomials.

Sought are not the angles but the mean slope μ and the squared roughness G (see `Ellipsoid`), which name each
ellipsoid in one way: around a start μ_0, G_0⁻¹ = W_0ᵀW_0, with W and W_0 upper triangular,

    μ = μ_0 + W_0⁻¹ (t_1, t_2),   W = [[e^{t_3}, t_5], [0, e^{t_4}]] W_0,   G⁻¹ = WᵀW

so that t is free of units, unbounded, and 0 at the start.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from fitting.covariance import sandwich_of
from fitting.least_squares import LaneSolutions, map_lanes, solve_grams
from fitting.outcome import Outcome, means_nothing, statuses
from fitting.table_loss import TableLoss, bordered, difference
from fitting.tables import FEWEST, Cells, cells_of, in_parts
from jaxbrdf.arrays import fitted_ranges
from jaxbrdf.fit_result import FitResult
from jaxbrdf.ndf.ellipsoid import Ellipsoid, Monomials, mean_theta_z, nearest_slopes
from jaxbrdf.ndf.tabulated import TabulatedNDF

NAMES = ("alpha_x", "alpha_y", "theta_x", "theta_y", "theta_z")
_BLOCK = 256  # tables at once: a few of their rows fit into a processor's cache
_ROUNDING = 1e-10  # of the products, which differences of moments about 0 are taken of
_STEPS = 8  # after which those that go on are gathered
_TOLERANCE = 1e-5  # of t
_LEAST = 0.2  # of the expected curvature: what the true one must exceed to be taken
_LEVERAGE = 0.9  # a cell that holds nearly all of the table says nothing of its noise
_THIN = 1e-6  # det / tr² of the covariance of cells that are no more than a line


class Slopes(eqx.Module):
    """An ellipsoid as μ and the numbers W_11, W_12 and W_22 of G⁻¹ = WᵀW."""

    mean: Float[Array | np.ndarray, "... 2"]
    W: Float[Array | np.ndarray, "... 3"]

    @classmethod
    def of(cls, mean: Float[Array, "2"], G: Float[Array, "2 2"]) -> "Slopes":
        root_yy, root_det = jnp.sqrt(G[1, 1]), jnp.sqrt(G[0, 0] * G[1, 1] - G[0, 1] ** 2)
        return cls(mean, jnp.stack([root_yy / root_det, -G[0, 1] / (root_det * root_yy), 1 / root_yy]))

    @property
    def scatter(self) -> Float[np.ndarray, "... 2 2"]:
        """G."""
        w11, w12, w22 = np.moveaxis(np.asarray(self.W), -1, 0)
        rows = np.stack([w12**2 + w22**2, -w12 * w11, -w12 * w11, w11**2], axis=-1)
        return rows.reshape(*w11.shape, 2, 2) / ((w11 * w22) ** 2)[..., None, None]

    def moved(self, t: Float[Array, "5"]) -> "Slopes":
        """The ellipsoid at t from here."""
        w11, w12, w22 = self.W
        mean = self.mean + jnp.stack([(t[0] - w12 * t[1] / w22) / w11, t[1] / w22])
        W = [jnp.exp(t[2]) * w11, jnp.exp(t[2]) * w12 + t[4] * w22, jnp.exp(t[3]) * w22]
        return Slopes(mean, jnp.stack(W))

    def quadric(self) -> Float[Array, "6"]:
        """q of D^{−1/2} = q·φ(m): ‖W (m_xy − μ m_z)‖² + m_z², times √(π √|G|)."""
        w11, w12, w22 = self.W
        x, y = w11 * self.mean[0] + w12 * self.mean[1], w22 * self.mean[1]
        squares = [w11**2, w12**2 + w22**2, x**2 + y**2 + 1]
        mixed = [-(w12 * x + w22 * y), -w11 * x, w11 * w12]
        return jnp.sqrt(jnp.pi / (w11 * w22)) * jnp.stack([*squares, *mixed])


class Shared(eqx.Module):
    """What all tables have in common: the loss, and where the cells are."""

    loss: TableLoss
    m_xy: Float[np.ndarray, "2 K"]
    monomials: Monomials


class Search(eqx.Module):
    """Of each table: the ellipsoid and how its search ended, whether the table holds enough, and what the
    covariance is made of: Σ w D_q D_qᵀ and Σ w² (D − T)² D_q D_qᵀ / (1 − h)², and how many cells count.

    A narrow distribution lies in a few cells; each then draws the fit to itself, by the leverage h, and its
    residual tells so much less of the noise (MacKinnon & White's HC3).
    """

    slopes: Slopes
    end: LaneSolutions
    enough: Bool[np.ndarray, " B"]
    gram: Float[np.ndarray, "B 6 6"]
    spread: Float[np.ndarray, "B 6 6"]
    cells: Int[np.ndarray, " B"]


def fit_ellipsoids(tables: TabulatedNDF, loss: TableLoss) -> FitResult:
    """The ellipsoid of each of a stack of tables; see `fit_ndf_patches`."""
    cells = cells_of(tables)
    shared = Shared(loss, cells.m.T[:2], Monomials.of(cells.m))
    parts = [_search(values, cells, shared) for values in in_parts(tables)]
    found = jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
    outcome = _outcome(found)
    return outcome.result(Ellipsoid(*jnp.asarray(outcome.numbers.T)), NAMES, loss.name)


def _search(values: Float[np.ndarray, "B K"], cells: Cells, shared: Shared) -> Search:
    start, enough = map_lanes(_start, values, shared, _BLOCK)
    lanes = values, shared.loss.scale(values, cells.area), start
    t = np.zeros((len(values), 5))
    end = solve_grams(_gram, t, lanes, shared, block=_BLOCK, steps_a_round=_STEPS, tolerance=_TOLERANCE)
    slopes, *sums = map_lanes(_at_the_end, (end.t, values, start), shared, _BLOCK)
    return Search(slopes, end, enough, *sums)


def _outcome(found: Search) -> Outcome:
    """What came of each table, by names that are nearest to the orientation of all."""
    scatter = found.slopes.scatter
    usable = found.enough & np.isfinite(found.end.cost)
    theta_z = mean_theta_z(scatter[usable])
    model = Ellipsoid.of_slopes(np.asarray(found.slopes.mean), scatter, theta_z)
    numbers = np.stack([np.asarray(getattr(model, name)) for name in NAMES], axis=-1)
    code = statuses(
        enough=found.enough,
        finite=usable & np.isfinite(numbers).all(1),
        no_lobe=np.zeros(len(numbers), bool),
        converged=found.end.converged,
        on_bound=_beyond_range(numbers),
    )
    nothing = means_nothing(code)[:, None]
    covariance = map_lanes(_covariance, (numbers, found.gram, found.spread, found.cells), None, _BLOCK)
    covariance = np.where(nothing[:, :, None], np.nan, covariance)
    numbers, none = np.where(nothing, np.nan, numbers), np.zeros((len(numbers), 0))
    return Outcome(numbers, code, found.end.cost, found.end.steps, covariance, none)


def _beyond_range(numbers: Float[np.ndarray, "B 5"]) -> np.ndarray:
    """Whether a roughness is none that the class declares fits to look for."""
    ranges = fitted_ranges(Ellipsoid)
    low, high = (np.array([getattr(ranges[name], end) for name in NAMES[:2]]) for end in ("low", "high"))
    return np.any((numbers[:, :2] < low[None]) | (numbers[:, :2] > high[None]), axis=1)


# One table


def _start(values, shared: Shared):
    """The nearest ellipsoid in closed form, and whether the table holds enough for one; if not, any."""
    D = values.astype(shared.monomials.each.dtype)
    mean, G = nearest_slopes(shared.monomials, D, jnp.ones_like(D))
    is_one = jnp.isfinite(G[0, 0]) & (G[0, 0] > 0) & (jnp.linalg.det(G) > 0)
    start = Slopes.of(jnp.where(is_one, mean, 0), jnp.where(is_one, G, jnp.eye(2)))
    return start, is_one & _spread_enough(D > 0, shared)


def _spread_enough(held, shared: Shared):
    """Whether enough cells hold something, and not all in one line of the disk."""
    x, y = shared.m_xy
    count = jnp.maximum(jnp.sum(held), 1)
    x, y = (jnp.where(held, a - jnp.sum(held * a) / count, 0) for a in (x, y))
    xx, xy, yy = jnp.sum(x * x), jnp.sum(x * y), jnp.sum(y * y)
    return (count >= FEWEST) & (xx * yy - xy**2 > _THIN * (xx + yy) ** 2)


def _gram(t, args):
    """Second derivatives by t, the gradient, and twice the value: see `solve_grams`.

    The second derivatives are the true ones: where a patch is far from any ellipsoid they differ from the
    expected ones, JᵀwJ, by more than a factor of two, and steps of the latter converge slowly or not at all.
    Where they are not positive, the expected ones stand in.
    """
    (values, scale, start), shared = args

    def quadric(t):
        return start.moved(t).quadric()

    at, J = _Derivatives.of(quadric(t), values, shared), jax.jacfwd(quadric)(t)
    expected = J.T @ at.expected @ J
    true = J.T @ at.true @ J + jnp.tensordot(at.slope, jax.hessian(quadric)(t), 1)
    positive = jnp.all(jnp.isfinite(jnp.linalg.cholesky(true - _LEAST * expected)))
    gram = scale**2 * bordered(jnp.where(positive, true, expected), J.T @ at.slope, at.loss)
    return gram + _ROUNDING * jnp.diag(jnp.diagonal(gram))


class _Derivatives(NamedTuple):
    """Σ ℓ over the cells, of ½ Σ ℓ the derivatives by q, and D and dD/dq but for its factor φ."""

    loss: Float[Array, ""]
    slope: Float[Array, "6"]
    expected: Float[Array, "6 6"]
    true: Float[Array, "6 6"]
    D: Float[Array, " K"]
    D_q: Float[Array, " K"]

    @classmethod
    def of(cls, q: Float[Array, "6"], values: Float[Array, " K"], shared: Shared) -> "_Derivatives":
        loss, sums = shared.loss, shared.monomials.sums_of_products
        root = q @ shared.monomials.each
        D = 1 / root**2
        D_q, D_qq = -2 * D / root, 6 * D**2
        weight = loss.weight(D, values)
        by_D = weight * difference(D, values)
        true = sums(loss.curvature(D, values) * D_q**2 + by_D * D_qq)
        slope, expected = shared.monomials.sums(by_D * D_q), sums(weight * D_q**2)
        return cls(jnp.sum(loss.loss(D, values)), slope, expected, true, D, D_q)


def _at_the_end(lane, shared: Shared):
    """The ellipsoid at t, and what `Search` has of it."""
    t, values, start = lane
    J = jax.jacfwd(lambda t: start.moved(t).quadric())(t)
    at = _Derivatives.of(start.moved(t).quadric(), values, shared)
    weight = shared.loss.weight(at.D, values)
    inverse = J @ jnp.linalg.pinv(J.T @ at.expected @ J) @ J.T
    leverage = weight * at.D_q**2 * shared.monomials.forms(inverse)
    residual = difference(at.D, values) / (1 - jnp.minimum(leverage, _LEVERAGE))
    spread = shared.monomials.sums_of_products((weight * residual * at.D_q) ** 2)
    return start.moved(t), at.expected, spread, jnp.sum(weight > 0)


def _covariance(lane, _):
    """The covariance of the parameters."""
    numbers, gram, spread, count = lane
    J = jax.jacfwd(lambda numbers: Slopes.of(*Ellipsoid(*numbers).slope_form()).quadric())(numbers)
    return sandwich_of(J.T @ gram @ J, J.T @ spread @ J, count)
