"""Text of IES LM-63-2002 files, written by the standard and by nothing of lumitree."""


def ies_text(intensity, c, gamma, opening=(0, 0, 0)):
    """Text of a file of Type C and absolute photometry.

    Args:
        intensity: [C][G] luminous intensity, cd.
        c, gamma: angles of the half-planes and from straight down, degrees.
        opening: width along C = 90, length along C = 0, and height, m.
    """

    def row(values):
        return " ".join(f"{each:.9g}" for each in values)

    sides = row(opening)
    return "\n".join(
        [
            "IESNA:LM-63-2002",
            "[TEST] none",
            "TILT=NONE",
            f"1 -1 1 {len(gamma)} {len(c)} 1 2 {sides}",
            "1 1 10",
            row(gamma),
            row(c),
            *(row(each) for each in intensity),
            "",
        ]
    )
