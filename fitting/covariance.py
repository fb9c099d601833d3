"""How well a fit determines its parameters."""

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

_FLAT = 1e-13  # eigenvalues of the scaled JᵀWJ below this share of the largest are rounding errors


def sandwich(
    jacobian: Float[Array, "N n"], residual: Float[Array, " N"], weight: Float[Array, " N"]
) -> Float[Array, "n n"]:
    r"""Covariance of weighted least squares whose weights are not the inverse variances.

        (JᵀWJ)⁻¹ JᵀW diag(r²) WJ (JᵀWJ)⁻¹ · N / (N − n)

    White 1980, with MacKinnon & White's HC1 factor; N counts the samples of weight > 0. The weights of our
    fits balance errors, they do not describe noise, so the noise is read off the residuals. A parameter
    that the samples do not determine, alone or only together with others, has NaN in its row and column.
    """
    gram = jacobian.T @ (weight[:, None] * jacobian)
    spread = jacobian.T @ ((weight * residual)[:, None] ** 2 * jacobian)
    return sandwich_of(gram, spread, jnp.sum(weight > 0))


def sandwich_of(
    gram: Float[Array, "n n"], spread: Float[Array, "n n"], count: ArrayLike
) -> Float[Array, "n n"]:
    """The same of JᵀWJ, JᵀW diag(r²) WJ and N."""
    scale = jnp.sqrt(jnp.diagonal(gram))
    safe = jnp.where(scale > 0, scale, 1)
    unit = jnp.outer(safe, safe)
    curvature, axes = jnp.linalg.eigh(gram / unit)
    known = curvature > _FLAT * curvature[-1]
    inverse = (axes * jnp.where(known, 1 / jnp.where(known, curvature, 1), 0)[None, :]) @ axes.T
    n = jnp.sum(known)
    factor = count / jnp.maximum(count - n, 1)
    covariance = factor * (inverse @ (spread / unit) @ inverse) / jnp.outer(scale, scale)
    # What lies in a flat direction is not determined.
    determined = jnp.all(jnp.where(known[None, :], 0, jnp.abs(axes)) < 1e-3, axis=1) & (count > n)
    return jnp.where(jnp.outer(determined, determined), (covariance + covariance.T) / 2, jnp.nan)
