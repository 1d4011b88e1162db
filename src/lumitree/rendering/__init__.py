"""Assets in Mitsuba scenes: placement, images, passes.

`scene` reads scenes (files, dictionaries, `mi.Scene`), chooses the integrator and places the
luminaires, `render` returns images as arrays, and `saved_image` writes them. Assets are opened by
`asset_cache`, and each is shared while anything uses it. Points are taken relative to the lamp's
centre before they are rotated and scaled, so a lamp far from the origin loses no precision. The
gains of an asset and of an instance multiply all radiance and flux; sampling does not depend on
them.
"""
