"""Built-in luminaires, one module each.

Frame of every lamp: metres, y up, the origin where it meets the ceiling (hanging lamps) or what it
stands on. Emitted radiance is in W/(m² sr) for each of R, G and B; its scale is
arbitrary.

Glass walls are solid: an outer and an inner surface around them, each closed, normals out of the
glass. Nothing touches the glass, and every filament is an emitter of its own, because Mitsuba
chooses among emitters uniformly and all filaments are equally bright. Metal parts may overlap
where they are joined. Equal parts share one mesh.
"""
