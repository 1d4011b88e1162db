"""Mitsuba's names of measured materials: conductors, and indices of refraction."""

# Names of conductors; the first group comes from two sources. "AlSb" and "AlSb_palik" are
# left out: Mitsuba's tables of them give NaN in RGB variants.
_MEASURED_TWICE = (
    *("AlAs", "Be", "CsI", "Cu", "Cu2O", "CuO", "d-C", "Hg", "HgTe", "Ir", "K", "Li", "MgO"),
    *("Mo", "Nb", "Rh", "Se", "Se-e", "SiC", "SnTe", "Ta", "Te", "Te-e", "ThF4", "TiC", "TiN"),
    *("TiO2", "TiO2-e", "VC", "VN"),
)
CONDUCTORS = frozenset(
    (
        *("none", "a-C", "Ag", "Al", "Au", "Cr", "W", "Na_palik", "Ni_palik", "V_palik"),
        *(f"{name}{source}" for name in _MEASURED_TWICE for source in ("", "_palik")),
    )
)
# Indices of refraction by name.
INDICES = {
    "vacuum": 1.0,
    "helium": 1.000036,
    "hydrogen": 1.000132,
    "air": 1.000277,
    "carbon dioxide": 1.00045,
    "water": 1.333,
    "acetone": 1.36,
    "ethanol": 1.361,
    "carbon tetrachloride": 1.461,
    "glycerol": 1.4729,
    "benzene": 1.501,
    "silicone oil": 1.52045,
    "bromine": 1.661,
    "water ice": 1.31,
    "fused quartz": 1.458,
    "pyrex": 1.47,
    "acrylic glass": 1.49,
    "polypropylene": 1.49,
    "bk7": 1.5046,
    "sodium chloride": 1.544,
    "amber": 1.55,
    "pet": 1.575,
    "diamond": 2.419,
}
