"""Sampling of the light that an asset sends to a receiver.

`divided_sampling` decides which rays get the field and which the light field. Of a light field,
cells are sampled (`light_field`; inside the lamp's box `light_inside`) from an alias table for the
cell of the receiver (`cell_table`, `receiver_cells`, `alias_table`); for receivers farther away,
sums of cells (`light_levels`). Of a field, leaves are sampled
(`emitter_sampling`, `light_leaves`); a tenth of the samples is uniform over the bounding sphere, so
the density is nowhere 0 where light may come from, and no weight exceeds 40 π times the radiance.
`straight_light` samples a lamp's own emitters.
"""
