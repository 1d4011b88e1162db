"""Luminous intensity by direction: measurement, figures, reports.

`far_field` sums over the rays that leave a luminaire or an asset, in 16 batches;
`far_field_figures` computes figures of it. `near_field` counts rays where they cross spheres, and
`exact_light` evaluates light fields and photometric files without rays.
"""
