"""The octree of a lamp, from traced rays: estimation and refinement.

`bake` puts the parts together, and `config.OctreeConfig` has the settings of each of them, whose
evidence is in docs/decisions/octree-fit.md.

    rays            `ray_source.RaySource` is the interface; `traced.TracedRays`, and for views
                    `stored.StoredRays`, implement it. Random rays come in tiles (`ray_tiles`).
    first field     `growth` divides the cells in which rays terminate (`termination`), `estimate`
                    fits density and harmonics to the statistics of each leaf (`leaf_statistics`).
    descent         `refine.Refiner` descends on the leaves of a `leaf_field.LeafField` by the
                    derivatives in `adjoint`, regularises leaves towards their neighbours, and
                    splits those with the largest error indicator. `descent` spends the budget, and
                    keeps the best field by `heldout`.
    interruption    `saved_state` has the state from which an interrupted bake continues.
    calibration     `calibration` corrects emission by region and side after the first estimate,
                    before each splitting and at the end; `flux_correction` then scales L_max, so
                    that the total flux is that of the luminaire.
"""
