r"""Pictures of a reflectance: a lit surface in linear RGB and in CIE Lab, and how different two of them look.

Arrays in, arrays out; files and plots are made elsewhere.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxbrdf.arrays import channel_count
from jaxbrdf.brdf.base import AbstractBRDF
from jaxbrdf.directions import above_horizon, cos_theta, dot
from jaxbrdf.scene import Scene, lit_sphere
from jaxbrdf.special import safe_divide, safe_sqrt

_EXPOSED, _BRIGHTNESS = 0.9, 0.8  # so many points are exposed to no more than so much of display white

# From linear sRGB, whose white is D65: IEC 61966-2-1:1999.
_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def render(brdf: AbstractBRDF, scene: Scene) -> Float[Array, "P 3"]:
    r"""Linear R, G, B of each point, Σ f(wi, wo) cos θ_i · flux; pairs where f is NaN count as dark.

    A grey reflectance gives grey. Raises ValueError where the channels are neither one nor R, G and B.
    """
    return _rendered(brdf.anonymous, scene)


class Appearance(eqx.Module):
    r"""How a measurement looks in a scene, for models to be compared with.

    `used` (P, L) are the pairs at which it has a value in all channels; `picture` (P, 3) is its linear
    picture from these alone. The `exposure` is a factor that brings the brightest channel to at most 0.8 of
    display white in nine points of ten; it is 1 for a black picture.
    """

    scene: Scene
    used: Bool[Array, "P L"]
    picture: Float[Array, "P 3"]
    exposure: Float[Array, ""]

    @classmethod
    def of(cls, measured: AbstractBRDF, scene: Scene | None = None) -> "Appearance":
        """The appearance of any reflectance, by default as a `lit_sphere`. Raises ValueError as `render`."""
        scene = lit_sphere() if scene is None else scene
        used, picture, exposure = _appearance(measured.anonymous, scene)
        return cls(scene, used, picture, exposure)

    def difference(self, model: AbstractBRDF) -> Float[Array, ""]:
        r"""The mean over the points of ΔE*_ab between the model's picture and this one; see `lab_difference`.

        A batch of models is `jax.vmap` of it, some 10 MB each; many are better mapped in blocks, by
        `jax.lax.map` with a `batch_size`.
        """
        return _difference(self, model.anonymous)

    def lab(self, picture: Float[Array, "P 3"]) -> Float[Array, "P 3"]:
        """A linear picture as L*, a*, b*, exposed like this one and clipped at display white."""
        return to_lab(jnp.minimum(self.exposure * picture, 1))


def lab_difference(
    model: AbstractBRDF, measured: AbstractBRDF, scene: Scene | None = None
) -> Float[Array, ""]:
    r"""How different both look as a lit sphere: the mean over its points of ΔE*_ab = ‖Lab − Lab'‖ (CIE 1976).

    Both pictures hold the pairs at which the measurement has a value, and points without any are left out.
    Both are exposed by the factor that suits the measurement, and what is brighter than display white is
    clipped, so that lamps in mirrors do not rule everything; the gradient of what is clipped is 0. NaN where
    the measurement has no value at all or the model none where one is used. Raises ValueError as `render`.
    After Bieron & Peers 2020, who choose among fits by how they look.
    """
    return Appearance.of(measured, scene).difference(model)


@eqx.filter_jit
def _rendered(brdf: AbstractBRDF, scene: Scene) -> Float[Array, "P 3"]:
    f = _colours(brdf, scene)
    return _light(f, _known(f), scene)


@eqx.filter_jit
def _appearance(measured: AbstractBRDF, scene: Scene) -> tuple[Array, Array, Array]:
    f = _colours(measured, scene)
    used = _known(f) & above_horizon(cos_theta(scene.wi))
    picture = _light(f, used, scene)
    brightest = jnp.where(jnp.any(used, axis=1), jnp.max(picture, axis=1), jnp.nan)
    bright = jnp.nanquantile(brightest, _EXPOSED)
    return used, picture, jnp.where(bright > 0, safe_divide(_BRIGHTNESS, bright), 1)


@eqx.filter_jit
def _difference(appearance: Appearance, model: AbstractBRDF) -> Float[Array, ""]:
    scene, used = appearance.scene, appearance.used
    picture = _light(_colours(model, scene), used, scene)
    delta = appearance.lab(picture) - appearance.lab(appearance.picture)
    return jnp.mean(safe_sqrt(dot(delta, delta)), where=jnp.any(used, axis=1))


def _colours(brdf: AbstractBRDF, scene: Scene) -> Float[Array, "P L channels"]:
    """f at all pairs, of one channel or three."""
    channels = channel_count(brdf) or 1
    if channels not in (1, 3) or (channels == 3 and getattr(brdf, "wavelengths", None) is not None):
        raise ValueError(
            f"a picture is made of one grey channel or of R, G and B; found {channels} channels, or "
            "wavelengths: make colours of them first, as `data_loaders.to_rgb` does for a measurement"
        )
    f = brdf(scene.wi, scene.wo[:, None])
    return f if f.ndim == 3 else f[..., None]


def _known(f: Float[Array, "P L channels"]) -> Bool[Array, "P L"]:
    return jnp.all(jnp.isfinite(f), axis=-1)


def _light(f: Float[Array, "P L channels"], used: Bool[Array, "P L"], scene: Scene) -> Float[Array, "P 3"]:
    light = jnp.where(used, cos_theta(scene.wi) * scene.flux, 0)
    rgb = jnp.sum(jnp.where(used[..., None], f, 0) * light[..., None], axis=1)
    return jnp.broadcast_to(rgb, (len(rgb), 3))


def to_lab(rgb: Float[Array, "... 3"]) -> Float[Array, "... 3"]:
    r"""L*, a*, b* of linear sRGB, (..., 3), where 1 is white (CIE 15:2004, section 8.2.1).

        L* = 116 f(Y) − 16,   a* = 500 (f(X) − f(Y)),   b* = 200 (f(Y) − f(Z)),   X, Y, Z over D65's
        f(t) = t^⅓ for t > δ³,   t / (3 δ²) + 4/29 below,   δ = 6/29

    The straight line goes on for colours outside the gamut, where X, Y or Z may be negative.
    """
    to_xyz = jnp.asarray(_XYZ / _XYZ.sum(axis=1, keepdims=True), rgb.dtype)
    X, Y, Z = (_lightness(dot(rgb, row)) for row in to_xyz)
    return jnp.stack([116 * Y - 16, 500 * (X - Y), 200 * (Y - Z)], axis=-1)


def _lightness(t: Float[Array, "..."]) -> Float[Array, "..."]:
    """f(t) of `to_lab`."""
    delta = 6 / 29
    curved = t > delta**3
    return jnp.where(curved, jnp.cbrt(jnp.where(curved, t, 1)), t / (3 * delta**2) + 4 / 29)


def to_srgb(rgb: Float[Array, "..."]) -> Float[Array, "..."]:
    """Linear RGB as a display wants it, clipped to [0, 1] and encoded (IEC 61966-2-1:1999)."""
    x = jnp.clip(rgb, 0, 1)
    curved = x > 0.0031308
    return jnp.where(curved, 1.055 * jnp.where(curved, x, 1) ** (1 / 2.4) - 0.055, 12.92 * x)


def image(
    values: Float[Array, "P ..."], scene: Scene, background: float = 0.0
) -> Float[Array, "rows columns ..."]:
    """What belongs to the points of a scene, (P, ...), as a picture of it: (rows, columns, ...)."""
    blank = jnp.full((*scene.shape, *values.shape[1:]), background, values.dtype)
    return blank.at[scene.pixels[:, 0], scene.pixels[:, 1]].set(values)
