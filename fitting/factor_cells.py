r"""A measured table as the fit of free factors sees it: its cells, and the sums over them.

The factors D, F and G1 have nodes, and every cell a node of D (its θ_h), one of F (its θ_d), and two of G1
around each of θ_i and θ_o. All that a step of the fit needs are sums over the cells that share a node, or a
pair of nodes: products with sparse matrices, which are made once for a grid.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from jaxbrdf.brdf.measured import MeasuredBRDF
from jaxbrdf.quadrature import HalfDifferenceGrid

_PHI = 12  # bins of φ_d
_POLAR = 46  # nodes of G1, from the normal to the horizon

Terms = list[tuple[np.ndarray, np.ndarray]]  # of each cell: a few rows, and the entry in each


class Cells(NamedTuple):
    """N cells, each the mean over a bin of φ_d of the samples with both directions below the largest angle.

    `h` and `d` are the nodes of D and F; `used` (H, E, P) tells which samples of the grid count, `starts`
    where the bins begin, `filled` (H, E, bins) which bins are cells.
    """

    h: Int[np.ndarray, " N"]
    d: Int[np.ndarray, " N"]
    cos_i: Float[np.ndarray, " N"]
    cos_o: Float[np.ndarray, " N"]
    used: np.ndarray
    starts: np.ndarray
    filled: np.ndarray

    def mean(self, measured: MeasuredBRDF) -> tuple[np.ndarray, np.ndarray]:
        """The reflectance of each cell, (N, C), and the dω_i dω_o of its valid samples: 0 where none is."""
        raw = np.asarray(measured.raw)
        valid = (raw >= 0) & self.used[..., None]
        share = valid * np.asarray(measured.grid.measure())[..., None]
        measure = np.add.reduceat(share, self.starts, axis=2)[self.filled]
        total = np.add.reduceat(share * np.where(valid, raw, 0), self.starts, axis=2)[self.filled]
        return total / np.where(measure > 0, measure, 1) * measured.scale, measure


def make_cells(grid: HalfDifferenceGrid, max_angle: float) -> Cells:
    cosines = [np.asarray(c) for c in grid.cosines()]
    used = np.minimum(*cosines) > max(np.cos(max_angle), 0)
    starts = np.unique(np.linspace(0, grid.shape[2], _PHI, endpoint=False).astype(int))
    measure = used * np.broadcast_to(grid.measure(), grid.shape)
    in_bin = np.add.reduceat(measure, starts, axis=2)
    filled = in_bin > 0
    h, d, _ = np.nonzero(filled)
    cos_i, cos_o = (np.add.reduceat(measure * c, starts, axis=2)[filled] / in_bin[filled] for c in cosines)
    return Cells(h, d, cos_i, cos_o, used, starts, filled)


class Sums:
    r"""The sums over cells by which f changes with the logarithms of ρ_d and of the factors' nodes.

        s = D_h F_d g_i g_o / 4,   g = Σ_k G1_k B_k(θ) / cos θ
        ∂f / ∂ log (ρ_d, D, F, G1_k) = ρ_d/π,   s,   s,   s G1_k (B_k(θ_i) / cos θ_i g_i + the same of θ_o)

    B_k are the hat functions of the nodes of G1, the last of which, at the horizon, stays 0.
    """

    def __init__(self, cells: Cells, grid: HalfDifferenceGrid):
        self.cells = cells
        self.sizes = (*grid.shape[:2], _POLAR - 1)
        h, d = ([(node, np.ones(len(node)))] for node in (cells.h, cells.d))
        i, o = (_hats(cos) for cos in (cells.cos_i, cells.cos_o))
        H, E, K = self.sizes
        self.h, self.d, self.hd = _matrix(h, H), _matrix(d, E), _matrix(_pairs(h, d, E), H * E)
        self.i, self.o = _matrix(i, K), _matrix(o, K)
        self.hi, self.ho = (_matrix(_pairs(h, w, K), H * K) for w in (i, o))
        self.di, self.do = (_matrix(_pairs(d, w, K), E * K) for w in (i, o))
        self.ii, self.oo = (_matrix(_pairs(w, w, K), K * K) for w in (i, o))
        self.io = _matrix(_pairs(i, o, K) + _pairs(o, i, K), K * K)
        self.at_i, self.at_o = self.i.T.tocsr(), self.o.T.tocsr()

    def lobe(self, D, F, G1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """s, g_i and g_o of each cell."""
        g_i, g_o = self.at_i @ G1, self.at_o @ G1
        return D[self.cells.h] * F[self.cells.d] * g_i * g_o / 4, g_i, g_o

    def project(self, v, G1, g_i, g_o) -> np.ndarray:
        """Σ v ∂f/∂log (D, F, G1) / s."""
        return np.concatenate([self.h @ v, self.d @ v, G1 * (self.i @ (v / g_i) + self.o @ (v / g_o))])

    def gram(self, v, G1, g_i, g_o) -> np.ndarray:
        """Σ v of the products of these derivatives, / s²: (n, n), the upper blocks alone."""
        H, E, K = self.sizes
        blocks = np.zeros((H + E + K,) * 2)
        a, b, c = (slice(*ends) for ends in pairwise(np.cumsum([0, *self.sizes])))
        v_i, v_o = v / g_i, v / g_o
        blocks[a, a], blocks[b, b] = np.diag(self.h @ v), np.diag(self.d @ v)
        blocks[a, b] = (self.hd @ v).reshape(H, E)
        blocks[a, c] = (self.hi @ v_i + self.ho @ v_o).reshape(H, K) * G1
        blocks[b, c] = (self.di @ v_i + self.do @ v_o).reshape(E, K) * G1
        of_pairs = self.ii @ (v_i / g_i) + self.oo @ (v_o / g_o) + self.io @ (v_i / g_o)
        blocks[c, c] = of_pairs.reshape(K, K) * np.outer(G1, G1)
        return blocks


def polar_nodes() -> Float[np.ndarray, " K"]:
    """Where G1 is tabulated."""
    return np.linspace(0, np.pi / 2, _POLAR)


def _hats(cos: np.ndarray) -> Terms:
    """B_k(θ) / cos θ of the two nodes around θ; that of the horizon is left out."""
    position = np.arccos(np.minimum(cos, 1)) * (_POLAR - 1) / (np.pi / 2)
    lower = np.minimum(position.astype(int), _POLAR - 2)
    upper = np.minimum(lower + 1, _POLAR - 2)
    share = position - lower
    return [(lower, (1 - share) / cos), (upper, np.where(lower + 1 == upper, share, 0) / cos)]


def _pairs(first: Terms, second: Terms, size: int) -> Terms:
    return [(r * size + s, x * y) for r, x in first for s, y in second]


def _matrix(terms: Terms, size: int) -> csr_array:
    """(size, N) of the entries of each cell."""
    count = len(terms[0][0])
    rows, entries = (np.concatenate(parts) for parts in zip(*terms, strict=True))
    return csr_array((entries, (rows, np.tile(np.arange(count), len(terms)))), shape=(size, count))
