r"""How fast are ellipsoids of many patches fitted, does any get stuck, and which loss is the better one?

    python benchmarks/patch_speed.py [--most N] [--csv FILE]

Tables of 65 × 65 cells over the disk, in float32, made of ellipsoids that are known: α_x and α_y from .05 to
.4 (evenly in the logarithm), θ_x and θ_y within ±.2, θ_z within ±.7. D is taken at the centres of the cells,
and the normals in each are Poisson distributed, 10,000 in a table unless another number is said.

The rival is a loop of scipy.optimize.least_squares over 200 of the patches, at its best: residuals and a
forward-mode Jacobian in (log α_x, log α_y, θ_x, θ_y, θ_z), jitted and compiled before, of the same objective,
from the same start in closed form (which is in our time and not in scipy's), tolerances as they come. Its
methods are MINPACK's ('lm') and 'trf'. It also starts at the truth: the lowest cost of all is the best one.
jaxopt's L-BFGS-B, jitted as a whole, goes down the same objective from the same start.

Memory is the largest of the process, less the tables. Of what the fits find, the error of log α is the rms
over α_x and α_y, and that of the mean slope μ is √((μ − μ_0)ᵀ G_0⁻¹ (μ − μ_0) / 2), in units of α; parameters
are held against that name of the truth that is nearest, and standard errors against those ellipsoids whose
axes differ by more than a fifth: the orientation of the others is none.
"""

import argparse
import csv
import os
import resource
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import least_squares

from fitting import fit_ndf_patches
from fitting.minimize import jaxopt
from fitting.table_loss import table_loss
from jaxbrdf import Ellipsoid, FitResult, TabulatedNDF
from jaxbrdf.ndf.ellipsoid import Monomials, nearest_slopes
from jaxbrdf.ndf.tabulated import cell_area, disk_cells

CELLS, PATCHES, NORMALS, FEW = 65, 10_000, 10_000, 200
SIZES = (1_000, 10_000, 30_000, 100_000)
COUNTS = (1_000, 10_000, 100_000, 1_000_000)  # normals a patch
LOSSES, METHODS = ("l2", "likelihood"), ("lm", "trf")
NAMES = ("alpha_x", "alpha_y", "theta_x", "theta_y", "theta_z")
AREA, GRID = cell_area(CELLS), np.moveaxis(disk_cells(CELLS), 0, -1)
INSIDE = GRID[..., 2] > 0
AT_ONCE = 1000  # tables drawn at once
WORSE = 1e-6  # a cost that is higher by more than this share is another minimum
ANY = Ellipsoid(*(jnp.array(number) for number in (0.2, 0.2, 0.0, 0.0, 0.0)))


class Printed(NamedTuple):
    """A table as it is printed and kept."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


# Patches


def ellipsoids(count: int, seed: int) -> Ellipsoid:
    """The truth."""
    rng = np.random.default_rng(seed)
    alphas = np.exp(rng.uniform(np.log(0.05), np.log(0.4), (2, count)))
    angles = (*rng.uniform(-0.2, 0.2, (2, count)), rng.uniform(-0.7, 0.7, count))
    return Ellipsoid(*(jnp.asarray(part) for part in (*alphas, *angles)))


def counted(truth: Ellipsoid, normals: float, seed: int) -> TabulatedNDF:
    """Tables of so many normals, written into one array: there never are two of it."""
    count = len(truth.alpha_x)
    values = jnp.zeros((count, CELLS, CELLS), jnp.float32)
    for start, part in drawn(truth, normals, np.random.default_rng(seed)):
        values = _put(values, part, start)
    return TabulatedNDF(values)


def drawn(truth: Ellipsoid, normals: float, rng: np.random.Generator) -> Iterator[tuple[int, np.ndarray]]:
    """Some tables at a time, and the number of the first."""
    for start in range(0, len(truth.alpha_x), AT_ONCE):
        some = jax.tree.map(lambda leaf, start=start: leaf[start : start + AT_ONCE], truth)
        expected = normals * AREA * np.asarray(_densities(some))
        yield start, (rng.poisson(expected) / (normals * AREA)).astype(np.float32)


@jax.jit
@jax.vmap
def _densities(ellipsoid):
    return jnp.where(INSIDE, ellipsoid._density(jnp.asarray(GRID)), 0)


@partial(jax.jit, donate_argnums=0)
def _put(values, part, start):
    return jax.lax.dynamic_update_slice(values, part, (start, 0, 0))


# Ours


def seconds(work: Callable) -> tuple[float, FitResult]:
    begin = time.perf_counter()
    result = work()
    return time.perf_counter() - begin, result


def timed(tables: TabulatedNDF, loss: str, repeat: int = 3) -> tuple[float, float, FitResult]:
    """Seconds of the first call, the median seconds of later ones, and what they give."""
    calls = [seconds(lambda: fit_ndf_patches(ANY, tables, loss=loss)) for _ in range(repeat + 1)]
    return calls[0][0], float(np.median([taken for taken, _ in calls[1:]])), calls[0][1]


# The rivals, one patch at a time


class Problem(NamedTuple):
    """What the rivals solve: the objective, and of each patch the table, its scale, and where to start."""

    loss: str
    values: np.ndarray  # (B, K)
    scale: np.ndarray  # (B,)
    start: np.ndarray  # (B, 5)

    @classmethod
    def of(cls, tables: TabulatedNDF, loss: str, count: int) -> "Problem":
        values = np.asarray(tables.values)[:count, INSIDE].astype(float)
        slopes = jax.jit(jax.vmap(nearest_slopes, (None, 0, 0)))
        mean, G = slopes(Monomials.of(GRID[INSIDE]), values, np.ones_like(values))
        start = numbers(Ellipsoid.of_slopes(np.asarray(mean), np.asarray(G)))
        scale = np.asarray(jax.vmap(table_loss(loss).scale, (0, None))(values, AREA))
        return cls(loss, values, scale, start)

    @property
    def residual(self) -> Callable:
        """r(p, T, scale), of which ½ Σ r² is sought."""
        rule, m = RESIDUALS[self.loss], jnp.asarray(GRID[INSIDE])
        return lambda p, values, scale: scale * rule(density(p, m), values)

    @property
    def objective(self) -> Callable:
        """The same ½ Σ r², without square roots."""
        loss, m = table_loss(self.loss), jnp.asarray(GRID[INSIDE])
        return lambda p, values, scale: jnp.sum(scale**2 * loss.loss(density(p, m), values)) / 2


def density(p, m):
    return Ellipsoid(*jnp.exp(p[:2]), *p[2:])._density(m)


def deviance(D, T):
    """r = −e √(2 D k), e = T/D − 1, k = ((1 + e) log(1 + e) − e) / e²: ½ − e/6 + e²/12 − … near 0."""
    y = T / D
    e, near = y - 1, jnp.abs(y - 1) < 1e-3
    far = jnp.where(near, 1, e)
    k = (jnp.where(T > 0, y * jnp.log(jnp.where(T > 0, y, 1)), 0) - e) / far**2
    return -e * jnp.sqrt(2 * D * jnp.where(near, 1 / 2 - e / 6 + e * e / 12, k))


RESIDUALS: dict[str, Callable] = {"l2": lambda D, T: D - T, "likelihood": deviance}


def numbers(model: Ellipsoid) -> np.ndarray:
    """(B, 5), the logarithms of α and the angles."""
    rows = np.stack([np.asarray(getattr(model, name)) for name in NAMES], axis=-1)
    return np.concatenate([np.log(rows[:, :2]), rows[:, 2:]], axis=1)


class Descent(NamedTuple):
    """Where a rival ended: costs, whether it says that it converged, iterations, seconds a patch."""

    cost: np.ndarray
    converged: np.ndarray
    steps: np.ndarray
    seconds: float


def by_scipy(problem: Problem, start: np.ndarray, method: str) -> Descent:
    residual, jacobian = jax.jit(problem.residual), jax.jit(jax.jacfwd(problem.residual))

    def fit(p, *data):
        found = least_squares(
            lambda p, *data: np.asarray(residual(p, *data)),
            p,
            lambda p, *data: np.asarray(jacobian(p, *data)),
            method=method,
            args=[jnp.asarray(part) for part in data],
        )
        return found.cost, found.success, found.nfev

    return one_by_one(fit, problem, start)


def by_jaxopt(problem: Problem, start: np.ndarray, tolerance: float) -> Descent:
    objective = problem.objective
    solver = jaxopt.LBFGSB(objective, tol=tolerance, maxiter=200)

    @jax.jit
    def fit(p, values, scale):
        p, state = solver.run(p, (-jnp.inf * jnp.ones(5), jnp.inf * jnp.ones(5)), values, scale)
        return objective(p, values, scale), state.error <= tolerance, state.iter_num

    return one_by_one(fit, problem, start)


def one_by_one(fit: Callable, problem: Problem, start: np.ndarray) -> Descent:
    """All patches by fit(p, T, scale), which is compiled on the first."""
    jax.block_until_ready(fit(start[0], problem.values[0], problem.scale[0]))
    begin = time.perf_counter()
    ends = [fit(*lane) for lane in zip(start, problem.values, problem.scale, strict=True)]
    cost, converged, steps = np.array(jax.device_get(ends), float).T
    return Descent(cost, converged > 0, steps, (time.perf_counter() - begin) / len(start))


# The tables that are printed


class Compared(NamedTuple):
    """One loss: ours on all patches, scipy on some of them by each of its methods, and from the truth."""

    loss: str
    first: float
    warm: float
    ours: FitResult
    theirs: dict[str, Descent]
    from_truth: Descent

    @classmethod
    def of(cls, truth: Ellipsoid, tables: TabulatedNDF, loss: str) -> "Compared":
        problem = Problem.of(tables, loss, FEW)
        ours = timed(tables, loss)
        theirs = {method: by_scipy(problem, problem.start, method) for method in METHODS}
        return cls(loss, *ours, theirs, by_scipy(problem, numbers(truth)[:FEW], METHODS[0]))

    def speed(self) -> list[str]:
        ours = self.warm / len(self.ours.cost)
        theirs = [descent.seconds for descent in self.theirs.values()]
        each = [f"{1e6 * taken:.0f}" for taken in (ours, *theirs)]
        return [self.loss, f"{self.first:.2f}", f"{self.warm:.2f}", *each, f"{min(theirs) / ours:.1f}"]

    def ends(self) -> list[str]:
        """How many are above the lowest cost of scipy's, by how much, and how many of scipy's above ours."""
        ours = np.asarray(self.ours.cost)[:FEW]
        theirs = [*(descent.cost for descent in self.theirs.values()), self.from_truth.cost]
        excess = ours / np.min(theirs, axis=0) - 1
        above = [int(np.sum(cost > ours * (1 + WORSE))) for cost in theirs]
        open_ones = int(np.sum(~self.ours.success))
        return [
            self.loss,
            str(np.sum(excess > WORSE)),
            f"{excess.max():.0e}",
            *map(str, above),
            str(open_ones),
        ]


def compare(patches: int) -> Iterator[Printed]:
    """Time and cost of all patches."""
    truth = ellipsoids(patches, 1)
    tables = counted(truth, NORMALS, 2)
    found = [Compared.of(truth, tables, loss) for loss in LOSSES]
    yield Printed(
        f"{patches} patches, {os.cpu_count()} cores",
        ("loss", "first call, s", "warm, s", "µs a patch", *(f"scipy {m}, µs" for m in METHODS), "ratio"),
        [each.speed() for each in found],
    )
    yield Printed(
        f"costs of {FEW} patches, above another's by more than {WORSE:g} of it",
        (
            "loss",
            "ours",
            "largest",
            *(f"scipy {m}" for m in METHODS),
            "scipy, from the truth",
            "not converged",
        ),
        [each.ends() for each in found],
    )


def peak() -> float:
    """The largest memory so far, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def growth(most: int) -> Printed:
    """More and more patches."""
    rows = []
    for count in (size for size in SIZES if size <= most):
        tables = counted(ellipsoids(count, 3), NORMALS, 4)
        size = tables.values.nbytes / 2**20
        for loss in LOSSES:
            taken, _ = seconds(lambda tables=tables, loss=loss: fit_ndf_patches(ANY, tables, loss=loss))
            each = 1e6 * taken / count
            rows.append(
                [f"{count}", loss, f"{taken:.2f}", f"{each:.0f}", f"{size:.0f}", f"{peak() - size:.0f}"]
            )
        del tables
    columns = ("patches", "loss", "seconds", "µs a patch", "tables, MB", "peak without them, MB")
    return Printed("growth, one warm call each", columns, rows)


class Errors(NamedTuple):
    """Of fits to noise: rms errors, steps, and the share of parameters within three standard errors."""

    alpha: float
    mean: float
    steps: float
    within: float

    @classmethod
    def of(cls, truth: Ellipsoid, result: FitResult) -> "Errors":
        expected, found = numbers(named_like(truth, result.model)), numbers(result.model)
        alpha = np.sqrt(np.mean((found - expected)[:, :2] ** 2))
        deviation = (found - expected) / standard_errors(result)
        told = np.abs(expected[:, 0] - expected[:, 1]) > 0.2
        within = np.mean(np.abs(deviation[told]) < 3)
        return cls(alpha, mean_error(truth, result.model), np.mean(result.steps), within)


def named_like(truth: Ellipsoid, model: Ellipsoid) -> Ellipsoid:
    """The truth, each by the name that is nearest to that of a fit."""
    mean, G = slopes(truth)
    theta_z = np.asarray(model.theta_z)
    named = [Ellipsoid.of_slopes(mean[k], G[k], float(theta_z[k])) for k in range(len(mean))]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *named)


def slopes(model: Ellipsoid) -> list[np.ndarray]:
    """Mean slopes (B, 2) and squared roughnesses (B, 2, 2)."""
    return [np.asarray(part) for part in jax.jit(jax.vmap(Ellipsoid.slope_form))(model)]


def standard_errors(result: FitResult) -> np.ndarray:
    """Of `numbers`: those of log α are relative."""
    errors = np.sqrt(np.diagonal(result.covariance, axis1=1, axis2=2))
    alphas = np.exp(numbers(result.model)[:, :2])
    return np.concatenate([errors[:, :2] / alphas, errors[:, 2:]], axis=1)


def mean_error(truth: Ellipsoid, model: Ellipsoid) -> float:
    """The rms error of the mean slope, in units of α."""
    (mean, G), (found, _) = slopes(truth), slopes(model)
    difference = (found - mean)[..., None]
    return float(np.sqrt(np.mean(difference.mT @ np.linalg.solve(G, difference)) / 2))


def which_loss(patches: int) -> Printed:
    """What each loss makes of few normals and of many."""
    truth, rows = ellipsoids(patches, 5), []
    for normals in COUNTS:
        tables = counted(truth, normals, 6)
        l2, likelihood = (Errors.of(truth, fit_ndf_patches(ANY, tables, loss=loss)) for loss in LOSSES)
        for loss, errors in zip(LOSSES, (l2, likelihood), strict=True):
            ratios = [f"{errors.alpha / l2.alpha:.2f}", f"{errors.mean / l2.mean:.2f}"]
            rms = [f"{errors.alpha:.2g}", f"{errors.mean:.2g}"]
            more = [f"{errors.steps:.1f}", f"{100 * errors.within:.1f} %"]
            rows.append([f"{normals:.0e}", loss, rms[0], ratios[0], rms[1], ratios[1], *more])
    columns = ("normals", "loss", "log α", "/ L2", "mean slope, α", "/ L2", "steps", "within 3 σ")
    return Printed(f"rms errors over {patches} patches", columns, rows)


def which_descent(patches: int) -> Printed:
    """Steps by the true curvature, Levenberg–Marquardt on residuals of the deviance, or L-BFGS-B."""
    tables = counted(ellipsoids(AT_ONCE, 7), NORMALS, 8)
    problem = Problem.of(tables, "likelihood", patches)
    _, warm, ours = timed(tables, "likelihood")
    best, steps = (np.asarray(part)[:patches] for part in (ours.cost, ours.steps))
    descents = {
        f"ours, {AT_ONCE} at once": Descent(best, ours.success[:patches], steps, warm / AT_ONCE),
        "scipy lm": by_scipy(problem, problem.start, "lm"),
        "jaxopt L-BFGS-B, 1e-3": by_jaxopt(problem, problem.start, 1e-3),
        "jaxopt L-BFGS-B, 1e-5": by_jaxopt(problem, problem.start, 1e-5),
    }
    columns = ("", "µs a patch", "/ ours", "iterations", "converged", "median excess", "largest excess")
    rows = [[name, *descent_row(descent, best, warm / AT_ONCE)] for name, descent in descents.items()]
    return Printed(f"likelihood of {patches} patches", columns, rows)


def descent_row(descent: Descent, best: np.ndarray, fastest: float) -> list[str]:
    excess = descent.cost / best - 1
    times = [f"{1e6 * descent.seconds:.0f}", f"{descent.seconds / fastest:.1f}"]
    went = [f"{np.mean(descent.steps):.1f}", str(int(np.sum(descent.converged)))]
    return [*times, *went, f"{np.median(excess):.0e}", f"{excess.max():.0e}"]


def show(console: Console, printed: Printed) -> None:
    table = Table(*printed.columns, title=printed.title)
    for row in printed.rows:
        table.add_row(*row)
    console.print(table)


def write_csv(path: Path, tables: Sequence[Printed]) -> None:
    """All tables, one below the other."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        for title, columns, rows in tables:
            writer.writerows([[title], columns, *rows, []])


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--most", type=int, default=SIZES[-1], help="the most patches in one call")
    parser.add_argument("--csv", type=Path, help="write all tables here")
    args = parser.parse_args()
    console, printed = Console(width=110), []
    for table in tables(args.most):
        show(console, table)
        printed.append(table)
    if args.csv:
        write_csv(args.csv, printed)


def tables(most: int) -> Iterator[Printed]:
    yield from compare(min(PATCHES, most))
    yield which_loss(500)
    yield which_descent(50)
    yield growth(most)


if __name__ == "__main__":
    main()
