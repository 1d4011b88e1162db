"""The plugins of Mitsuba: emitter, BSDF, shape, and the integrator.

`shape` makes the proxy and, where images show the geometry of a lamp, its shapes
(`geometry_shapes`) with emitters and glass of their own (`geometry_plugins`). Then the proxy
transmits all light, and emits only for paths that had a vertex that was not specular. `integrator`
is `lumitree_path`, a loop of blocks: `path_segments`, `path_emission`, `path_vertices`, which read
a `PathScene` and change a `PathState`. `proxies` finds the proxies that a ray enters, `shadow_rays`
the transmittance to a light, and `deferred_emitter` is the protocol of emitters that evaluate no
radiance for occluded directions. `objects` creates scenes with lamps in one thread.
"""
