r"""Ellipsoids fitted to many tables at once.

D^{−1/2} = q·φ(m) is linear in the six monomials φ of m, whatever the ellipsoid is, so that all of a block of
tables share matrix products: [tables, 6] × [6, cells] makes the densities, and [tables, cells] × [cells, 21]
all of JᵀJ, from the products of two monomials.

Sought are not the angles but the mean slope μ and the squared roughness G (see `Ellipsoid`), which name each
ellipsoid in one way: around a start μ_0, G_0⁻¹ = W_0ᵀW_0, with W and W_0 upper triangular,

    μ = μ_0 + W_0⁻¹ (t_1, t_2),   W = [[e^{t_3}, t_5], [0, e^{t_4}]] W_0,   G⁻¹ = WᵀW

so that t is free of units, unbounded, and 0 at the start.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from fitting.covariance import sandwich_of
from fitting.least_squares import LaneSolutions, map_lanes, solve_grams, with_rows
from fitting.outcome import Outcome, means_nothing, statuses
from fitting.table_loss import TableLoss, bordered, difference
from fitting.tables import FEWEST, Cells, cells_of, in_parts
from jaxbrdf.arrays import fitted_ranges
from jaxbrdf.fit_result import FitResult
from jaxbrdf.ndf.ellipsoid import Ellipsoid, Monomials, mean_theta_z, nearest_slopes
from jaxbrdf.ndf.tabulated import TabulatedNDF

NAMES = ("alpha_x", "alpha_y", "theta_x", "theta_y", "theta_z")
_BLOCK = 128  # tables at once: what is made of them on the way fits into a processor's cache
_ROUNDING = 1e-10  # of the products, which differences of moments about 0 are taken of
_STEPS = 5  # after which those that go on are gathered: most do not
_MORE = 12  # in a round of those: damping begins anew in each, and must grow to what they need
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
    """What all tables have in common: the loss, where the cells are, also as 1, x, y, x², xy and y², and the
    area of each."""

    loss: TableLoss
    monomials: Monomials
    moments: Float[np.ndarray, "6 K"]
    area: float

    @classmethod
    def of(cls, cells: Cells, loss: TableLoss) -> "Shared":
        x, y, _ = cells.m.T
        moments = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])
        return cls(loss, Monomials.of(cells.m), moments, cells.area)


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
    shared = Shared.of(cells_of(tables), loss)
    parts = [_search(values, shared) for values in in_parts(tables)]
    found = jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
    outcome = _outcome(found)
    return outcome.result(Ellipsoid(*jnp.asarray(outcome.numbers.T)), NAMES, loss.name)


def _search(values: Float[np.ndarray, "B K"], shared: Shared) -> Search:
    start, scale, enough = map_lanes(_start, values, shared, _BLOCK)
    end = _minima((values, scale, start), shared)
    slopes, *sums = map_lanes(_at_the_end, (end.t, values, start), shared, _BLOCK)
    return Search(slopes, end, enough, *sums)


def _minima(lanes: tuple, shared: Shared) -> LaneSolutions:
    """First by the expected second derivatives, which are cheaper and mostly lead there, then by true ones.

    Where a patch is far from any ellipsoid the two differ by more than a factor of two, and steps of the
    expected ones converge slowly or not at all.
    """
    solve = partial(solve_grams, block=_BLOCK, tolerance=_TOLERANCE)
    t = np.zeros((len(lanes[0]), 5))
    end = solve(_expected, t, lanes, shared, steps_a_round=_STEPS, rounds=1)
    rest = np.flatnonzero(~end.converged & np.isfinite(end.cost))
    if not len(rest):
        return end
    chosen = jax.tree.map(lambda leaf: leaf[rest], lanes)
    more = solve(_true, end.t[rest], chosen, shared, steps_a_round=_MORE)
    more = eqx.tree_at(lambda found: found.steps, more, more.steps + end.steps[rest])
    return jax.tree.map(lambda old, new: with_rows(old, rest, new), end, more)


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
    """The nearest ellipsoid in closed form, the table's scale, and whether the table holds enough for one."""
    D = values.astype(shared.monomials.each.dtype)
    mean, G = nearest_slopes(shared.monomials, D, jnp.ones_like(D))
    is_one = jnp.isfinite(G[0, 0]) & (G[0, 0] > 0) & (jnp.linalg.det(G) > 0)
    start = Slopes.of(jnp.where(is_one, mean, 0), jnp.where(is_one, G, jnp.eye(2)))
    return start, shared.loss.scale(D, shared.area), is_one & _spread_enough((D > 0).astype(D.dtype), shared)


def _spread_enough(held, shared: Shared):
    """Whether enough cells hold something, and not all in one line of the disk."""
    count, *moments = shared.moments @ held
    x, y, xx, xy, yy = jnp.stack(moments) / jnp.maximum(count, 1)
    xx, xy, yy = xx - x * x, xy - x * y, yy - y * y
    return (count >= FEWEST) & (xx * yy - xy**2 > _THIN * (xx + yy) ** 2)


def _expected(t, args):
    """Expected second derivatives by t, the gradient, and twice the value: see `solve_grams`."""
    at, J, scale, _ = _derivatives(t, args)
    return _bordered(J.T @ at.expected @ J, J, at, scale)


def _true(t, args):
    """The same with the true second derivatives, unless these are not positive."""
    at, J, scale, quadric = _derivatives(t, args)
    expected = J.T @ at.expected @ J
    true = J.T @ at.true @ J + jnp.tensordot(at.slope, jax.hessian(quadric)(t), 1)
    positive = jnp.all(jnp.isfinite(jnp.linalg.cholesky(true - _LEAST * expected)))
    return _bordered(jnp.where(positive, true, expected), J, at, scale)


def _derivatives(t, args):
    """Those by q, dq/dt, the table's scale, and q of t."""
    (values, scale, start), shared = args

    def quadric(t):
        return start.moved(t).quadric()

    return _Derivatives(quadric(t), values, shared), jax.jacfwd(quadric)(t), scale, quadric


def _bordered(curvature, J, at, scale):
    gram = scale**2 * bordered(curvature, J.T @ at.slope, at.loss)
    return gram + _ROUNDING * jnp.diag(jnp.diagonal(gram))


class _Derivatives:
    """At q: D, dD/dq but for its factor φ, and of ½ Σ ℓ over the cells the derivatives by q.

    What is not asked for is not made.
    """

    def __init__(self, q: Float[Array, "6"], values: Float[Array, " K"], shared: Shared):
        self._values, self._shared = values, shared
        root = q @ shared.monomials.each
        self.D = 1 / root**2
        self.D_q = -2 * self.D / root
        self.weight = shared.loss.weight(self.D, values)
        self._by_D = self.weight * difference(self.D, values)

    @property
    def loss(self) -> Float[Array, ""]:
        """Σ ℓ."""
        return jnp.sum(self._shared.loss.loss(self.D, self._values))

    @property
    def slope(self) -> Float[Array, "6"]:
        return self._shared.monomials.sums(self._by_D * self.D_q)

    @property
    def expected(self) -> Float[Array, "6 6"]:
        return self._shared.monomials.sums_of_products(self.weight * self.D_q**2)

    @property
    def true(self) -> Float[Array, "6 6"]:
        curvature = self._shared.loss.curvature(self.D, self._values)
        D_qq = 6 * self.D**2
        return self._shared.monomials.sums_of_products(curvature * self.D_q**2 + self._by_D * D_qq)


def _at_the_end(lane, shared: Shared):
    """The ellipsoid at t, and what `Search` has of it."""
    t, values, start = lane
    at, J, _, _ = _derivatives(t, ((values, 1.0, start), shared))
    gram = at.expected
    inverse = J @ jnp.linalg.inv(J.T @ gram @ J) @ J.T
    leverage = at.weight * at.D_q**2 * shared.monomials.forms(inverse)
    residual = difference(at.D, values) / (1 - jnp.minimum(leverage, _LEVERAGE))
    spread = shared.monomials.sums_of_products((at.weight * residual * at.D_q) ** 2)
    return start.moved(t), gram, spread, jnp.sum(at.weight > 0)


def _covariance(lane, _):
    """The covariance of the parameters."""
    numbers, gram, spread, count = lane
    J = jax.jacfwd(lambda numbers: Slopes.of(*Ellipsoid(*numbers).slope_form()).quadric())(numbers)
    return sandwich_of(J.T @ gram @ J, J.T @ spread @ J, count)
