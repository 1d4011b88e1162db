"""Texts of IES TM-33 files."""

import numpy as np

C, GAMMA = np.arange(0, 360, 22.5), np.arange(0, 181, 5.0)
AREA = (
    "<EmissionAreas><BottomFace><NumberBottom>1</NumberBottom><BottomArea><Length>0.6</Length>"
    "<Width>0.2</Width><LengthOffset>0</LengthOffset><WidthOffset>0</WidthOffset></BottomArea>"
    "</BottomFace></EmissionAreas>"
)


def candela(c, gamma):
    """300 cos γ cd below, with a part that depends on C."""
    c, gamma = np.deg2rad(c), np.deg2rad(gamma)
    return 300 * np.maximum(np.cos(gamma), 0) * (1 + 0.5 * np.sin(gamma) * np.cos(c))


def table(c=C, gamma=GAMMA, scale=1.0, extra="", point="IntData", keys=("h", "v")):
    """XML of intensities."""
    rows = "".join(
        f'<{point} {keys[0]}="{h:g}" {keys[1]}="{v:g}">{scale * candela(h, v):.6g}</{point}>'
        for h in c
        for v in gamma
    )
    return f"<LuminousIntensity>{extra}{rows}</LuminousIntensity>"


def tm33(data=None, areas=AREA, before="", after="", root="IESTM33-22", top="", emitters=1):
    """Text of a TM-33 file."""
    data = table() if data is None else data
    emitter = (
        f"<Emitter><Quantity>1</Quantity>{before}<LuminousData>{data}</LuminousData>{after}{areas}"
        "</Emitter>"
    )
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n<!-- A <scene> in a hall -->\n'
        f"<{root}><Version>1.1</Version><Header><Description>A lamp</Description></Header>"
        "<Luminaire><Dimensions><Length>0.7</Length><Width>0.3</Width><Height>0.1</Height>"
        f"</Dimensions><NumEmitter>1</NumEmitter></Luminaire>{top}{emitters * emitter}</{root}>"
    )
