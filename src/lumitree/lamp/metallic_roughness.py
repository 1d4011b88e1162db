"""The BSDF `lumitree_metallic_roughness`: surfaces of glTF and OBJ models.

It follows the metallic-roughness material of appendix B of the glTF 2.0 specification: a Lambertian
base under a dielectric layer of GGX microfacets, or a metal of such microfacets, both with
Schlick's Fresnel factor. Where the appendix leaves a choice it takes the models that conserve
energy and are reciprocal, which the appendix recommends (Kulla and Conty, 2017): the base gets the
light that the layer does not reflect, and light that microfacets scatter more than once is not
lost. A base colour of 1 therefore reflects everything, at any roughness.

Parameters are in [0, 1] unless stated, with their defaults; all but `eta` and `thin` may be
textures:

    base_color          colour of the base, of the metal, and of transmitted light (0.5)
    metallic            part of the surface that is metal (0)
    roughness           square root of the alpha of microfacets (0.5)
    anisotropic         stretches highlights as `principled` does (0). Scattering more than once is
                        compensated as for round highlights: up to a fifth of the light is lost
    eta                 index of refraction inside over the one outside, 1.001 to 10 (1.5)
    specular            factor on the reflection of the dielectric layer (1)
    spec_trans          part of the light below the layer that is transmitted (0). A solid refracts
                        it, and is tinted by the square root of `base_color` at each crossing
    thin                the surface is a sheet, which light crosses without refraction (false)
    diff_trans          twice the part of the base's light that leaves a sheet behind, in [0, 2] (0)
    clearcoat, clearcoat_roughness    a second dielectric layer, of index 1.5 (0)
    sheen               reflectance that the base gains at grazing angles, up to 1 (0)

Symbols
    m, p, g     parts of the surface that are metal, dielectric over a base, and clear
    E(μ)        directional albedo of the microfacets for single scattering, at the cosine μ of the
                angle to the normal; 1 - E(μ) is scattered more than once
    T(μ)        light that the dielectric layer lets pass, 1 minus its albedo
    C(μ)        light that the clear coat lets pass

Lobes, each with the cosine of the second direction in its value:

    base        p · base · T(μ_i) T(μ_o) / mean T, and (1 - E(μ_i)) (1 - E(μ_o)) / mean (1 - E) for
                the light that microfacets of metal and glass scatter more than once; both over π
    facet       single scattering by microfacets, D G F / (4 μ_i μ_o)
    behind, crossed     the same on the other side of the surface
    coat        single scattering by the clear coat; all other lobes are multiplied by C(μ_i) C(μ_o)

E is tabulated by numerical integration. Tables have the roughness, the root of alpha, along the
first axis and the root of the cosine along the second, both from 0 to 1: the albedo changes fast at
grazing angles.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.materials import MetallicRoughness
from lumitree.core.device import on_device, parameter

Floats = NDArray[np.float64]

# Entries along each axis of a table, and sampled normals for each entry.
SIZE, _SAMPLES = 48, 1024
# Least alpha of a surface; no normal is sampled in the plane of the surface.
MIN_ALPHA, _MIN_COSINE = 1e-3, 1e-4
_registered: set[str | None] = set()
# Parameters that may be textures, and their defaults.
_DEFAULTS = {
    name: value
    for name, value in MetallicRoughness().parameters.items()
    if name != "eta" and isinstance(value, float)
}
# Reflectance of the clear coat at normal incidence; and a bound of the variance of Schlick's factor
# over the hemisphere: two layers transmit more than the product of their mean transmittances.
_COAT, _COAT_VARIANCE = 0.04, 0.0145
# Numbers of the lobes; Mitsuba gets the facets' number for the coat.
_BASE, _FACET, _BEHIND, _CROSSED, _OF_COAT = range(5)


@functools.cache
def reflection_albedo() -> Floats:
    """[SIZE, SIZE, 2] albedo of microfacets that reflect 1 - s and s, with s = (1 - cos)⁵.

    cos is between a direction and the normal of a microfacet. By Schlick's approximation
    microfacets reflect f0 at normal incidence with an albedo of f0 times the first plus the second.
    """

    def reflected(alpha: float, cosine: Floats) -> tuple[Floats, Floats]:
        normal, facing = _visible_normals(alpha, cosine)
        weight = _unshadowed(alpha, 2 * facing * normal - cosine)
        tinted = weight * (1 - facing) ** 5
        return (weight - tinted).mean(axis=1), tinted.mean(axis=1)

    return _tabulated(reflected)


def glass_albedo(ior: float) -> tuple[Floats, float]:
    """Albedo of a dielectric's surface, and its reflectance for light from all directions outside.

    The albedo [2, SIZE, SIZE, 2] is the reflected part and the sum of both parts, from outside and
    from inside. `ior` is inside over outside, above 1.
    """

    def side(eta: float, alpha: float, cosine: Floats) -> tuple[Floats, Floats]:
        normal, facing = _visible_normals(alpha, cosine)
        part, refracted = _fresnel(facing, eta)
        mirrored = part * _unshadowed(alpha, 2 * facing * normal - cosine)
        through = (refracted - facing / eta) * normal + cosine / eta
        crossed = (1 - part) * _unshadowed(alpha, through)
        return mirrored.mean(axis=1), (mirrored + crossed).mean(axis=1)

    sides = [_tabulated(functools.partial(side, eta)) for eta in (ior, 1 / ior)]
    cosines = (np.arange(4096) + 0.5) / 4096
    reflectance = 2 * (cosines * _fresnel(cosines, ior)[0]).mean()
    return np.stack(sides), float(reflectance)


def hemisphere_mean(table: Floats) -> Floats:
    """Mean [..., C] of a table over the cosine-weighted hemisphere, linear between its entries.

    The table is [..., SIZE, C], with the root of the cosine along the last axis but one.
    """
    # The density of the root x is 4 x³; three points of Gauss and Legendre are exact.
    points, weights = np.polynomial.legendre.leggauss(3)
    place = (np.arange(SIZE - 1)[:, None] + (points + 1) / 2).ravel()
    density = 4 * (place / (SIZE - 1)) ** 3 * np.tile(weights / 2, SIZE - 1) / (SIZE - 1)
    weight = np.maximum(1 - np.abs(np.arange(SIZE)[:, None] - place), 0) @ density
    return np.einsum("...kc,k->...c", table, weight)


def _tabulated(values: Callable[[float, Floats], tuple[Floats, Floats]]) -> Floats:
    """[SIZE, SIZE, 2] values for an alpha and cosines [SIZE, 1]."""
    cosines = np.maximum(np.linspace(0, 1, SIZE) ** 2, _MIN_COSINE)[:, None]
    alphas = np.maximum(np.linspace(0, 1, SIZE) ** 2, MIN_ALPHA).tolist()
    with ThreadPoolExecutor(dr.thread_count()) as pool:
        rows = pool.map(lambda alpha: np.stack(values(alpha, cosines), axis=1), alphas)
        return np.stack(list(rows))


def _visible_normals(alpha: float, cosine: Floats) -> tuple[Floats, Floats]:
    """Cosines of normals with the surface's normal, and with the direction that sees them.

    The cosine of the direction [C, 1] gives [C, N] of N normals each.

    Heitz (2018), "Sampling the GGX Distribution of Visible Normals"; the direction is in the plane
    of x and z.
    """
    sine = np.sqrt(1 - cosine**2)
    x, z = np.array([alpha * sine, cosine]) / np.hypot(alpha * sine, cosine)
    # Points that fill the unit disk evenly, on a Fibonacci spiral.
    index = np.arange(_SAMPLES, dtype=np.float64)
    radius, azimuth = (
        np.sqrt((index + 0.5) / _SAMPLES),
        2 * np.pi * (index * 0.6180339887498949 % 1),
    )
    first, second = radius * np.cos(azimuth), radius * np.sin(azimuth)
    mixed = 0.5 * (1 + z)
    second = (1 - mixed) * np.sqrt(1 - first**2) + mixed * second
    third = np.sqrt(np.maximum(1 - first**2 - second**2, 0))
    # The frame of the stretched direction: y, and the direction's normal in the plane of x and z.
    stretched = alpha * (third * x - second * z), alpha * first, third * z + second * x
    length = np.sqrt(sum(each**2 for each in stretched))
    normal = np.maximum(stretched[2], 0) / length
    return normal, np.clip(sine * stretched[0] / length + cosine * normal, 0, 1)


def _unshadowed(alpha: float, cosine: Floats) -> Floats:
    """Smith's part of the microfacets that are not hidden, 0 below the surface."""
    above = np.maximum(cosine, 0)
    return 2 * above / (above + np.sqrt(alpha**2 + (1 - alpha**2) * above**2))


def _fresnel(cosine: Floats, eta: float) -> tuple[Floats, Floats]:
    """Reflected part, and cosine of the refracted direction, 0 where all is reflected.

    `eta` is the index of refraction behind the surface over the one before it.
    """
    behind = np.sqrt(np.maximum(1 - (1 - cosine**2) / eta**2, 0))
    parallel = (eta * cosine - behind) / np.maximum(eta * cosine + behind, 1e-12)
    across = (cosine - eta * behind) / np.maximum(cosine + eta * behind, 1e-12)
    return (parallel**2 + across**2) / 2, behind


class _Table:
    """A table [H, W, 2] over the unit square, linear between its entries."""

    def __init__(self, table: np.ndarray) -> None:
        values = mi.TensorXf(on_device(mi.Float, table), table.shape)
        self._texture = mi.Texture2f(values, use_accel=False)
        self._size = table.shape[1], table.shape[0]

    def __call__(self, first: mi.Float | float, second: mi.Float) -> tuple[mi.Float, mi.Float]:
        places = zip((first, second), self._size, strict=True)
        place = mi.Point2f(*((x * (size - 1) + 0.5) / size for x, size in places))
        values = self._texture.eval(place)
        return values[0], values[1]


class ReflectionLookup:
    """`reflection_albedo`: the two parts of the albedo."""

    def __init__(self) -> None:
        table = reflection_albedo()
        mean = hemisphere_mean(table)
        self._albedo = _Table(table)
        self._mean = _Table(np.stack([mean, mean], axis=1))

    def albedo(self, cosine: mi.Float, roughness: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Both parts for light from one direction."""
        return self._albedo(dr.sqrt(cosine), roughness)

    def mean(self, roughness: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Both parts for light from all directions."""
        return self._mean(0.5, roughness)


class GlassLookup:
    """`glass_albedo`, of one index of refraction."""

    def __init__(self, ior: float) -> None:
        table, reflectance = glass_albedo(ior)
        # The sides one above the other; a lookup stays within one of them.
        self._albedo = _Table(table.reshape(2 * SIZE, SIZE, 2))
        mean = hemisphere_mean(table)[..., 1].T
        self._mean = _Table(np.stack([mean, mean], axis=1))
        self._transmittance = 1 - reflectance

    def albedo(
        self, inside: mi.Bool, cosine: mi.Float, roughness: mi.Float
    ) -> tuple[mi.Float, mi.Float]:
        """Reflected part and sum of both parts, for light from one side."""
        step = (SIZE - 1) / (2 * SIZE - 1)
        return self._albedo(dr.sqrt(cosine), dr.select(inside, 1 - step, 0) + step * roughness)

    def rebounds(
        self, inside: mi.Bool, roughness: mi.Float, squared: mi.Float
    ) -> tuple[mi.Float, mi.Float, mi.Float, mi.Float]:
        """Photons that microfacets scatter more than once, by the side that they arrive from.

        Parts that stay on their side and that cross; and means of 1 - E on their side and on the
        other one. `inside` is the denser medium; `squared` the square of the index of refraction.
        """
        lost = [dr.maximum(1 - mean, 1e-6) for mean in self._mean(0.5, roughness)]
        here, there = dr.select(inside, lost[1], lost[0]), dr.select(inside, lost[0], lost[1])
        # Equal radiance on both sides stays equal: n² times as many arrive from the denser medium.
        crossing = self._transmittance * dr.minimum(here, there)
        crossing = dr.select(inside, crossing / squared, crossing)
        return 1 - crossing / here, crossing / here, here, there


@functools.cache
def reflection_lookup(variant: str) -> ReflectionLookup:
    """The lookup for a variant of Mitsuba, which is set."""
    return ReflectionLookup()


@functools.lru_cache(maxsize=64)
def glass_lookup(variant: str, ior: float) -> GlassLookup:
    """The lookup for a variant of Mitsuba, which is set, and an index of refraction."""
    return GlassLookup(ior)


def _schlick(cosine: mi.Float) -> mi.Float:
    """Weight of the reflectance at grazing angles."""
    return dr.power(1 - dr.clip(cosine, 0, 1), 5)


def _ggx(alphas: Sequence[mi.Float]) -> mi.MicrofacetDistribution:
    return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, *alphas)


class _Point:
    """A point of the surface: all that does not depend on the second direction.

    Directions are turned so that the first one, `wi`, is above the surface.
    """

    def __init__(self, bsdf, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, active) -> None:
        below = si.wi.z < 0
        self.bsdf, self.turn = bsdf, dr.select(below, mi.Float(-1), 1)
        self.wi = si.wi * self.turn
        self.inside = below & (bsdf.glass is not None)
        self.active = active & (si.wi.z != 0 if bsdf.has_back else si.wi.z > 0)
        self.radiance = ctx.mode == mi.TransportMode.Radiance
        # For base, facets, base behind, crossed and coat.
        used = [ctx.is_enabled(kind, i) for i, kind in enumerate(bsdf.kinds)]
        self.enabled = [*used, *[False] * (_OF_COAT - len(used)), used[_FACET]]
        self._read(si)
        self._look_up()
        self._weigh()

    def _read(self, si: mi.SurfaceInteraction3f) -> None:
        """Parameters of the point."""
        bsdf = self.bsdf

        def value(name: str) -> mi.Float:
            given = name not in bsdf.absent
            return bsdf.textures[name].eval_1(si, self.active) if given else mi.Float(0)

        self.base = mi.Spectrum(bsdf.textures["base_color"].eval(si, self.active))
        self.tint = self.base if bsdf.thin else dr.sqrt(self.base)
        self.metal, through = value("metallic"), value("spec_trans")
        self.clear = (1 - self.metal) * through
        self.opaque = (1 - self.metal) * (1 - through)
        if bsdf.glass is not None:
            # From inside, light meets the clear part only; the rest absorbs it.
            self.metal = dr.select(self.inside, 0, self.metal)
            self.opaque = dr.select(self.inside, 0, self.opaque)
        self.eta = dr.select(self.inside, dr.rcp(bsdf.eta), bsdf.eta)
        self.specular, self.behind = value("specular"), value("diff_trans") / 2
        self.coat, self.sheen = value("clearcoat"), value("sheen")
        alpha, aspect = dr.square(value("roughness")), dr.sqrt(1 - 0.9 * value("anisotropic"))
        along = dr.maximum(alpha / aspect, MIN_ALPHA)
        self.alphas = along, dr.maximum(alpha * aspect, MIN_ALPHA)
        self.roughness = dr.minimum(dr.sqrt(dr.sqrt(along * self.alphas[1])), 1)
        self.coat_roughness = value("clearcoat_roughness")
        self.coat_alphas = (dr.maximum(dr.square(self.coat_roughness), MIN_ALPHA),) * 2

    def _look_up(self) -> None:
        """Means over the hemisphere, and what passes the layers in the first direction."""
        bsdf = self.bsdf
        tinted, grazing = bsdf.lookup.mean(self.roughness)
        found = tinted + grazing
        self.lost_mean = dr.maximum(1 - found, 1e-6)
        average = self.base + (1 - self.base) / 21
        # The part that leaves of the light that microfacets of metal scatter more than once.
        self.rebound = dr.square(average) * found / (1 - average * self.lost_mean)
        self.layer_mean = 1 - self.layer(tinted, grazing)
        stays = self.specular * (bsdf.f0 + (1 - bsdf.f0) / 21)
        self.glass = stays, 1 - stays, self.lost_mean, self.lost_mean
        if bsdf.glass is not None:
            self.glass = bsdf.glass.rebounds(self.inside, self.roughness, dr.square(bsdf.eta))
        self.coat_mean = mi.Float(1)
        if bsdf.coated:
            tinted, grazing = bsdf.lookup.mean(self.coat_roughness)
            self.coat_mean = 1 - self.coat * (_COAT * tinted + grazing - _COAT_VARIANCE)
        self.albedo = bsdf.lookup.albedo(self.wi.z, self.roughness)
        self.passed = self.passing(self.wi.z, self.albedo, self.inside)

    def layer(self, tinted: mi.Float, grazing: mi.Float) -> mi.Float:
        """Reflection of the dielectric layer, of both parts of an albedo or of Schlick's factor."""
        return self.specular * (self.bsdf.f0 * tinted + grazing)

    def passing(
        self, cosine: mi.Float, albedo: tuple[mi.Float, mi.Float], inside: mi.Bool
    ) -> tuple[mi.Float, ...]:
        """1 - E of metal, T, 1 - E of glass, and C, for one direction."""
        bsdf, lost, coat = self.bsdf, 1 - albedo[0] - albedo[1], mi.Float(1)
        glass = lost
        if bsdf.glass is not None:
            glass = 1 - bsdf.glass.albedo(inside, cosine, self.roughness)[1]
        if bsdf.coated:
            tinted, grazing = bsdf.lookup.albedo(cosine, self.coat_roughness)
            coat = dr.select(inside, 1, 1 - self.coat * (_COAT * tinted + grazing))
        return lost, 1 - self.layer(*albedo), glass, coat

    def _weigh(self) -> None:
        """Probabilities of the lobes, in proportion to their albedo."""
        bsdf, (tinted, grazing) = self.bsdf, self.albedo
        lost, under, glass, coat = self.passed
        base, tint = dr.mean(self.base), dr.mean(self.tint)
        mirrored = self.layer(tinted, grazing)
        facet = self.metal * (base * tinted + grazing) + self.opaque * mirrored
        diffuse = self.metal * dr.mean(self.rebound) * lost
        diffuse += self.opaque * (1 - self.behind) * (base + 0.2 * self.sheen) * under
        behind = through = mi.Float(0)
        if bsdf.transmits:
            stays, crosses = self.glass[:2]
            if bsdf.glass is not None:
                mirrored = bsdf.glass.albedo(self.inside, self.wi.z, self.roughness)[0]
            diffuse += self.clear * stays * glass
            facet += self.clear * mirrored
            behind = self.opaque * self.behind * base * under + self.clear * tint * crosses * glass
            through = self.clear * tint * dr.maximum(1 - glass - mirrored, 0)
        weights = [*(each * coat for each in (diffuse, facet, behind, through)), 1 - coat]
        weights = [
            weight if used else mi.Float(0)
            for weight, used in zip(weights, self.enabled, strict=True)
        ]
        total = functools.reduce(operator.add, weights)
        self.pmf = [dr.select(total > 0, weight / total, 0) for weight in weights]

    def scattered(self, cosine: mi.Float) -> tuple[mi.Spectrum, mi.Spectrum, mi.Float]:
        """Factors of reflected and transmitted light of a microfacet; probability of reflection."""
        bsdf, grazing = self.bsdf, _schlick(cosine)
        layer = self.layer(1 - grazing, grazing)
        reflected = self.metal * (self.base * (1 - grazing) + grazing) + self.opaque * layer
        if not bsdf.transmits:
            return reflected, mi.Spectrum(0), mi.Float(1)
        if bsdf.glass is not None:
            layer = mi.fresnel(cosine, self.eta)[0]
        reflected += self.clear * layer
        crossed = self.clear * self.tint * (1 - layer)
        reflected = reflected if self.enabled[_FACET] else mi.Spectrum(0)
        crossed = crossed if self.enabled[_CROSSED] else mi.Spectrum(0)
        both = dr.mean(reflected) + dr.mean(crossed)
        return reflected, crossed, dr.select(both > 0, dr.mean(reflected) / both, 0)

    def evaluate(self, wo: mi.Vector3f) -> tuple[mi.Spectrum, mi.Float]:
        """Value, and density for a second direction."""
        bsdf, wo = self.bsdf, wo * self.turn
        above, cosine = wo.z > 0, dr.abs(wo.z)
        active = self.active & (wo.z != 0 if bsdf.transmits else above)
        albedo = bsdf.lookup.albedo(cosine, self.roughness)
        passed = self.passing(cosine, albedo, self.inside ^ ~above)
        products = [first * second for first, second in zip(self.passed, passed, strict=True)]
        value, pdf = self._base(wo, above, products)
        facets, density = self._facets(wo, above)
        value, pdf = (value + facets) * products[3], pdf + density
        if bsdf.glass is not None and self.radiance:
            value *= dr.select(above, 1, dr.rcp(dr.square(self.eta)))
        if bsdf.coated and self.enabled[_OF_COAT]:
            coat, density = self._coat(wo, above & ~self.inside)
            value, pdf = value + coat, pdf + density
        return value & active, dr.select(active, pdf, 0)

    def _base(
        self, wo: mi.Vector3f, above: mi.Bool, passed: list[mi.Float]
    ) -> tuple[mi.Spectrum, mi.Float]:
        """The lobes of the base and of multiple scattering, on both sides."""
        lost, under, glass, _ = passed
        base, under = self.base, under / self.layer_mean
        stays, crosses, here, there = self.glass
        cosine, pmf = dr.abs(wo.z) * dr.inv_pi, self.pmf[_BASE]
        if "sheen" not in self.bsdf.absent:
            grazing = _schlick(dr.dot(wo, dr.normalize(self.wi + wo)))
            base = dr.minimum(base + self.sheen / dr.inv_pi * grazing, 1)
        value = self.metal * self.rebound * lost / self.lost_mean
        value += self.opaque * (1 - self.behind) * base * under
        if self.bsdf.transmits:
            value += self.clear * stays * glass / here
        value = value if self.enabled[_BASE] else mi.Spectrum(0)
        if self.bsdf.transmits:
            crossed = self.opaque * self.behind * self.base * under
            crossed += self.clear * self.tint * crosses * glass / there
            crossed = crossed if self.enabled[_BEHIND] else mi.Spectrum(0)
            value = dr.select(above, value, crossed)
            pmf = dr.select(above, pmf, self.pmf[_BEHIND])
        return value * cosine / self.coat_mean, cosine * pmf

    def _facets(self, wo: mi.Vector3f, above: mi.Bool) -> tuple[mi.Spectrum, mi.Float]:
        """The lobes of single scattering by the microfacets, on both sides."""
        bsdf, wi = self.bsdf, self.wi
        if bsdf.glass is None:
            # A sheet transmits where it would reflect, mirrored.
            wo = mi.Vector3f(wo.x, wo.y, dr.abs(wo.z))
            normal = dr.normalize(wi + wo)
            cosine = dr.dot(wi, normal)
            stretch = dr.rcp(4 * cosine)
        else:
            normal = dr.normalize(wi + dr.select(above, 1, self.eta) * wo)
            normal = dr.mulsign(normal, normal.z)
            cosine, other = dr.dot(wi, normal), dr.dot(wo, normal)
            refracted = dr.abs(other) * dr.square(self.eta / (cosine + self.eta * other))
            stretch = dr.select(above, dr.rcp(4 * cosine), refracted)
            stretch = dr.select(above == (other > 0), stretch, 0)
        reflected, crossed, share = self.scattered(cosine)
        facets = _ggx(self.alphas)
        density = facets.eval(normal) * facets.smith_g1(wi, normal) * cosine / wi.z * stretch
        density = dr.select(cosine > 0, density, 0)
        value = reflected if self.enabled[_FACET] else mi.Spectrum(0)
        if bsdf.transmits:
            value, share = dr.select(above, value, crossed), dr.select(above, share, 1 - share)
        pmf = self.pmf[_FACET] + self.pmf[_CROSSED]
        return value * density * facets.smith_g1(wo, normal), pmf * share * density

    def _coat(self, wo: mi.Vector3f, active: mi.Bool) -> tuple[mi.Float, mi.Float]:
        """The lobe of the clear coat."""
        normal = dr.normalize(self.wi + wo)
        facets = _ggx(self.coat_alphas)
        density = facets.eval(normal) * facets.smith_g1(self.wi, normal) / (4 * self.wi.z)
        density = dr.select(active, density, 0)
        factor = self.coat * (_COAT + (1 - _COAT) * _schlick(dr.dot(self.wi, normal)))
        return factor * density * facets.smith_g1(wo, normal), self.pmf[_OF_COAT] * density

    def propose(self, sample: mi.Float, square: mi.Point2f) -> tuple[mi.Vector3f, mi.UInt32]:
        """A second direction, and the number of its lobe."""
        bsdf, wi = self.bsdf, self.wi
        # In the order: facets, coat, base, base behind.
        facets, coat = self.pmf[_FACET] + self.pmf[_CROSSED], self.pmf[_OF_COAT]
        is_facet, is_single = sample < facets, sample < facets + coat
        alphas = [
            dr.select(is_facet, alpha, coat)
            for alpha, coat in zip(self.alphas, self.coat_alphas, strict=True)
        ]
        normal, _ = _ggx(alphas if bsdf.coated else self.alphas).sample(wi, square)
        cosine = dr.dot(wi, normal)
        single, diffuse = 2 * cosine * normal - wi, mi.warp.square_to_cosine_hemisphere(square)
        lobe = dr.select(is_single, mi.UInt32(_FACET), _BASE)
        if bsdf.transmits:
            crosses = is_facet & (sample >= facets * self.scattered(cosine)[2])
            through = mi.Vector3f(single.x, single.y, -single.z)
            if bsdf.glass is not None:
                _, refracted, _, inverse = mi.fresnel(cosine, self.eta)
                through = normal * (cosine * inverse + refracted) - wi * inverse
            single = dr.select(crosses, through, single)
            behind = sample >= facets + coat + self.pmf[_BASE]
            diffuse.z = dr.select(behind, -diffuse.z, diffuse.z)
            lobe = dr.select(crosses, mi.UInt32(_CROSSED), lobe)
            lobe = dr.select(behind & ~is_single, mi.UInt32(_BEHIND), lobe)
        return dr.select(is_single, single, diffuse), lobe


def register() -> None:
    """Register the BSDF with the variant of Mitsuba that is set; harmless when repeated."""
    if mi.variant() not in _registered:
        mi.register_bsdf(MetallicRoughness.plugin, _bsdf_class())
        _registered.add(mi.variant())


def _bsdf_class() -> type:
    """Class of the BSDF for the variant of Mitsuba that is set, whose base class it extends."""

    class LumitreeMetallicRoughness(mi.BSDF):
        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            given = _DEFAULTS | {name: props.get(name) for name in _DEFAULTS if name in props}
            # Parameters that are 0 everywhere.
            self.absent = {
                name for name, value in given.items() if isinstance(value, float) and value == 0
            }
            self.textures = {
                name: props.get_texture(name, value) for name, value in _DEFAULTS.items()
            }
            ior, self.thin = (
                float(props.get("eta", MetallicRoughness.eta)),
                bool(props.get("thin", False)),
            )
            self.absent |= set() if self.thin else {"diff_trans"}
            self.eta = parameter(mi.Float, ior)
            self.f0 = parameter(mi.Float, ((ior - 1) / (ior + 1)) ** 2)
            clear, self.coated = "spec_trans" not in self.absent, "clearcoat" not in self.absent
            self.transmits = clear or "diff_trans" not in self.absent
            self.has_back = self.thin or self.transmits
            self.lookup = reflection_lookup(mi.variant())
            self.glass = glass_lookup(mi.variant(), ior) if clear and not self.thin else None
            flags = mi.BSDFFlags
            self.kinds = [flags.DiffuseReflection, flags.GlossyReflection]
            if self.transmits:
                self.kinds += [flags.DiffuseTransmission, flags.GlossyTransmission]
            sides = flags.FrontSide | (flags.BackSide if self.has_back else 0)
            # Refraction scales radiance.
            scaled = [0, 0] + [0 if self.glass is None else flags.NonSymmetric] * 2
            self.m_components = [
                kind | sides | scale for kind, scale in zip(self.kinds, scaled, strict=False)
            ]
            self.m_flags = functools.reduce(operator.or_, self.m_components)

        def traverse(self, callback) -> None:
            for name, texture in self.textures.items():
                callback.put(name, texture, mi.ParamFlags.Differentiable)

        def sample(self, ctx, si, sample1, sample2, active=True):
            point = _Point(self, ctx, si, active)
            wo, lobe = point.propose(sample1, sample2)
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo, bs.sampled_component, bs.eta = wo * point.turn, lobe, 1
            bs.sampled_type = mi.UInt32(+self.kinds[_BASE])
            for number, kind in enumerate(self.kinds):
                bs.sampled_type = dr.select(lobe == number, mi.UInt32(+kind), bs.sampled_type)
            if self.glass is not None:
                bs.eta = dr.select(lobe >= _BEHIND, point.eta, 1)
            value, bs.pdf = point.evaluate(bs.wo)
            # A microfacet may reflect light down, where another lobe has a density of its own.
            valid = (bs.pdf > 0) & ((lobe < _BEHIND) == (wo.z > 0))
            bs.pdf = dr.select(valid, bs.pdf, 0)
            return bs, (value / bs.pdf) & valid

        def eval(self, ctx, si, wo, active=True):
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx, si, wo, active=True):
            return self.eval_pdf(ctx, si, wo, active)[1]

        def eval_pdf(self, ctx, si, wo, active=True):
            return _Point(self, ctx, si, active).evaluate(wo)

        def eval_diffuse_reflectance(self, si, active=True):
            return self.textures["base_color"].eval(si, active)

        def to_string(self) -> str:
            return f"LumitreeMetallicRoughness[base_color={self.textures['base_color']}]"

    return LumitreeMetallicRoughness
