"""Time of a field query against that of a plain area light: python benchmarks/query.py ASSET.

Random lines through the proxy box, incoherent on purpose. The baseline is what Mitsuba does for the
same rays where the lamp is a plain emissive cube: one intersection and one constant emission.
Interleaved, medians of several rounds.
"""

import statistics
import sys
import time

import numpy as np

from lumitree.asset.file import load
from lumitree.core.backend import load_mitsuba

NUM_RAYS = 1 << 20
ROUNDS = 7


def main(path: str) -> None:
    mi = load_mitsuba()
    import drjit as dr

    from lumitree.render.field import Field

    asset = load(path)
    field = Field(asset)
    cube = mi.load_dict(
        {
            "type": "scene",
            "lamp": {
                "type": "cube",
                "to_world": mi.ScalarTransform4f().scale(asset.half_extents.tolist()),
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
            },
        }
    )
    random = np.random.default_rng(0)
    d = random.normal(size=(NUM_RAYS, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o = random.uniform(-1, 1, (NUM_RAYS, 3)) * asset.half_extents - 3 * d
    origin, direction = mi.Point3f(o.T), mi.Vector3f(d.T)

    def area_light():
        si = cube.ray_intersect(mi.Ray3f(origin, direction))
        return si.emitter(cube).eval(si)

    jobs = {
        "area light (baseline)": area_light,
        "transmittance": lambda: field.transmittance(origin, direction),
        "emission": lambda: field.emission(origin, direction),
    }
    times: dict[str, list[float]] = {name: [] for name in jobs}
    for round_index in range(ROUNDS + 1):
        for name, job in jobs.items():
            dr.sync_thread()
            start = time.perf_counter()
            dr.eval(job())
            dr.sync_thread()
            if round_index:  # the first round compiles
                times[name].append((time.perf_counter() - start) / NUM_RAYS * 1e9)
    medians = {name: statistics.median(values) for name, values in times.items()}
    baseline = medians["area light (baseline)"]
    print(
        f"{asset.luminaire}, depth {asset.tree_depth}, {asset.num_leaves} leaves, {mi.variant()}, "
        f"Mitsuba {mi.__version__}"
    )
    print("| query | ns a ray | ratio |\n|---|---|---|")
    for name, value in medians.items():
        print(f"| {name} | {value:.0f} | {value / baseline:.1f} |")


if __name__ == "__main__":
    main(sys.argv[1])
