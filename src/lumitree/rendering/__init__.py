"""Assets in Mitsuba scenes: placement, images, passes.

`scene.load_scene` reads rooms (files, dictionaries, `mi.Scene`), `integrators` chooses the
integrator, `render` returns images as arrays, and `saved_image` writes them. Assets are opened by
`asset_cache`, which shares what is on the device while anything uses it. Points are taken relative
to the lamp's centre before they are rotated and scaled, so a lamp far from the origin loses no
precision. The gains of an asset and of an instance multiply all radiance and flux; sampling
does not depend on them.
"""
