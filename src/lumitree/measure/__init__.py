"""Figures of lamps, assets and scenes.

`evaluate` compares an asset with its luminaire, by `metrics` of views and `irradiance` around
it. `photometry` measures intensities by direction: `far_field` sums over rays in `batches`,
`near_field` tests the inverse-square law, `photometric_figures` computes figures and their tables.
`illuminance` is estimated at `receivers` by `illuminance_estimate`, and `floor_plan` outlines the
room around them; `glare` rates images. `figures` draws all sheets, plans and reports.
"""
