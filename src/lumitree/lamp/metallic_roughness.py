"""The BSDF `lumitree_metallic_roughness`: surfaces of glTF and OBJ models.

It follows the metallic-roughness material of appendix B of the glTF 2.0 specification: a Lambertian
base under a dielectric layer of GGX microfacets, or a metal of such microfacets, both with Schlick's
Fresnel factor. Where the appendix leaves a choice it takes the models that conserve energy and are
reciprocal, which the appendix recommends (Kulla and Conty, 2017): the base gets the light that the
layer does not reflect, and light that microfacets scatter more than once is not lost. A base colour
of 1 therefore reflects everything, at any roughness.

Parameters, in [0, 1] unless stated; all but `eta` and `thin` may be textures:

    base_color          colour of the base, of the metal, and of transmitted light (0.5)
    metallic            part of the surface that is metal (0)
    roughness           square root of the alpha of microfacets (0.5)
    anisotropic         stretches highlights as `principled` does (0)
    eta                 index of refraction inside over the one outside, above 1 (1.5)
    specular            factor on the reflection of the dielectric layer (1)
    spec_trans          part of the light below the layer that is transmitted (0). A solid refracts
                        it; its colour is the square root of `base_color`, once at each crossing
    thin                the surface is a sheet, which light crosses without refraction (false)
    diff_trans          twice the part of the base's light that leaves a sheet behind, in [0, 2] (0)
    clearcoat, clearcoat_roughness    a second dielectric layer, of index 1.5 (0)
    sheen               of the base: reflectance at grazing angles, never above 1 (0)
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from lumitree.core.backend import load_mitsuba
from lumitree.core.device import on_device, parameter
from lumitree.lamp.microfacet_albedo import (
    MIN_ALPHA,
    SIZE,
    glass_albedo,
    hemisphere_mean,
    reflection_albedo,
)

METALLIC_ROUGHNESS = "lumitree_metallic_roughness"
# Parameters that may be textures, and their defaults.
_VALUES = {
    "base_color": 0.5,
    "metallic": 0.0,
    "roughness": 0.5,
    "anisotropic": 0.0,
    "specular": 1.0,
    "spec_trans": 0.0,
    "diff_trans": 0.0,
    "clearcoat": 0.0,
    "clearcoat_roughness": 0.0,
    "sheen": 0.0,
}
# Reflectance of a clear coat at normal incidence; and a bound of the variance of Schlick's factor
# over the hemisphere: two layers transmit more than the product of their mean transmittances.
_COAT, _COAT_VARIANCE = 0.04, 0.0145
_registered: set[str] = set()


def register_metallic_roughness() -> None:
    """Register the BSDF with the variant of Mitsuba that is set; harmless when repeated."""
    mi = load_mitsuba()
    if mi.variant() not in _registered:
        _registered.add(mi.variant())
        mi.register_bsdf(METALLIC_ROUGHNESS, _bsdf_class())


class _Albedo:
    """A table of `microfacet_albedo` on the device."""

    def __init__(self, table: np.ndarray) -> None:
        mi = load_mitsuba()
        values = mi.TensorXf(on_device(mi.Float, table), table.shape)
        self._texture = mi.Texture2f(values, use_accel=False)
        self._size = table.shape[1], table.shape[0]

    def __call__(self, first: Any, second: Any) -> list[Any]:
        """Channels at two coordinates in [0, 1], linear between the entries."""
        mi = load_mitsuba()
        places = zip((first, second), self._size, strict=True)
        return self._texture.eval(
            mi.Point2f(*((place * (size - 1) + 0.5) / size for place, size in places))
        )


@functools.cache
def _reflection(variant: str) -> tuple[_Albedo, _Albedo]:
    """`reflection_albedo` by cosine and roughness, and its mean over the hemisphere."""
    table = reflection_albedo()
    mean = hemisphere_mean(table)
    return _Albedo(table), _Albedo(np.stack([mean, mean], axis=1))


class _Glass:
    """The surface of a solid dielectric: the albedo of single scattering, and its mean."""

    def __init__(self, ior: float) -> None:
        found = glass_albedo(ior)
        # The sides one above the other; a lookup stays within one of them.
        self._albedo = _Albedo(found.table.reshape(2 * SIZE, SIZE, 2))
        mean = hemisphere_mean(found.table)[..., 1].T
        self._mean = _Albedo(np.stack([mean, mean], axis=1))
        self._transmittance = 1 - found.reflectance

    def albedo(self, inside: Any, cosine: Any, roughness: Any) -> tuple[Any, Any]:
        """Reflected part and sum of both parts, of light from one side."""
        import drjit as dr

        step = (SIZE - 1) / (2 * SIZE - 1)
        reflected, both = self._albedo(
            dr.sqrt(cosine), dr.select(inside, 1 - step, 0) + step * roughness
        )
        return reflected, both

    def shares(self, inside: Any, roughness: Any, squared: Any) -> tuple[Any, Any, Any, Any]:
        """Photons that microfacets scatter more than once, by the side that they arrive from.

        Args:
            squared: square of the index of refraction.

        Returns:
            parts that stay on their side and that cross; means of 1 - E on their side and behind.
        """
        import drjit as dr

        lost = [dr.maximum(1 - mean, 1e-6) for mean in self._mean(0.5, roughness)]
        here, there = dr.select(inside, lost[1], lost[0]), dr.select(inside, lost[0], lost[1])
        # Of photons from all directions. Equal radiance on both sides stays equal, if n² times as
        # many arrive from the denser medium.
        crossing = self._transmittance * dr.minimum(here, there)
        crossing = dr.select(inside, crossing / squared, crossing)
        return 1 - crossing / here, crossing / here, here, there


@functools.lru_cache(maxsize=64)
def _glass(variant: str, ior: float) -> _Glass:
    return _Glass(ior)


def _bsdf_class() -> type:
    """Class of the BSDF for the variant of Mitsuba that is set, whose base class it extends."""
    import drjit as dr
    import mitsuba as mi

    flags = mi.BSDFFlags

    class Point:
        """A point of the surface: all that does not depend on the second direction.

        Directions are turned so that the first one is above the surface.
        """

        def __init__(self, bsdf: Any, ctx: Any, si: Any, active: Any) -> None:
            self.bsdf, below = bsdf, si.wi.z < 0
            self.turn = dr.select(below, mi.Float(-1), 1)
            self.wi = si.wi * self.turn
            self.inside = below & (bsdf.glass is not None)
            self.active = active & ((si.wi.z != 0) if bsdf.transmits else (si.wi.z > 0))
            self._read(si)
            self._look_up()
            self._weigh(ctx)

        def _read(self, si: Any) -> None:
            """The parameters of the point."""
            bsdf, active = self.bsdf, self.active
            self.base = mi.Spectrum(bsdf.textures["base_color"].eval(si, active))
            self.specular = bsdf.value("specular", si, active)
            self.clearcoat = bsdf.value("clearcoat", si, active)
            self.sheen = bsdf.value("sheen", si, active)
            self.behind = bsdf.value("diff_trans", si, active) / 2
            self.metal = bsdf.value("metallic", si, active)
            crossed = bsdf.value("spec_trans", si, active)
            self.clear = (1 - self.metal) * crossed
            self.opaque = (1 - self.metal) * (1 - crossed)
            if bsdf.glass is not None:
                # What is opaque absorbs the light that meets it from inside.
                self.metal = dr.select(self.inside, 0, self.metal)
                self.opaque = dr.select(self.inside, 0, self.opaque)
            self.tint = self.base if bsdf.thin else dr.sqrt(self.base)
            self.eta = dr.select(self.inside, dr.rcp(bsdf.eta), bsdf.eta)
            alpha = dr.square(bsdf.value("roughness", si, active))
            aspect = dr.sqrt(1 - 0.9 * bsdf.value("anisotropic", si, active))
            self.alphas = (
                dr.maximum(alpha / aspect, MIN_ALPHA),
                dr.maximum(alpha * aspect, MIN_ALPHA),
            )
            self.roughness = dr.minimum(dr.sqrt(dr.sqrt(self.alphas[0] * self.alphas[1])), 1)
            self.coat_roughness = bsdf.value("clearcoat_roughness", si, active)

        def _look_up(self) -> None:
            """Constants of the lobes that scatter as a diffuse surface does."""
            bsdf = self.bsdf
            mean = bsdf.albedo_mean(0.5, self.roughness)
            self.coat_norm = 1
            if bsdf.has("clearcoat"):
                coat = bsdf.albedo_mean(0.5, self.coat_roughness)
                reflected = self.clearcoat * (_COAT * coat[0] + coat[1])
                self.coat_norm = dr.rcp(1 - reflected + _COAT_VARIANCE * self.clearcoat)
            self.base_norm = dr.rcp(1 - self.layer(*mean))
            found = mean[0] + mean[1]
            self.lost = dr.maximum(1 - found, 1e-6)
            average = self.base + (1 - self.base) / 21
            self.rebound = dr.square(average) * found / (1 - average * self.lost)
            stays = self.specular * (bsdf.f0 + (1 - bsdf.f0) / 21)
            self.glass = stays, 1 - stays, self.lost, self.lost
            if bsdf.glass is not None:
                squared = dr.square(bsdf.eta)
                self.glass = bsdf.glass.shares(self.inside, self.roughness, squared)

        def layer(self, first: Any, second: Any) -> Any:
            """Reflection of the dielectric layer, of the two parts of a table or of Schlick's."""
            return self.specular * (self.bsdf.f0 * first + second)

        def through(self, cosine: Any, inside: Any) -> tuple[Any, ...]:
            """Light that is not scattered once by the microfacets, for a direction.

            Returns:
                of the metal, of the dielectric layer and of the glass; and of the clear coat.
            """
            bsdf = self.bsdf
            first, second = bsdf.albedo(dr.sqrt(cosine), self.roughness)
            lost, under = 1 - first - second, 1 - self.layer(first, second)
            glass, uncoated = lost, mi.Float(1)
            if bsdf.glass is not None:
                glass = 1 - bsdf.glass.albedo(inside, cosine, self.roughness)[1]
            if bsdf.has("clearcoat"):
                first, second = bsdf.albedo(dr.sqrt(cosine), self.coat_roughness)
                reflected = self.clearcoat * (_COAT * first + second)
                uncoated = dr.select(inside, 1, 1 - reflected)
            return lost, under, glass, uncoated

        def _weigh(self, ctx: Any) -> None:
            """Albedo of the lobes, with which they are sampled: 0 where they are left out."""
            bsdf, cosine = self.bsdf, self.wi.z
            self.passed = lost, under, glass, uncoated = self.through(cosine, self.inside)
            first, second = bsdf.albedo(dr.sqrt(cosine), self.roughness)
            reflected = self.layer(first, second)
            if bsdf.glass is not None:
                reflected = bsdf.glass.albedo(self.inside, cosine, self.roughness)[0]
            base, tint = dr.mean(self.base), dr.mean(self.tint)
            self.enabled = [ctx.is_enabled(kind, index) for index, kind in enumerate(bsdf.m_kinds)]
            weights = [
                self.metal * dr.mean(self.rebound) * lost
                + self.opaque * (1 - self.behind) * base * under
                + self.clear * self.glass[0] * glass,
                self.metal * (base * first + second)
                + self.opaque * self.layer(first, second)
                + self.clear * reflected,
            ]
            if bsdf.transmits:
                weights += [
                    self.opaque * self.behind * base * under
                    + self.clear * tint * self.glass[1] * glass,
                    self.clear * tint * dr.maximum(1 - glass - reflected, 0),
                ]
            weights = [
                weight * uncoated if enabled else mi.Float(0)
                for weight, enabled in zip(weights, self.enabled, strict=True)
            ]
            weights.append((1 - uncoated) if self.enabled[1] else mi.Float(0))
            total = weights[0] + weights[1] + weights[-1]
            if bsdf.transmits:
                total += weights[2] + weights[3]
            self.chances = [dr.select(total > 0, weight / total, 0) for weight in weights]

        def facet(self, cosine: Any) -> tuple[Any, Any, Any, Any]:
            """What a microfacet does, by the cosine of its normal with the first direction.

            Returns:
                factors of reflected and of transmitted light, the probability of the former in
                sampling, and Schlick's weight.
            """
            bsdf = self.bsdf
            weight = dr.power(1 - dr.clip(cosine, 0, 1), 5)
            layer = self.layer(1 - weight, weight)
            reflected = self.metal * (self.base * (1 - weight) + weight) + self.opaque * layer
            if not bsdf.transmits:
                return reflected, mi.Spectrum(0), mi.Float(1), weight
            if bsdf.glass is not None:
                layer = mi.fresnel(cosine, self.eta)[0]
            reflected += self.clear * layer
            crossed = self.clear * self.tint * (1 - layer)
            share = dr.mean(reflected) if self.enabled[1] else mi.Float(0)
            both = share + (dr.mean(crossed) if self.enabled[3] else 0)
            return reflected, crossed, dr.select(both > 0, share / both, 0), weight

        def evaluate(self, ctx: Any, wo: Any) -> tuple[Any, Any]:
            """Value, with the cosine, and density for the second direction."""
            bsdf, wi, wo = self.bsdf, self.wi, wo * self.turn
            above = wo.z > 0
            cosine = dr.abs(wo.z)
            active = self.active & (above if not bsdf.transmits else (cosine > 0))
            scale = mi.Float(1)
            if bsdf.glass is not None and ctx.mode == mi.TransportMode.Radiance:
                scale = dr.select(above, 1, dr.rcp(dr.square(self.eta)))
            lost, under, glass, uncoated = self.through(cosine, self.inside ^ ~above)
            value, pdf = self._diffuse(wo, above, (lost, under, glass))
            single, density, weight = self._facets(wo, above)
            value, pdf = value + single, pdf + density
            value *= scale * self.passed[3] * uncoated
            if bsdf.has("clearcoat") and self.enabled[1]:
                coated, density = self._coat(wo, above & ~self.inside)
                value, pdf = value + coated, pdf + density
            return value & active, dr.select(active, pdf, 0)

        def _diffuse(self, wo: Any, above: Any, passed: tuple[Any, ...]) -> tuple[Any, Any]:
            """The lobes of the base, and of what microfacets scatter more than once."""
            lost, under, glass = (
                first * second for first, second in zip(self.passed[:3], passed, strict=True)
            )
            cosine = dr.abs(wo.z) * dr.inv_pi
            under *= self.base_norm
            base = self.base
            if self.bsdf.has("sheen"):
                half = dr.normalize(self.wi + wo)
                grazing = dr.power(1 - dr.clip(dr.dot(wo, half), 0, 1), 5)
                base = dr.minimum(base + dr.pi * self.sheen * grazing, 1)
            stays, crosses, here, there = self.glass
            value = self.metal * self.rebound * lost / self.lost
            value += self.opaque * (1 - self.behind) * base * under
            value += self.clear * stays * glass / here
            value = value if self.enabled[0] else mi.Spectrum(0)
            chance = self.chances[0]
            if self.bsdf.transmits:
                crossed = self.opaque * self.behind * self.base * under
                crossed += self.clear * self.tint * crosses * glass / there
                crossed = crossed if self.enabled[2] else mi.Spectrum(0)
                value = dr.select(above, value, crossed)
                chance = dr.select(above, chance, self.chances[2])
            return value * cosine * self.coat_norm, cosine * chance

        def _facets(self, wo: Any, above: Any) -> tuple[Any, Any, Any]:
            """The lobes of light that microfacets reflect or transmit once."""
            bsdf, wi = self.bsdf, self.wi
            # The direction that a sheet would reflect.
            seen = wo
            if bsdf.transmits and bsdf.glass is None:
                seen = mi.Vector3f(wo.x, wo.y, dr.abs(wo.z))
            half = wi + seen
            if bsdf.glass is not None:
                half = dr.select(above, half, wi + self.eta * seen)
            half = dr.normalize(half)
            half = dr.mulsign(half, half.z)
            cosine, other = dr.dot(wi, half), dr.dot(seen, half)
            stretch = 1 / (4 * cosine)
            valid = (cosine > 0) & (other > 0)
            if bsdf.glass is not None:
                refracted = dr.abs(other) * dr.square(self.eta / (cosine + self.eta * other))
                stretch = dr.select(above, stretch, refracted)
                valid = (cosine > 0) & (above == (other > 0))
            reflected, crossed, share, weight = self.facet(cosine)
            facets = self._distribution(*self.alphas)
            density = facets.eval(half) * facets.smith_g1(wi, half) * cosine / wi.z * stretch
            density = dr.select(valid, density, 0)
            value = reflected if self.enabled[1] else mi.Spectrum(0)
            if bsdf.transmits:
                crossed = crossed if self.enabled[3] else mi.Spectrum(0)
                value = dr.select(above, value, crossed)
                share = dr.select(above, share, 1 - share)
            chance = self.chances[1] + (self.chances[3] if bsdf.transmits else 0)
            return value * density * facets.smith_g1(seen, half), chance * share * density, weight

        def _coat(self, wo: Any, active: Any) -> tuple[Any, Any]:
            """The lobe of the clear coat."""
            half = dr.normalize(self.wi + wo)
            cosine = dr.dot(self.wi, half)
            weight = dr.power(1 - dr.clip(cosine, 0, 1), 5)
            facets = self._distribution(*self.coat_alphas())
            density = facets.eval(half) * facets.smith_g1(self.wi, half) / (4 * self.wi.z)
            density = dr.select(active, density, 0)
            factor = self.clearcoat * (_COAT + (1 - _COAT) * weight)
            return factor * density * facets.smith_g1(wo, half), self.chances[-1] * density

        def coat_alphas(self) -> tuple[Any, Any]:
            alpha = dr.maximum(dr.square(self.coat_roughness), MIN_ALPHA)
            return alpha, alpha

        def _distribution(self, first: Any, second: Any) -> Any:
            return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, first, second)

        def propose(self, sample: Any, square: Any) -> tuple[Any, Any]:
            """A second direction, and the number of its lobe."""
            bsdf, wi = self.bsdf, self.wi
            base, coated = self.chances[0], self.chances[-1]
            facets = self.chances[1] + (self.chances[3] if bsdf.transmits else 0)
            is_facet = sample < facets
            alphas, is_coat = self.alphas, mi.Bool(False)
            if bsdf.has("clearcoat"):
                is_coat = ~is_facet & (sample < facets + coated)
                alphas = [
                    dr.select(is_coat, coat, own)
                    for coat, own in zip(self.coat_alphas(), alphas, strict=True)
                ]
            normal, _ = self._distribution(*alphas).sample(wi, square)
            cosine = dr.dot(wi, normal)
            wo = 2 * cosine * normal - wi
            lobe = mi.UInt32(1)
            diffuse = mi.warp.square_to_cosine_hemisphere(square)
            diffuse_lobe = mi.UInt32(0)
            if bsdf.transmits:
                crosses = is_facet & (sample >= facets * self.facet(cosine)[2])
                if bsdf.glass is None:
                    through = mi.Vector3f(wo.x, wo.y, -wo.z)
                else:
                    _, refracted, _, inverse = mi.fresnel(cosine, self.eta)
                    through = normal * (cosine * inverse + refracted) - wi * inverse
                wo, lobe = dr.select(crosses, through, wo), dr.select(crosses, mi.UInt32(3), lobe)
                behind = sample >= facets + coated + base
                diffuse.z = dr.select(behind, -diffuse.z, diffuse.z)
                diffuse_lobe = dr.select(behind, mi.UInt32(2), diffuse_lobe)
            single = is_facet | is_coat
            return dr.select(single, wo, diffuse), dr.select(single, lobe, diffuse_lobe)

    class MetallicRoughness(mi.BSDF):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            given = {name: props.get(name) for name in _VALUES if name in props}
            self._absent = {
                name
                for name, value in (_VALUES | given).items()
                if isinstance(value, int | float) and value == 0
            }
            self.textures = {
                name: props.get_texture(name, default) for name, default in _VALUES.items()
            }
            ior = float(props.get("eta", 1.5))
            self.thin = bool(props.get("thin", False))
            self.eta = parameter(mi.Float, ior)
            self.f0 = parameter(mi.Float, ((ior - 1) / (ior + 1)) ** 2)
            self.albedo, self.albedo_mean = _reflection(mi.variant())
            clear = self.has("spec_trans")
            self.transmits = clear or (self.thin and self.has("diff_trans"))
            self.glass = _glass(mi.variant(), ior) if clear and not self.thin else None
            sides = flags.FrontSide | (flags.BackSide if self.transmits else flags.Empty)
            self.m_kinds = [flags.DiffuseReflection, flags.GlossyReflection]
            if self.transmits:
                self.m_kinds += [flags.DiffuseTransmission, flags.GlossyTransmission]
            self.m_components = [kind | sides for kind in self.m_kinds]
            if self.glass is not None:
                # Refraction scales radiance.
                self.m_components[2:] = [
                    kind | flags.NonSymmetric for kind in self.m_components[2:]
                ]
            self.m_flags = functools.reduce(lambda a, b: a | b, self.m_components)

        def has(self, name: str) -> bool:
            """Whether a parameter is not 0 everywhere."""
            return name not in self._absent

        def value(self, name: str, si: Any, active: Any) -> Any:
            """A parameter that is a number, at a point."""
            return self.textures[name].eval_1(si, active) if self.has(name) else mi.Float(0)

        def traverse(self, callback: Any) -> None:
            for name, texture in self.textures.items():
                callback.put(name, texture, mi.ParamFlags.Differentiable)
            callback.put("eta", self.eta, mi.ParamFlags.Differentiable)

        def sample(self, ctx, si, sample1, sample2, active=True):
            point = Point(self, ctx, si, active)
            wo, lobe = point.propose(sample1, sample2)
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo, bs.sampled_component, bs.eta = wo * point.turn, lobe, mi.Float(1)
            bs.sampled_type = mi.UInt32(+self.m_kinds[0])
            for number, kind in enumerate(self.m_kinds):
                bs.sampled_type = dr.select(lobe == number, mi.UInt32(+kind), bs.sampled_type)
            if self.glass is not None:
                bs.eta = dr.select(lobe >= 2, point.eta, 1)
            value, bs.pdf = point.evaluate(ctx, bs.wo)
            # A reflected direction may be below the surface.
            valid = (bs.pdf > 0) & ((lobe < 2) == (wo.z > 0))
            bs.pdf = dr.select(valid, bs.pdf, 0)
            return bs, (value / bs.pdf) & valid

        def eval(self, ctx, si, wo, active=True):
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx, si, wo, active=True):
            return self.eval_pdf(ctx, si, wo, active)[1]

        def eval_pdf(self, ctx, si, wo, active=True):
            return Point(self, ctx, si, active).evaluate(ctx, wo)

        def eval_diffuse_reflectance(self, si, active=True):
            return mi.Color3f(self.textures["base_color"].eval(si, active))

        def to_string(self) -> str:
            return f"MetallicRoughness[{self.textures['base_color']}]"

    return MetallicRoughness
