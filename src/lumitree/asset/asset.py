"""The in-memory form of a baked luminaire, and every invariant it must satisfy.

Symbols
    N   interior nodes          M   leaves          K   (l_max + 1)² coefficients per channel
    octant                      x + 2y + 4z; each of x, y, z is 0 in the lower half, 1 in the upper
"""

import dataclasses
import functools
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.asset.geometry import AssetGeometry
from lumitree.asset.light_field import LightField
from lumitree.core.backend import load_mitsuba
from lumitree.core.frames import LocalFrame
from lumitree.core.harmonics import MAX_L, num_coefficients
from lumitree.core.photometry import WAVELENGTHS
from lumitree.core.reading import expect, expect_arrays, expect_range, label
from lumitree.core.transmittance import LAWS, Law
from lumitree.errors import LumitreeError, shown
from lumitree.octree.build import MAX_TREE_DEPTH

# With values within these bounds all results of a renderer, and squares, are finite in float32.
MIN_RADIANCE, MAX_RADIANCE = 1e-15, 1e15
MAX_DENSITY = 1e15
# Parts that an asset may have: illumination, its image without and with the luminaire itself.
Part = Literal["light", "field", "geometry"]
PARTS: tuple[Part, ...] = get_args(Part)
UNIT_FACTORS = (1.0, 1.0, 1.0)
# Fraction of the luminous flux that must have a known spectrum before the lamp gets one.
_WHOLE = 0.999
_expect = functools.partial(expect, "asset")


@dataclasses.dataclass(frozen=True, eq=False)
class EmittedSpectrum:
    """The spectral power distribution of the light of a luminaire's bare emitters.

    It is the sum over those emitters whose spectra are known, weighted by their luminous flux. The
    effect of glass and surfaces of the luminaire on the light is in the RGB of the asset only.

    Attributes:
        power: float32 [471], power per nm at 360 to 830 nm, 1 nm apart, relative; the largest is 1.
        share: part of the luminous flux of all bare emitters that these emitters have, above 0 and
            at most 1.

    Raises:
        LumitreeError: a member has a wrong type, shape or range.
    """

    power: NDArray[np.float32]
    share: float = 1.0

    def __post_init__(self) -> None:
        """Refuse anything that is no spectrum."""
        expect_arrays("spectrum", {"power": (self.power, np.float32, WAVELENGTHS.shape)})
        expect(
            "spectrum",
            ((self.power >= 0) & (self.power <= 1)).all() and self.power.max() == 1,
            "power is not 0 to 1 with 1 as the largest",
        )
        expect_range("spectrum", "share", self.share, float, 1e-300, 1)

    @property
    def is_whole(self) -> bool:
        """Whether it includes all emitters, but for a thousandth of their luminous flux."""
        return self.share >= _WHOLE

    @staticmethod
    def of(power: NDArray[np.float64], share: float = 1.0) -> "EmittedSpectrum | None":
        """The spectrum of power per nm [471] in any unit; None if all of it is 0.

        `share` is as in `EmittedSpectrum`.
        """
        largest = power.max()
        return EmittedSpectrum((power / largest).astype(np.float32), share) if largest > 0 else None


@dataclasses.dataclass(frozen=True, eq=False)
class Asset:
    """A sparse octree over the cube [-1, 1]³ of the local frame.

    Density and coefficients are constant within a leaf. The emission towards a viewer in
    direction v is Φ = light_factors · max_radiance · sigmoid(Σ coefficient · Y(v)).

    Attributes:
        children: int32 [N, 8], by octant: 0 empty, n > 0 interior node n, c < 0 leaf ~c.
            Node 0 is the root; a node's children come after it.
        density: float32 [M], 0 to 1e15, per local unit of length.
        coefficients: float16 [M, 3, K], spherical-harmonics coefficients of the logit.
        tree_depth: level of the smallest possible leaf, whose side is 2 / 2**tree_depth.
        l_max: highest spherical-harmonics band, 0 to 4.
        law: transmittance law that the field was made for, "linear" or "exponential".
        max_radiance: L_max, the upper end of the emission, 1e-15 to 1e15; radiance units of the
            luminaire's own scene.
        frame: the luminaire's local frame.
        luminaire: name of the luminaire, for messages; kept as a `core.reading.label`.
        light_field: what the luminaire sends to receivers outside its box; None if the field serves
            for that too.
        geometry: the luminaire itself, which `lumitree_path` shows in place of the field; None if
            there is none.
        light_factors: [3] factors on the R, G and B of all light of the asset: of the field, the
            light field and the geometry, which are stored without them. At least 0, not all 0.
        spectrum: of the luminaire's bare emitters; None if only their RGB colours are known.

    Raises:
        LumitreeError: a member has a wrong type, shape or range, or the tree is inconsistent.
    """

    children: NDArray[np.int32]
    density: NDArray[np.float32]
    coefficients: NDArray[np.float16]
    tree_depth: int
    l_max: int
    law: Law
    max_radiance: float
    frame: LocalFrame
    luminaire: str
    light_field: LightField | None = None
    geometry: AssetGeometry | None = None
    light_factors: tuple[float, float, float] = UNIT_FACTORS
    spectrum: EmittedSpectrum | None = None

    def __post_init__(self) -> None:
        """Refuse anything that a renderer could not traverse safely."""
        object.__setattr__(self, "luminaire", label(self.luminaire))
        _check_members(self)
        _check_tree(self.children, len(self.density), self.tree_depth)
        if self.geometry is not None:
            self.geometry.check_inside(self.frame)
            illuminates = self.num_leaves or self.light_field
            _expect(illuminates, "geometry without anything that illuminates")

    def __repr__(self) -> str:
        size = " x ".join(f"{side:.4g}" for side in self.frame.size)
        parts = " + ".join(self.parts) or "empty"
        return (
            f"Asset({shown(repr(self.luminaire))}: {parts}, size {size}, "
            f"{self.num_leaves:,} leaves of depth {self.tree_depth}, {self.num_bytes:,} bytes)"
        )

    @property
    def num_leaves(self) -> int:
        """Number of leaves, M."""
        return len(self.density)

    @property
    def num_bytes(self) -> int:
        """Bytes of the octree, the densities, the coefficients and the other parts."""
        others = sum(part.num_bytes for part in (self.light_field, self.geometry) if part)
        return self.children.nbytes + self.density.nbytes + self.coefficients.nbytes + others

    @property
    def parts(self) -> tuple[Part, ...]:
        """Which of "light", "field" and "geometry" it has."""
        present = (self.light_field is not None, self.num_leaves > 0, self.geometry is not None)
        return tuple(name for name, has in zip(PARTS, present, strict=True) if has)

    @property
    def appearance(self) -> Part:
        """The part that images show under `lumitree_path`: the geometry, the field or the light."""
        present = self.parts
        return next(part for part in ("geometry", "field", "light") if part in present)

    @property
    def is_photometric(self) -> bool:
        """Whether a photometric file or a ray file states its light, with lengths in metres.

        Its intensities and its flux are absolute: they stay if the lamp is scaled.
        """
        return self.light_field is not None and self.light_field.absolute

    @property
    def without_factors(self) -> "Asset":
        """The asset with factors of 1: with the light of the luminaire that it was baked from."""
        if self.light_factors == UNIT_FACTORS:
            return self
        return dataclasses.replace(self, light_factors=UNIT_FACTORS)

    @property
    def near_origin(self) -> "Asset":
        """The asset, moved to the origin of its file if its coordinates are too coarse there."""
        if not self.frame.is_far:
            return self
        offset, geometry = -self.frame.centre, self.geometry
        if geometry is not None:
            x, y, z = (np.array(geometry.origin) + offset).tolist()
            geometry = dataclasses.replace(geometry, origin=(x, y, z))
        return dataclasses.replace(self, frame=self.frame.moved(offset), geometry=geometry)

    def scaled(self, factor: float) -> "Asset":
        """The asset of the luminaire with all lengths of its file times a factor.

        Radiance stays, so that intensities and flux are multiplied by the factor's square.
        """
        geometry = None if self.geometry is None else self.geometry.scaled(factor)
        return dataclasses.replace(self, frame=self.frame.scaled(factor), geometry=geometry)

    @property
    def info(self) -> "AssetInfo":
        """Size, depth and bounds of the asset."""
        traced = None if self.light_field is None else self.light_field.traced
        inside = None if self.light_field is None else self.light_field.inside
        return AssetInfo(
            luminaire=self.luminaire,
            tree_depth=self.tree_depth,
            leaves=self.num_leaves,
            nodes=len(self.children),
            l_max=self.l_max,
            law=self.law,
            max_radiance=self.max_radiance,
            size=tuple(self.frame.size.tolist()),
            centre=tuple(self.frame.centre.tolist()),
            light_field_cells=0 if self.light_field is None else len(self.light_field.cells),
            light_inside_cells=0 if inside is None else len(inside.cells),
            light_field_paths=None if traced is None else traced.count,
            light_field_noise=None if traced is None else traced.noise,
            geometry_triangles=0 if self.geometry is None else self.geometry.num_triangles,
            parts=self.parts,
            appearance=self.appearance,
            light_factors=self.light_factors,
            spectrum_share=None if self.spectrum is None else self.spectrum.share,
        )

    def eval(
        self, origin: ArrayLike, direction: ArrayLike
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Radiance emitted along rays, and their transmittance (Eq. 3 and 4).

        A ray crosses the whole luminaire, also the part that lies behind its origin.

        Args:
            origin: [N, 3] any point on each ray, in the frame and unit of the luminaire's file.
            direction: [N, 3] directions of travel, away from the viewer, of any length but 0.

        Returns:
            Radiance [N, 3], W/(m² sr), that a viewer outside the luminaire receives along each
            ray; and transmittance [N] in [0, 1].

        Raises:
            LumitreeError: the arrays are not [N, 3] finite numbers, or a direction is 0.
        """
        origin, direction = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
        if origin.shape != direction.shape or origin.ndim != 2 or origin.shape[1] != 3:
            raise LumitreeError(
                f"origin is {origin.shape} and direction {direction.shape}; expected [N, 3] both"
            )
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        if not (np.isfinite(origin).all() and np.isfinite(length).all() and (length > 0).all()):
            raise LumitreeError("rays need finite origins and finite directions other than 0")
        load_mitsuba()
        from lumitree.octree.field import shared_field

        frame, rotation = self.frame, self.frame.rotation
        local = (origin - frame.centre) @ rotation / frame.scale
        return shared_field(self).eval_rays(local, direction / length @ rotation)


@dataclasses.dataclass(frozen=True)
class AssetInfo:
    """Size, depth and bounds of an asset.

    Attributes:
        luminaire: name of the luminaire.
        tree_depth: level of the smallest possible leaf.
        leaves, nodes: numbers of leaves and of interior nodes of the octree.
        l_max: highest spherical-harmonics band.
        law: transmittance law, "linear" or "exponential".
        max_radiance: upper end of the emission without `light_factors`, W/(m² sr).
        size: [3] sides of the bounding box, in the unit of the luminaire's file.
        centre: [3] centre of the bounding box, in the frame of the luminaire's file.
        light_field_cells: number of cells of the light field; 0 if there is none.
        light_inside_cells: number of cells that light receivers inside the box; 0 if the light
            field lights only those outside.
        light_field_paths: number of light paths that it was estimated from; None if not known.
        light_field_noise: relative standard error of its intensity by direction, see `TracedPaths`;
            None if it is not known.
        geometry_triangles: number of triangles of the geometry; 0 if there is none.
        parts: which of "light", "field" and "geometry" it has.
        appearance: which of them images show under `lumitree_path`.
        light_factors: [3] factors on the R, G and B of its light; not 1 if it was mixed or baked
            with a luminous flux or a colour temperature.
        spectrum_share: part of the luminous flux of the luminaire's emitters whose spectrum is
            known; None if no spectrum is known.
    """

    luminaire: str
    tree_depth: int
    leaves: int
    nodes: int
    l_max: int
    law: Law
    max_radiance: float
    size: tuple[float, ...]
    centre: tuple[float, ...]
    light_field_cells: int
    geometry_triangles: int
    parts: tuple[Part, ...]
    appearance: Part
    light_inside_cells: int = 0
    light_field_paths: int | None = None
    light_field_noise: float | None = None
    light_factors: tuple[float, float, float] = UNIT_FACTORS
    spectrum_share: float | None = None


def light_field_asset(
    light_field: LightField,
    frame: LocalFrame,
    luminaire: str,
    spectrum: EmittedSpectrum | None = None,
) -> Asset:
    """An asset whose field is empty: it lights its surroundings, and lets all light through."""
    return Asset(
        children=np.zeros((1, 8), np.int32),
        density=np.zeros(0, np.float32),
        coefficients=np.zeros((0, 3, 1), np.float16),
        tree_depth=1,
        l_max=0,
        law="exponential",
        max_radiance=1.0,
        frame=frame,
        luminaire=luminaire,
        light_field=light_field,
        spectrum=spectrum,
    )


def _check_members(asset: Asset) -> None:
    expect_range("asset", "tree depth", asset.tree_depth, int, 1, MAX_TREE_DEPTH)
    expect_range("asset", "l_max", asset.l_max, int, 0, MAX_L)
    _expect(asset.law in LAWS, f"transmittance law {asset.law!r}, expected one of {LAWS}")
    radiance, factors = asset.max_radiance, asset.light_factors
    expect_range("asset", "maximum radiance", radiance, float, MIN_RADIANCE, MAX_RADIANCE)
    valid = len(factors) == 3 and all(type(each) is float and each >= 0 for each in factors)
    _expect(
        valid and any(factors),
        f"light factors {factors!r}, expected three numbers of at least 0, not all 0",
    )
    field = asset.light_field
    lights = [] if field is None else [field, *([field.inside] if field.inside else [])]
    brightest = max(factors) * max(radiance, *(light.scale for light in lights), 0.0)
    _expect(
        brightest <= MAX_RADIANCE,
        f"light factors {factors!r}, with which emission exceeds {MAX_RADIANCE}",
    )
    # An array may have no dimensions, and so no length.
    leaves, nodes = asset.density.size, asset.children.shape[:1]
    coefficients = (leaves, 3, num_coefficients(asset.l_max))
    expect_arrays(
        "asset",
        {
            "children": (asset.children, np.int32, (*nodes, 8)),
            "density": (asset.density, np.float32, (leaves,)),
            "coefficients": (asset.coefficients, np.float16, coefficients),
        },
    )
    _expect(
        ((asset.density >= 0) & (asset.density <= MAX_DENSITY)).all(),
        f"density has NaN, negative values or values above {MAX_DENSITY}",
    )
    _expect(np.isfinite(asset.coefficients).all(), "coefficients have NaN or infinity")


def _check_tree(children: NDArray[np.int32], num_leaves: int, tree_depth: int) -> None:
    num_nodes = len(children)
    _expect(num_nodes >= 1, "the tree has no root")
    nodes, leaves = children[children > 0], ~children[children < 0]
    _expect(not len(nodes) or nodes.max() < num_nodes, "a node index is out of range")
    _expect(
        (np.bincount(nodes, minlength=num_nodes)[1:] == 1).all(),
        "interior nodes are not each referenced exactly once",
    )
    _expect(not len(leaves) or leaves.max() < num_leaves, "a leaf index is out of range")
    _expect(
        len(leaves) == num_leaves and (np.bincount(leaves, minlength=num_leaves) == 1).all(),
        "leaves are not each referenced exactly once",
    )
    # A tree in which every node is referenced once and reached from the root has no cycle.
    level, reached = np.array([0]), 0
    for _ in range(tree_depth):
        reached += len(level)
        below = children[level]
        level = below[below > 0]
    _expect(
        reached == num_nodes and not len(level),
        f"the tree is deeper than {tree_depth} levels or not connected",
    )
