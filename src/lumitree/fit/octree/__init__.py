"""The octree of a lamp, from traced rays: estimation and refinement.

`bake` puts the parts together, and `config.OctreeConfig` has the settings of each of them, whose
evidence is in docs/decisions/octree-fit.md.

    rays            `rays.RaySource` is the interface; `rays.TracedRays`, and for views
                    `stored.StoredRays`, implement it.
    first field     `estimate` divides the cells in which rays terminate, and fits density and
                    harmonics to the statistics of each leaf.
    descent         `descent.Refiner` descends on the leaves of a `leaf_field.LeafField` by its
                    derivatives, regularises leaves towards their neighbours, and splits those with
                    the largest error indicator. `descent.Descent` spends the budget, saves the
                    state, and keeps the field with the best score on held-out rays.
    calibration     `calibration` corrects emission by region and side after the first estimate,
                    before each splitting and at the end. It then scales L_max, so that the field
                    has the total flux of the luminaire.

Sums over rays are exact (`sums`): equal seeds and ray budgets give equal bytes.
"""
