"""Assets in Mitsuba scenes: placement, images, passes.

`scene` reads scenes (files, dictionaries, `mi.Scene`), chooses the integrator and places the
luminaires; `render` returns images as arrays, `image` writes and mixes them, and `photograph` makes
what a display shows. Assets are opened by `asset_cache`, and `device` has their copies on the
device.

The plugins of Mitsuba, which `register` registers: `shapes` makes the proxy of a lamp and, where
images show its geometry, the shapes of `geometry`. `emitter` and `null_bsdf` are attached to the
proxy. `integrator` is `lumitree_path`; `lamps` chooses among the emitters of a scene, and `proxies`
finds the proxies that a ray enters.

The light of a lamp is sampled from cells of its light field (`device_light`, `light_table`,
`light_levels`), or from its emitters (`straight_light`); `field_rays` samples a radiance field.

Points are taken relative to the lamp's centre before they are rotated and scaled, so a lamp far
from the origin loses no precision. The factors of an asset and of an instance multiply all
radiance and flux; sampling does not depend on them.
"""
