"""`merge`: bakes of one luminaire with different seeds, combined."""

import dataclasses
import os
from collections.abc import Sequence

from lumitree.asset.asset import Asset
from lumitree.asset.light_field import LightField
from lumitree.core.arguments import check_asset_output
from lumitree.core.files import FilePath
from lumitree.core.stopwatch import Stopwatch
from lumitree.core.turns import in_turn
from lumitree.errors import LumitreeError, shown
from lumitree.fit.result import BakeResult
from lumitree.fit.work import save_asset
from lumitree.rendering.asset_cache import open_asset


@in_turn
def merge(assets: "Sequence[Asset | FilePath]", output: FilePath | None = None) -> BakeResult:
    """Combine light fields of one luminaire that were baked with different seeds.

    The result is what one bake with all of their light paths gives: the mean of the intensities,
    weighted by the number of paths. So a luminaire can be baked on several machines. All other
    parts of the asset are those of the first asset that has a field, or else of the first.

    Args:
        assets: at least two assets, or paths of their `.lumitree` files.
        output: path of the `.lumitree` file to write. Default: no file is written.

    Returns:
        The asset (`asset`) and its file (`path`). `asset.info` has the number of light paths
        (`light_field_paths`) and the noise (`light_field_noise`).

    Raises:
        LumitreeError: there are fewer than two assets; one has no light field, or does not
            state its light paths; they are of different luminaires, or have different grids or
            numbers of bins; two have a seed in common, or different gains; or a file cannot be
            read or written.

    Example:
        >>> for seed in (0, 1):
        ...     config = lumitree.BakeConfig(parts=("light",), seed=seed)
        ...     lumitree.bake("bulbs", f"{seed}.lumitree", config)
        >>> result = lumitree.merge(["0.lumitree", "1.lumitree"], "bulbs.lumitree")
        >>> result.asset.info.light_field_paths
    """
    if output is not None:
        check_asset_output(output)
    if isinstance(assets, Asset | str | os.PathLike) or len(assets) < 2:
        raise LumitreeError("merge takes at least two assets; give another one")
    from lumitree.fit.light_field.merge import merge_light_fields

    watch = Stopwatch()
    with watch.stage("merge"):
        loaded = [open_asset(each) for each in assets]
        names = [_name(number, given) for number, given in enumerate(assets)]
        fields = [_light_field(*each) for each in zip(loaded, names, strict=True)]
        light_field = merge_light_fields(fields, names)
        for name, asset in zip(names, loaded, strict=True):
            if asset.frame != loaded[0].frame:
                raise LumitreeError(
                    f"{names[0]} and {name} have different bounding boxes; expected assets of one "
                    "luminaire"
                )
            if asset.gain != loaded[0].gain:
                raise LumitreeError(
                    f"{names[0]} and {name} have different gains; expected assets of one luminous "
                    "flux and colour: bake them without lumens and temperature, and merge then"
                )
        base = next((asset for asset in loaded if asset.num_leaves), loaded[0])
        asset = dataclasses.replace(base, light_field=light_field)
        path = save_asset(asset, output)
    return BakeResult(asset=asset, path=path, **watch.costs())


def _light_field(asset: Asset, name: str) -> LightField:
    if asset.light_field is None:
        raise LumitreeError(f"{name} has no light field; bake it again with the part light")
    return asset.light_field


def _name(number: int, asset: Asset | FilePath) -> str:
    """What an argument is called in messages."""
    if isinstance(asset, Asset):
        return f"asset {number + 1} ({shown(asset.luminaire, 100)})"
    return shown(asset, 300)
