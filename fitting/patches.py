"""Distributions fitted to the tables of many patches, a block of them at a time."""

from fitting.distribution import as_result, fit_lanes
from fitting.ellipsoids import fit_ellipsoids
from fitting.model_space import model_space
from fitting.outcome import joined, warn_of_float32
from fitting.table_loss import table_loss
from fitting.tables import cells_of, check, in_parts
from jaxbrdf.fit_result import FitResult
from jaxbrdf.ndf.base import AbstractNDF
from jaxbrdf.ndf.ellipsoid import Ellipsoid
from jaxbrdf.ndf.tabulated import TabulatedNDF
from jaxbrdf.surface.patches import PatchNDFs

_AT_ONCE = 256  # tables, each of which is copied for all of its starts


def fit_ndf_patches(
    model: AbstractNDF,
    tables: TabulatedNDF | PatchNDFs,
    *,
    loss: str = "l2",
    fixed: tuple[str, ...] = (),
    starts: int = 3,
) -> FitResult:
    r"""Fit a distribution to each of a stack of tables, (B, N, N): `fit_ndf` for many small ones.

    `tables` may be what `patch_ndfs` returns; `loss`, `model`, `fixed` and `starts` are those of `fit_ndf`.
    The result has leaves (B,), for `jax.vmap`; residuals are not kept, they would be as large as the tables.
    Ellipsoids without fixed parameters are fitted by matrix products that all tables share, from the nearest
    D^{−1/2} in closed form; of the names of each that one is given whose θ_z is nearest to the orientation of
    all, so that neighbouring patches have neighbouring parameters (see `aligned`).

    The likelihood determines an ellipsoid from counts of normals as well as L2 does from twice as many, and
    takes twice as long (benchmarks/patch_speed.py).

    Raises ValueError as `fit_ndf`. A patch that cannot be fitted is a status, its parameters NaN; of an
    ellipsoid AT_BOUND says that a roughness is beyond the range of its class.
    """
    if isinstance(tables, PatchNDFs):
        tables = tables.tables
    check(model, tables)
    warn_of_float32()
    if type(model) is Ellipsoid and not fixed:
        return fit_ellipsoids(tables, table_loss(loss))
    space, given, _ = model_space(model, fixed)
    cells, minimised = cells_of(tables), table_loss(loss)
    parts = [
        fit_lanes(space, given, cells, values, minimised, starts).without_residuals()
        for values in in_parts(tables, _AT_ONCE)
    ]
    return as_result(model, space, joined(parts), minimised)
